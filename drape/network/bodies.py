"""Posed bodies as the network sees them: bones, the code of the pose, and the skin that patches feel.

The formulas are those of ``drape.geometry.rigid``, ``drape.body.features`` and ``drape.contact.skin``, in
``drape/engine/source/body.hpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.body.features import STATIC_PER_JOINT, Kinematics, joint_rotations
from drape.body.feed import BodyFeed
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.contact.samples import REGION_SIZE
from drape.engine.calls import call, call_with_scratch
from drape.engine.packer import Recorded
from drape.network.weights import Weights

NO_POSE = np.zeros((0, 4), np.float32)  # of a feed without a pose


@dataclass(frozen=True, eq=False)
class PosedBody(Recorded):
    """A posed body as the network reads it. Places count from the root joint's rest place.

    ``quaternion`` (24, 4) wxyz of any length, ``rotation`` (24, 9) and ``translation`` [m] (24, 3) are the bones'
    motion from the T-pose; ``place`` [m] (24, 3) are the posed joints. ``code`` (n,) is the summand of the decoder's
    first layer that depends on the body alone, ``betas`` (10,) its shape. ``skin`` (S, 8) are the posed samples,
    ``region`` (R, 4) the mean point [m] of each region of samples and half of its square.
    """

    quaternion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    place: np.ndarray
    code: np.ndarray
    betas: np.ndarray
    skin: np.ndarray
    region: np.ndarray


def pose_bodies(weights: Weights, feed: BodyFeed, skin: np.ndarray) -> PosedBody:
    """Returns the posed body of ``feed``. Its samples are written to ``skin`` (S, 8); where ``feed`` has no rows for
    them, ``skin`` must hold them already."""
    kind = skin.dtype
    quaternion, rotation, translation, place = (np.empty((JOINT_COUNT, size), kind) for size in (4, 9, 3, 3))
    code, region = np.empty(len(weights.from_body.bias), kind), np.empty((len(skin) // REGION_SIZE, 4), kind)
    body = PosedBody(quaternion, rotation, translation, place, code, feed.betas, skin, region)
    call_with_scratch("pose_body", kind, weights, feed, body)
    return body


def moments(body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None) -> Kinematics:
    """Returns pose features, joints [m] in the world and bone rotations of F frames, float64, of a body of one shape
    ``betas`` (S,), for ``poses`` (F, 24, 3) [rad] and root translations ``trans`` [m] (F, 3)."""
    count = len(poses)
    static, joints = np.empty((count, JOINT_COUNT, STATIC_PER_JOINT)), np.empty((count, JOINT_COUNT, 3))
    rotations = np.empty((count, JOINT_COUNT, 3, 3))
    trans, rest = (np.ascontiguousarray(each, np.float64) for each in (trans, body.rest_joints(betas)))
    call("moments", np.float64, joint_rotations(poses)[0], trans, rest, count, static, joints, rotations)
    return Kinematics(static, joints, rotations)
