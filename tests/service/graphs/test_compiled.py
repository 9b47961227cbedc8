"""The engine's network: the shipped one drapes as its graph does, what it covers, and what a model must have."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.measure.depth import depths_mm
from drape.artifacts import MODELS_DIR, load_manifest
from drape.body.assets import load_body
from drape.contact.skin import posed_table
from drape.graph.packing import pack_body
from drape.inference.compiled import is_covered
from drape.inference.engine import Engine
from drape.inference.packing import Packer, ScenePlan
from tests.fixtures.garments import shipped
from tests.fixtures.poses import random_motion

SHIPPED = MODELS_DIR / "onefit"
ROUNDING_M = 5e-6  # of coordinates up to a metre, through four corrections
ITEMS = [("tank", 0), ("shorts", 2), ("tank", 2)]


@cache
def packers() -> tuple[Packer, Packer]:
    """Packers of the shipped model: its network compiled, and its graph."""
    both = Packer(Engine(SHIPPED), load_body()), Packer(Engine(SHIPPED, compiled=False), load_body())
    for packer in both:
        for kind in ("tank", "shorts"):
            packer.add(kind, shipped(kind))
    return both


def bodies(**more: np.ndarray) -> dict[str, np.ndarray]:
    """Three bodies, one of them of another shape, that move."""
    body, (poses, _) = load_body(), random_motion(3, seed=3)
    shapes = np.zeros((3, body.shape_count))
    shapes[2] = np.random.default_rng(1).normal(size=body.shape_count)
    rows = [pack_body(body, shape).rows(pose[None]) for shape, pose in zip(shapes, poses, strict=True)]
    code = np.random.default_rng(2).normal(scale=0.1, size=(3, 256)).astype(np.float32)
    joined = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    return joined | {"dynamic_code": code} | more


@pytest.mark.parametrize("passes", [0, 1, None])
def test_the_shipped_network_drapes_as_its_graph(passes: int | None):
    compiled, graph = packers()
    plan = ScenePlan("both", skin=True, passes=passes)
    for got, want in zip(*(packer.run(plan, bodies(), ITEMS) for packer in (compiled, graph)), strict=True):
        assert got.finite and list(got.arrays) == list(want.arrays)
        for name in ("vertices", "frame_centre", "frame_rotation", "skin"):
            assert_allclose(got.arrays[name], want.arrays[name], rtol=0, atol=4 * ROUNDING_M, err_msg=name)
        assert_allclose(got.arrays["vertices"], want.arrays["vertices"], rtol=0, atol=ROUNDING_M)


def test_corrections_take_no_cloth_through_arms_beside_the_trunk():
    """As learnt they do: up to 40 mm."""
    body, pose, packer = load_body(), np.zeros((1, 24, 3)), Packer(Engine(SHIPPED), load_body())
    pose[0, [16, 17], 2] = -1.3, 1.3  # shoulders
    skin, rows = body.posed_vertices(pose)[0], pack_body(body, np.zeros(body.shape_count)).rows(pose)
    packer.add("tshirt", shipped("tshirt"))
    still = rows | {"dynamic_code": np.zeros((1, 256), np.float32)}
    for passes in (0, 1, None):
        (found,) = packer.run(ScenePlan(passes=passes), still, [("tshirt", 0)])
        world = found.arrays["vertices"][: shipped("tshirt").vertex_count] + body.rest_joints()[0]
        assert depths_mm(world.astype(np.float64), skin, body.faces).max() < 10.0


def test_a_posed_skin_that_is_given_is_taken():
    compiled, graph = packers()
    body, (poses, _) = load_body(), random_motion(3, seed=3)
    skin = posed_table(body, poses + 0.05, np.zeros(body.shape_count))
    far, own = (compiled.run(ScenePlan(), bodies(**more), ITEMS[:1])[0].arrays for more in ({"skin": skin}, {}))
    want = graph.run(ScenePlan(), bodies(skin=skin), ITEMS[:1])[0].arrays
    assert_allclose(far["vertices"], want["vertices"], rtol=0, atol=ROUNDING_M)
    assert np.abs(far["vertices"] - own["vertices"]).max() > 1e-3


def test_a_garment_that_is_put_there_anew_is_draped():
    compiled, _ = packers()
    packer = Packer(Engine(SHIPPED), load_body())
    packer.add("worn", shipped("tank"))
    packer.run(ScenePlan(), bodies(), [("worn", 0)])
    packer.add("worn", shipped("shorts"))
    again = packer.run(ScenePlan(), bodies(), [("worn", 0)])[0].arrays["vertices"]
    assert_array_equal(again, compiled.run(ScenePlan(), bodies(), [("shorts", 0)])[0].arrays["vertices"])


def test_the_engine_covers_the_shipped_kind_of_network():
    network = load_manifest(SHIPPED).network
    assert is_covered(network)
    for change in (
        {"variant": "paper"},
        {"corrections": 0},
        {"decoder_sizes": [512, 190]},
        {"decoder_sizes": [510, 192]},
    ):
        assert not is_covered(network | change)
    assert not is_covered({})


@pytest.mark.parametrize("options", [{"compiled": False}, {"pushes": True}])
def test_where_the_graph_is_asked_for_it_runs(options: dict[str, Any]):
    assert Engine(SHIPPED, **options).compiled is None
    assert Engine(SHIPPED).compiled is not None


def test_a_network_that_the_engine_does_not_cover_runs_as_its_readable_graph(monkeypatch: pytest.MonkeyPatch):
    manifest = load_manifest(SHIPPED)
    without = replace(manifest, network=manifest.network | {"decoder_sizes": [512, 190]})
    monkeypatch.setattr("drape.inference.engine.load_manifest", lambda folder: without)
    engine = Engine(SHIPPED)
    assert engine.compiled is None and engine.whole
