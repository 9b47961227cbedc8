import numpy as np
import pytest

from benchmarks.recovery.surfaces import sample_surface, surface_error
from drape.errors import MeshError

SQUARE = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
FACES = np.array([(0, 1, 2), (0, 2, 3)])
COUNT = 20_000


def test_points_lie_on_the_surface_and_are_drawn_by_area():
    stretched = SQUARE * np.array([1.0, 3.0, 1.0]) + np.array([0.0, 0.0, 0.4])
    points, normals = sample_surface(stretched, FACES, COUNT, np.random.default_rng(0))
    assert np.allclose(points[:, 2], 0.4) and np.allclose(normals, (0.0, 0.0, 1.0))
    assert np.histogram(points[:, 1], bins=3, range=(0.0, 3.0))[0] == pytest.approx(COUNT / 3.0, rel=0.03)
    assert points[:, :2].mean(axis=0) == pytest.approx((0.5, 1.5), abs=0.02)


def test_the_floor_is_what_evenly_drawn_points_leave():
    found = surface_error(SQUARE, FACES, SQUARE, FACES, count=COUNT)
    assert found.chamfer_cm2 == pytest.approx(1e4 * 2.0 / (np.pi * COUNT), rel=0.05)
    assert found.mean_mm == pytest.approx(1e3 * 0.5 / np.sqrt(COUNT), rel=0.05)
    assert found.normal == pytest.approx(0.0, abs=1e-12) and found.normal_deg < 1e-5


@pytest.mark.parametrize("angle_deg", [10.0, 60.0])
def test_normals_of_a_turned_square(angle_deg: float):
    angle = np.radians(angle_deg)
    turned = SQUARE @ np.array(
        [(1.0, 0.0, 0.0), (0.0, np.cos(angle), np.sin(angle)), (0.0, -np.sin(angle), np.cos(angle))]
    )
    found = surface_error(turned, FACES, SQUARE, FACES, count=1000)
    assert found.normal == pytest.approx(1.0 - np.cos(angle), abs=1e-9)
    assert found.normal_deg == pytest.approx(angle_deg, abs=1e-6)
    assert surface_error(SQUARE, FACES[:, ::-1], SQUARE, FACES, count=1000).normal == pytest.approx(2.0)


def test_a_mesh_without_area_is_refused():
    with pytest.raises(MeshError, match="have area"):
        sample_surface(np.zeros((3, 3)), np.array([(0, 1, 2)]), 10, np.random.default_rng(0))
