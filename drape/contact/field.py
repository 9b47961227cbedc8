"""The signed distance of points to a surface given by samples with normals, smooth in points and samples.

With weights w_k = softmax(-|x - b_k|^2 / h^2 + bias_k) over a list of samples b_k, n_k, the mean normal n and the
mean point b,

    d(x) = 1/2 sum_k w_k n_k . (x - b_k) + 1/2 n . (x - b) / |n|

The first term is the implicit moving-least-squares surface (Kolluri 2008, "Provably good moving least squares", ACM
Trans. Algorithms 4(2)). For samples s away it lies s^2 / 2R outside a surface of radius R. The second term is the plane
of mean point and mean normal (Alexa and Adamson 2004, "On normals and projection operators for surfaces defined by
point sets", SPBG), which lies as far inside. Their mean has no error of second order, so that samples may be a quarter
of a limb's radius apart.

``attend`` gives the means: it is the attention of points to samples, two matrix products and a softmax. ``surface``
reads distance and normal off the means. Its coordinates come first, so that every operation runs along the points.
"""

from __future__ import annotations

from dataclasses import dataclass

from drape.arrays import Array, like, namespace
from drape.geometry.rotations import dot_columns

BANDWIDTH_M = 0.014  # h, about the spacing of the samples
TINY = 1e-12
# The mean point and the mean normal are divided by the sum of the weights, or by these where it is smaller. So normals
# fade while weights times coordinates are still exact: below 1e-38 these are subnormal in float32, or zero.
LEAST_WEIGHTS = (1e-37, 1e-30)


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of samples as seen from N points: the signed ``distance`` [m] (..., N) of a point, positive outside,
    and the unit ``normal`` (..., 3, N) there.

    ``beside_m2`` [m^2] (..., N): the square of the distance from the samples along the surface; where it is larger than
    their spacing the surface has ended. ``agreement`` (..., N) in [0, 1] is the length of the mean normal: it is small
    between two surfaces that face each other.
    """

    distance: Array
    normal: Array
    beside_m2: Array
    agreement: Array


def queries(points: Array) -> Array:
    """Returns columns (..., 8, P) for ``points`` x [m] (..., 3, P). A sample's row of ``sample_table`` times a column
    is -|x - b|^2 / h^2 + x . x / h^2, b the sample's point and h the bandwidth."""
    scale = 1.0 / (BANDWIDTH_M * BANDWIDTH_M)
    turned = like(points, [[2.0 * scale * (row == column) for row in range(3)] for column in range(8)])
    return turned @ points + like(points, [[-scale * (column == 3)] for column in range(8)])


def attend(query: Array, table: Array, bias: Array) -> Array:
    """Returns at P points the weighted means (..., P, 8) of K samples, rows of ``table`` (..., K, 8)
    (``drape.contact.samples.sample_table``). The weights are the softmax of distance and ``bias`` (..., K).

    ``query`` (..., P, 8) are ``queries`` of the points, transposed.
    """
    logits = query @ namespace(query).matrix_transpose(table) + bias[..., None, :]
    return softmax(logits) @ table


def query_columns(points: Array) -> Array:
    """Returns columns (..., 10, P) for ``points`` x [m] (..., 3, P), which ``attend_columns`` takes. Times a sample's
    ten numbers there, a column is its logit -|x - b|^2 / h^2 + bias."""
    xp = namespace(points)
    scale = 1.0 / (BANDWIDTH_M * BANDWIDTH_M)
    plain = queries(points)
    square = dot_columns(points, points) * (-scale)
    return xp.concat([plain, xp.ones_like(square), square], axis=-2)


def attend_columns(query: Array, table: Array, bias: Array) -> Array:
    """Returns at P points the weighted means (..., 8, P) of K samples, as ``attend`` does, but with the points last.

    ``query`` (..., 10, P) are ``query_columns``, ``table`` (..., K, 8) the samples, ``bias`` (..., K) their logits.
    This softmax does not search for the largest logit, which would cost more than all the rest. So the ``bias`` of some
    sample must be near 0, and means fade to nothing from some 10 cm away from all samples on.
    """
    xp = namespace(query)
    count = table.shape[-2]
    logits = xp.broadcast_to(bias[..., None, :], (*table.shape[:-2], 1, count))
    rows = xp.concat([xp.matrix_transpose(table), logits, xp.ones_like(logits)], axis=-2)  # (..., 10, K)
    sums = rows @ xp.exp(xp.matrix_transpose(rows) @ query)
    least = like(query, [[LEAST_WEIGHTS[row // 4]] for row in range(8)])
    return sums[..., :8, :] / xp.maximum(sums[..., 9:, :], least)


def surface(points: Array, means: Array) -> Surface:
    """Returns the surface as seen from ``points`` [m] (..., 3, N), from the ``means`` (..., 8, N) of samples there."""
    xp = namespace(points)
    normal = means[..., 4:7, :]
    length = xp.sqrt(xp.clip(dot_columns(normal, normal), min=TINY))
    unit = normal * (1.0 / length)
    offset = points - means[..., :3, :]
    along = dot_columns(unit, offset)
    implicit = dot_columns(normal, points) - means[..., 7:8, :]
    beside = dot_columns(offset, offset) - along * along
    return Surface((0.5 * (implicit + along))[..., 0, :], unit, beside[..., 0, :], length[..., 0, :])


def softmax(logits: Array) -> Array:
    """Returns the softmax of ``logits`` over the last axis; torch's own, one kernel, where the namespace has it."""
    xp = namespace(logits)
    if hasattr(xp, "softmax"):
        return xp.softmax(logits, -1)
    grown = xp.exp(logits - xp.max(logits, axis=-1, keepdims=True))
    return grown / xp.sum(grown, axis=-1, keepdims=True)


def ramp(value: Array, low: float, high: float) -> Array:
    """Returns 0 where ``value`` is at ``low``, 1 at ``high``, linear between and constant beyond, in the shape of
    ``value``. ``high`` may lie below ``low``."""
    return namespace(value).clip((value - low) * (1.0 / (high - low)), min=0.0, max=1.0)


def take(rows: Array, index: Array, axis: int = 0) -> Array:
    """Returns the entries of ``rows`` at ``index`` (n,), none negative, along ``axis``: one operation in torch, where
    indexing is four."""
    xp = namespace(rows)
    return xp.index_select(rows, axis, index) if hasattr(xp, "index_select") else xp.take(rows, index, axis=axis)


def columns(table: Array, index: Array) -> Array:
    """Returns (F, n, m): the columns of ``table`` (F, n, N) at ``index`` (m,).

    They are taken from one matrix of few rows, which graphs are fast with.
    """
    xp = namespace(table)
    flat = take(xp.reshape(table, (-1, table.shape[2])), index, axis=1)
    return xp.reshape(flat, (table.shape[0], table.shape[1], -1))


def largest(scores: Array, count: int) -> Array:
    """Returns the indices (..., ``count``) of the largest ``scores`` (..., n) along the last axis, in no order."""
    xp = namespace(scores)
    if hasattr(xp, "topk"):
        return xp.topk(scores, count, dim=-1, sorted=False)[1]
    return xp.argpartition(scores, -count, axis=-1)[..., -count:]
