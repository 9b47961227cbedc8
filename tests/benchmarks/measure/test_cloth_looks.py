"""Measures of moving cloth on waves, creases and hems whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure.cloth_looks import BANDS_M, ClothLooks
from drape.cloth.rest_state import modelled_rest
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.geometry.geometry_shapes import icosphere

AMPLITUDE_M = 0.001


def sheet() -> ClothLooks:
    rest, faces = grid(360, 4, cell_m=0.0025)
    return ClothLooks(modelled_rest(rest, faces), faces, rest)


@pytest.mark.parametrize(("wavelength_m", "band"), [(0.015, 0), (0.04, 1), (0.15, 2)])
def test_a_wave_is_relief_of_its_own_band(wavelength_m: float, band: int):
    looks = sheet()
    height = AMPLITUDE_M * np.cos(2.0 * np.pi * looks.place[:, 0] / wavelength_m)
    found = looks.relief_mm((looks.place + height[:, None] * [0.0, 0.0, 1.0])[None])[0]
    shares = [(wavelength_m / c) ** 4 / (1.0 + (wavelength_m / c) ** 4) for c in BANDS_M]  # that a low-pass keeps
    expected = -np.diff([1.0, *shares]) * 1e3 * AMPLITUDE_M / np.sqrt(2.0)
    assert_allclose(found, expected, rtol=0.05, atol=0.02)
    assert found.argmax() == band


def test_a_sheet_folded_in_two_keeps_its_area_and_has_an_angle():
    looks = sheet()
    x = looks.place[:, 0] - looks.place[:, 0].mean()
    folded = looks.place.copy()
    folded[:, 0], folded[:, 2] = 0.5 * np.abs(x), np.sqrt(0.75) * np.abs(x)  # by 120 degrees
    assert_allclose(looks.area_m2(folded[None]), looks.area_m2(looks.place[None]), rtol=1e-9)
    assert looks.dihedral_deg(folded[None]) > looks.dihedral_deg(looks.place[None]) == 0.0


def test_a_closed_surface_has_the_curvature_of_gauss_and_bonnet_and_a_folded_sheet_none():
    ball, ball_faces = icosphere(2, radius_m=0.2)
    assert_allclose(
        ClothLooks(modelled_rest(ball, ball_faces), ball_faces, ball).curvature(ball[None]), 4.0 * np.pi, rtol=1e-9
    )
    looks = sheet()
    x = looks.place[:, 0] - looks.place[:, 0].mean()
    folded = np.stack([np.abs(x), looks.place[:, 1], 0.0 * x], axis=1)
    peak = looks.place.copy()
    peak[np.flatnonzero(looks.inner)[0], 2] += 0.001
    flat, creased, dimpled = looks.curvature(np.stack([looks.place, folded, peak]))
    assert max(flat, creased) < 1e-5 < 0.05 < dimpled


def test_strain_is_that_of_edges():
    looks = sheet()
    assert_allclose(looks.strain_pct(np.stack([1.05 * looks.place, 1.05 * looks.place])), 5.0, rtol=1e-6)
    assert looks.strain_pct(looks.place[None]) < 1e-6


def test_a_hem_is_rough_where_its_vertices_alternate():
    rest, faces = tube(64, 20, radius_m=0.2, height_m=0.4)
    looks = ClothLooks(modelled_rest(rest, faces), faces, rest)
    (loop,) = looks.hems
    jagged = rest.copy()
    jagged[loop[::2], 1] += 0.001
    smooth_mm, jagged_mm = looks.hem_mm(np.stack([rest, jagged]))
    assert_allclose(np.sqrt(jagged_mm**2 - smooth_mm**2), 4.0, rtol=1e-6)  # 1, 3, 3, 1 of alternating signs, halved
    closed, closed_faces = icosphere(1, radius_m=0.1)
    assert np.isnan(ClothLooks(modelled_rest(closed, closed_faces), closed_faces, closed).hem_mm(closed[None])).all()


def test_relief_that_goes_along_does_not_pop_and_new_relief_does(rng):
    looks = sheet()
    waves = looks.place + AMPLITUDE_M * rng.normal(size=(3, len(looks.place), 1)) * [0.0, 0.0, 1.0]
    assert looks.pop(np.stack([waves[0], waves[0] + [0.1, 0.0, 0.0]])) < 1e-6
    assert_allclose(looks.pop(waves), np.sqrt(2.0), rtol=0.1)
