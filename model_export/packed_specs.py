"""Names, shapes, types and units of the packed graph's tensors, and sizes to trace it with."""

from __future__ import annotations

from drape.artifacts import TensorSpec
from drape.body.skeleton import JOINT_COUNT
from drape.garment.agreement import FIT_COUNT, MEMBERS, STRAIN_POINTS
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.geometry import jets
from drape.graph.feeds import BETA_COUNT
from drape.graph.packing import CHARTS_PER_TILE, COLUMNS, LOWER_COLUMNS, VERTICES_PER_BLOCK, pass_name
from drape.push.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE
from drape.push.tables import OWN_CLUSTERS
from training.agreement import TANGENT_COUNT
from training.model import OneFit

# As in export.SAMPLE: odd, and unlike each other and every fixed axis.
SAMPLE = {
    "bodies": 5, "patches": 7, "tiles": 9, "items": 11, "blocks": 13, "blocks_per_item": 17,
    "stored_patches": 19, "stored_tiles": 21, "stored_tangents": 23, "anchor_blocks": 27,
    "shapes": 3, "parts": 6, "part_bones": 10,
}  # fmt: skip
PART_SIZE = POSED_REGIONS * REGION_SIZE  # samples that are posed together

AGREEMENT_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("anchor_columns", ("stored_patches", LOWER_COLUMNS, MEMBERS), "float32", "1"),
    TensorSpec("anchor_fit", ("stored_patches", MEMBERS, FIT_COUNT), "float32", "1"),
    TensorSpec("anchor_rest", ("stored_patches", 3 * FIT_COUNT), "float32", "patch scales"),
    TensorSpec("strain_tangent", ("stored_patches", TANGENT_COUNT), "float32", "1"),
    TensorSpec("strain_unit", ("stored_patches", 3, STRAIN_POINTS), "float32", "1"),
    TensorSpec("anchor_charts", (CHARTS_PER_VERTEX, "anchor_blocks", VERTICES_PER_BLOCK), "int32", "anchor column"),
    TensorSpec("member_anchor", ("patches", MEMBERS), "int32", "anchor"),
)


