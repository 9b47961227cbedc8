"""Distance from the static drape as colour, and a sheet of a model whose motion is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from benchmarks import swing_sheets as subject
from benchmarks.dynamics import FPS
from drape.body.assets import load_body
from drape.garment.cache import save_garment
from drape.motion.clip import MotionClip
from tests.fixtures.poses import smooth_motion
from tests.fixtures.tiny_model import TINY_DYNAMIC, tube_garment, write_tiny_model

FACES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(("way_m", "share"), [(0.0, 0.0), (0.015, 0.5), (0.03, 1.0), (0.3, 1.0)])
def test_colour_follows_the_way_from_the_static_drape(way_m: float, share: float):
    still = np.eye(3)
    want = (1.0 - share) * subject.UNMOVED + share * subject.MOVED
    got = subject.swing_colours(still + np.array([0.0, way_m, 0.0]), still, FACES)
    assert_allclose(got, want[None], rtol=0, atol=1e-12)


def test_a_sheet_has_a_column_per_time_and_the_swing_dies_away(tmp_path: Path):
    models = write_tiny_model(tmp_path, load_body(), dynamic=True)
    save_garment(tube_garment(load_body()), tmp_path / "garments")
    poses, trans = smooth_motion(np.arange(20) / FPS)
    MotionClip(poses, trans, FPS, "swaying").save(tmp_path / "swaying.npz")
    options = ["--model", str(models), "--garment", str(next((tmp_path / "garments").glob("*.npz")))]
    path = subject.main([*options, "--motions", str(tmp_path / "swaying.npz"), "--out", str(tmp_path / "swing.png")])
    assert models.name == TINY_DYNAMIC
    with Image.open(path) as picture:
        assert picture.size == (len(subject.AFTER_S) * subject.SIZE[1], subject.SIZE[0])
        pixels = np.asarray(picture.convert("RGB"), dtype=float)
    # The cloth is redder at the stop than when the code of the small model has died away.
    first, *_, last = np.split(pixels, len(subject.AFTER_S), axis=1)
    redness = [(part[..., 0] - part[..., 1]).sum() for part in (first, last)]
    assert redness[0] > redness[1]
