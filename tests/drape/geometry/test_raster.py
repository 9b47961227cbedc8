"""The rasteriser against closed forms: what is in front covers, sizes are those of the projection."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.geometry.raster import Surface, render, view_matrix

SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def covered(image: np.ndarray, channel: int) -> np.ndarray:
    other = [c for c in range(3) if c != channel]
    return (image[..., channel] > 0.2) & (image[..., other] < 0.05).all(axis=-1)


def draw(*surfaces: Surface, **options) -> np.ndarray:
    return render(list(surfaces), size=(200, 200), centre=np.zeros(3), extent_m=2.0, elevation_deg=0.0, **options)


def test_a_square_covers_its_share_of_the_picture():
    image = draw(Surface(SQUARE, FACES, (1.0, 0.0, 0.0)))
    assert_allclose(covered(image, 0).mean(), 0.25, rtol=0.03, atol=0)


def test_the_nearer_surface_hides_the_farther_whatever_the_order():
    near = Surface(0.5 * SQUARE + [0.0, 0.0, 0.3], FACES, (0.0, 1.0, 0.0))
    far = Surface(SQUARE, FACES, (1.0, 0.0, 0.0))
    first, second = draw(near, far), draw(far, near)
    assert_allclose(first, second, rtol=0, atol=0)
    assert_allclose(covered(first, 1).mean(), 0.0625, rtol=0.06, atol=0)


def test_a_quarter_turn_shows_the_square_from_its_edge():
    assert covered(draw(Surface(SQUARE, FACES, (1.0, 0.0, 0.0)), azimuth_deg=90.0), 0).mean() < 0.01


def test_views_are_rotations_and_azimuth_ninety_looks_from_the_left_hand():
    view = view_matrix(90.0, 0.0)
    assert_allclose(view @ view.T, np.eye(3), rtol=0, atol=1e-12)
    assert_allclose(view @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], rtol=0, atol=1e-12)  # towards the viewer
