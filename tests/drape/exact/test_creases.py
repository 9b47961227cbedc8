"""Skin in creases: which it is, and that contact with the rest leads out of them."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from drape.cloth.contact import BodyContact
from drape.exact.creases import hidden_skin, move_out, without_creases
from tests.drape.geometry.geometry_shapes import icosphere

RADIUS_M, BEND_M = 0.05, 0.1


def bent(turn_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A sausage (V, 3) [m] bent round by ``turn_rad``, its faces, and the side (V,) of its middle of a vertex."""
    ball, faces = icosphere(4)  # x turns into y
    along = turn_rad * (np.clip(3.0 * ball[:, 0], -0.5, 0.5))
    tip = np.sign(ball[:, 0]) * np.maximum(np.abs(ball[:, 0]) - 1.0 / 6.0, 0.0)
    across = ball[:, 1:] / np.maximum(np.linalg.norm(ball[:, 1:], axis=1, keepdims=True), 1e-12)
    width = np.sqrt(np.maximum(1.0 - (tip / (5.0 / 6.0)) ** 2, 0.0))
    away = BEND_M + RADIUS_M * width * across[:, 0]
    ahead = RADIUS_M * tip / (5.0 / 6.0)
    x, y = away * np.cos(along) - ahead * np.sin(along), away * np.sin(along) + ahead * np.cos(along)
    return np.stack([x, y, RADIUS_M * width * across[:, 1]], axis=1), faces[:, ::-1], along


def ends(turn_rad: float) -> np.ndarray:
    """The middles [m] (2, 3) of its two round ends."""
    return BEND_M * np.array([[np.cos(0.5 * turn_rad), side * np.sin(0.5 * turn_rad), 0.0] for side in (-1.0, 1.0)])


def test_only_skin_inside_another_part_is_hidden():
    x, faces, along = bent(5.6)  # the ends lie 3 cm in each other
    hidden = hidden_skin(x, faces)
    depth = RADIUS_M - np.linalg.norm(x - ends(5.6)[(along < 0).astype(int)], axis=1)  # in the other end
    assert 20 < hidden.sum() < 0.25 * len(x) and depth[hidden].min() > 0.0
    assert hidden[depth > 0.01].all()
    near, faces, _ = bent(5.2)
    assert not hidden_skin(near, faces).any()


def test_contact_is_with_the_outside_of_the_body():
    x, faces, _ = bent(5.25)  # the ends touch nearly
    taking_part = without_creases(BodyContact(faces, len(x)), x).vertices
    assert taking_part is not None and 0 < len(x) - len(taking_part) < 0.2 * len(x)
    some = without_creases(BodyContact(faces, len(x), vertices=np.arange(10)), x).vertices
    assert_array_equal(some, np.intersect1d(taking_part, np.arange(10)))


def test_points_are_led_out_of_a_crease():
    x, faces, _ = bent(5.6)
    contact = without_creases(BodyContact(faces, len(x)), x)
    between = ends(5.6).mean(axis=0, keepdims=True) - np.array([0.02, 0.0, 0.0])
    moved = move_out(contact, x, between, 0.004)
    assert moved[0, 0] < between[0, 0] - 0.005
    far = np.array([[0.0, 0.5, 0.0]])
    assert_array_equal(move_out(contact, x, far, 0.004), far)
