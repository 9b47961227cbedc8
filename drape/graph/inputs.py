"""Inputs of the readable drape graph, each declared once: posed bodies, patches, charts and how charts agree.

Training, export and tests hold these groups; ``drape.graph.feeds`` makes their arrays by name. Inputs of the packed
graph stand in ``drape.graph.packed_inputs``, those of the push-out in ``drape.graph.push_feed`` and ``layer_feed``.
"""

from __future__ import annotations

from dataclasses import dataclass

from drape.arrays import Array
from drape.arrays.tensors import Tensors, group, tensor
from drape.body.features import DYNAMIC_PER_JOINT, feature_count
from drape.body.skeleton import JOINT_COUNT
from drape.contact.proximity import PatchSkin
from drape.contact.samples import REGION_SIZE
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.consensus import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.geometry import jets

BETA_COUNT = 10
SLOPE = 0.01  # LeakyReLU's slope below zero, as in appendix A.3 of OneFit
ROOT = "m, relative to the root joint"
# Parts of a network that need inputs of their own, in the order in which a graph has them.
PAPER, SURROUNDINGS, DYNAMIC, AGREES, FEELS = PARTS = ("paper", "surroundings", "dynamic", "agrees", "feels")


@dataclass(frozen=True, eq=False)
class BodyTensors(Tensors):
    """F posed bodies as the readable graph takes them, relative to the root joint's rest place.

    ``features`` are pose features and shape; ``rotation``, ``translation`` and ``quaternion`` (wxyz) are the bones'
    motion from the T-pose; ``skin`` are the posed samples of ``drape.contact.skin.skin_table``.
    """

    features: Array = tensor("body_features", "frames", feature_count() + BETA_COUNT)
    rotation: Array = tensor("bone_rotation", "frames", JOINT_COUNT, 3, 3)
    translation: Array = tensor("bone_translation", "frames", JOINT_COUNT, 3, unit="m")
    quaternion: Array = tensor("bone_quaternion", "frames", JOINT_COUNT, 4)
    betas: Array = tensor("betas", "frames", BETA_COUNT, unit="standard deviations")
    joints: Array | None = tensor("body_joints", "frames", JOINT_COUNT, 3, unit=ROOT, part=SURROUNDINGS)
    skin: Array | None = tensor(
        "body_skin", "frames", "regions", REGION_SIZE, 8, unit="m and 1, relative to the root joint", part=FEELS
    )


@dataclass(frozen=True, eq=False)
class PatchTensors(Tensors):
    """The constants of a garment's K patches: their frames at rest, skinning weights, how their centres move with the
    body's shape, and the skin near them. ``place`` are the seven strain points at rest in the patch's frame."""

    centre: Array = tensor("patch_centre", "patches", 3, unit="m")
    rotation: Array = tensor("patch_rotation", "patches", 3, 3)
    scale: Array = tensor("patch_scale", "patches", unit="m")
    weights: Array = tensor("patch_weights", "patches", JOINT_COUNT)
    heaviest: Array = tensor("patch_heaviest", "patches", dtype="int64", unit="bone index")
    shapedirs: Array = tensor("patch_shapedirs", "patches", 3, BETA_COUNT, unit="m")
    place: Array | None = tensor("patch_place", "patches", STRAIN_POINTS, 3, unit="m", part=FEELS)
    skin: PatchSkin | None = group(PatchSkin, part=FEELS)


@dataclass(frozen=True, eq=False)
class ChartTensors(Tensors):
    """The charts of V vertices, at most four each: the ``patch``, its ``weight`` in the blend (0 where there is no
    chart), the ``basis``, monomials of the height's polynomial at the vertex, and ``local``, the vertex at rest in the
    patch's frame."""

    patch: Array = tensor("chart_patch", "vertices", CHARTS_PER_VERTEX, dtype="int64", unit="patch index")
    weight: Array = tensor("chart_weight", "vertices", CHARTS_PER_VERTEX)
    basis: Array = tensor("chart_basis", "vertices", CHARTS_PER_VERTEX, jets.HEIGHT_COUNT)
    local: Array = tensor("chart_local", "vertices", CHARTS_PER_VERTEX, 3, unit="m")


@dataclass(frozen=True, eq=False)
class AgreementTensors(Tensors):
    """The tables by which overlapping patches are fitted to their blend at the anchors, a few vertices of each patch.

    ``anchor_patch`` are the patches of an anchor's four charts; ``anchor_row`` is the weight of a chart times [1, the
    anchor at rest in the patch's frame, the monomials of the height]. The other fields are those of
    ``drape.garment.consensus.Consensus``.
    """

    anchor_patch: Array = tensor("anchor_patch", "anchors", CHARTS_PER_VERTEX, dtype="int64", unit="patch index")
    anchor_row: Array = tensor("anchor_row", "anchors", CHARTS_PER_VERTEX, 4 + jets.HEIGHT_COUNT, unit="1 and m")
    member: Array = tensor("patch_member", "patches", MEMBERS, dtype="int64", unit="anchor index")
    fit: Array = tensor("patch_fit", "patches", FIT_COUNT, MEMBERS)
    rest: Array = tensor("patch_rest", "patches", FIT_COUNT, 3, unit="patch scales")
    tangent: Array = tensor("patch_tangent", "patches", STRAIN_POINTS, 3, 2)
    orthonormal: Array = tensor("patch_orthonormal", "patches", STRAIN_POINTS, 2, 2)


@dataclass(frozen=True, eq=False)
class MotionTensors(Tensors):
    """The inputs of the recurrent motion encoder, a row for each client: motion features (``drape.body.features``), the
    encoder's state, and the time since the frame before."""

    features: Array = tensor("motion_features", "clients", JOINT_COUNT, DYNAMIC_PER_JOINT, unit="1/s and m/s^2")
    state: Array = tensor("state", "clients", "state")
    dt_s: Array = tensor("dt_s", "clients", unit="s")
