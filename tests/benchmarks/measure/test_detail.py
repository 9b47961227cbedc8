"""Detail and angles of surfaces whose waves are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure.detail import WAVELENGTH_M, LowPass, cotangent_matrix, dihedral_deg
from drape.cloth.rest_state import modelled_rest
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube

AMPLITUDE_M = 0.001
CELL_M = 0.00125


def sheet(width: int, height: int = 8, *, cell_m: float = CELL_M) -> tuple[np.ndarray, LowPass]:
    rest, faces = grid(width, height, cell_m=cell_m)
    return rest, LowPass.of(modelled_rest(rest, faces), faces, len(rest))


def wave(rest: np.ndarray, wavelength_m: float) -> np.ndarray:
    """``rest`` with a cosine along x, flat at both ends where the length is a multiple of half a wave."""
    return rest + AMPLITUDE_M * np.cos(2.0 * np.pi * rest[:, :1] / wavelength_m) * [0.0, 0.0, 1.0]


@pytest.mark.parametrize("wavelength_m", [0.02, WAVELENGTH_M, 0.3])
def test_a_corrugated_sheet_has_the_share_of_its_amplitude_that_the_filter_takes(wavelength_m: float):
    rest, low_pass = sheet(720, 4)
    kept = 1.0 / (1.0 + (WAVELENGTH_M / wavelength_m) ** 4)
    expected_mm = 1e3 * (1.0 - kept) * AMPLITUDE_M / np.sqrt(2.0)
    assert_allclose(low_pass.detail_mm(wave(rest, wavelength_m)), expected_mm, rtol=0.02, atol=3e-3)


def test_the_figure_does_not_follow_the_mesh():
    fine, coarse = (sheet(round(0.3 / cell), 4, cell_m=cell) for cell in (CELL_M, 2.0 * CELL_M))
    found = [low_pass.detail_mm(wave(rest, 0.03)) for rest, low_pass in (fine, coarse)]
    assert_allclose(found[1], found[0], rtol=0.03, atol=0.0)


def test_a_cylinder_as_thin_as_a_sleeve_has_none_to_speak_of():
    rest, faces = tube(64, 60, radius_m=0.05, height_m=0.3)
    low_pass = LowPass.of(modelled_rest(rest, faces), faces, len(rest))
    off_mm = 1e3 * 0.05 * (WAVELENGTH_M / (2.0 * np.pi * 0.05)) ** 4
    assert_allclose(low_pass.detail_mm(rest), off_mm, rtol=0.2, atol=0.0)
    assert low_pass.detail_mm(rest) < 0.05


def test_a_flat_sheet_has_none_although_smoothing_draws_its_border_in():
    rest, low_pass = sheet(40, 40, cell_m=0.005)
    assert np.abs(low_pass.smoothed(rest) - rest).max() > 0.003
    assert_allclose(low_pass.detail_mm(rest), 0.0, rtol=0.0, atol=1e-9)


def test_rigid_motion_changes_nothing(rng):
    rest, low_pass = sheet(100)
    waves = wave(rest, 0.02)
    moved = waves @ random_rotation(rng).T + [1.0, 2.0, 3.0]
    assert_allclose(low_pass.detail_mm(moved), low_pass.detail_mm(waves), rtol=1e-7, atol=0.0)
    faces = low_pass.faces
    assert_allclose(dihedral_deg(moved[None], faces), dihedral_deg(waves[None], faces), rtol=1e-7, atol=0.0)


def test_frames_are_taken_one_by_one():
    rest, low_pass = sheet(60)
    frames = np.stack([wave(rest, length) for length in (0.02, 0.03, 0.075)])
    assert_allclose(low_pass.detail_mm(frames), [low_pass.detail_mm(frame) for frame in frames], rtol=1e-9, atol=0.0)


def test_a_vertex_without_a_triangle_stays_where_it_is():
    rest, faces = grid(8, 8)
    alone = np.vstack([rest, [0.5, 0.5, 0.5]])
    low_pass = LowPass.of(modelled_rest(alone, faces), faces, len(alone))
    assert_allclose(low_pass.smoothed(alone)[-1], 0.5, rtol=1e-12, atol=0.0)
    assert_allclose(low_pass.detail_mm(alone), 0.0, rtol=0.0, atol=1e-9)


def test_the_stiffness_matrix_integrates_the_gradient():
    rest, faces = grid(7, 5, cell_m=0.02)
    matrix = cotangent_matrix(modelled_rest(rest, faces), faces, len(rest))
    slope = rest @ [3.0, -2.0, 0.0]
    assert_allclose(slope @ (matrix @ slope), 13.0 * 0.14 * 0.10, rtol=1e-12, atol=0.0)
    assert_allclose(matrix @ np.ones(len(rest)), 0.0, rtol=0.0, atol=1e-12)
    assert_allclose((matrix - matrix.T).toarray(), 0.0, rtol=0.0, atol=1e-12)


def test_angles_of_a_roof_and_of_the_plane():
    flat = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0], [1.0, 0.5, 0.0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    bent = flat.copy()
    bent[3] = [np.cos(0.6), 0.5, np.sin(0.6)]
    assert_allclose(dihedral_deg(np.stack([flat, bent]), faces), [0.0, np.degrees(0.6)], rtol=1e-12, atol=1e-9)
