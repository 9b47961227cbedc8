"""How unlike training poses are: ``drape.body.pose_distance.PoseSupport.novelty``, by the engine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.body.features import joint_rotations
from drape.body.pose_distance import PART_ENTRIES, PART_JOINTS, PoseSupport
from drape.engine.calls import call_with_scratch
from drape.engine.packer import Recorded
from drape.network.dense import Layer, body_layer


@dataclass(frozen=True, eq=False)
class KeptPoses(Recorded):
    """The poses that the network was trained on, as the engine measures distances to them (``PoseSupport``).

    For each part of the body ``parts`` has a layer that gives |k|^2 - 2 k.x for each kept pose k, and ``counts`` the
    number of poses. Inputs x of the layers are numbers of the pose's rotation matrices (24, 3, 3): ``entry`` are their
    indices in these, part after part. Squares of distances are divided by ``over``, one number for each part.
    """

    parts: tuple[Layer, ...]
    counts: np.ndarray
    entry: np.ndarray
    over: np.ndarray


def kept_poses(support: PoseSupport) -> KeptPoses:
    """Returns the poses of ``support`` as the engine reads them."""
    return KeptPoses(
        tuple(body_layer(-2.0 * columns.T, squares) for columns, squares in support.columns),
        np.array([len(squares) for _, squares in support.columns], np.int32),
        np.concatenate(PART_ENTRIES).astype(np.int32),
        (PART_JOINTS * support.limits**2).astype(np.float32),
    )


def novelty(kept: KeptPoses, poses: np.ndarray) -> np.ndarray:
    """Returns how unlike the poses of training each of ``poses`` (F, 24, 3) [rad] is, (F,) float32: above 1 it is
    novel."""
    matrices, found = joint_rotations(poses)[1].astype(np.float32), np.empty(len(poses), np.float32)
    call_with_scratch("novelty", np.float32, kept, matrices, len(poses), found)
    return found
