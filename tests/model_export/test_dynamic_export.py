"""Export of a dynamic model: parity over a sequence, the static drape bit for bit at rest, and rest for ever."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal

from drape.artifacts import load_manifest
from drape.body.assets import load_body
from drape.body.features import motion_features
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.graph.feeds import body_feed, garment_feed, kinematics
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.packing import Packer, ScenePlan
from drape.stages.motion import Memory, Moment, advance
from model_export import export as exporting
from model_export.export import static_training
from model_export.parity import session
from tests.fixtures.packed import MOVING, exported, exported_dynamic
from tests.fixtures.packed import garment as fixture_garment
from tests.fixtures.poses import smooth_motion
from training.onefit import OneFit

pytestmark = pytest.mark.slow
REST_S = 2.0
FRAMES_AT_REST = 10_000


@pytest.fixture(scope="module")
def garment() -> Garment:
    return fixture_garment("tank")


@pytest.fixture(scope="module")
def model() -> OneFit:
    return exported_dynamic()[0]


@pytest.fixture(scope="module")
def folder() -> Path:
    return exported_dynamic()[1]


def test_the_manifest_tells_of_the_static_training_too_where_it_is_the_same(tmp_path: Path):
    still, folder, _ = exported()
    moving, _, _ = exported_dynamic()
    assert static_training(moving, folder) == {"static": {"steps": 0}}
    assert static_training(still, folder) == {}, "a static model has no other part"
    assert static_training(moving, tmp_path) == {}, "no model stands there"
    other = OneFit(moving.config)
    assert static_training(other, folder) == {}, "other weights"


def test_the_manifest_says_that_it_is_dynamic(folder):
    manifest = load_manifest(folder)
    assert (manifest.dynamic, manifest.state_size) == (True, 32)
    assert 0.0 < manifest.parity_error_m < 1e-5
    assert {spec.name: spec.shape for spec in manifest.graphs["dynamic_encoder"].inputs} == {
        "motion_features": ("clients", 24, 12),
        "state": ("clients", 32),
        "dt_s": ("clients",),
    }
    assert {spec.name: spec.shape for spec in manifest.graphs["dynamic_encoder"].outputs} == {
        "dynamic_code": ("clients", 16),
        "next_state": ("clients", 32),
    }
    assert "dynamic_code" in {spec.name for spec in manifest.graphs["drape"].inputs}


def test_a_recurrence_that_differs_is_refused(model, garment, folder, tmp_path, monkeypatch):
    graphs = load_manifest(folder).graphs
    torch.manual_seed(9)
    other = OneFit(MOVING).eval()
    other.load_state_dict(model.state_dict())
    assert other.dynamic is not None
    with torch.no_grad():
        other.dynamic.cell.weight_hh.mul_(1.01)
    assert exporting.sequence_error(model, folder, graphs, garment) < 1e-5
    assert exporting.sequence_error(other, folder, graphs, garment) > exporting.TOLERANCE_M
    monkeypatch.setattr(exporting, "write_graphs", lambda model, staged: graphs)
    monkeypatch.setattr(exporting, "share_weights", lambda staged, graphs, parameters: (graphs, None))
    monkeypatch.setattr(exporting, "parity_error", lambda *_: 0.0)
    for other_parity in ("packed_parity_error", "push_parity_error"):
        monkeypatch.setattr(exporting, other_parity, lambda *_: 0.0)
    monkeypatch.setattr(exporting, "sequence_error", lambda *_: 1.0)
    with pytest.raises(ArtifactError, match="parity"):
        exporting.export(other, tmp_path / "m", garment=garment, training={})
    assert not (tmp_path / "m").exists()


def test_at_rest_it_is_the_static_model_bit_for_bit(model, garment, folder):
    still, static, _ = exported()
    ours = model.state_dict()
    assert all(torch.equal(ours[name], value) for name, value in still.state_dict().items())
    poses, trans = smooth_motion(np.arange(3) * 0.4)
    arrays = body_feed(load_body(), poses, trans, skin=True).arrays | garment_feed(garment, body=load_body())
    arrays["patch_embedding"] = np.ones((garment.patch_count, MOVING.embedding_size), np.float32)
    want = readable(static, arrays)
    arrays["dynamic_code"] = np.zeros((3, MOVING.body_code_size), np.float32)
    assert_array_equal(readable(folder, arrays), want)
    arrays["dynamic_code"] += 1.0
    assert np.abs(readable(folder, arrays) - want).max() > 1e-3


def readable(folder: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Vertices [m] (F, V, 3) of the readable graph in ``folder``."""
    opened = session(folder / "drape.onnx")
    feed = {tensor.name: arrays[tensor.name] for tensor in opened.get_inputs()}
    return np.asarray(opened.run(["vertices"], feed)[0])


@pytest.mark.parametrize("fps", [30.0, 90.0])
def test_a_body_that_stops_rests_within_two_seconds_and_then_for_ever(folder, garment, fps):
    """The drape swings after the stop, comes to rest, and then keeps every bit for 10,000 frames."""
    engine, body = Engine(folder), load_body()
    moving = 15
    poses, trans = smooth_motion(np.arange(moving) / fps)
    at = kinematics(body, poses, trans)
    packer, last = Packer(engine, body), pack_body(body).rows(poses[-1:])
    packer.add("it", garment)

    def drape(code: np.ndarray) -> np.ndarray:
        return packer.run(ScenePlan(), last | {"dynamic_code": code[None]}, [("it", 0)])[0].arrays["vertices"]

    memory = Memory.empty(engine)
    static = drape(memory.code)
    for i in range(moving):
        (memory,) = advance(engine, [memory], [Moment(i / fps, at[i])])
    assert np.abs(memory.state).max() > 0.05
    resting_frames = int(REST_S * fps)
    swung = []
    for i in range(moving, moving + resting_frames):
        (memory,) = advance(engine, [memory], [Moment(i / fps, at[-1])])
        if i < moving + resting_frames // 8:
            swung.append(float(np.abs(drape(memory.code) - static).max()))
    assert min(swung) > 1e-4, "the cloth must swing on after the stop"
    assert_array_equal(memory.state, np.zeros(32))
    assert_array_equal(drape(memory.code), static)
    # Nobody can put the whole service through 10,000 frames in a test: the recurrent graph alone, fed with its state.
    features = motion_features(at[-1], at[-1], at[-1], 1 / fps, 1 / fps)[None]
    state, dt_s = memory.state[None], np.array([1 / fps])
    for i in range(FRAMES_AT_REST):
        code, state = engine.advance(features, state, dt_s)
        assert not state.any() and not code.any(), f"frame {i}"
        if i % 2500 == 0:
            assert drape(code[0]).tobytes() == static.tobytes()
