"""Skin in pictures of balls whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.measure.judged import BEHIND_M, HEM_M, Camera, JudgedBody, covered_skin, skin_pixels_pct
from drape.geometry.raster import Surface, render
from tests.drape.geometry.geometry_shapes import icosphere

RADIUS_M = 0.15
BALL, FACES = icosphere(3, radius_m=RADIUS_M)
ALL = np.ones(len(FACES), bool)


@pytest.fixture(scope="module")
def ball() -> JudgedBody:
    return JudgedBody.of(BALL, FACES)


def test_the_camera_sees_all_of_a_body_and_how_near_it_is():
    camera = Camera.around(BALL)
    for azimuth_deg in (0.0, 45.0, 130.0):
        seen = camera.see(BALL, FACES, azimuth_deg)
        area_m2 = np.count_nonzero(seen.face >= 0) * (0.003**2)
        assert_allclose(area_m2, np.pi * RADIUS_M**2, rtol=0.02, atol=0)
        assert_allclose(seen.depth.max(), RADIUS_M, rtol=0.02, atol=0)
        assert_array_equal(np.isfinite(seen.depth), seen.face >= 0)


def test_cloth_outside_hides_the_skin_and_cloth_inside_shows_it(ball: JudgedBody):
    assert_array_equal(skin_pixels_pct(ball, ALL, 1.05 * BALL, FACES), np.zeros(4))
    near = skin_pixels_pct(ball, ALL, 0.95 * BALL, FACES)
    assert ((near > 70.0) & (near < 91.0)).all()  # a disc of 0.95 of the radius, less a rim that it stands back from
    far = skin_pixels_pct(ball, ALL, 0.5 * BALL, FACES)
    assert_array_equal(far, np.zeros(4))  # it lies too deep for skin that came through
    assert not (1.0 - 0.5) * RADIUS_M < BEHIND_M
    assert np.isnan(skin_pixels_pct(ball, ~ALL, 0.5 * BALL, FACES)).all()


def test_a_dent_shows_from_its_side_by_its_share(ball: JudgedBody):
    dented = 1.03 * BALL
    front = BALL[:, 2] > 0.9 * RADIUS_M
    dented[front] = 0.99 * BALL[front]
    share = skin_pixels_pct(ball, ALL, dented, FACES)
    # A cap of this height has 0.19 of the disc's area; chords at its rim cover some of it.
    assert 8.0 < share[0] < 22.0 and share[2] == 0.0


def test_faces_are_covered_off_the_hems(ball: JudgedBody):
    centre = BALL[FACES].mean(axis=1)
    cap = FACES[centre[:, 1] < 0.05]
    covered = covered_skin(BALL, FACES, 1.04 * BALL, cap)
    assert covered[(centre[:, 1] < 0.05 - HEM_M - 0.02) & (centre[:, 1] > -0.1)].all()
    assert not covered[centre[:, 1] > 0.05 - HEM_M + 0.02].any()
    assert covered_skin(BALL, FACES, 1.04 * BALL, FACES).mean() > 0.95, "no hem, nothing bare"


def test_the_pictures_agree_with_the_shaded_ones():
    camera = Camera.around(BALL)
    seen = camera.see(BALL, FACES, 90.0)
    extent_m = 0.003 * camera.size[0]
    image = render([Surface(BALL, FACES)], size=camera.size, azimuth_deg=90.0, centre=camera.centre, extent_m=extent_m)
    assert_array_equal((image < 1.0).any(axis=-1), seen.face >= 0)
