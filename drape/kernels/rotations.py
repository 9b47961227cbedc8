"""Rotations, compiled: vectors, quaternions wxyz and matrices, those of ``drape.geometry.rotations``."""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel


@kernel
def put_quaternion(turn, out):
    """Writes the unit quaternion ``out`` (4,) of the rotation vector ``turn`` [rad] (3,)."""
    angle = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    share = np.sin(0.5 * angle) / angle if angle > 1e-8 else 0.5
    out[0] = np.cos(0.5 * angle)
    for i in range(3):
        out[1 + i] = share * turn[i]


@kernel
def put_quaternions(turns, out):
    """Writes the quaternions of the vectors ``turns`` [rad] (F, J, 3) to the first J of ``out`` (F, n, 4)."""
    for frame in range(len(turns)):
        for joint in range(turns.shape[1]):
            put_quaternion(turns[frame, joint], out[frame, joint])


@kernel
def put_product(a, b, out):
    """Writes the product of the quaternions ``a`` and ``b``."""
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[1] * b[0] + a[0] * b[1] - a[3] * b[2] + a[2] * b[3]
    out[2] = a[2] * b[0] + a[3] * b[1] + a[0] * b[2] - a[1] * b[3]
    out[3] = a[3] * b[0] - a[2] * b[1] + a[1] * b[2] + a[0] * b[3]


@kernel
def put_matrix(q, out):
    """Writes the matrix ``out`` (9,) of the quaternion ``q``, of any length."""
    kind = q.dtype.type
    w, x, y, z = q[0], q[1], q[2], q[3]
    two = kind(2) / (w * w + x * x + y * y + z * z)
    out[0], out[1], out[2] = kind(1) - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)
    out[3], out[4], out[5] = two * (x * y + w * z), kind(1) - two * (x * x + z * z), two * (y * z - w * x)
    out[6], out[7], out[8] = two * (x * z - w * y), two * (y * z + w * x), kind(1) - two * (x * x + y * y)
