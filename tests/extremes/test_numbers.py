"""Numbers at the ends of their formats: subnormals, halves that overflow, and the rounding of every encoding."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.precision import encoding_errors_mm
from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.graph.packing import pack_body
from drape.wire import messages as wire
from model_export.folder import _add_packed
from model_export.precision.half import HALF, halve_matrices
from service.compute.drape_runtime import Drapery
from service.graphs.engine import Engine
from service.graphs.packing import Packer, ScenePlan
from tests.extremes.frames import check_bounded, draped
from tests.fixtures.packed import exported, garment

BUDGET_MM = {"frame": 0.05, "jets_turn": 0.1, "jets_centre": 0.05, "float32": 0.001, "float16": 1.0}


def test_subnormal_inputs_drape_as_zeros(drapery: Drapery):
    """Guards against subnormals in a matrix product; how much slower they are is in ``benchmarks.precision``."""
    poses = np.full((2, 24, 3), 1e-40)
    with flushed():
        batch = draped(drapery, poses, trans=np.full((2, 3), 1e-310), betas=np.full(10, 1e-40))
    check_bounded(drapery, batch)
    zero = draped(drapery, np.zeros((2, 24, 3)))
    np.testing.assert_allclose(batch.vertices, zero.vertices, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("size", [1e-12, 1e-3, 1.0, 1e3])
def test_every_encoding_keeps_its_budget(size: float):
    """Guards against a step that is wider than it is said to be, at boxes from nothing to a kilometre."""
    found = encoding_errors_mm(size_m=size, seed=1)
    for name, limit in BUDGET_MM.items():
        assert found[name] <= limit * max(size, 1e-3), name


@given(st.floats(1e-30, 1e30), st.floats(-1e6, 1e6))
def test_quantising_any_box_is_off_by_half_a_step(extent: float, low: float):
    """Guards against a flat box, a subnormal step and a box that float32 cannot tell from a point."""
    positions = low + extent * np.random.default_rng(0).uniform(size=(50, 3))
    steps, corner, step = wire.quantise(positions)
    off = np.abs(wire.dequantise(steps, corner, step).astype(np.float64) - positions)
    ulp = np.spacing(np.abs(positions).max(axis=0).astype(np.float32)).astype(np.float64)
    assert (off.max(axis=0) <= 0.5 * step + 4.0 * ulp).all()


def test_the_path_in_halves_stays_finite_at_the_extremes(tmp_path: Path):
    """Guards against float16, which ends at 65504: the graph with matrices of 16 bits, run on a processor."""
    folder = Path(shutil.copytree(exported()[1], tmp_path / "model"))
    _add_packed(folder, HALF, lambda proto: halve_matrices(proto, least=256))
    engine, body = Engine(folder, half=True), load_body()
    assert engine.half
    packer = Packer(engine, body)
    packer.add("tank", garment("tank"))
    poses = np.random.default_rng(2).uniform(-1000.0, 1000.0, (4, 24, 3))
    for betas in (np.full(10, 20.0), np.full(10, -20.0)):
        results = packer.run(ScenePlan(), pack_body(body, betas).rows(poses), [("tank", i) for i in range(4)])
        vertices = np.stack([result.arrays["vertices"] for result in results])
        assert all(result.finite for result in results) and np.abs(vertices).max() < 20.0
