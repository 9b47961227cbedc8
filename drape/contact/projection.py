"""The push-out, a collision projection: cloth out of its own part of the body, and of parts that come near in a pose.

A vertex knows from its rest place on which side of which limb it belongs. A push along the normal of whichever skin is
nearest tears cloth that two parts press from both sides: between arm and trunk one vertex goes with the arm and its
neighbour with the trunk. So the skin under the cloth at rest ("own") and the rest of the body ("other parts") are two
surfaces (``drape.contact.field``), and there are three steps:

1. out of other parts, then out of the own part, which has the last word;
2. the garment's own charts, a polynomial per patch, fit the displacement and are blended: cloth beside the pushed
   vertices comes along, and edges keep their lengths;
3. the same two surfaces push, to first order, by what is still missing to the clearance.

Whatever switches a push on fades it in over a length, so that cloth moves smoothly when the body does. One function
runs on numpy, on torch and, exported, in ONNX Runtime: the sizes of its arrays depend on those of the inputs alone.
Vectors have their coordinates first and points last: operations then run along the points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import Array, count_of, device, namespace
from drape.arrays.tensors import tensor
from drape.contact.field import attend_columns, columns, largest, query_columns, ramp, surface, take
from drape.contact.push_tables import BLOCK_SIZE, GROUP_SIZE, OTHER_STEPS, PushTables
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE, Samples, region_centres, sample_table
from drape.engine.packer import Recorded
from drape.geometry import jets
from drape.geometry.rotations import dot_columns

CLEARANCE_M = 0.0025  # the lift of folds has it too: it is less than contact's gap, so that cloth at rest is not lifted
MOVED_M = 1e-4  # a vertex that is moved by less counts as left alone
REGION_COUNT = 2  # regions of other parts that a group of blocks is tested against
BESIDE_M2 = (0.026**2, 0.016**2)  # a point this far beside the samples is beyond the end of their surface
DEPTH_M = (-0.035, -0.025)  # a point deeper inside belongs to another surface
AGREEMENT = (0.35, 0.65)  # where mixed normals agree less, two surfaces are mixed
LARGEST_PUSH_M = 0.030
HAS_OTHER = 2.0  # in 255ths: there is another part where a sample belongs to one by this much
OTHER_LEAST = 1e-3  # the weight of a sample that belongs to no other part, beside samples that do
CHARTS_PER_VERTEX = 4
JET_ROUNDS = 4  # fits of jets, whose charts carry all of the push
JET_OVER = 2.0  # factor of each fit of what is missing: a fit spreads a push and so falls short of it
TILE_WIDTH = 64  # columns of ten numbers: wider tiles than those of the drape are faster and still small
TERMS = jets.coefficient_count(3)  # coefficients of a patch's cubic
REGION_BIAS_M2 = 0.002  # squared distance [m^2] that one logit of a region outweighs


@dataclass(frozen=True, eq=False)
class PushFeed(PushTables, Recorded):
    """The constants with which ``push_out`` pushes one garment; ``drape.graph.push_feed.pack_push`` makes them.

    Besides ``PushTables`` with G groups, so N = 32 G slots, they are the charts of K patches, in Q tiles of 64 columns
    (``drape.graph.packing``). ``patch_block`` (K, B): the blocks in a patch; ``patch_fit`` (K, B, 10): the weights by
    which mean displacements of blocks give the patch's cubic. ``tile_basis`` (Q, 10, 64): the cubic's monomials at a
    chart times the chart's weight; ``tile_patch`` (Q,): the patch of a tile; ``slot_charts`` (4, G, 32): the columns,
    counted through all tiles, of the charts of a slot.
    """

    patch_block: Array = tensor("push_patch_block", "patches", "patch_blocks", dtype="int32", unit="block")
    patch_fit: Array = tensor("push_patch_fit", "patches", "patch_blocks", TERMS)
    tile_basis: Array = tensor("push_tile_basis", "tiles", TERMS, TILE_WIDTH)
    tile_patch: Array = tensor("push_tile_patch", "tiles", dtype="int32", unit="patch")
    slot_charts: Array = tensor(
        "push_slot_charts", CHARTS_PER_VERTEX, "groups", GROUP_SIZE * BLOCK_SIZE, dtype="int32", unit="column"
    )

    @property
    def patches(self) -> int:
        """The number K of patches, which the engine reads too."""
        return len(self.patch_fit)


@dataclass(frozen=True, eq=False)
class Pushed:
    """F drapes after the push-out: pushed ``vertices`` [m] (F, V, 3), and the push as jets of K patches can show it.

    ``coefficients`` [m] (F, K, 3, 10): the displacement of a patch as a cubic of its parameters, in the axes of the
    vertices. It is fitted several times to what is still missing, since jets cannot move single vertices. ``left_m``
    [m] (F,): the largest distance between where a vertex should go and where ``coefficients`` move it.
    """

    vertices: Array
    coefficients: Array
    left_m: Array


def push_out(vertices: Array, skin: Array, feed: PushFeed, clearance_m: Array | float = CLEARANCE_M) -> Array:
    """Returns ``vertices`` [m] (F, V, 3) pushed out of the bodies with the samples ``skin`` (F, R, 12, 8)
    (``skin.skin_table``), in the same frame, up to ``clearance_m`` [m] off the skin."""
    return push_in_parts(vertices, skin, feed, clearance_m).vertices


def push_in_parts(vertices: Array, skin: Array, feed: PushFeed, clearance_m: Array | float = CLEARANCE_M) -> Pushed:
    """Returns what ``push_out`` does, and the push as jets can show it. Arguments are those of ``push_out``. An
    exported graph whose only output are the vertices does not compute the jets."""
    xp = namespace(vertices)
    start = columns(xp.matrix_transpose(vertices), _flat(feed.block_vertex))  # (F, 3, N)
    means, has_other = _means(start, skin, feed)
    both = surface(xp.concat([start, start], axis=2), means)
    share = ramp(both.beside_m2, *BESIDE_M2) * ramp(both.distance, *DEPTH_M) * ramp(both.agreement, *AGREEMENT)
    missing = clearance_m - both.distance  # (F, 2 N): to the own part, then to others
    slots = start.shape[2]
    own_normal, other_normal = both.normal[:, :, :slots], both.normal[:, :, slots:]
    own_missing, other_missing = missing[:, None, :slots], missing[:, None, slots:]
    own_share, other_share = share[:, None, :slots], share[:, None, slots:] * has_other

    def out(moved: Array | None) -> Array:
        """``moved`` (F, 3, N), None at first, pushed on by the distance that it still lacks, to first order."""
        lacking = other_missing if moved is None else other_missing - dot_columns(moved, other_normal)
        from_other = _way(lacking, other_share) * other_normal
        moved = from_other if moved is None else moved + from_other
        return moved + _way(own_missing - dot_columns(moved, own_normal), own_share) * own_normal

    coefficients = fit(out(None), feed)
    carried = blend_displacement(coefficients, feed)
    moved = out(carried)
    vertices = xp.matrix_transpose(columns(start + moved, feed.vertex_slot))
    for _ in range(JET_ROUNDS - 1):
        coefficients = coefficients + JET_OVER * fit(moved - carried, feed)
        carried = blend_displacement(coefficients, feed)
        moved = out(carried)
    rest = moved - carried
    left = xp.sqrt(xp.max(dot_columns(rest, rest)[:, 0], axis=-1))
    return Pushed(vertices, coefficients, left)


def push_out_of_bodies(
    vertices: np.ndarray, body_vertices: np.ndarray, skin: Samples, feed: PushFeed, clearance_m: float = CLEARANCE_M
) -> np.ndarray:
    """Returns ``vertices`` [m] (F, V, 3) pushed out of the posed bodies ``body_vertices`` [m] (F, Vb, 3), one frame at
    a time, up to ``clearance_m`` [m] off the skin. ``skin`` are the bodies' samples."""
    pushed = np.empty_like(vertices)
    for frame in range(len(vertices)):
        now = slice(frame, frame + 1)
        # Relative to the body: the field multiplies coordinates, and a body may stand far away.
        origin = body_vertices[frame].mean(axis=0)
        point, normal = skin.posed(body_vertices[now] - origin)
        table = np.asarray(sample_table(point, normal)).reshape(1, skin.region_count, REGION_SIZE, -1)
        pushed[now] = push_out(vertices[now] - origin, table, feed, clearance_m) + origin
    return pushed


