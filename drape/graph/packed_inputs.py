"""Inputs of the packed drape graph, each declared once: bodies, stored patches and tiles, and index tensors.

``drape.graph.packing`` makes the arrays and says how they lie in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

from drape.arrays import Array
from drape.arrays.tensors import Tensors, group, tensor
from drape.body.skeleton import JOINT_COUNT
from drape.contact.push_tables import OWN_CLUSTERS
from drape.contact.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.consensus import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.geometry import jets
from drape.graph.inputs import AGREES, BETA_COUNT, DYNAMIC, FEELS

COLUMNS = 3 + jets.HEIGHT_COUNT  # rest place, basis
LOWER_COLUMNS = 3 + jets.IN_PLANE_COUNT  # rest place, basis up to the second order
CHARTS_PER_TILE = 32  # half of a patch's last tile is empty on average
VERTICES_PER_BLOCK = 64
PART_SIZE = POSED_REGIONS * REGION_SIZE  # samples that are posed together


@dataclass(frozen=True, eq=False)
class ShapedSkins(Tensors):
    """The skins of U body shapes as weighted sums over bones (``SkinOnBones``), and the shape of each body."""

    rows: Array = tensor("skin_rows", "shapes", "parts", "part_bones", 4, 3 * PART_SIZE, unit="m or 1")
    bones: Array = tensor("skin_bones", "parts", "part_bones", dtype="int32", unit="bone index")
    shape: Array = tensor("body_shape", "bodies", dtype="int32", unit="row of skin_rows")


@dataclass(frozen=True, eq=False)
class PackedBodies(Tensors):
    """B bodies as the packed graph takes them: rotations relative to the parent (wxyz), rest joints, shape, the code of
    motion, and the skin that patches feel.

    A last rotation, the identity, stands for the parent of joints that have none. ``dynamic_code`` is added to the code
    of the pose.
    """

    quaternion: Array = tensor("joint_quaternion", "bodies", JOINT_COUNT + 1, 4, unit="1, relative to the parent")
    rest: Array = tensor("joint_rest", "bodies", JOINT_COUNT, 3, unit="m")
    betas: Array = tensor("betas", "bodies", BETA_COUNT, unit="standard deviations")
    dynamic_code: Array | None = tensor("dynamic_code", "bodies", "code", part=DYNAMIC)
    skins: ShapedSkins | None = group(ShapedSkins, part=FEELS)


@dataclass(frozen=True, eq=False)
class StoredCharts(Tensors):
    """The tables by which stored patches are fitted to the blend at their 56 anchors, and by which their strain is
    read.

    ``columns``: the anchor's blend weight in the patch times [its rest place in patch scales, the basis up to the
    second order]. ``fit`` takes values at the anchors to 21 coefficients, 15 of the height's order and 6 of the
    in-plane order; ``rest`` are the coefficients of x, y and z at rest. ``tangent``: derivatives at rest at seven
    strain points, by u of x, y, z, then by v; ``unit``: entries 00, 01 and 11 of ``AgreementTensors.orthonormal``.
    """

    columns: Array = tensor("anchor_columns", "patches", LOWER_COLUMNS, MEMBERS)
    fit: Array = tensor("anchor_fit", "patches", MEMBERS, FIT_COUNT)
    rest: Array = tensor("anchor_rest", "patches", 3 * FIT_COUNT, unit="patch scales")
    tangent: Array = tensor("strain_tangent", "patches", 6 * STRAIN_POINTS)
    unit: Array = tensor("strain_unit", "patches", 3, STRAIN_POINTS)


@dataclass(frozen=True, eq=False)
class StoredProximity(Tensors):
    """Points at which stored patches read body proximity, and the skin near them at rest.

    ``place`` are the strain points at rest in the patch's frame. ``cluster``, ``bias`` and ``region`` are
    ``own_cluster``, ``own_bias`` and ``region_bias`` of ``PatchSkin``, ``other`` is its ``other``, two numbers to a
    byte (``proximity.in_halves``).
    """

    place: Array = tensor("felt_place", "patches", 3, STRAIN_POINTS, unit="patch scales")
    cluster: Array = tensor("felt_cluster", "patches", OWN_CLUSTERS, dtype="int32", unit="cluster of samples")
    bias: Array = tensor("felt_bias", "patches", OWN_CLUSTERS * CLUSTER_SIZE)
    other: Array = tensor("felt_other", "patches", "parts", PART_SIZE // 2, dtype="uint8", unit="1 / 15, two each")
    region: Array = tensor("felt_region", "patches", "parts", POSED_REGIONS, dtype="float16")


@dataclass(frozen=True, eq=False)
class StoredPatches(Tensors):
    """The constants of stored patches: frames at rest, skinning weights, how their centres move with the body's shape,
    and ``first``, the summand of the decoder's first layer that depends on the patch alone."""

    first: Array = tensor("patch_first", "patches", "width")
    weights: Array = tensor("patch_weights", "patches", JOINT_COUNT)
    rotation: Array = tensor("patch_rotation", "patches", 3, 3)
    scale: Array = tensor("patch_scale", "patches", 1, unit="m")
    centre: Array = tensor("patch_centre", "patches", 4, unit="m, homogeneous")
    shapedirs: Array = tensor("patch_shapedirs", "patches", 4, BETA_COUNT, unit="m, last row zero")
    charts: StoredCharts | None = group(StoredCharts, part=AGREES)
    proximity: StoredProximity | None = group(StoredProximity, part=FEELS)


@dataclass(frozen=True, eq=False)
class StoredTiles(Tensors):
    """The chart entries of stored garments, as columns of tiles (``drape.graph.packing``)."""

    positions: Array = tensor("tile_positions", "stored_tiles", COLUMNS, CHARTS_PER_TILE)


@dataclass(frozen=True, eq=False)
class Indices(Tensors):
    """The patches, tiles and vertices of one call, as rows of what is stored and of the bodies; the units name the
    rows."""

    stored: Array = tensor("patch_stored", "patches", dtype="int32", unit="row of patch_first and the like")
    body: Array = tensor("patch_body", "patches", dtype="int32", unit="row of joint_quaternion and the like")
    bone: Array = tensor("patch_bone", "patches", dtype="int32", unit="24 patch_body + heaviest bone")
    tile_stored: Array = tensor("tile_stored", "tiles", dtype="int32", unit="row of tile_positions")
    tile_patch: Array = tensor("tile_patch", "tiles", dtype="int32", unit="packed patch")
    vertex_charts: Array = tensor(
        "vertex_charts", CHARTS_PER_VERTEX, "blocks", VERTICES_PER_BLOCK, dtype="int32", unit="column of the tiles"
    )
    anchor_charts: Array | None = tensor(
        "anchor_charts", CHARTS_PER_VERTEX, "anchor_blocks", VERTICES_PER_BLOCK, dtype="int32", unit="anchor column",
        part=AGREES,
    )  # fmt: skip
    member_anchor: Array | None = tensor("member_anchor", "patches", MEMBERS, dtype="int32", unit="anchor", part=AGREES)


@dataclass(frozen=True, eq=False)
class PackedTensors(Tensors):
    """All inputs of the packed graph."""

    bodies: PackedBodies = group(PackedBodies)
    patches: StoredPatches = group(StoredPatches, patches="stored_patches")
    tiles: StoredTiles = group(StoredTiles)
    index: Indices = group(Indices)
