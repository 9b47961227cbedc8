"""Sewn garments under the shipped model: strain of their panels, relief that is carried along, table and picture."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from benchmarks.recovery.sewn_drapes import drawn, main, panel_strain_pct, relief
from drape.cloth.detail import LowPass
from drape.cloth.rest_state import flat, modelled
from drape.motion.hard_poses import HardPoses
from tests.drape.cloth.cloth_shapes import equilateral, random_rotation


def test_strain_is_against_the_panels(rng):
    vertices, faces = equilateral(6, 7, edge_m=0.02)
    panels = modelled(vertices, faces)
    assert panel_strain_pct(vertices @ random_rotation(rng).T, faces, panels) == pytest.approx(0.0, abs=1e-9)
    assert panel_strain_pct(np.stack([1.03 * vertices, vertices]), faces, panels) == pytest.approx(1.5, rel=1e-9)


def test_relief_turns_with_the_cloth(rng):
    vertices, faces = equilateral(40, 46, edge_m=0.01)
    vertices[:, 2] = 0.001 * np.sin(2.0 * np.pi * vertices[:, 0] / 0.03)
    low_pass = LowPass.of(flat(vertices, faces), faces, len(vertices))
    assert_allclose(relief(low_pass, vertices @ random_rotation(rng).T), relief(low_pass, vertices), atol=1e-9)


def test_a_pose_of_each_clip_is_drawn():
    labels = ("squat:1", "squat:2", "walk:4", "walk:3", "turn:9")
    assert drawn(HardPoses(np.zeros((5, 24, 3)), labels)) == [0, 2]


@pytest.mark.slow
def test_the_shipped_model_drapes_a_sewn_skirt(tmp_path):
    picture = tmp_path / "skirt.png"
    record = main(["--garments", "skirt", "--motions", "walk", "--quick", "--threads", "1", "--picture", str(picture)])
    (row,) = record["rows"]
    assert row["garment"] == "skirt" and row["fabric"] == "stretch_denim"
    assert 0.0 < row["left_pct"] < 50.0 and row["rest_panel_pct"] < row["panel_pct"]
    assert 0.5 < row["copied"] <= 1.0
    assert Image.open(picture).size == (2 * 2 * 176, 250)