def fit(displacement: Array, feed: PushFeed) -> Array:
    """Returns for each of K patches the cubic nearest to ``displacement`` [m] (F, 3, N) of the N slots of ``feed``, in
    the sense of least squares: its coefficients [m] (F, K, 3, 10)."""
    xp = namespace(displacement)
    frames, (patches, members, _) = displacement.shape[0], feed.patch_fit.shape
    of_blocks = xp.mean(xp.reshape(displacement, (frames, 3, -1, BLOCK_SIZE)), axis=3)
    of_patch = xp.reshape(columns(of_blocks, _flat(feed.patch_block)), (frames, 3, patches, members))
    return xp.permute_dims(of_patch, (0, 2, 1, 3)) @ feed.patch_fit


def blend_displacement(coefficients: Array, feed: PushFeed) -> Array:
    """Returns the displacement [m] (F, 3, N) of the N slots of ``feed`` that the cubics ``coefficients`` [m] (F, K, 3,
    10) of the patches give them: their weighted mean over the charts of a slot."""
    xp = namespace(coefficients)
    frames, slots = coefficients.shape[0], feed.slot_charts.shape[1] * feed.slot_charts.shape[2]
    tiles, _, width = feed.tile_basis.shape
    said = xp.permute_dims(take(coefficients, feed.tile_patch, axis=1) @ feed.tile_basis, (0, 2, 1, 3))
    taken = columns(xp.reshape(said, (frames, 3, tiles * width)), _flat(feed.slot_charts))
    return xp.sum(xp.reshape(taken, (frames, 3, CHARTS_PER_VERTEX, slots)), axis=2)


