"""Posed bodies as the network sees them, compiled: bones, the code of the pose, and the skin that patches feel.

The formulas are those of ``drape.geometry.rigid``, ``drape.body.features`` and ``drape.contact.skin``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.body.features import STATIC_PER_JOINT, Kinematics
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.contact.samples import REGION_SIZE
from drape.graph.inputs import SLOPE
from drape.graph.packed import PART_SIZE
from drape.kernels.compiled import kernel
from drape.kernels.lanes import LANES, most, put, put_points, root, row_at
from drape.kernels.rotations import put_matrix, put_product, put_quaternion
from drape.network.dense import run_body_layer

_PARENTS = np.array(PARENTS)


class BodyFeed(NamedTuple):
    """What a body is posed by: ``local`` quaternions (24, 4), joints at ``rest`` [m] (24, 3), shape ``betas``, the
    ``motion`` that is added to the code of the pose, and the skin on its bones: ``skin_rows`` (P, n, 4, 144), none
    where the skin is given, ``skin_bones`` (P, n), and how many of these count (P,)."""

    local: np.ndarray
    rest: np.ndarray
    betas: np.ndarray
    motion: np.ndarray
    skin_rows: np.ndarray
    skin_bones: np.ndarray
    skin_counts: np.ndarray


class PosedBody(NamedTuple):
    """A body: of its bones the ``quaternion`` (24, 4), of any length, ``rotation`` (24, 9), ``translation`` and joint
    ``place`` [m] (24, 3); the body's half of the first layer, ``code``; shape components ``betas``; samples ``skin``
    (S, 8) and the mean points of their ``region`` [m] (R, 4), with half of their squares."""

    quaternion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    place: np.ndarray
    code: np.ndarray
    betas: np.ndarray
    skin: np.ndarray
    region: np.ndarray


@kernel
def posed_body(weights, feed, skin):
    """The ``PosedBody`` of ``feed``. Its ``skin`` (S, 8) is written, or given where ``feed`` has no rows for it."""
    local, rest = feed.local, feed.rest
    kind = local.dtype.type
    quaternion, rotation = np.empty((JOINT_COUNT, 4), local.dtype), np.empty((JOINT_COUNT, 9), local.dtype)
    translation, place = np.empty((JOINT_COUNT, 3), local.dtype), np.empty((JOINT_COUNT, 3), local.dtype)
    place[0] = kind(0)
    _pose_bones(local, rest, quaternion, rotation, place)
    for joint in range(JOINT_COUNT):
        for axis in range(3):
            total = place[joint, axis]
            for i in range(3):
                total -= rotation[joint, 3 * axis + i] * rest[joint, i]
            translation[joint, axis] = total
    code = _code(weights, feed, rotation)
    if len(feed.skin_rows):
        _pose_skin(rotation, translation, feed, skin)
    return PosedBody(quaternion, rotation, translation, place, code, feed.betas, skin, _regions(skin))


@kernel
def _pose_bones(local, rest, quaternion, rotation, place):
    """Writes quaternions (24, 4), rotations (24, 9) and joints [m] (24, 3) of bones with ``local`` quaternions.

    The root stays at its ``place``.
    """
    for joint in range(JOINT_COUNT):
        parent, own = _PARENTS[joint], quaternion[joint]
        if parent < 0:
            own[:] = local[joint]
        else:
            put_product(quaternion[parent], local[joint], own)
            for axis in range(3):
                total = place[parent, axis]
                for i in range(3):
                    total += rotation[parent, 3 * axis + i] * (rest[joint, i] - rest[parent, i])
                place[joint, axis] = total
        put_matrix(own, rotation[joint])


def moments(body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None) -> Kinematics:
    """``drape.graph.feeds.kinematics`` of one shape, compiled: ``poses`` (F, 24, 3) [rad], ``trans`` (F, 3) [m]."""
    poses, trans, rest = _float64(poses), _float64(trans), _float64(body.rest_joints(betas))
    count = len(poses)
    static, joints = np.empty((count, JOINT_COUNT, STATIC_PER_JOINT)), np.empty((count, JOINT_COUNT, 3))
    rotations = np.empty((count, JOINT_COUNT, 9))
    _write_moments(poses, trans, rest, static, joints, rotations)
    return Kinematics(static, joints, rotations.reshape(count, JOINT_COUNT, 3, 3))


def _float64(array: np.ndarray) -> np.ndarray:
    return np.array(array, np.float64, order="C")  # a copy: kernels are compiled for arrays that may be written


@kernel
def _write_moments(poses, trans, rest, static, joints, rotations):
    local, quaternion = np.empty((JOINT_COUNT, 4)), np.empty((JOINT_COUNT, 4))
    for frame in range(len(poses)):
        for joint in range(JOINT_COUNT):
            put_quaternion(poses[frame, joint], local[joint])
        for i in range(3):
            joints[frame, 0, i] = rest[0, i] + trans[frame, i]
        _pose_bones(local, rest, quaternion, rotations[frame], joints[frame])
        _describe(local, rotations[frame], static[frame].reshape(-1))


@kernel
def _describe(local, rotation, features):
    """Writes ``drape.body.features.static_features`` of ``local`` quaternions and the bones' ``rotation`` (24, 9)."""
    kind, matrix = local.dtype.type, np.empty(9, local.dtype)
    for joint in range(JOINT_COUNT):
        own = features[STATIC_PER_JOINT * joint :]
        put_matrix(local[joint], matrix)
        for i in range(3):
            # The root's own turn is not told.
            own[i] = matrix[3 * i] if joint else kind(i == 0)
            own[3 + i] = matrix[3 * i + 1] if joint else kind(i == 1)
            own[6 + i] = -rotation[joint, 3 + i]


