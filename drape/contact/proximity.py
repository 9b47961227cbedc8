"""Body proximity of patches: how near the body is at a few points of each, and which way it would push them.

The two surfaces of the push-out (``drape.contact.projection``), own and other parts of the body, are read at the points
of a patch, not at the vertices of a block: the cost does not grow with the mesh. Nothing is pushed. The network's
corrections read closeness and force at every point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import Array, namespace
from drape.arrays.tensors import Tensors, tensor
from drape.contact.field import Surface, attend, largest, queries, ramp, surface, take
from drape.contact.projection import AGREEMENT, BESIDE_M2, OTHER_LEAST, REGION_BIAS_M2, REGION_COUNT, samples_in
from drape.contact.push_tables import OWN_CLUSTERS, skin_lists
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE, region_centres
from drape.contact.skin import Skin
from drape.geometry.rotations import dot_columns

GAP_M = 0.006  # proximity begins at this distance; the contact energy at 4 mm
UNIT_M = 0.01
DEEP_M = (-0.060, -0.045)  # deeper inside there is no proximity
HELD_M = 0.004  # no correction takes a point deeper below a plane
SOFT_M = 0.001  # makes the share of a correction change gently, so that rounding is not seen
OTHER_STEPS = 15  # half a byte: two samples lie in one where they are stored
REGION_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class PatchSkin(Tensors):
    """The skin near each of K patches at rest, as indices and weights of the body's samples.

    ``own_cluster`` (K, 10): clusters of samples under the patch; ``own_bias`` (K, 40): the attention logits of their
    samples. ``other`` (K, R, 12) uint8: how much each sample belongs to another part of the body than the patch, in
    15ths; ``region_bias`` (K, R): the logits of the regions (``region_bias_of``).
    """

    own_cluster: Array = tensor("patch_cluster", "patches", OWN_CLUSTERS, dtype="int64", unit="cluster of samples")
    own_bias: Array = tensor("patch_cluster_bias", "patches", OWN_CLUSTERS * CLUSTER_SIZE)
    other: Array = tensor("patch_other", "patches", "regions", REGION_SIZE, dtype="uint8", unit="1 / 15")
    region_bias: Array = tensor("patch_region_bias", "patches", "regions")


def patch_skin(centre: np.ndarray, facing: np.ndarray, skin: Skin) -> PatchSkin:
    """Returns the skin near K patches with the centres ``centre`` [m] (K, 3) and unit outward normals ``facing`` (K, 3)
    at rest on the body in T-pose, as numpy arrays."""
    lists = skin_lists(np.asarray(centre, dtype=np.float64), np.asarray(facing, dtype=np.float64), skin)
    other = np.rint(OTHER_STEPS * lists.other.reshape(len(centre), -1, REGION_SIZE)).astype(np.uint8)
    return PatchSkin(
        own_cluster=lists.own_cluster.astype(np.int64),
        own_bias=lists.own_bias.astype(np.float32),
        other=other,
        region_bias=region_bias_of(other.max(axis=2)),
    )


def region_bias_of(most: np.ndarray) -> np.ndarray:
    """Returns the attention logits, float32, of regions, in the shape of ``most``. ``most`` is the largest number of a
    region's samples in ``PatchSkin.other``, in 15ths.

    A region with no sample of another part has a logit far below 0. All 16 values are rounded to two bytes here, so
    that all who choose regions by them choose the same.
    """
    return np.log(most / OTHER_STEPS + REGION_LEAST).astype(np.float16).astype(np.float32)


def in_halves(other: np.ndarray) -> np.ndarray:
    """Returns the 4-bit numbers ``other`` (..., 12) uint8 of ``PatchSkin`` two to a byte, (..., 6) uint8: number i in
    the low half, i + 6 in the high half."""
    half = other.shape[-1] // 2
    return other[..., :half] | (other[..., half:] << 4)


def from_halves(stored: Array) -> Array:
    """Returns the 4-bit numbers (..., 12), as floats, of the bytes ``stored`` (..., 6) that ``in_halves`` made.
    ``stored`` must be floats too."""
    xp = namespace(stored)
    high = xp.floor(stored * (1.0 / 16.0))
    return xp.concat([stored - 16.0 * high, high], axis=-1)


@dataclass(frozen=True, eq=False)
class Planes:
    """Tangent planes of the body at n points of each of K patches; along the axis of 2 one of the patch's own part of
    the body, then one of other parts.

    ``normal`` (F, K, 2, 3, n) is of unit length; normal . x + ``offset`` [m] (F, K, 2, n) is the distance of x,
    positive outside. ``share`` (F, K, 2, n) in [0, 1] is 0 where there is no plane (``plane_share``).
    """

    normal: Array
    offset: Array
    share: Array


def planes(points: Array, skin: Array, lists: PatchSkin) -> Planes:
    """Returns the tangent planes of the body at ``points`` [m] (F, K, n, 3) of posed patches, whose skin near by is
    ``lists``. ``skin`` (F, R, 12, 8) is the body's ``skin_table``, in the frame of the points."""
    xp = namespace(points)
    query = xp.matrix_transpose(queries(xp.matrix_transpose(points)))
    return tangent_planes(points, _own(query, skin, lists), _other(points, query, skin, lists))


