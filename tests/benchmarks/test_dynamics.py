"""What the benchmark of dynamics reads off motions whose answer is known, on a small network of random weights."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks import dynamics as subject
from drape.body.assets import load_body
from drape.cloth.material import material
from drape.errors import Unavailable
from drape.garment.cache import save_garment
from drape.motion.clip import MotionClip
from tests.benchmarks.quality_setup import tube as tube_garment
from tests.fixtures.garments import COLUMNS
from tests.fixtures.packed import exported, exported_dynamic
from tests.fixtures.poses import smooth_motion

FPS = subject.FPS


@pytest.fixture(scope="module")
def tube() -> subject.Subject:
    network = subject.open_network(exported_dynamic()[1], load_body(), threads=1)
    return subject.Subject.of(tube_garment(), network, load_body())


def clip(frames: int = 40) -> MotionClip:
    poses, trans = smooth_motion(np.arange(frames) / FPS)
    return MotionClip(poses, trans, FPS, "swaying")


def test_a_stop_holds_the_pose_of_the_middle():
    held, stop = subject.stopped(clip(), hold_s=1.0)
    assert (stop, held.frame_count) == (20, 20 + 1 + 30)
    assert_array_equal(held.poses[:21], clip().poses[:21])
    assert_array_equal(held.poses[20:], np.broadcast_to(clip().poses[20], (31, 24, 3)))
    assert_array_equal(held.trans[20:], np.broadcast_to(clip().trans[20], (31, 3)))


def test_the_hem_is_the_lower_border(tube: subject.Subject):
    assert_array_equal(tube.hem, np.arange(COLUMNS))  # the tube's lowest ring


def test_the_hem_is_told_as_far_as_it_is_from_the_static_drape(tube: subject.Subject):
    row = subject.stop_row(tube, clip())
    held, stop = subject.stopped(clip())
    moving, static = (tube.drape(held, motion=knob)[stop:] for knob in (1.0, 0.0))
    away = 1e3 * np.linalg.norm((moving - static)[:, tube.hem], axis=-1).mean(axis=1)
    assert away[0] > 0.1
    assert_allclose(row["peak_mm"], away.max(), rtol=1e-4, atol=0)
    for after_s in subject.AFTER_S:
        assert_allclose(row[f"{after_s:g}s"], away[round(after_s * FPS)], rtol=1e-3, atol=1e-4)


def test_a_clip_without_motion_rests_at_once(tube: subject.Subject):
    still = MotionClip(np.zeros((20, 24, 3)), np.zeros((20, 3)), FPS, "still")
    row = subject.stop_row(tube, still)
    assert (row["rest_s"], row["peak_mm"], row["swings"], row["millimetre_s"]) == (0.0, 0.0, 0, 0.0)
    assert row["rests_in_time"] and row["bits_stay"] and row["still_frames"] == 1 + subject.HOLD_S * FPS


def test_swings_are_crossings():
    time_s = np.arange(90) / 30.0
    way = np.exp(-time_s)[:, None] * np.cos(2.0 * np.pi * time_s)[:, None] * np.array([0.03, 0.0, 0.04])
    assert subject.swings(way) == 6
    assert subject.swings(1e-3 * way) == 0


def test_the_potential_of_a_body_in_free_fall_is_inertias(tube: subject.Subject):
    frames, acceleration = 12, np.array([2.0, 0.0, -1.0])
    trans = 0.5 * (np.arange(frames)[:, None] / FPS) ** 2 * acceleration
    pushed = MotionClip(np.zeros((frames, 24, 3)), trans, FPS, "pushed")
    row = subject.potential_row(tube, pushed, material(), frames=frames)
    mass = float(tube.mesh.vertex_mass(material()).sum())
    want = 0.5 * mass * 5.0 / FPS**2
    assert row["frames"] == frames - 2
    assert_allclose(row["inertia_static_j"], want, rtol=1e-3, atol=0)
    assert_allclose(row["own_static_j"] - row["energy_static_j"], want, rtol=1e-3, atol=0)


def test_the_whole_prints_a_record(tmp_path: Path, capsys):
    save_garment(tube_garment(), tmp_path)
    clip().save(tmp_path / "swaying.npz")
    garment = next(tmp_path.glob("tube*.npz"))
    options = f"--model {exported_dynamic()[1]} --garments {garment} --motions {tmp_path / 'swaying.npz'}"
    record = subject.main(f"{options} --frames 8 --threads 1".split())
    printed = capsys.readouterr().out.splitlines()
    assert json.loads(printed[-1]) == record
    assert [row["kind"] for row in record["rows"]] == ["stop", "potential"]
    assert printed[1].split()[:4] == ["kind", "garment", "clip", "peak_mm"]


def test_a_static_model_is_refused_with_a_sentence():
    with pytest.raises(Unavailable, match="expected a dynamic model, got a static one"):
        subject.open_network(exported()[1], load_body(), threads=1)
