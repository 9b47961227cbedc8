"""Rotations as vectors, matrices, 6D descriptors and wxyz quaternions, for numpy or torch.

Every function takes any leading batch axes. Singular branches are guarded so
that the branch not taken keeps finite gradients ("double where").
"""

from __future__ import annotations

from drape.arrays import Array, like, namespace


def _small_angle(xp, dtype) -> float:
    """Below this squared angle [rad^2] the Taylor branch is exact to machine precision."""
    return 1e-8 if xp.finfo(dtype).bits == 64 else 1e-4


def rotvec_to_quaternion(rotvec: Array) -> Array:
    """Returns the unit quaternions wxyz (..., 4) of rotation vectors [rad] (..., 3)."""
    xp = namespace(rotvec)
    squared = xp.sum(rotvec * rotvec, axis=-1, keepdims=True)
    small = squared < _small_angle(xp, rotvec.dtype)
    angle = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    real = xp.where(small, 1.0 - squared / 8.0 + squared * squared / 384.0, xp.cos(angle / 2.0))
    scale = xp.where(small, 0.5 - squared / 48.0 + squared * squared / 3840.0, xp.sin(angle / 2.0) / angle)
    return xp.concat([real, scale * rotvec], axis=-1)


def rotvec_to_matrix(rotvec: Array) -> Array:
    """Returns the rotation matrices (..., 3, 3) of rotation vectors [rad] (..., 3), by Rodrigues' formula."""
    xp = namespace(rotvec)
    squared = xp.sum(rotvec * rotvec, axis=-1, keepdims=True)
    small = squared < _small_angle(xp, rotvec.dtype)
    angle = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    sinc = xp.where(small, 1.0 - squared / 6.0 + squared * squared / 120.0, xp.sin(angle) / angle)
    half_sinc = xp.sin(angle / 2.0) / angle
    versine = xp.where(small, 0.5 - squared / 24.0 + squared * squared / 720.0, 2.0 * half_sinc * half_sinc)
    x, y, z = rotvec[..., 0], rotvec[..., 1], rotvec[..., 2]
    s, c, r2 = sinc[..., 0], versine[..., 0], squared[..., 0]
    rows = [
        [1.0 + c * (x * x - r2), c * x * y - s * z, c * x * z + s * y],
        [c * x * y + s * z, 1.0 + c * (y * y - r2), c * y * z - s * x],
        [c * x * z - s * y, c * y * z + s * x, 1.0 + c * (z * z - r2)],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_to_matrix(wxyz: Array) -> Array:
    """Returns the rotation matrices (..., 3, 3) of unit quaternions wxyz (..., 4)."""
    xp = namespace(wxyz)
    w, x, y, z = wxyz[..., 0], wxyz[..., 1], wxyz[..., 2], wxyz[..., 3]
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def matrix_to_quaternion(matrix: Array) -> Array:
    """Returns the unit quaternions wxyz (..., 4), w >= 0, of rotation matrices (..., 3, 3). It takes the largest of the
    four candidate rows (Bar-Itzhack's matrix), so it stays accurate at half turns."""
    xp = namespace(matrix)
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    rows = [
        [1.0 + trace, m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]],
        [None, 1.0 + 2.0 * m[..., 0, 0] - trace, m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0]],
        [None, None, 1.0 + 2.0 * m[..., 1, 1] - trace, m[..., 1, 2] + m[..., 2, 1]],
        [None, None, None, 1.0 + 2.0 * m[..., 2, 2] - trace],
    ]
    full = [[rows[min(i, j)][max(i, j)] for j in range(4)] for i in range(4)]
    k = xp.stack([xp.stack(row, axis=-1) for row in full], axis=-2)
    diagonal = xp.stack([full[i][i] for i in range(4)], axis=-1)
    best = xp.argmax(diagonal, axis=-1)
    chosen = xp.zeros_like(diagonal)
    for i in range(4):
        chosen = chosen + xp.where((best == i)[..., None], k[..., i, :], xp.zeros_like(diagonal))
    sign = xp.where(chosen[..., :1] < 0.0, -xp.ones_like(chosen[..., :1]), xp.ones_like(chosen[..., :1]))
    return sign * chosen / xp.sqrt(xp.sum(chosen * chosen, axis=-1, keepdims=True))


