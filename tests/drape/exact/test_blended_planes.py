"""The blended distance against its formula, differences and closed forms, and that it has no steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.contact import BodyContact
from drape.exact.blended_planes import FAR_M, REACH_M, BlendedPlanes, blended_distance
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere

GAP_M = 0.004
WIDTH_M, FADED = 0.006, 14.0  # h, and the exponent of what is left out: drape/engine/source/blended_planes.hpp


@pytest.fixture(scope="module")
def uneven():
    """A ball of 10 cm with dents, and its normals."""
    rng = np.random.default_rng(3)
    ball, faces = icosphere(3, radius_m=0.1)
    ball = ball + 0.002 * rng.normal(size=ball.shape)
    return ball, np.asarray(BodyContact(faces, len(ball)).normals(ball))


def around(body, rng, count: int = 300) -> np.ndarray:
    """Points from 6 mm inside to 12 mm outside the vertices of ``body``."""
    points, normals = body
    chosen = rng.integers(0, len(points), size=count)
    return (
        points[chosen]
        + rng.uniform(-0.006, 0.012, size=(count, 1)) * normals[chosen]
        + 0.003 * rng.normal(size=(count, 3))
    )


def distance(body, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, gradient and second derivatives, looked up anew."""
    points, normals = body
    point, normal, bend = BlendedPlanes(points, normals, len(x), GAP_M)(x)
    return ((x - point) * normal).sum(axis=1), normal, bend


def test_the_distance_is_the_weighted_mean_of_all_planes(uneven, rng):
    points, normals = uneven
    x = around(uneven, rng)
    way = x[:, None] - points
    square = (way**2).sum(axis=2)
    weight = np.exp((square.min(axis=1, keepdims=True) - square) / WIDTH_M**2)
    wanted = (weight * (way * normals).sum(axis=2)).sum(axis=1) / weight.sum(axis=1)
    # What is left out weighs less than that of the nearest each: some twenty of them, planes 20 cm apart or less.
    assert_allclose(distance(uneven, x)[0], wanted, rtol=0, atol=np.exp(-FADED) * 20 * 0.2)


def test_first_and_second_derivatives_are_those_of_differences(uneven, rng):
    x = around(uneven, rng)
    way, step = rng.normal(size=x.shape), 1e-7
    ahead, behind = (distance(uneven, x + sign * step * way) for sign in (1.0, -1.0))
    _, gradient, bend = distance(uneven, x)
    # Weights of 1e-6 come and go within a step; where they do, a difference is off by that over the step.
    for ends, wanted in (
        ((ahead[0] - behind[0]) / (2.0 * step), (gradient * way).sum(axis=1)),
        ((ahead[1] - behind[1]) / (2.0 * step), (bend @ way[..., None])[..., 0]),
    ):
        off = np.abs(ends - wanted) / np.abs(wanted).max()
        assert np.quantile(off, 0.95) < 1e-5
    assert_allclose(bend, np.swapaxes(bend, 1, 2), rtol=0, atol=1e-12 * np.abs(bend).max())


def test_over_a_fine_ball_it_is_the_distance_and_the_curvature_less_what_the_blend_rounds(rng):
    radius = 0.1
    points, _ = icosphere(5, radius_m=radius)  # edges of 3 mm
    body = points, points / radius
    way = rng.normal(size=(60, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    found, gradient, bend = distance(body, (radius + 0.003) * way)
    # The mean of 1 - cos over a blend of variance h^2 / 2 along each of two axes, for planes of a ball.
    rounded = WIDTH_M**2 / (2.0 * radius)
    assert_allclose(found, 0.003 - rounded, rtol=0, atol=0.1 * rounded)
    assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, rtol=0, atol=0.01)
    assert_allclose((gradient * way).sum(axis=1), 1.0, rtol=0, atol=0.01)
    assert_allclose(np.trace(bend, axis1=1, axis2=2).mean(), 2.0 / radius, rtol=0.1, atol=0.0)


def test_along_a_way_it_has_no_steps_where_the_nearest_plane_has(uneven):
    points, normals = uneven
    angle = np.linspace(0.0, 1.0, 20_001)
    x = 0.103 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    nearest = ((x[:, None] - points[None]) ** 2).sum(axis=2).argmin(axis=1)
    stepping = ((x - points[nearest]) * normals[nearest]).sum(axis=1)
    assert np.abs(np.diff(stepping)).max() > 2e-4
    found, gradient, _ = distance(uneven, x)
    step = np.linalg.norm(np.diff(x, axis=0), axis=1)
    assert (np.abs(np.diff(found)) < 1.01 * step * np.linalg.norm(gradient, axis=1).max()).all()


def two_sheets(rng):
    """Sheets 3 cm over each other and points about them; a point above the lower one is inside the upper."""
    sheet, _ = grid(12, 12, cell_m=0.01)
    points = np.concatenate([sheet, sheet + np.array([0.0, 0.0, 0.03])])
    normals = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=points.shape)
    x = rng.uniform([0.01, 0.01, -0.1], [0.11, 0.11, 0.13], size=(400, 3))
    return (points, normals / np.linalg.norm(normals, axis=1, keepdims=True)), x


