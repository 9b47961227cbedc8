"""Ease: a garment's girth without stress, whatever the drape does to it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.measures import measures
from drape.body.model import BodyModel
from drape.cloth.rest_state import modelled_rest
from drape.garment.cache import Garment
from drape.garment.ease import Ease, eases, girth_around, rest_lengths
from drape.geometry.sections import level_section
from tests.drape.cloth import cloth_shapes

AROUND, RADIUS_M = 48, 0.2
GIRTH_M = 2.0 * AROUND * RADIUS_M * np.sin(np.pi / AROUND)
MIDDLE = np.zeros(2)


def tube() -> tuple[np.ndarray, np.ndarray]:
    return cloth_shapes.tube(AROUND, 9, radius_m=RADIUS_M, height_m=0.5)


def test_the_girth_is_that_of_the_cloth_and_not_of_the_drape(rng):
    rest, faces = tube()
    cloth = modelled_rest(rest, faces)
    for stretch in (1.0, 1.2, 0.7):
        draped = rest * [stretch, 1.0, stretch]
        for y in rng.uniform(0.05, 0.45, 3):
            found = girth_around(faces, cloth, draped, y=y, middle=MIDDLE)
            assert found == pytest.approx(GIRTH_M, rel=1e-12)
    wave = 0.02 * np.sin(3.0 * np.arctan2(rest[:, 0], rest[:, 2]))
    longer = girth_around(faces, cloth, rest + wave[:, None] * [0.0, 1.0, 0.0], y=0.25, middle=MIDDLE)
    assert longer is not None and longer > GIRTH_M, "the line lies aslant on the cloth"


def test_what_is_open_elsewhere_or_beside_the_body_has_no_girth():
    rest, faces = tube()
    cloth = modelled_rest(rest, faces)
    assert girth_around(faces, cloth, rest, y=0.6, middle=MIDDLE) is None
    assert girth_around(faces, cloth, rest, y=0.25, middle=np.array([0.5, 0.0])) is None
    front = (rest[faces, 2] > 0.0).any(axis=1)
    assert girth_around(faces[front], modelled_rest(rest, faces[front]), rest, y=0.25, middle=MIDDLE) is None


def test_of_two_rings_the_outer_one_counts():
    (first, faces), (second, _) = tube(), cloth_shapes.tube(AROUND, 9, radius_m=0.3, height_m=0.5)
    both, double = np.concatenate([first, second]), np.concatenate([faces, faces + len(first)])
    found = girth_around(double, modelled_rest(both, double), both, y=0.25, middle=MIDDLE)
    assert found == pytest.approx(1.5 * GIRTH_M, rel=1e-12)


def test_lengths_on_the_rest_of_a_mesh_are_those_of_its_section():
    rest, faces = tube()
    section = level_section(faces, rest, 0.21)
    ends = section.points(rest)[section.ends]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert_allclose(rest_lengths(section, faces, modelled_rest(rest, faces)), lengths, rtol=1e-9, atol=1e-15)


def test_ease_is_the_garments_girth_minus_the_bodys(body: BodyModel, tube: Garment):
    vertices = tube.vertices.astype(np.float64)
    found = eases(tube.faces, tube.rest_state(), vertices, body)
    assert set(found) == {"waist_m"}, "it ends below the chest and above the seat"
    ring = vertices[:24]
    length_m = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum()
    assert_allclose(found["waist_m"].garment_m, length_m, rtol=1e-5)
    assert_allclose(found["waist_m"].body_m, measures(body).waist_m, rtol=1e-12)
    assert Ease(0.8, 0.9).ease_m == 0.9 - 0.8
    larger = eases(tube.faces, tube.rest_state(), vertices, body, np.array([0.1]))
    assert larger["waist_m"].ease_m < found["waist_m"].ease_m