def tangent_planes(points: Array, own: Array, other: Array) -> Planes:
    """Returns the tangent planes at ``points`` [m] (F, K, n, 3) from the means (F, K, n, 8) of samples of the ``own``
    part and of ``other`` parts there (``field.attend``)."""
    xp = namespace(points)
    means = xp.stack([own, other], axis=2)  # (F, K, 2, n, 8)
    columns = xp.matrix_transpose(points)[:, :, None]
    found = surface(columns, xp.matrix_transpose(means))
    return Planes(found.normal, found.distance - dot_columns(found.normal, columns)[..., 0, :], plane_share(found))


def plane_share(found: Surface) -> Array:
    """Returns the share, in [0, 1], to which there is a tangent plane at each point of ``found``, in the shape of its
    distance: 0 where the samples have ended or face each other, and deep inside the body."""
    return ramp(found.beside_m2, *BESIDE_M2) * ramp(found.distance, *DEEP_M) * ramp(found.agreement, *AGREEMENT)


def body_proximity(points: Array, near: Planes) -> tuple[Array, Array]:
    """Returns the closeness (F, K, 2 n) of ``points`` [m] (F, K, n, 3) to the planes ``near``, and the force (F, K, n,
    3) of the planes on them; both have no unit.

    Closeness is tanh((gap - distance) / 1 cm) to the own part, then to others. The force is the sum over both parts of
    (gap - distance) / 1 cm along the normal, where that is positive. Both are times the plane's share.
    """
    xp = namespace(points)
    frames, count = points.shape[0], points.shape[2]
    distance = dot_columns(near.normal, xp.matrix_transpose(points)[:, :, None])[..., 0, :] + near.offset
    missing = (GAP_M - distance) * (1.0 / UNIT_M)  # (F, K, 2, n)
    closeness = xp.reshape(near.share * xp.tanh(missing), (frames, -1, 2 * count))
    pull = (near.share * xp.clip(missing, min=0.0))[:, :, :, None] * near.normal
    return closeness, xp.matrix_transpose(xp.sum(pull, axis=2))


def held_share(before: Array, after: Array, near: Planes) -> Array:
    """Returns the share (F, K), in [0, 1], of a correction that each patch may take. The correction moves the patch's
    points from ``before`` to ``after``, both [m] (F, K, n, 3); ``near`` are the tangent planes at the points.

    The share is 1 where no point comes deeper than ``HELD_M`` below a plane, and where the correction brings it out.
    Otherwise the point with the least room decides. With ``deeper`` the depth by which the correction lowers a point,
    times the share to which there is a plane, held = ``HELD_M`` and soft = ``SOFT_M``, the share is

        min (room + soft) / (max(deeper, room) + soft),   room = max(distance + held, 0).
    """
    xp = namespace(before)
    distance = dot_columns(near.normal, xp.matrix_transpose(before)[:, :, None])[..., 0, :] + near.offset
    way = dot_columns(near.normal, xp.matrix_transpose(after - before)[:, :, None])[..., 0, :]
    room = xp.clip(distance + HELD_M, min=0.0) + SOFT_M
    share = room / xp.maximum(SOFT_M - near.share * way, room)
    return xp.min(xp.reshape(share, (*before.shape[:2], -1)), axis=-1)


def _own(query: Array, skin: Array, lists: PatchSkin) -> Array:
    """Means (F, K, n, 8) of the skin under the patches."""
    xp = namespace(query)
    frames, patches = query.shape[0], query.shape[1]
    clusters = xp.reshape(skin, (frames, -1, 8 * CLUSTER_SIZE))
    taken = take(clusters, xp.reshape(lists.own_cluster, (-1,)), axis=1)
    return attend(query, xp.reshape(taken, (frames, patches, lists.own_bias.shape[1], 8)), lists.own_bias)


def _other(points: Array, query: Array, skin: Array, lists: PatchSkin) -> Array:
    """Means (F, K, n, 8) of the other parts nearest to each patch; without a normal where there are none."""
    xp = namespace(points)
    patches = lists.region_bias.shape[0]
    region = region_centres(skin)
    centre = xp.mean(points, axis=2)  # (F, K, 3)
    squared = xp.sum(region * region, axis=-1)[:, None] - 2.0 * (centre @ xp.matrix_transpose(region))
    top = largest(REGION_BIAS_M2 * lists.region_bias - squared, REGION_COUNT)  # (F, K, 2)
    return attend_others(query, *samples_in(top, skin, lists.other, patches))


def attend_others(query: Array, table: Array, other: Array) -> Array:
    """Returns the weighted means (..., n, 8) of the samples ``table`` (..., c, 8) for ``query`` (..., n, 8), as
    ``field.attend`` does. ``other`` (..., c) is how much a sample belongs to another part, in 15ths; the normal is zero
    where no sample does."""
    xp = namespace(query)
    share = xp.astype(other, query.dtype)
    means = attend(query, table, xp.log(share * (1.0 / OTHER_STEPS) + OTHER_LEAST))
    there = xp.astype(xp.max(share, axis=-1, keepdims=True) >= 1.0, query.dtype)
    # Normals that are zero agree with nothing, which fades the surface out.
    return xp.concat([means[..., :4], means[..., 4:] * there[..., None]], axis=-1)