def quaternion_to_rotvec(wxyz: Array) -> Array:
    """Returns the rotation vectors [rad] (..., 3), of length <= pi, of unit quaternions wxyz (..., 4)."""
    xp = namespace(wxyz)
    wxyz = xp.where(wxyz[..., :1] < 0.0, -wxyz, wxyz)
    real, imaginary = wxyz[..., :1], wxyz[..., 1:]
    squared = xp.sum(imaginary * imaginary, axis=-1, keepdims=True)
    small = squared < _small_angle(xp, wxyz.dtype)
    sine = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    factor = xp.where(small, 2.0 + squared / 3.0, 2.0 * xp.atan2(sine, real) / sine)
    return factor * imaginary


def matrix_to_rotvec(matrix: Array) -> Array:
    """Returns the rotation vectors [rad] (..., 3), of length <= pi, of rotation matrices (..., 3, 3)."""
    return quaternion_to_rotvec(matrix_to_quaternion(matrix))


def quaternion_multiply(left_wxyz: Array, right_wxyz: Array) -> Array:
    """Returns the Hamilton products wxyz (..., 4) left * right: the rotation ``right_wxyz`` first, then
    ``left_wxyz``."""
    xp = namespace(left_wxyz)
    a, b, c, d = (left_wxyz[..., i] for i in range(4))
    w, x, y, z = (right_wxyz[..., i] for i in range(4))
    return xp.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def quaternion_slerp(start_wxyz: Array, end_wxyz: Array, fraction: Array) -> Array:
    """Returns the unit quaternions wxyz (..., 4) on the shorter great arc from start to end; ``fraction`` (...,) runs
    from 0 to 1."""
    xp = namespace(start_wxyz)
    cosine = xp.sum(start_wxyz * end_wxyz, axis=-1, keepdims=True)
    end = xp.where(cosine < 0.0, -end_wxyz, end_wxyz)
    cosine = xp.clip(xp.abs(cosine), 0.0, 1.0)
    near = cosine > 1.0 - 1e-7
    angle = xp.acos(xp.where(near, xp.zeros_like(cosine), cosine))
    t = fraction[..., None]
    sine = xp.sin(angle)
    start_weight = xp.where(near, 1.0 - t, xp.sin((1.0 - t) * angle) / sine)
    end_weight = xp.where(near, t, xp.sin(t * angle) / sine)
    mixed = start_weight * start_wxyz + end_weight * end
    return mixed / xp.sqrt(xp.sum(mixed * mixed, axis=-1, keepdims=True))


def matrix_to_sixd(matrix: Array) -> Array:
    """Returns the first two columns, one after the other (..., 6), of rotation matrices (..., 3, 3) (Zhou et al.
    2019)."""
    xp = namespace(matrix)
    return xp.concat([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)


def sixd_to_matrix(sixd: Array) -> Array:
    """Returns rotation matrices (..., 3, 3) whose first two columns are those in ``sixd`` (..., 6), made orthonormal by
    Gram-Schmidt (Zhou et al. 2019)."""
    xp = namespace(sixd)
    first, second = sixd[..., :3], sixd[..., 3:]
    x = first / _norm(first)
    y = second - xp.sum(x * second, axis=-1, keepdims=True) * x
    y = y / _norm(y)
    return xp.stack([x, y, cross(x, y)], axis=-1)


def cross(a: Array, b: Array) -> Array:
    """Returns the cross products (..., 3) of ``a`` and ``b`` (..., 3), broadcast. It is written out because torch's
    ``cross`` refuses arrays with different numbers of axes."""
    xp = namespace(a)
    return xp.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def cross_columns(a: Array, b: Array) -> Array:
    """Returns the cross products (..., 3, N) of N columns ``a`` and ``b`` (..., 3, N). Coordinates come first, so that
    N numbers are computed at a time, and not three."""
    xp = namespace(a)
    # Coordinates once more, so that yzx and zxy are three rows that follow each other.
    a, b = (xp.concat([x, x[..., :2, :]], axis=-2) for x in (a, b))
    return a[..., 1:4, :] * b[..., 2:5, :] - a[..., 2:5, :] * b[..., 1:4, :]


def dot_columns(a: Array, b: Array) -> Array:
    """Returns the scalar products (..., 1, N) of N columns ``a`` and ``b`` (..., n, N) with small n, whose rows are
    added, N numbers at a time."""
    product = a * b
    if product.ndim <= 3:  # few wide matrices: one product adds the rows
        return like(product, [[1.0] * product.shape[-2]]) @ product
    total = product[..., :1, :]
    for row in range(1, product.shape[-2]):
        total = total + product[..., row : row + 1, :]
    return total


def _norm(vector: Array) -> Array:
    xp = namespace(vector)
    return xp.sqrt(xp.sum(vector * vector, axis=-1, keepdims=True) + like(vector, 1e-30))
