import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import recovery_targets
from benchmarks.records import targets_table
from benchmarks.recovery.disturbed import off
from benchmarks.recovery.newton_drape import outward
from benchmarks.recovery.published import ahead
from recovery.pattern.bases import skirt
from tests.recovery.pattern_setup import default_measurements


def test_clockwise_triangles_are_mirrored_for_newton():
    panels = np.array([(0.0, 0.0), (1.0, 0.0), (0.3, 0.8), (1.2, 0.9)])
    faces = np.array([(0, 1, 2), (1, 2, 3)])  # the second runs clockwise
    flat, numbers = outward(panels, faces)
    first, second = flat[numbers][:, 1] - flat[numbers][:, 0], flat[numbers][:, 2] - flat[numbers][:, 0]
    assert (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0.0).all()
    for corners, kept in zip(panels[faces], flat[numbers], strict=True):
        sides = [np.linalg.norm(np.diff(np.roll(c, -1, axis=0), axis=0), axis=1) for c in (corners, kept)]
        assert np.allclose(*sides)
    assert np.array_equal(flat[numbers[0]], panels[faces[0]])


def test_turning_of_a_pattern_is_zero_for_itself_and_blind_for_size():
    truth = skirt(default_measurements())
    assert recovery_targets.turning_deg(truth, truth) == pytest.approx(np.zeros(2), abs=1e-4)
    assert (recovery_targets.turning_deg(off(truth, 0), truth) > 0.5).all()


def test_an_interpreter_without_newton_is_named(tmp_path: Path):
    scene = {"nodes": np.zeros((3, 3))}
    with pytest.raises(SystemExit, match=r"newton|warp"):
        recovery_targets.newton_drape("tee", scene, sys.executable, tmp_path)
    with pytest.raises(SystemExit, match="nowhere"):
        recovery_targets.newton_drape("tee", scene, "/nowhere/python", tmp_path)
    assert not list(tmp_path.glob("*.npz"))


def test_the_table_marks_what_is_at_or_ahead_of_the_paper():
    row = {
        "garment": "tee", "seed": 1, "chamfer_cm2": 0.112, "normal": 0.02, "turning_deg": 9.6, "area_err": 0.01,
        "mean_mm": 1.9, "truth_chamfer_cm2": 0.09, "graded_turning_deg": 7.0, "graded_area_err": 0.02, "minutes": 0.5,
    }  # fmt: skip
    record = {"rows": [row], "machine": "M", "commit": "c", "command": "python"}
    assert ahead(row) == 3
    text = targets_table(record)
    assert "| tee, 1 | **0.112** / 0.112 | **0.020** / 0.049 | 9.60 / 9.53 | **0.010** / 0.09 | 3 of 4 |" in text
