"""Training, export and engine compute one thing: each row of a table names what, and compares all three.

Training, in float64, is the reference: rounding of float32 is what is left between them. Of the push-out that is its
formula (``test_push.py`` here and in ``tests/drape/graph``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.artifacts import MODELS_DIR, Manifest, load_manifest, read_parameters
from drape.body.assets import load_body
from drape.garment.fabric_features import encoder_features
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.packing import Place, compose_garments, pack_body, pack_garment
from drape.graph.push_feed import SkinShapes
from drape.inference.compiled import CompiledNetwork
from drape.inference.engine import Engine
from drape.inference.graph_names import PACKED
from drape.inference.onnx_runtime import Session
from model_export.parity import parity_poses, session
from model_export.readable_graphs import DrapeTensors, DynamicGraph, EncoderGraph, drape_inputs
from tests.fixtures.garments import shipped
from training.checkpoint import model_config_from
from training.onefit import OneFit, vertex_positions

pytestmark = pytest.mark.slow
SHIPPED = MODELS_DIR / "onefit"
FRAMES, POSES = 3, parity_poses(3, seed=4)
ROUNDING_M = 5e-6  # of coordinates up to a metre, through four corrections

Arrays = dict[str, np.ndarray]
Ways = tuple[np.ndarray, dict[str, np.ndarray]]  # what training gives, and what export and engine give


@cache
def manifest() -> Manifest:
    return load_manifest(SHIPPED)


@cache
def parameters() -> Arrays:
    weights = manifest().weights
    assert weights is not None
    return read_parameters(SHIPPED, weights)


@cache
def trained() -> OneFit:
    """The shipped network in float64."""
    model = OneFit(model_config_from(manifest().network)).eval()
    model.load_state_dict({name: torch.from_numpy(value) for name, value in parameters().items()})
    return model.double()


@cache
def engine() -> CompiledNetwork:
    return CompiledNetwork(parameters(), manifest().network)


def exported(graph: str, arrays: Arrays, output: str) -> np.ndarray:
    opened = session(SHIPPED / manifest().graphs[graph].file)
    return np.asarray(opened.run([output], {tensor.name: arrays[tensor.name] for tensor in opened.get_inputs()})[0])


@cache
def by_packed(passes: int | None) -> Session:
    """The packed graph's vertices after so many corrections."""
    return Engine(SHIPPED, compiled=False).open_cut(PACKED, ["vertices"], passes=passes)


def wide(arrays: Arrays) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(array.astype(np.float64) if array.dtype == np.float32 else array)
            for name, array in arrays.items()}  # fmt: skip


def described(kind: str) -> Arrays:
    return {"patch_features": encoder_features(shipped(kind), trained().config.encoder_feature_count)}


@torch.no_grad()
def garment_half() -> Ways:
    arrays = described("tank")
    embedding = EncoderGraph(trained())(wide(arrays))
    found = exported("garment_encoder", arrays, "patch_first"), engine().encode(arrays["patch_features"])
    return trained().decoder.from_patch(embedding).numpy(), dict(zip(("export", "engine"), found, strict=True))


@torch.no_grad()
def drape(kind: str, *, passes: int | None = None, shaped: bool = False, moved: bool = False) -> Ways:
    draw, body, whole = np.random.default_rng(2), load_body(), shipped(kind)
    betas = draw.normal(size=body.shape_count) if shaped else np.zeros(body.shape_count)
    code = draw.normal(scale=0.1 if moved else 0.0, size=(FRAMES, 256)).astype(np.float32)
    feed, first = garment_feed(whole, body=body), engine().encode(described(kind)["patch_features"])
    arrays = body_feed(body, POSES, np.zeros((FRAMES, 3)), betas, skin=True).arrays | feed | {"dynamic_code": code}
    arrays["patch_embedding"] = EncoderGraph(trained())(wide(described(kind))).numpy()
    given = DrapeTensors.from_flat(wide({spec.name: arrays[spec.name] for spec in drape_inputs(trained())}))
    posed = trained()(
        given.body, given.patches, given.embedding, given.dynamic_code, charts=given.consensus, passes=passes
    )
    packed = pack_garment(feed, first)
    bodies = pack_body(body, betas).rows(POSES) | {"dynamic_code": code}
    skins = SkinShapes(body)
    bodies |= skins.feed(bodies["betas"])
    composition = compose_garments([(packed, Place(0, 0), row) for row in range(FRAMES)])
    given_arrays = bodies | packed.stored | composition.arrays
    by_graph = by_packed(passes).run(["vertices"], {name: given_arrays[name] for name in by_packed(passes).inputs})[0]
    rows = engine().rows(packed)
    by_engine = [
        engine().drape(rows, engine().body(bodies, row, skins.counts), passes, vertices=True)[0]["vertices"]
        for row in range(FRAMES)
    ]
    by_graph = np.stack([by_graph.reshape(-1, 3)[rows] for rows in composition.vertices])
    return vertex_positions(posed, given.patches, given.charts).numpy(), {
        "export": by_graph,
        "engine": np.stack(by_engine),
    }


@torch.no_grad()
def motion() -> Ways:
    draw, network = np.random.default_rng(3), trained().config
    arrays = {
        "motion_features": 10.0 * draw.normal(size=(4, 24, 12)),
        "state": draw.uniform(-0.7, 0.7, size=(4, network.state_size)),
        "dt_s": np.array([1 / 240, 1 / 60, 1 / 30, 1 / 12]),
    }
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
    want = DynamicGraph(trained())(wide(arrays))
    by_graph = [exported("dynamic_encoder", arrays, name) for name in ("dynamic_code", "next_state")]
    by_engine = engine().advance(*arrays.values())
    return np.concatenate(want, axis=1), {
        "export": np.concatenate(by_graph, axis=1),
        "engine": np.concatenate(by_engine, axis=1),
    }


@dataclass(frozen=True)
class Row:
    """What is computed, within which rounding, and how large it is at least."""

    ways: Callable[[], Ways]
    atol: float
    least: float = 0.1


TABLE = {
    "garment encoder": Row(garment_half, 2e-5),
    "drape without corrections": Row(partial(drape, "tank", passes=0), ROUNDING_M),
    "drape with one correction": Row(partial(drape, "shorts", passes=1, moved=True), ROUNDING_M),
    "drape of another shape": Row(partial(drape, "tank", shaped=True, moved=True), ROUNDING_M),
    "recurrent encoder": Row(motion, 1e-5),
}


@pytest.mark.parametrize("row", TABLE.values(), ids=TABLE)
def test_training_export_and_engine_agree(row: Row):
    expected, ways = row.ways()
    assert np.abs(expected).max() > row.least
    for way, found in ways.items():
        assert_allclose(found, expected, rtol=0, atol=row.atol, err_msg=way)
