"""The packed graph computes what the readable one does, for every configuration, output and mix of items."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.packing import Composition, Place, compose_garments, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes
from model_export.packed.graph import FirstGraph, PackedGraph, packed_inputs, packed_outputs
from model_export.packed.kinematics import ancestor_jumps
from model_export.parity import packed_parity_error, parity_poses
from model_export.readable_graphs import DrapeGraph, EncoderGraph, drape_inputs
from tests.fixtures.packed import KINDS, SMALL, described, exported, garment, lively
from tests.fixtures.rounding import FIT_MOVED, FIT_ROUNDING, moved_by_rounding
from training.config import as_published
from training.layers import Decoder
from training.onefit import OneFit

FRAMES = 4
ITEMS = [("shorts", 2), ("tank", 0), ("shorts", 3), ("tank", 1), ("tank", 2)]
BETAS = np.random.default_rng(5).normal(size=load_body().shape_count)


def first_of(model: OneFit, kind: str) -> tuple[np.ndarray, np.ndarray]:
    with torch.no_grad():
        embedding, first = FirstGraph(model)({"patch_features": torch.from_numpy(described(kind, model.config))})
    return embedding.numpy(), first.numpy()


def run_packed(model: OneFit, **more: np.ndarray) -> tuple[dict[str, np.ndarray], Composition]:
    """All outputs of ``ITEMS`` by the packed graph in torch."""
    made, places, patch, tile = {}, {}, 0, 0
    for kind in ("tank", "shorts"):
        whole = garment(kind)
        made[kind] = pack_garment(garment_feed(whole, body=load_body()), first_of(model, kind)[1])
        places[kind] = Place(patch, tile)
        patch, tile = patch + made[kind].patch_count, tile + made[kind].tile_count
    stored = {name: np.concatenate([m.stored[name] for m in made.values()]) for name in made["tank"].stored}
    bodies = pack_body(load_body(), BETAS).rows(parity_poses(FRAMES, seed=1))
    bodies |= SkinShapes(load_body()).feed(bodies["betas"])
    composition = compose_garments([(made[kind], places[kind], row) for kind, row in ITEMS])
    arrays = bodies | stored | composition.arrays | more
    with torch.no_grad():
        graph = PackedGraph(model)
        out = graph({s.name: torch.from_numpy(np.array(arrays[s.name])) for s in packed_inputs(model)})
    return {spec.name: value.numpy() for spec, value in zip(packed_outputs(model), out, strict=True)}, composition


def feed_of(model: OneFit, kind: str, row: int) -> dict[str, np.ndarray]:
    """What the readable graph takes for one item."""
    feed = body_feed(load_body(), parity_poses(FRAMES, seed=1)[row : row + 1], np.zeros((1, 3)), BETAS, skin=True)
    return feed.arrays | garment_feed(garment(kind), body=load_body()) | {"patch_embedding": first_of(model, kind)[0]}


def readable(model: OneFit, kind: str, row: int) -> list[np.ndarray]:
    """Vertices, jets and frames of one item by the readable graph."""
    arrays = feed_of(model, kind, row)
    with torch.no_grad():
        out = DrapeGraph(model)({s.name: torch.from_numpy(arrays[s.name]) for s in drape_inputs(model)})
    return [value[0].numpy() for value in out]


CONFIGS = {
    "one correction": SMALL,
    "none": replace(SMALL, corrections=0),
    "two": replace(SMALL, corrections=2),
    "deep heads": replace(SMALL, head_sizes=(12, 8), decoder_sizes=(24, 16, 16)),
    "no hidden heads": replace(SMALL, head_sizes=()),
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS.keys())
def test_a_mixed_batch_equals_the_readable_graph_item_by_item(config):
    model = lively(config)
    out, composition = run_packed(model)
    for item, (kind, row) in enumerate(ITEMS):
        vertices, jet, rotation, centre = readable(model, kind, row)
        assert_allclose(out["vertices"].reshape(-1, 3)[composition.vertices[item]], vertices, rtol=0, atol=2e-6)
        here = composition.patches[item]
        assert_allclose(out["jet"][here], jet, rtol=0, atol=FIT_ROUNDING)
        assert_allclose(out["frame_rotation"][here], rotation, rtol=0, atol=2e-6)
        assert_allclose(out["frame_centre"][here], centre, rtol=0, atol=2e-6)


def test_rounding_moves_the_closing_fit_as_its_tolerance_says():
    model = lively()
    arrays = feed_of(model, "tank", 1)
    model.double()
    numbers = [s.name for s in drape_inputs(model) if arrays[s.name].dtype == np.float32]

    def jets(*values: np.ndarray) -> list[np.ndarray]:
        tensors = {s.name: torch.from_numpy(arrays[s.name]) for s in drape_inputs(model)}
        tensors |= {name: torch.from_numpy(value) for name, value in zip(numbers, values, strict=True)}
        with torch.no_grad():
            return [DrapeGraph(model)(tensors)[1].numpy()]

    _, (moved,) = moved_by_rounding(jets, *(arrays[name] for name in numbers))
    assert 0.3 * FIT_MOVED < moved < FIT_MOVED


def test_a_vertex_that_is_not_finite_shows_in_its_own_item_alone():
    quaternion = pack_body(load_body(), BETAS).rows(parity_poses(FRAMES, seed=1))["joint_quaternion"].copy()
    quaternion[2, 5, 1] = np.nan
    out, composition = run_packed(lively(), joint_quaternion=quaternion)
    vertices = out["vertices"].reshape(-1, 3)
    assert [bool(np.isfinite(vertices[place]).all()) for place in composition.vertices] == [
        row != 2 for _, row in ITEMS
    ]


def test_the_dynamic_code_is_added_to_the_body_code():
    model = lively(replace(SMALL, dynamic=True))
    code = np.random.default_rng(2).normal(size=(FRAMES, SMALL.body_code_size)).astype(np.float32)
    still, _ = run_packed(model, dynamic_code=0.0 * code)
    moved, composition = run_packed(model, dynamic_code=code)
    static = lively()
    static.load_state_dict({k: v for k, v in model.state_dict().items() if not k.startswith("dynamic.")})
    assert_allclose(still["vertices"], run_packed(static)[0]["vertices"], rtol=0, atol=0)
    # As if the last layer of the body encoder gave it.
    kind, row = ITEMS[0]
    last = list(static.body.layers.children())[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.bias.add_(torch.from_numpy(code[row]))
    vertices = readable(static, kind, row)[0]
    assert_allclose(moved["vertices"].reshape(-1, 3)[composition.vertices[0]], vertices, rtol=0, atol=2e-6)


def test_the_papers_variant_is_refused():
    with pytest.raises(ArtifactError, match="variant: expected 'vector'"):
        PackedGraph(lively(as_published(SMALL)))


def test_first_half_is_the_decoders_own():
    model = lively()
    embedding, first = first_of(model, "tank")
    features = torch.from_numpy(described("tank"))
    with torch.no_grad():
        assert_array_equal(embedding, EncoderGraph(model)({"patch_features": features}).numpy())
        decoder = model.decoder
        assert isinstance(decoder, Decoder)
        assert_array_equal(first, decoder.from_patch(torch.from_numpy(embedding)).numpy())


def test_jumps_reach_the_root_of_every_joint():
    jumps = ancestor_jumps()
    assert len(jumps) == 4  # nine joints from the root to a hand
    assert all(int(jump[24]) == 24 for jump in jumps)


@pytest.mark.slow
def test_the_exported_graph_keeps_the_parity():
    model, folder, manifest = exported()
    assert set(manifest.graphs) == {"garment_encoder", "drape", "packed", "push_out", "push_over"}
    error = packed_parity_error(model, folder / "garment_encoder.onnx", folder / "packed.onnx", garment(KINDS[0]))
    assert 0.0 < error < 1e-5


@pytest.mark.slow
def test_the_parity_sees_another_network():
    """The check that lets a model out must fail when the graph is of other weights."""
    _, folder, _ = exported()
    error = packed_parity_error(
        lively(seed=1), folder / "garment_encoder.onnx", folder / "packed.onnx", garment("tank")
    )
    assert error > 1e-4


@pytest.mark.slow
def test_guards_survive_the_export():
    """An optimiser that takes + 1e-12 for + 0 would leave divisions by zero."""
    import onnx

    _, folder, _ = exported()
    graph = onnx.load(str(folder / "packed.onnx")).graph
    made_by = {output: node for node in graph.node for output in node.output}
    roots = [node for node in graph.node if node.op_type == "Sqrt"]
    assert roots
    assert {made_by[node.input[0]].op_type for node in roots} <= {"Clip", "Max"}
    forbidden = {"ScatterElements", "ScatterND", "Einsum", "Loop", "If", "Scan", "GatherND"}
    assert forbidden.isdisjoint(node.op_type for node in graph.node)