@kernel
def _code(weights, feed, rotation):
    """The body's half of the first layer: features, the layers of its code, and ``from_body``."""
    local = feed.local
    kind = local.dtype.type
    features = np.zeros(len(weights.mean), local.dtype)
    _describe(local, rotation, features)
    features[STATIC_PER_JOINT * JOINT_COUNT :] = feed.betas
    for i in range(len(features)):
        scaled = (features[i] - weights.mean[i]) * weights.inverse_deviation[i]
        features[i] = min(max(scaled, kind(-5)), kind(5))
    last = len(weights.body) - 1
    for number in range(len(weights.body)):
        layer = weights.body[number]
        outputs = np.empty(len(layer.bias), local.dtype)
        run_body_layer(layer, features, kind(1 if number == last else SLOPE), outputs)
        features = outputs
    features[: len(feed.motion)] += feed.motion
    code = np.empty(len(weights.from_body.bias), local.dtype)
    run_body_layer(weights.from_body, features, kind(1), code)
    return code


@kernel
def _pose_skin(rotation, translation, feed, skin):
    """Writes the samples (S, 8) of ``drape.contact.samples.sample_table``: sums over bones, a part at a time."""
    rows, bones = feed.skin_rows, feed.skin_bones
    width = 3 * PART_SIZE
    posed = np.empty(3 * width, rows.dtype)
    factors = np.empty((3, 4 * bones.shape[1]), rows.dtype)
    normal = np.empty((LANES, 3), rows.dtype)
    point = np.empty((LANES, 3), rows.dtype)
    for part in range(len(bones)):
        count = feed.skin_counts[part]
        for n in range(count):
            bone = bones[part, n]
            for axis in range(3):
                for i in range(3):
                    factors[axis, 4 * n + i] = rotation[bone, 3 * axis + i]
                factors[axis, 4 * n + 3] = translation[bone, axis]
        flat = rows[part].reshape(-1)
        for column in range(0, width, LANES):
            x, y, z = row_at(flat, column) * 0.0, row_at(flat, column) * 0.0, row_at(flat, column) * 0.0
            for k in range(4 * count):
                row = row_at(flat, width * k + column)
                x, y, z = x + row * factors[0, k], y + row * factors[1, k], z + row * factors[2, k]
            put(posed, column, x)
            put(posed, width + column, y)
            put(posed, 2 * width + column, z)
        for first in range(0, PART_SIZE, LANES):
            x, y, z = row_at(posed, first), row_at(posed, width + first), row_at(posed, 2 * width + first)
            a, b = PART_SIZE + first, 2 * PART_SIZE + first
            u = row_at(posed, a), row_at(posed, width + a), row_at(posed, 2 * width + a)
            v = row_at(posed, b), row_at(posed, width + b), row_at(posed, 2 * width + b)
            p, q, r = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
            length = root(most(p * p + q * q + r * r, 1e-12))
            put_points(point, 0, (x, y, z))
            put_points(normal, 0, (p / length, q / length, r / length))
            for lane in range(LANES):
                own, s = skin[PART_SIZE * part + first + lane], lane
                own[0], own[1], own[2] = point[s, 0], point[s, 1], point[s, 2]
                own[3] = own[0] * own[0] + own[1] * own[1] + own[2] * own[2]
                own[4], own[5], own[6] = normal[s, 0], normal[s, 1], normal[s, 2]
                own[7] = own[0] * own[4] + own[1] * own[5] + own[2] * own[6]


@kernel
def _regions(skin):
    region = np.zeros((len(skin) // REGION_SIZE, 4), skin.dtype)
    for r in range(len(region)):
        own = region[r]
        for s in range(REGION_SIZE * r, REGION_SIZE * (r + 1)):
            for axis in range(3):
                own[axis] += skin[s, axis]
        for axis in range(3):
            own[axis] *= skin.dtype.type(1.0 / REGION_SIZE)
        own[3] = skin.dtype.type(0.5) * (own[0] * own[0] + own[1] * own[1] + own[2] * own[2])
    return region