# Of networks that feel the body; a shape is one of a body, shared by all bodies that have it.
CONTACT_INPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("skin_rows", ("shapes", "parts", "part_bones", 4, 3 * PART_SIZE), "float32", "m or 1"),
    TensorSpec("skin_bones", ("parts", "part_bones"), "int32", "bone index"),
    TensorSpec("body_shape", ("bodies",), "int32", "row of skin_rows"),
    TensorSpec("felt_place", ("stored_patches", 3, STRAIN_POINTS), "float32", "patch scales"),
    TensorSpec("felt_cluster", ("stored_patches", OWN_CLUSTERS), "int32", "cluster of samples"),
    TensorSpec("felt_bias", ("stored_patches", OWN_CLUSTERS * CLUSTER_SIZE), "float32", "1"),
    TensorSpec("felt_other", ("stored_patches", "parts", PART_SIZE // 2), "uint8", "1 / 15, two each"),
    TensorSpec("felt_region", ("stored_patches", "parts", POSED_REGIONS), "float16", "1"),
)
SKIN_OUTPUT = TensorSpec(
    "skin", ("bodies", "regions", REGION_SIZE, 8), "float32", "m and 1, relative to the root joint"
)


def packed_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the packed graph of ``model``, in order."""
    return (
        TensorSpec("vertices", ("blocks", VERTICES_PER_BLOCK, 3), "float32", "m, relative to the root joint"),
        TensorSpec("normals", ("blocks", VERTICES_PER_BLOCK, 3), "float32", "1"),
        TensorSpec("steps", ("blocks", VERTICES_PER_BLOCK, 3), "uint16", "box_step"),
        TensorSpec("box_low", ("items", 3), "float32", "m, relative to the root joint"),
        TensorSpec("box_step", ("items", 3), "float32", "m"),
        TensorSpec("jet", ("patches", model.jet_count), "float32", "patch scales"),
        TensorSpec("frame_rotation", ("patches", 3, 3), "float32", "1"),
        TensorSpec("frame_centre", ("patches", 3), "float32", "m, relative to the root joint"),
        TensorSpec("bone_rotation", ("bodies", JOINT_COUNT, 3, 3), "float32", "1"),
        TensorSpec("bone_translation", ("bodies", JOINT_COUNT, 3), "float32", "m, relative to the root joint"),
        *((SKIN_OUTPUT,) if model.config.feels_body else ()),
        *pass_outputs(model),
    )


def pass_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Jets before the first correction of ``model`` and after each; none where no closing fit takes them."""
    count = model.config.corrections
    if not model.config.closing_fit or count == 0:
        return ()
    return tuple(
        TensorSpec(pass_name(i), ("patches", jets.JET_COUNT), "float32", "patch scales") for i in range(count + 1)
    )


def packed_inputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Inputs of the packed graph of ``model``, in order."""
    width = model.config.decoder_sizes[0]
    charts = AGREEMENT_INPUTS if model.agrees else ()
    contact = CONTACT_INPUTS if model.config.feels_body else ()
    code = (TensorSpec("dynamic_code", ("bodies", model.config.body_code_size), "float32", "1"),)
    return (
        TensorSpec("joint_quaternion", ("bodies", JOINT_COUNT + 1, 4), "float32", "1, relative to the parent"),
        TensorSpec("joint_rest", ("bodies", JOINT_COUNT, 3), "float32", "m"),
        TensorSpec("betas", ("bodies", BETA_COUNT), "float32", "standard deviations"),
        TensorSpec("patch_first", ("stored_patches", width), "float32", "1"),
        TensorSpec("patch_weights", ("stored_patches", JOINT_COUNT), "float32", "1"),
        TensorSpec("patch_rotation", ("stored_patches", 3, 3), "float32", "1"),
        TensorSpec("patch_scale", ("stored_patches", 1), "float32", "m"),
        TensorSpec("patch_centre", ("stored_patches", 4), "float32", "m, homogeneous"),
        TensorSpec("patch_shapedirs", ("stored_patches", 4, BETA_COUNT), "float32", "m, last row zero"),
        TensorSpec("tile_positions", ("stored_tiles", COLUMNS, CHARTS_PER_TILE), "float32", "1"),
        TensorSpec("tile_tangents", ("stored_tangents", COLUMNS, 2 * CHARTS_PER_TILE), "float32", "1/m"),
        TensorSpec("patch_stored", ("patches",), "int32", "row of patch_first and the like"),
        TensorSpec("patch_body", ("patches",), "int32", "row of joint_quaternion and the like"),
        TensorSpec("patch_bone", ("patches",), "int32", "24 patch_body + heaviest bone"),
        TensorSpec("tile_stored", ("tiles",), "int32", "row of tile_positions"),
        TensorSpec("tile_patch", ("tiles",), "int32", "packed patch"),
        TensorSpec("vertex_charts", (CHARTS_PER_VERTEX, "blocks", VERTICES_PER_BLOCK), "int32", "column of the tiles"),
        TensorSpec("block_item", ("blocks",), "int32", "item of a block of vertices"),
        TensorSpec("item_blocks", ("items", "blocks_per_item"), "int32", "blocks of an item, the first one repeated"),
        *(code if model.config.dynamic else ()),
        *charts,
        *contact,
    )


def first_outputs(model: OneFit) -> tuple[TensorSpec, ...]:
    """Outputs of the garment encoder where the model has a packed graph."""
    return (
        TensorSpec("patch_embedding", ("patches", model.config.embedding_size), "float32", "1"),
        TensorSpec("patch_first", ("patches", model.config.decoder_sizes[0]), "float32", "1"),
    )
