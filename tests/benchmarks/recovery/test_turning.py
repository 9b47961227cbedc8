import numpy as np
import pytest

from benchmarks.recovery.turning import turning_distance
from drape.errors import InputError


def regular(corners: int) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(corners) / corners
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rectangle(width: float) -> np.ndarray:
    return np.array([(0.0, 0.0), (width, 0.0), (width, 1.0), (0.0, 1.0)])


@pytest.mark.parametrize(("m", "n"), [(3, 6), (4, 20), (5, 35), (4, 400)])
def test_regular_polygons_have_a_closed_form(m: int, n: int):
    # Both turning functions are stairs along one line; where m divides n their difference is a saw of known variance.
    want = np.sqrt(((2.0 * np.pi / m) ** 2 - (2.0 * np.pi / n) ** 2) / 12.0)
    assert turning_distance(regular(m), regular(n)) == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize(("a", "b"), [(1.0, 2.0), (1.0, 1.01), (3.0, 1.5)])
def test_rectangles_have_a_closed_form(a: float, b: float):
    off = abs(a / (2.0 * (a + 1.0)) - b / (2.0 * (b + 1.0)))
    want = 0.5 * np.pi * np.sqrt(2.0 * off * (1.0 - 2.0 * off))
    assert turning_distance(rectangle(a), rectangle(b)) == pytest.approx(want, abs=1e-9)


def test_place_size_orientation_start_direction_and_more_corners_on_a_side_do_not_count():
    rng = np.random.default_rng(3)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
    shape = rng.uniform(0.5, 1.5, 9)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    turn = np.array([(np.cos(0.7), -np.sin(0.7)), (np.sin(0.7), np.cos(0.7))])
    moved = 3.0 * np.roll(shape, 4, axis=0)[::-1] @ turn.T + np.array([5.0, -2.0])
    split = np.insert(moved, 2, 0.5 * (moved[1] + moved[2]), axis=0)
    assert turning_distance(shape, split) == pytest.approx(0.0, abs=1e-7)


def test_a_mirror_image_is_the_same_shape_only_if_asked_for():
    shape = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.5, 0.7)])
    image = shape * np.array([-1.0, 1.0])
    assert turning_distance(shape, image) == pytest.approx(0.0, abs=1e-7)
    assert turning_distance(shape, image, mirror=False) > 0.1


def test_it_is_symmetric_and_keeps_the_triangle_inequality():
    rng = np.random.default_rng(5)
    shapes = [regular(count) * rng.uniform(0.7, 1.3, (count, 1)) for count in (5, 8, 11)]
    ab, bc, ac = (turning_distance(shapes[i], shapes[j]) for i, j in ((0, 1), (1, 2), (0, 2)))
    assert turning_distance(shapes[1], shapes[0]) == pytest.approx(ab, abs=1e-9)
    assert ac <= ab + bc


def test_no_start_between_corners_is_nearer():
    # A side cut into many: starts anywhere along it are tried, and none may win.
    rng = np.random.default_rng(8)
    first, second = (regular(count) * rng.uniform(0.6, 1.4, (count, 1)) for count in (5, 6))
    share = np.linspace(0.0, 1.0, 41)[:-1, None]
    fine = np.concatenate([a + share * (b - a) for a, b in zip(first, np.roll(first, -1, axis=0), strict=True)])
    assert turning_distance(fine, second) == pytest.approx(turning_distance(first, second), abs=1e-9)


@pytest.mark.parametrize("outline", [np.zeros((2, 2)), np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)])])
def test_what_bounds_no_area_is_refused(outline: np.ndarray):
    with pytest.raises(InputError, match="bounds an area"):
        turning_distance(outline, regular(4))
