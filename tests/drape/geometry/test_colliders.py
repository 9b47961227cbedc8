"""Colliders: distances against closed forms, and as clients name them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import TypeAdapter, ValidationError

from drape.geometry.colliders import NONE, ROW, box, capsule, distances, plane, seen_from
from drape.wire.colliders import Collider, collider_rows
from drape.wire.options import DrapeOptions

POINTS = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 3))


def test_the_distance_to_a_plane_is_along_its_normal():
    found = distances(plane([0.0, 2.0, 1.0], 0.2)[None], POINTS)
    assert_allclose(found, POINTS @ np.array([0.0, 2.0, 1.0]) / np.sqrt(5.0) - 0.2, atol=1e-9)


def test_the_distance_to_a_capsule_is_that_to_its_line():
    a, b = np.array([0.1, -0.4, 0.0]), np.array([0.5, 0.3, -0.6])
    share = np.clip((POINTS - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    expected = np.linalg.norm(POINTS - a - share[:, None] * (b - a), axis=1) - 0.2
    assert_allclose(distances(capsule(a, b, 0.2)[None], POINTS), expected, atol=1e-12)
    ball = distances(capsule(a, a, 0.2)[None], POINTS)
    assert_allclose(ball, np.linalg.norm(POINTS - a, axis=1) - 0.2, atol=1e-12)


def test_the_distance_to_a_turned_box_is_that_to_its_nearest_point():
    centre, size, angle = np.array([0.2, 0.0, -0.1]), np.array([0.6, 0.2, 0.8]), 0.7
    turned = np.array([[np.cos(angle), 0.0, -np.sin(angle)], [0.0, 1.0, 0.0], [np.sin(angle), 0.0, np.cos(angle)]])
    local = (POINTS - centre) @ turned.T
    nearest = np.clip(local, -0.5 * size, 0.5 * size)
    inside = (np.abs(local) - 0.5 * size).max(axis=1)
    expected = np.where(inside < 0.0, inside, np.linalg.norm(local - nearest, axis=1))
    assert (inside < 0.0).any()
    assert_allclose(distances(box(centre, size, [0.0, angle, 0.0])[None], POINTS), expected, atol=1e-12)


def test_the_nearest_of_several_counts_from_any_origin():
    several = np.stack([plane([0.0, 1.0, 0.0], -0.5), capsule([0, 0, 0], [0, 1, 0], 0.1)])
    found = distances(several, POINTS)
    assert_array_equal(found, np.minimum(*(distances(one[None], POINTS) for one in several)))
    moved = np.array([3.0, -1.0, 2.0])
    assert_allclose(distances(seen_from(several, moved), POINTS - moved), found, atol=1e-9)
    assert np.isinf(distances(seen_from(NONE, moved), POINTS)).all()


def test_clients_name_them():
    read = TypeAdapter(Collider).validate_python
    seat = {"kind": "box", "centre": [0, 0.4, 0], "size": [0.5, 0.05, 0.4]}
    chosen = DrapeOptions.model_validate({"colliders": [{"kind": "plane"}, seat]})
    rows = collider_rows(chosen.colliders)
    assert rows.shape == (2, ROW) and collider_rows(None).shape == (0, ROW)
    assert_allclose(distances(rows, np.array([[0.0, 0.5, 0.0], [2.0, 0.3, 0.0]])), [0.075, 0.3], atol=1e-9)
    assert hash(chosen) == hash(DrapeOptions.model_validate({"colliders": [{"kind": "plane"}, seat]}))
    rail = read({"kind": "capsule", "ends": [[0, 1, 0], [1, 1, 0]], "radius_m": 0.05})
    assert_allclose(distances(rail.row()[None], np.array([[0.5, 1.2, 0.0]])), [0.15])


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "ball"},
        {"kind": "plane", "normal": [0, 0, 0]},
        {"kind": "plane", "offset_m": float("nan")},
        {"kind": "box", "centre": [0, 0, 0], "size": [0.5, 0, 0.4]},
        {"kind": "box", "centre": [0, 0, 2e6], "size": [0.5, 1, 0.4]},
        {"kind": "capsule", "ends": [[0, 1, 0], [1, 1, 0]], "radius": 0.05},
    ],
)
def test_what_is_no_collider_is_refused(wrong: dict[str, object]):
    with pytest.raises(ValidationError):
        TypeAdapter(Collider).validate_python(wrong)


def test_there_may_not_be_too_many():
    with pytest.raises(ValidationError):
        DrapeOptions.model_validate({"colliders": 33 * [{"kind": "plane"}]})
