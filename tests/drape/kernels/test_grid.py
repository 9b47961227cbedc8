"""A grid of points: a walk over a box meets every point in it once, and no walk leaves the grid."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from drape.engine.calls import call_with_scratch
from tests.fixtures.laws import each

WIDEST_M = 10.0  # points farther apart than that, along an axis, are in no cell
for_each_type = each(dtype=(np.float32, np.float64))


def met(points: np.ndarray, low: np.ndarray, high: np.ndarray, per_m: float = 20.0) -> np.ndarray:
    """How often a walk from ``low`` to ``high`` meets each point."""
    times = np.zeros(len(points), np.int64)
    call_with_scratch("law_walk", points.dtype, points, *points.shape, per_m, *map(float, (*low, *high)), times)
    return times


@for_each_type
def test_a_walk_meets_every_point_of_its_box_once_and_no_point_a_cell_away(rng, dtype):
    points = rng.uniform(-0.3, 0.4, size=(500, 4)).astype(dtype)  # a fourth number is no place
    for low, size in ((rng.uniform(-0.5, 0.5, 3), rng.uniform(0.0, 0.4, 3)) for _ in range(40)):
        times = met(points, low, low + size)
        inside = ((points[:, :3] >= low) & (points[:, :3] <= low + size)).all(axis=1)
        beside = ((points[:, :3] > low - 0.051) & (points[:, :3] < low + size + 0.051)).all(axis=1)
        assert (times[inside] == 1).all() and times.max(initial=0) <= 1 and not times[~beside].any()


@for_each_type
def test_boxes_beside_the_grid_and_of_numbers_that_are_none_meet_nothing(dtype):
    points = np.zeros((3, 3), dtype)
    for where in (-1e12, -0.2, 0.2, 1e12, np.nan, np.inf):
        assert_array_equal(met(points, np.full(3, where), np.full(3, where)), 0)
        for axis in range(3):
            beside = np.where(np.arange(3) == axis, where, 0.0)
            assert_array_equal(met(points, beside, beside), 0)


def test_points_as_far_apart_as_houses_or_of_numbers_that_are_none_are_in_no_cell():
    everywhere = (np.full(3, -100.0), np.full(3, 100.0))
    for far in (1.01 * WIDEST_M, np.nan, np.inf):
        assert_array_equal(met(np.array([[0.0, 0.0, 0.0], [0.1, far, 0.0]]), *everywhere), 0)
