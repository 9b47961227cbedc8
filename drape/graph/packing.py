"""The layout of garments in memory for the packed drape graph: charts in tiles, vertices in blocks, index tensors.

A chart entry (vertex, patch, weight, rest place y, parameters u, v) contributes ``C @ column`` to its vertex, where C
(3, 18) are the posed jets of the patch and the column is ``w [y / s, basis(u, v)]``. Columns of one patch
lie side by side in tiles of ``CHARTS_PER_TILE``, the rest of its last tile is zero, so the vertex stage
is one product of a fixed shape per tile and a sum of ``CHARTS_PER_VERTEX`` columns per vertex. A garment's vertices
fill whole blocks of ``VERTICES_PER_BLOCK``; the last block is filled up by repeating the first vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.body.features import joint_rotations
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.contact.proximity import in_halves
from drape.contact.samples import POSED_REGIONS
from drape.errors import ArtifactError
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.consensus import MEMBERS
from drape.geometry import jets
from drape.graph.feeds import shape_numbers
from drape.graph.inputs import PARTS
from drape.graph.packed_inputs import (
    CHARTS_PER_TILE,
    VERTICES_PER_BLOCK,
    Indices,
    StoredCharts,
    StoredPatches,
    StoredProximity,
    StoredTiles,
)

KINDS = {spec.name: spec.dtype for kind in (StoredPatches, StoredTiles) for spec in kind.specs(PARTS)}


def pass_name(index: int) -> str:
    """Returns the name of the packed graph's output with the jets after ``index`` corrections, before the closing
    fit."""
    return f"pass_{index}"


@dataclass(frozen=True, eq=False)
class PackedBody:
    """A body of one shape as the packed graph takes it: ``joint_rest`` [m] (24, 3), ``betas`` (10,), and ``root`` [m]
    (3,) float64, the rest place of the root joint, which the graph's outputs count from."""

    joint_rest: np.ndarray
    betas: np.ndarray
    root: np.ndarray

    def rows(self, poses: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the inputs of the packed graph for this body in ``poses`` (F, 24, 3) [rad], float32 with F rows each:
        "joint_quaternion", "joint_rest" and "betas" (``PackedBodies``)."""
        quaternion = np.empty((len(poses), JOINT_COUNT + 1, 4), dtype=np.float32)
        quaternion[:, :JOINT_COUNT] = joint_rotations(poses)[0]
        quaternion[:, JOINT_COUNT] = (1.0, 0.0, 0.0, 0.0)  # the ancestor of joints that have none
        return {
            "joint_quaternion": quaternion,
            "joint_rest": _repeated(self.joint_rest, len(poses)),
            "betas": _repeated(self.betas, len(poses)),
        }


def _repeated(array: np.ndarray, count: int) -> np.ndarray:
    """``array`` ``count`` times, without a copy."""
    return array[None] if count == 1 else np.broadcast_to(array, (count, *array.shape))  # broadcasting takes 10 us


def pack_body(body: BodyModel, betas: np.ndarray | None = None) -> PackedBody:
    """Returns ``body`` in the shape ``betas`` (S,), or its mean shape, as the packed graph takes it."""
    rest = body.rest_joints(betas)
    return PackedBody(rest.astype(np.float32), shape_numbers(body, betas).astype(np.float32), rest[0])


@dataclass(frozen=True, eq=False)
class PackedGarment:
    """The constants of one garment with K patches and Q tiles, as the packed graph takes them.

    ``stored``: the inputs ``StoredPatches`` (K rows) and ``StoredTiles`` (Q rows) by their names in the graph.
    ``heaviest`` (K,): the bone that moves a patch most;
    ``tile_patch`` (Q,): the patch of a tile. ``vertex_charts`` (4, blocks, 64): the columns of a vertex's charts among
    those of all tiles. ``anchor_charts`` (4, blocks, 64): the same for anchors, among K x 56 anchor columns;
    ``member_anchor`` (K, 56): the anchors of a patch.
    """

    stored: dict[str, np.ndarray]
    heaviest: np.ndarray
    tile_patch: np.ndarray
    vertex_charts: np.ndarray
    anchor_charts: np.ndarray
    member_anchor: np.ndarray
    vertex_count: int

    @property
    def patch_count(self) -> int:
        return len(self.heaviest)

    @property
    def tile_count(self) -> int:
        return len(self.tile_patch)

    @property
    def bytes(self) -> int:
        """The memory of all arrays, in bytes."""
        indices = [self.heaviest, self.tile_patch, self.vertex_charts, self.anchor_charts, self.member_anchor]
        arrays = [*self.stored.values(), *indices]
        return sum(array.nbytes for array in arrays)


@dataclass(frozen=True, eq=False)
class Tiling:
    """How the chart entries of V vertices lie in Q tiles of ``width`` columns: ``patch`` (Q,) is the patch of a tile,
    ``column`` (V, 4) the column of an entry among those of all tiles."""

    patch: np.ndarray
    column: np.ndarray
    width: int

    def lay(self, values: np.ndarray) -> np.ndarray:
        """Returns the numbers ``values`` (V, 4, n) of the chart entries as tiles (Q, n, width) float32; columns without
        an entry are zero."""
        tiles = np.zeros((len(self.patch) * self.width, values.shape[-1]), dtype=np.float32)
        tiles[self.column.reshape(-1)] = values.reshape(-1, values.shape[-1])
        laid = tiles.reshape(len(self.patch), self.width, -1).transpose(0, 2, 1)
        return np.ascontiguousarray(laid)


def tile_charts(chart_patch: np.ndarray, patch_count: int, *, width: int = CHARTS_PER_TILE) -> Tiling:
    """Returns how chart entries lie in tiles of ``width`` columns, entries of one patch side by side. ``chart_patch``
    (V, 4) is the patch of each entry.

    Raises ``ArtifactError`` for other shapes, and for patches outside [0, ``patch_count``).
    """
    if chart_patch.ndim != 2 or chart_patch.shape[1] != CHARTS_PER_VERTEX or not len(chart_patch):
        raise ArtifactError(
            "chart_patch",
            expected=f"shape (vertices, {CHARTS_PER_VERTEX})",
            got=str(chart_patch.shape),
            cure="Run the intake again.",
        )
    _check_range("chart_patch", chart_patch, "indices", patch_count)
    flat = chart_patch.reshape(-1)
    order = np.argsort(flat, kind="stable")
    sizes = np.bincount(flat, minlength=patch_count)
    tiles = -(-sizes // width)
    start = (np.cumsum(tiles) - tiles) * width  # first column of each patch
    rank = np.arange(len(flat)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    column = np.empty(len(flat), dtype=np.int64)
    column[order] = start[flat[order]] + rank
    return Tiling(np.repeat(np.arange(patch_count), tiles).astype(np.int32), column.reshape(chart_patch.shape), width)


def _check_range(name: str, numbers: np.ndarray, what: str, count: int) -> None:
    if numbers.size and (numbers.min() < 0 or numbers.max() >= count):
        got = f"[{numbers.min()}, {numbers.max()}]"
        raise ArtifactError(name, expected=f"{what} in [0, {count})", got=got, cure="Run the intake again.")


def pack_garment(feed: dict[str, np.ndarray], patch_first: np.ndarray) -> PackedGarment:
    """Returns the garment with the ``garment_feed`` ``feed``, laid out for the packed graph.

    ``patch_first`` (K, n) is the summand of the decoder's first layer that depends on the patch alone, from the model's
    garment encoder. Raises ``ArtifactError`` for another number of rows, and for indices out of range.
    """
    count = len(feed["patch_scale"])
    if patch_first.ndim != 2 or len(patch_first) != count:
        raise ArtifactError(
            "patch_first",
            expected=f"{count} rows, one per patch",
            got=f"shape {patch_first.shape}",
            cure="Encode this garment's own patch features.",
        )
    heaviest = feed["patch_heaviest"]
    _check_range("patch_heaviest", heaviest, "bones", JOINT_COUNT)
    tiling = tile_charts(feed["chart_patch"], count)
    scale = feed["patch_scale"][feed["chart_patch"]].astype(np.float64)[..., None]
    entries = np.concatenate([feed["chart_local"] / scale, feed["chart_basis"]], axis=-1)
    columns = feed["chart_weight"].astype(np.float64)[..., None] * entries
    patches = StoredPatches(
        first=patch_first,
        weights=feed["patch_weights"],
        rotation=feed["patch_rotation"],
        scale=feed["patch_scale"][:, None],
        centre=np.concatenate([feed["patch_centre"], np.ones((count, 1))], axis=1),
        shapedirs=np.pad(feed["patch_shapedirs"], ((0, 0), (0, 1), (0, 0))),
        charts=_charts(feed),
        proximity=_proximity(feed) if "patch_place" in feed else None,
    )
    stored = patches.flat() | {"tile_positions": tiling.lay(columns)}
    return PackedGarment(
        stored={key: np.ascontiguousarray(value, dtype=KINDS[key]) for key, value in stored.items()},
        heaviest=heaviest.astype(np.int32),
        tile_patch=tiling.patch,
        vertex_charts=_small(_blocks(tiling.column)),
        anchor_charts=_small(_blocks(_anchor_rows(feed))),
        member_anchor=_small(feed["patch_member"]),
        vertex_count=len(columns),
    )


def _small(index: np.ndarray) -> np.ndarray:
    """``index`` in two bytes a number if they hold it."""
    return index.astype(np.uint16 if index.max(initial=0) <= np.iinfo(np.uint16).max else np.int32)


def _blocks(index: np.ndarray) -> np.ndarray:
    """``index`` (n, 4) as (4, blocks, 64), the last block filled up with the first row."""
    blocks = -(-len(index) // VERTICES_PER_BLOCK)
    filled = np.empty((blocks * VERTICES_PER_BLOCK, CHARTS_PER_VERTEX), dtype=np.int32)
    filled[: len(index)], filled[len(index) :] = index, index[0]
    return np.ascontiguousarray(filled.T).reshape(CHARTS_PER_VERTEX, blocks, VERTICES_PER_BLOCK)


def _charts(feed: dict[str, np.ndarray]) -> StoredCharts:
    """The tables of ``drape.garment.consensus`` of each patch, in columns like those of the tiles."""
    count = len(feed["patch_scale"])
    row = feed["anchor_row"][feed["patch_member"], feed["patch_slot"]].astype(np.float64)  # (K, 56, 19)
    row = np.where(_held(feed)[..., None], row, 0.0)
    rest_place = row[..., 1:4] / feed["patch_scale"][:, None, None]
    unit = feed["patch_orthonormal"]
    lower = row[..., 4 : 4 + jets.IN_PLANE_COUNT]  # the higher orders are products of these
    return StoredCharts(
        columns=np.concatenate([rest_place, lower], axis=-1).swapaxes(1, 2),
        fit=feed["patch_fit"].swapaxes(1, 2),
        rest=feed["patch_rest"].swapaxes(1, 2).reshape(count, -1),
        tangent=feed["patch_tangent"].transpose(0, 3, 2, 1).reshape(count, -1),
        unit=np.stack([unit[..., 0, 0], unit[..., 0, 1], unit[..., 1, 1]], axis=1),
    )


def _proximity(feed: dict[str, np.ndarray]) -> StoredProximity:
    """Points of each patch at which body proximity is read, and the skin near them at rest."""
    count, regions = feed["patch_other"].shape[:2]
    parts = regions // POSED_REGIONS
    return StoredProximity(
        place=(feed["patch_place"] / feed["patch_scale"][:, None, None]).swapaxes(1, 2),
        cluster=feed["patch_cluster"],
        bias=feed["patch_cluster_bias"],
        other=in_halves(feed["patch_other"]).reshape(count, parts, -1),
        region=feed["patch_region_bias"].reshape(count, parts, POSED_REGIONS),
    )


def _held(feed: dict[str, np.ndarray]) -> np.ndarray:
    """Places (K, 56) that hold an anchor: the fit is zero in the others."""
    return np.any(feed["patch_fit"] != 0.0, axis=1)


def _anchor_rows(feed: dict[str, np.ndarray]) -> np.ndarray:
    """Rows of the anchors' charts (A, 4) among the K x 56 anchor columns; charts of no weight have columns of zeros."""
    held = _held(feed)
    empty = MEMBERS - 1  # the last place of a patch is always empty
    rows = feed["anchor_patch"] * MEMBERS + empty
    patch, place = np.nonzero(held)
    rows[feed["patch_member"][held], feed["patch_slot"][held]] = patch * MEMBERS + place
    return rows


@dataclass(frozen=True)
class Place:
    """The first rows of a garment among all stored patches and tiles."""

    patch: int
    tile: int


@dataclass(frozen=True, eq=False)
class Composition:
    """The index tensors of a call by name (``Indices``), and the rows of its items in the outputs: the ``patches`` and
    the ``vertices`` of each."""

    arrays: dict[str, np.ndarray]
    patches: tuple[slice, ...]
    vertices: tuple[slice, ...]

    @property
    def bytes(self) -> int:
        """The memory of the index tensors, in bytes."""
        return sum(array.nbytes for array in self.arrays.values())


def compose_garments(items: Sequence[tuple[PackedGarment, Place, int]]) -> Composition:
    """Returns the index tensors of a call and the rows of ``items`` in its outputs. An item is a garment, its first
    rows in store, and the row of its body."""
    patch_stored, patch_body, patch_bone, tile_stored, tile_patch, charts = ([] for _ in range(6))
    anchor_charts, member_anchor = [], []
    patches, vertices = [], []
    patch = tile = block = anchor_block = 0
    for garment, place, body in items:
        patch_stored.append(np.arange(place.patch, place.patch + garment.patch_count, dtype=np.int32))
        patch_body.append(np.full(garment.patch_count, body, dtype=np.int32))
        patch_bone.append(garment.heaviest + np.int32(JOINT_COUNT * body))
        tile_stored.append(np.arange(place.tile, place.tile + garment.tile_count, dtype=np.int32))
        tile_patch.append(garment.tile_patch + np.int32(patch))
        charts.append(garment.vertex_charts + np.int32(CHARTS_PER_TILE * tile))
        anchor_charts.append(garment.anchor_charts + np.int32(MEMBERS * patch))
        member_anchor.append(garment.member_anchor + np.int32(VERTICES_PER_BLOCK * anchor_block))
        anchor_block += garment.anchor_charts.shape[1]
        patches.append(slice(patch, patch + garment.patch_count))
        vertices.append(slice(VERTICES_PER_BLOCK * block, VERTICES_PER_BLOCK * block + garment.vertex_count))
        patch, tile = patch + garment.patch_count, tile + garment.tile_count
        block += garment.vertex_charts.shape[1]
    indices = Indices(
        stored=np.concatenate(patch_stored),
        body=np.concatenate(patch_body),
        bone=np.concatenate(patch_bone),
        tile_stored=np.concatenate(tile_stored),
        tile_patch=np.concatenate(tile_patch),
        vertex_charts=np.concatenate(charts, axis=1),
        anchor_charts=np.concatenate(anchor_charts, axis=1),
        member_anchor=np.concatenate(member_anchor),
    )
    return Composition(indices.flat(), tuple(patches), tuple(vertices))
