"""The push-out as a graph of its own: draped vertices and bones in, vertices out of the body.

It has no weights: skin, garment and clearance are inputs, so one file serves every network, garment, body and shape,
and takes what the drape graph gives, what the packed graph gives, and plain skinning where a network fails.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor, nn

from drape.artifacts import TensorSpec
from drape.body.assets import load_body
from drape.body.skeleton import JOINT_COUNT
from drape.cloth.push.out import CLEARANCE_M, PushFeed, push_in_parts, push_out
from drape.cloth.push.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE
from drape.cloth.push.skin import body_skin, skin_table
from drape.cloth.push.tables import BLOCK_SIZE, GROUP_SIZE, OWN_CLUSTERS
from drape.feeds import garment_feed
from drape.garment.cache import CHARTS_PER_VERTEX, Garment
from drape.geometry.skinning import skin_points
from drape.push_packing import TERMS, TILE_WIDTH, feed_arrays, pack_push
from drape.subnormals import flushed
from model_export.parity import hard_poses, session

# As in export.SAMPLE: odd, and unlike each other and every fixed axis.
SAMPLE = {
    "frames": 3, "vertices": 29, "parts": 7, "part_bones": 5, "groups": 11, "tiles": 9, "patches": 13,
    "patch_blocks": 15,
}  # fmt: skip
OUTPUTS: tuple[TensorSpec, ...] = (
    TensorSpec("pushed", ("frames", "vertices", 3), "float32", "m"),
    TensorSpec("jet_push", ("frames", "patches", 3, TERMS), "float32", "m, in the axes of the vertices"),
    TensorSpec("left", ("frames",), "float32", "m, what the jets lack"),
    TensorSpec("skin", ("frames", "regions", REGION_SIZE, 8), "float32", "m and 1, as the bones"),
)
OWN = OWN_CLUSTERS * CLUSTER_SIZE


def push_inputs() -> tuple[TensorSpec, ...]:
    """Inputs of the graph, in order; those that start with "push" are constants of a garment, "skin" of a body."""
    return (
        TensorSpec("vertices", ("frames", "vertices", 3), "float32", "m"),
        TensorSpec("bone_rotation", ("frames", JOINT_COUNT, 3, 3), "float32", "1"),
        TensorSpec("bone_translation", ("frames", JOINT_COUNT, 3), "float32", "m, relative as vertices are"),
        TensorSpec("clearance", (1,), "float32", "m"),
        TensorSpec("skin_rows", ("parts", "part_bones", 4, 3 * POSED_REGIONS * REGION_SIZE), "float32", "m or 1"),
        TensorSpec("skin_bones", ("parts", "part_bones"), "int32", "bone index"),
        TensorSpec("push_block_vertex", ("groups", GROUP_SIZE * BLOCK_SIZE), "int32", "vertex"),
        TensorSpec("push_vertex_slot", ("vertices",), "int32", "slot"),
        TensorSpec("push_own_cluster", ("groups", GROUP_SIZE, OWN_CLUSTERS), "int32", "cluster of samples"),
        TensorSpec("push_own_bias", ("groups", GROUP_SIZE, OWN), "float32", "1"),
        TensorSpec("push_other", ("groups", "parts", POSED_REGIONS * REGION_SIZE), "uint8", "1 / 255"),
        TensorSpec("push_region_bias", ("groups", "parts", POSED_REGIONS), "float32", "1"),
        TensorSpec("push_patch_block", ("patches", "patch_blocks"), "int32", "block"),
        TensorSpec("push_patch_fit", ("patches", "patch_blocks", TERMS), "float32", "1"),
        TensorSpec("push_tile_basis", ("tiles", TERMS, TILE_WIDTH), "float32", "1"),
        TensorSpec("push_tile_patch", ("tiles",), "int32", "patch"),
        TensorSpec("push_slot_charts", (CHARTS_PER_VERTEX, "groups", GROUP_SIZE * BLOCK_SIZE), "int32", "column"),
    )


class PushGraph(nn.Module):
    """``drape.cloth.push.out.push_out`` with the skin posed by its bones, or given: it is an output too."""

    def forward(
        self,
        vertices: Tensor,
        bone_rotation: Tensor,
        bone_translation: Tensor,
        clearance: Tensor,
        skin_rows: Tensor,
        skin_bones: Tensor,
        push_block_vertex: Tensor,
        push_vertex_slot: Tensor,
        push_own_cluster: Tensor,
        push_own_bias: Tensor,
        push_other: Tensor,
        push_region_bias: Tensor,
        push_patch_block: Tensor,
        push_patch_fit: Tensor,
        push_tile_basis: Tensor,
        push_tile_patch: Tensor,
        push_slot_charts: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        feed = PushFeed(
            block_vertex=push_block_vertex, vertex_slot=push_vertex_slot, own_cluster=push_own_cluster,
            own_bias=push_own_bias, other=push_other, region_bias=push_region_bias,
            patch_block=push_patch_block, patch_fit=push_patch_fit, tile_basis=push_tile_basis,
            tile_patch=push_tile_patch, slot_charts=push_slot_charts,
        )  # fmt: skip
        skin = skin_table(skin_rows, skin_bones, bone_rotation, bone_translation)
        found = push_in_parts(vertices, skin, feed, clearance)
        return found.vertices, found.coefficients, found.left_m, skin


@flushed()
def push_parity_error(file: Path, garment: Garment, *, frames: int = 3) -> float:
    """Largest vertex distance [m] between numpy and onnxruntime, for a skinned garment in hard poses."""
    body = load_body()
    skin = body_skin(body)
    rotations, translations = body.bones(hard_poses(frames))
    rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    weights = garment.skin_weights[: garment.vertex_count].astype(np.float64)
    vertices = skin_points(np.broadcast_to(rest, (frames, *rest.shape)), weights, rotations, translations)
    feed, bones = pack_push(garment_feed(garment), rest, skin), skin.on_bones(body)
    arrays = {
        "vertices": vertices.astype(np.float32),
        "bone_rotation": rotations.astype(np.float32),
        "bone_translation": translations.astype(np.float32),
        "clearance": np.full(1, CLEARANCE_M, dtype=np.float32),
        "skin_rows": bones.rows,
        "skin_bones": bones.bones,
        **feed_arrays(feed),
    }
    got = np.asarray(session(file).run(["pushed"], arrays)[0])
    table = skin_table(bones.rows, bones.bones, arrays["bone_rotation"], arrays["bone_translation"])
    expected = push_out(arrays["vertices"], table, feed)
    return float(np.linalg.norm(got - expected, axis=-1).max())
