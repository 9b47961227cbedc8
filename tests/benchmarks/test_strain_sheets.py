"""Strain as colour, and a sheet of a real garment."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from benchmarks import strain_sheets
from benchmarks.strain_sheets import COLUMNS, METHODS, PRESSED, SIZE, STRETCHED, UNCHANGED, strain_colours

FACES = np.array([[0, 1, 2]])
REST = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("stretch", "colour"),
    [(1.0, UNCHANGED), (1.5, STRETCHED), (0.5, PRESSED), (1.1, 0.5 * (UNCHANGED + STRETCHED))],
)
def test_colour_follows_the_change_of_area(stretch: float, colour: np.ndarray):
    assert_allclose(strain_colours(REST * [stretch, 1.0, 1.0], REST, FACES)[0], colour, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_sheet_has_a_row_per_method_and_a_column_per_pose(tmp_path):
    arguments = ["--quick", "--garments", "shorts", "--frames", "1", "--steps", "80", "--threads", "1"]
    (path,) = strain_sheets.main([*arguments, "--no-physics-cache", "--images", str(tmp_path)])
    with Image.open(path) as picture:
        assert picture.size == (SIZE[1], SIZE[0] * len(METHODS))
    assert COLUMNS >= 1
