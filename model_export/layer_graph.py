"""The push-out of a garment over others as a graph of its own: out of the body and of the garments below it.

Like ``push_graph`` it has no weights; the garments below come as their draped vertices.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor, nn

from drape.artifacts import TensorSpec
from drape.body.assets import load_body
from drape.cloth.push.layers import MEMBERS
from drape.cloth.push.out import CLEARANCE_M, PushFeed
from drape.cloth.push.samples import CLUSTER_SIZE, POSED_REGIONS
from drape.cloth.push.skin import body_skin, skin_table
from drape.feeds import garment_feed
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.layer_packing import PART_CLUSTERS, LayerFeed, layer_arrays, pack_layer, push_over, push_over_in_parts, sheet
from drape.subnormals import flushed
from model_export.parity import hard_poses, session
from model_export.push_graph import SAMPLE as PUSH_SAMPLE
from model_export.push_graph import push_inputs

SAMPLE = PUSH_SAMPLE | {"under_vertices": 31, "all_parts": 10, "cloth_parts": 6}
OF_SAMPLES = ("push_other", "push_region_bias")


def layer_inputs() -> tuple[TensorSpec, ...]:
    """Inputs of the graph, in order: those of the push-out's, whose samples are ``region``, and the garments below."""
    specs = []
    for spec in push_inputs():
        shape = tuple("all_parts" if axis == "parts" else axis for axis in spec.shape)
        specs.append(TensorSpec(spec.name, shape, spec.dtype, spec.unit) if spec.name in OF_SAMPLES else spec)
    return (
        *specs,
        TensorSpec("under", ("frames", "under_vertices", 3), "float32", "m"),
        TensorSpec("region", ("all_parts", POSED_REGIONS), "int32", "region of samples"),
        TensorSpec("cloth_member", ("cloth_parts", PART_CLUSTERS, MEMBERS), "int32", "vertex of under"),
        TensorSpec("cloth_rows", ("cloth_parts", PART_CLUSTERS, MEMBERS, 3 * CLUSTER_SIZE), "float32", "1"),
    )


class LayerGraph(nn.Module):
    """``drape.layer_packing.push_over`` with the skin posed by its bones."""

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
        under: Tensor,
        region: Tensor,
        cloth_member: Tensor,
        cloth_rows: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        push = PushFeed(
            block_vertex=push_block_vertex, vertex_slot=push_vertex_slot, own_cluster=push_own_cluster,
            own_bias=push_own_bias, other=push_other, region_bias=push_region_bias,
            patch_block=push_patch_block, patch_fit=push_patch_fit, tile_basis=push_tile_basis,
            tile_patch=push_tile_patch, slot_charts=push_slot_charts,
        )  # fmt: skip
        feed = LayerFeed(push, region, cloth_member, cloth_rows)  # pyright: ignore[reportArgumentType]
        skin = skin_table(skin_rows, skin_bones, bone_rotation, bone_translation)
        found = push_over_in_parts(vertices, under, skin, feed, clearance)
        return found.vertices, found.coefficients, found.left_m, skin


def layer_case(
    outer: Garment, inner: Garment, poses: np.ndarray, clearance_m: float = CLEARANCE_M
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Inputs of the graph for two skinned garments in ``poses`` (F, 24, 3), and what numpy makes of them."""
    body = load_body()
    rotations, translations = (x.astype(np.float32) for x in body.bones(poses))
    drawn = []
    for garment in (outer, inner):
        count = garment.vertex_count
        rest = np.broadcast_to(garment.vertices[:count], (len(poses), count, 3)).astype(np.float64)
        weights = garment.skin_weights[:count].astype(np.float64)
        drawn.append(skin_points(rest, weights, rotations, translations).astype(np.float32))
    skin = body_skin(body)
    feed = pack_layer(garment_feed(outer), outer.vertices[: outer.vertex_count], skin, [sheet(inner)])
    bones = skin.on_bones(body)
    arrays = {
        "vertices": drawn[0],
        "under": drawn[1],
        "bone_rotation": rotations,
        "bone_translation": translations,
        "clearance": np.full(1, clearance_m, dtype=np.float32),
        "skin_rows": bones.rows,
        "skin_bones": bones.bones,
        **layer_arrays(feed),
    }
    table = skin_table(bones.rows, bones.bones, rotations, translations)
    return arrays, push_over(drawn[0], drawn[1], table, feed, np.float32(clearance_m))


@flushed()
def layer_parity_error(file: Path, garment: Garment, *, frames: int = 3) -> float:
    """Largest vertex distance [m] between numpy and onnxruntime, for a garment worn over its like in hard poses."""
    arrays, expected = layer_case(garment, garment, hard_poses(frames))
    got = np.asarray(session(file).run(["pushed"], arrays)[0])
    return float(np.linalg.norm(got - expected, axis=-1).max())
