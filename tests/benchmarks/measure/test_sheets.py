"""Strain as colour, and a sheet of a real garment."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure.sheets import (
    CLOTH_SIZE,
    METHODS,
    PRESSED,
    SIZE,
    STRETCHED,
    UNCHANGED,
    Drapes,
    cloth_sheet,
    strain_colours,
    strain_sheet,
)
from benchmarks.shared.render import PLAIN_CLOTH, SKIN
from tests.benchmarks.quality_setup import bending, body, tube

FACES = np.array([[0, 1, 2]])
REST = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("stretch", "colour"),
    [(1.0, UNCHANGED), (1.5, STRETCHED), (0.5, PRESSED), (1.1, 0.5 * (UNCHANGED + STRETCHED))],
)
def test_colour_follows_the_change_of_area(stretch: float, colour: np.ndarray):
    assert_allclose(strain_colours(REST * [stretch, 1.0, 1.0], REST, FACES)[0], colour, rtol=0, atol=1e-12)


def test_a_sheet_has_a_row_per_method_and_a_column_per_pose():
    positions = {method: np.stack([tube().vertices, 1.2 * tube().vertices]) for method in METHODS}
    skin = body().posed_vertices(bending(2))
    drapes = Drapes(tube(), positions, skin, body().faces)
    assert strain_sheet(drapes).shape == (SIZE[0] * len(METHODS), SIZE[1] * 2, 3)
    assert cloth_sheet(drapes).shape == (CLOTH_SIZE[0] * len(METHODS), CLOTH_SIZE[1] * 2, 3)


def test_plain_cloth_shows_shade_and_no_strain():
    positions = {method: 1.2 * tube().vertices[None].astype(np.float64) for method in METHODS}
    picture = cloth_sheet(Drapes(tube(), positions, body().posed_vertices(bending(1)), body().faces))
    hue = picture / picture[..., :1]
    colours = (PLAIN_CLOTH, SKIN, (1.0, 1.0, 1.0))
    known = [np.abs(hue - np.array(colour) / colour[0]).max(axis=-1) < 1e-6 for colour in colours]
    assert np.any(known, axis=0).all()
    assert known[0].mean() > 0.1
