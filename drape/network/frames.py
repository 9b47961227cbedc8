"""Posed frames of patches and what a patch sees of its surroundings, compiled.

The formulas are those of ``drape.geometry.skinning.blend_frames`` and ``training.model.patch_surroundings``.
"""

from __future__ import annotations

import numpy as np

from drape.body.skeleton import JOINT_COUNT
from drape.garment.features import JOINT_REACH_M
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, put, root, row_at, tangent

ROTATION, CENTRE, SCALE, FRAME = 0, 9, 12, 13  # rows of a block's frames: rotation, centre [m], scale [m]; their count
GRAVITY = 3 * JOINT_COUNT  # of the surroundings' rows, behind the joints


@kernel
def pose_frames(body, rows, frames):
    """Writes the frames (13 rows a block) of the patches ``rows`` on ``body``."""
    signs = np.empty((JOINT_COUNT, JOINT_COUNT), body.rotation.dtype)
    _agreement(body.quaternion, signs)
    signed, reference = np.empty(LANES, signs.dtype), np.empty(4 * LANES, signs.dtype)
    for block in range(len(rows.scale) // LANES):
        for lane in range(LANES):
            heaviest = rows.heaviest[LANES * block + lane]
            for i in range(4):
                reference[LANES * i + lane] = signs.dtype.type(1e-6) * body.quaternion[heaviest, i]
        w, x, y, z = row_at(reference, 0), row_at(reference, 16), row_at(reference, 32), row_at(reference, 48)
        for joint in range(JOINT_COUNT):
            weight = row_at(rows.weights, LANES * (JOINT_COUNT * block + joint))
            for lane in range(LANES):
                signed[lane] = signs[joint, rows.heaviest[LANES * block + lane]]
            weight, own = weight * row_at(signed, 0), body.quaternion[joint]
            w, x, y, z = w + weight * own[0], x + weight * own[1], y + weight * own[2], z + weight * own[3]
        _put_rotation((w, x, y, z), rows, block, frames)
        _put_centre(body, rows, block, frames)
        put(frames, LANES * (FRAME * block + SCALE), row_at(rows.scale, LANES * block))


@kernel
def _agreement(quaternion, signs):
    for i in range(JOINT_COUNT):
        for j in range(JOINT_COUNT):
            same = quaternion.dtype.type(0)
            for k in range(4):
                same += quaternion[i, k] * quaternion[j, k]
            signs[i, j] = -1 if same < 0 else 1


@part
def _put_rotation(q, rows, block, frames):
    """Writes the rotations of the quaternions ``q``, of any length, times those of the patches at rest."""
    w, x, y, z = q
    two = 2.0 / (w * w + x * x + y * y + z * z)
    turn = (
        (1.0 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)),
        (two * (x * y + w * z), 1.0 - two * (x * x + z * z), two * (y * z - w * x)),
        (two * (x * z - w * y), two * (y * z + w * x), 1.0 - two * (x * x + y * y)),
    )
    first = LANES * 9 * block
    for column in range(3):
        a = row_at(rows.rotation, first + LANES * column)
        b = row_at(rows.rotation, first + LANES * (3 + column))
        c = row_at(rows.rotation, first + LANES * (6 + column))
        for axis in range(3):
            own = turn[axis]
            place = LANES * (FRAME * block + ROTATION + 3 * axis + column)
            put(frames, place, own[0] * a + own[1] * b + own[2] * c)


@kernel
def _put_centre(body, rows, block, frames):
    """Writes where the blended bones take the centres that the shape has moved."""
    at = LANES * 3 * block
    x, y, z = row_at(rows.centre, at), row_at(rows.centre, at + LANES), row_at(rows.centre, at + 2 * LANES)
    count = len(body.betas)
    for i in range(count):
        slope = LANES * (3 * count * block + i)
        x = x + row_at(rows.slopes, slope) * body.betas[i]
        y = y + row_at(rows.slopes, slope + LANES * count) * body.betas[i]
        z = z + row_at(rows.slopes, slope + 2 * LANES * count) * body.betas[i]
    for axis in range(3):
        total = x * 0.0
        for joint in range(JOINT_COUNT):
            turn, weight = body.rotation[joint], row_at(rows.weights, LANES * (JOINT_COUNT * block + joint))
            moved = x * turn[3 * axis] + y * turn[3 * axis + 1] + z * turn[3 * axis + 2]
            total = total + weight * (moved + body.translation[joint, axis])
        put(frames, LANES * (FRAME * block + CENTRE + axis), total)


@part
def into_frame(frames, block, a):
    """World vectors ``a`` in the axes of the frames of a block."""
    at, one, two = LANES * FRAME * block, LANES, 2 * LANES
    three, six = at + 3 * LANES, at + 6 * LANES
    return (
        row_at(frames, at) * a[0] + row_at(frames, three) * a[1] + row_at(frames, six) * a[2],
        row_at(frames, at + one) * a[0] + row_at(frames, three + one) * a[1] + row_at(frames, six + one) * a[2],
        row_at(frames, at + two) * a[0] + row_at(frames, three + two) * a[1] + row_at(frames, six + two) * a[2],
    )


@part
def out_of_frame(frames, block, a):
    """Vectors ``a`` in the axes of the frames of a block, in the world."""
    at, one, two = LANES * FRAME * block, LANES, 2 * LANES
    three, six = at + 3 * LANES, at + 6 * LANES
    return (
        row_at(frames, at) * a[0] + row_at(frames, at + one) * a[1] + row_at(frames, at + two) * a[2],
        row_at(frames, three) * a[0] + row_at(frames, three + one) * a[1] + row_at(frames, three + two) * a[2],
        row_at(frames, six) * a[0] + row_at(frames, six + one) * a[1] + row_at(frames, six + two) * a[2],
    )


@part
def centres_of(frames, block):
    at = LANES * (FRAME * block + CENTRE)
    return row_at(frames, at), row_at(frames, at + LANES), row_at(frames, at + 2 * LANES)


@kernel
def see_surroundings(body, frames, seen):
    """Writes the joints and gravity in the axes of each patch to the first 75 rows of the ``seen`` (``Rows``)."""
    for block in range(len(frames) // (LANES * FRAME)):
        at = LANES * seen.count * block
        centre = centres_of(frames, block)
        for joint in range(JOINT_COUNT):
            way = (
                body.place[joint, 0] - centre[0],
                body.place[joint, 1] - centre[1],
                body.place[joint, 2] - centre[2],
            )
            x, y, z = into_frame(frames, block, way)
            reach = root(most(x * x + y * y + z * z, 1e-12))
            share = tangent(reach * (1.0 / JOINT_REACH_M)) / reach
            put(seen.values, at + LANES * 3 * joint, share * x)
            put(seen.values, at + LANES * (3 * joint + 1), share * y)
            put(seen.values, at + LANES * (3 * joint + 2), share * z)
        for axis in range(3):
            turn = row_at(frames, LANES * (FRAME * block + ROTATION + 3 + axis))
            put(seen.values, at + LANES * (GRAVITY + axis), -turn)