@pytest.mark.parametrize("place", ["about a ball", "between two surfaces and deep inside"])
def test_a_place_has_one_blend_whatever_the_way_there(uneven, rng, place):
    body, x = (uneven, around(uneven, rng)) if place == "about a ball" else two_sheets(rng)
    points, normals = body
    planes, turned = BlendedPlanes(points, normals, len(x), GAP_M), 0
    before = np.full(len(x), np.inf)
    for size in (0.0, 1e-5, 1e-3, 2e-3, 2e-3, 4e-3, 1e-3, 8e-3, 2e-3, 1e-4):
        x = x + size * rng.normal(size=x.shape)
        point, normal, bend = planes(x)
        wanted, slope, second = distance(body, x)
        found = ((x - point) * normal).sum(axis=1)
        touching = wanted < GAP_M
        assert_allclose(found[touching], wanted[touching], rtol=0, atol=1e-15)
        turned += int((touching & (before > GAP_M)).sum())
        before = wanted
        assert (found[~touching] >= GAP_M).all()
        blended = touching & np.any(bend != 0.0, axis=(1, 2))
        assert_array_equal(normal[blended], slope[blended])
        assert_array_equal(bend[blended], second[blended])
    assert turned > 20


def test_over_coarse_faces_the_distance_is_that_to_what_is_seen():
    points, faces = icosphere(3, radius_m=0.1)  # edges of 16 to 20 mm
    contact = BodyContact(faces, len(points))
    middles = points[faces].mean(axis=1)
    over = middles + GAP_M * meshes.face_normals(points, faces)
    off = blended_distance(over[None], contact, points[None], gap_m=GAP_M)[0] - GAP_M
    alone = distance((points, np.asarray(contact.normals(points))), over)[0] - GAP_M
    assert abs(off).max() < 0.8e-3 < 2.5e-3 < abs(alone).max()
    half = np.flatnonzero(points[:, 1] > 0.0)
    some = BodyContact(faces, len(points), vertices=half)
    assert_array_equal(np.unique(some.edges), np.unique(faces[np.isin(faces, half).all(axis=1)]))
    high = middles[:, 1] > 0.05
    near = blended_distance(over[None, high], some, points[None], gap_m=GAP_M)[0] - GAP_M
    assert_allclose(near, off[high], rtol=0, atol=1e-12)


def test_beyond_reach_the_nearest_plane_holds_what_is_behind_it_and_nothing_else():
    points, faces = icosphere(3, radius_m=0.1)
    planes = BlendedPlanes(points, np.asarray(BodyContact(faces, len(points)).normals(points)), 2, GAP_M)
    inside, outside = np.array([0.0, 0.05, 0.0]), np.array([0.0, 0.1 + 2.0 * REACH_M, 0.0])
    for _ in range(2):
        x = np.stack([inside, outside])
        point, normal, bend = planes(x)
        nearest = ((inside - points) ** 2).sum(axis=1).argmin()
        assert_array_equal(point[0], points[nearest])
        distance_m = ((x - point) * normal).sum(axis=1)
        assert_allclose(distance_m, [-0.05, GAP_M + FAR_M], rtol=0, atol=0.003)
        assert_array_equal(bend, 0.0)
        outside = outside + 1.1 * FAR_M * np.array([0.0, 1.0, 0.0])
    edge = BlendedPlanes(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 1, GAP_M)
    beside = np.array([[0.3, 0.0, -0.01]])  # 10 mm below the plane of a vertex 30 cm away
    point, normal, _ = edge(beside)
    assert ((beside - point) * normal).sum() > GAP_M