def _means(start: Array, skin: Array, feed: PushFeed) -> tuple[Array, Array]:
    """Means (F, 8, 2 N) of the samples about the slots ``start`` (F, 3, N), of the own part and then of others; and 1
    where there are others (F, 1, N), else 0."""
    xp = namespace(start)
    frames = start.shape[0]
    query = query_columns(start)
    own = _own_part(_apart(query, BLOCK_SIZE), skin, feed)
    table, bias, has_other = _other_parts(start, skin, feed)
    other = attend_columns(_apart(query, GROUP_SIZE * BLOCK_SIZE), table, bias)
    # The points come last again, because what follows runs along them.
    means = [xp.reshape(xp.permute_dims(part, (0, 2, 1, 3)), (frames, 8, -1)) for part in (own, other)]
    has_other = xp.broadcast_to(has_other, (*has_other.shape[:2], GROUP_SIZE * BLOCK_SIZE))
    return xp.concat(means, axis=2), xp.reshape(has_other, (frames, 1, -1))


def _apart(rows: Array, size: int) -> Array:
    """``rows`` (F, n, N) of the slots as those of blocks or groups of ``size`` slots (F, N / size, n, size)."""
    xp = namespace(rows)
    return xp.permute_dims(xp.reshape(rows, (*rows.shape[:2], -1, size)), (0, 2, 1, 3))


def _own_part(query: Array, skin: Array, feed: PushFeed) -> Array:
    """Means (F, C, 8, 16) of the skin under the blocks, for their ``query_columns`` (F, C, 10, 16)."""
    xp = namespace(query)
    frames, own = query.shape[0], feed.own_bias.shape[2]
    clusters = xp.reshape(skin, (frames, -1, 8 * CLUSTER_SIZE))
    table = xp.reshape(take(clusters, _flat(feed.own_cluster), axis=1), (frames, -1, own, 8))
    return attend_columns(query, table, xp.reshape(feed.own_bias, (-1, own)))


def _other_parts(start: Array, skin: Array, feed: PushFeed) -> tuple[Array, Array, Array]:
    """The 24 samples of other parts nearest to each group: rows (F, G, 24, 8), logits (F, G, 24), and (F, G, 1), which
    is 1 where there are any."""
    xp = namespace(start)
    frames, regions = skin.shape[0], skin.shape[1]
    groups = feed.region_bias.shape[0]
    region = region_centres(skin)
    centre = xp.mean(xp.reshape(start, (frames, 3, groups, GROUP_SIZE * BLOCK_SIZE)), axis=3)  # (F, 3, G)
    along = xp.matrix_transpose(centre) @ xp.matrix_transpose(2.0 * region)
    far = REGION_BIAS_M2 * xp.reshape(feed.region_bias, (groups, regions))
    top = largest(far - xp.sum(region * region, axis=-1)[:, None] + along, REGION_COUNT)  # (F, G, n)
    rows, other = samples_in(top, skin, feed.other, groups)
    other = xp.astype(other, start.dtype)
    bias = xp.log(other * (1.0 / OTHER_STEPS) + OTHER_LEAST)
    has_other = xp.astype(xp.max(other, axis=-1, keepdims=True) >= HAS_OTHER, start.dtype)
    return rows, bias, has_other


def samples_in(top: Array, skin: Array, other: Array, groups: int) -> tuple[Array, Array]:
    """Returns the samples of the two regions ``top`` (F, G, 2) that each of G ``groups`` has chosen: their rows (F, G,
    24, 8) of ``skin`` (F, R, 12, 8), and their entries (F, G, 24) of ``other`` (12 R G,). That says for each sample,
    group by group, how far it is of another part of the body (``PushFeed.other``)."""
    xp = namespace(skin)
    frames, regions, count = skin.shape[0], count_of(skin[0, :, 0, 0], top.dtype), REGION_COUNT * REGION_SIZE
    frame = regions * xp.arange(frames, dtype=top.dtype, device=device(top))[:, None, None]
    group = regions * xp.arange(groups, dtype=top.dtype, device=device(top))[:, None]
    rows = take(xp.reshape(skin, (-1, 8 * REGION_SIZE)), _flat(top + frame))
    parts = take(xp.reshape(other, (-1, REGION_SIZE)), _flat(top + group))
    return xp.reshape(rows, (frames, groups, count, 8)), xp.reshape(parts, (frames, groups, count))


def _flat(index: Array) -> Array:
    return namespace(index).reshape(index, (-1,))


def _way(missing: Array, share: Array) -> Array:
    """Length [m] of a push that is ``missing`` [m] from the clearance: never negative, saturated."""
    xp = namespace(missing)
    return LARGEST_PUSH_M * xp.tanh(xp.clip(missing, min=0.0) * (1.0 / LARGEST_PUSH_M)) * share
