"""Numbers at the ends of their formats: subnormals, halves that overflow, and the rounding of every encoding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.packing import Packer, ScenePlan
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, pack_jets, unpack_jets
from service.compute.drape_runtime import DrapeRuntime
from tests.extremes.frames import check_bounded, draped
from tests.fixtures.garments import shipped
from tests.fixtures.packed import exported

BUDGET_MM = {"frame": 0.05, "jets_turn": 0.1, "jets_centre": 0.05, "float32": 0.001, "float16": 1.0}
BOX_M, PATCH_M = 2.0, 0.1


def encoding_errors_mm(*, size_m: float, seed: int = 0, count: int = 500) -> dict[str, float]:
    """The largest error [mm] of each encoding for positions in a box of ``size_m``, where a patch of the JETS message
    has a twentieth of it. ``jets_turn`` is at a patch's rim."""
    rng = np.random.default_rng(seed)
    positions = (size_m * rng.uniform(-0.5, 0.5, (count, 3))).astype(np.float32)
    exact, rim_m = positions.astype(np.float64), size_m * PATCH_M / BOX_M
    frame = wire.unpack_frame(wire.pack_frame(wire.Frame(0, 0.0, 0.0, np.zeros(3), positions)))
    rotation = rotvec_to_matrix(rng.normal(size=(count, 3)))
    jet = 0.3 * rng.normal(size=(count, jets.FULL_COUNT)).astype(np.float32)
    said = JetFrame(0, 0.0, 0.0, np.zeros(3), jet, rotation.astype(np.float32), positions)
    got = unpack_jets(pack_jets(said))

    def largest_mm(difference_m: np.ndarray) -> float:
        return 1e3 * float(np.linalg.norm(difference_m, axis=-1).max())

    with np.errstate(over="ignore"):
        half = positions.astype(np.float16).astype(np.float64)
    return {
        "frame": largest_mm(frame.positions - exact),
        "jets_centre": largest_mm(got.centre - exact),
        "jets_turn": 1e3 * rim_m * float(np.linalg.norm(got.rotation - rotation, axis=(1, 2)).max()),
        "float32": largest_mm(0.5 * np.spacing(np.abs(positions)).astype(np.float64)),
        "float16": largest_mm(half - exact),
    }


def test_subnormal_inputs_drape_as_zeros(runtime: DrapeRuntime):
    """Guards against subnormals in a matrix product."""
    poses = np.full((2, 24, 3), 1e-40)
    with flushed():
        batch = draped(runtime, poses, trans=np.full((2, 3), 1e-310), betas=np.full(10, 1e-40))
    check_bounded(runtime, batch)
    zero = draped(runtime, np.zeros((2, 24, 3)))
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


def test_the_network_stays_finite_at_the_extremes():
    """Guards against what exponentials of compiled kernels do."""
    engine, body = Engine(exported()[1]), load_body()
    assert engine.compiled is not None
    packer = Packer(engine, body)
    packer.add("tank", shipped("tank"))
    poses = np.random.default_rng(2).uniform(-1000.0, 1000.0, (4, 24, 3))
    for betas in (np.full(10, 20.0), np.full(10, -20.0)):
        results = packer.run(ScenePlan(), pack_body(body, betas).rows(poses), [("tank", i) for i in range(4)])
        vertices = np.stack([result.arrays["vertices"] for result in results])
        assert all(result.finite for result in results) and np.abs(vertices).max() < 20.0
