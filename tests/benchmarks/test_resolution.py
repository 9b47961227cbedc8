"""The meshes of the resolution benchmark, and its record."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks.resolution import at_size, flipped, main
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.geometry import meshes


@pytest.fixture(scope="module")
def tank() -> tuple[np.ndarray, np.ndarray]:
    garment = open_garment(find_garments(["tank"])[0], load_body())
    return garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("count", [1_000, 3_337, 12_000])
def test_meshes_have_about_the_size_asked_for_and_the_same_area(tank, count):
    whole, whole_faces = tank
    vertices, faces = at_size(whole, whole_faces, count)
    assert 0.75 * count < len(vertices) < 1.3 * count
    assert area(vertices, faces) == pytest.approx(area(whole, whole_faces), rel=0.01)
    assert faces.max() == len(vertices) - 1


def test_flipped_diagonals_are_other_triangles_over_the_same_vertices(tank):
    vertices, faces = tank
    other = flipped(vertices, faces)
    changed = (np.sort(other, axis=1) != np.sort(faces, axis=1)).any(axis=1)
    assert 0.3 < changed.mean() < 1.0
    assert area(vertices, other) == pytest.approx(area(vertices, faces), rel=0.02)
    for triangles in (faces, other):
        _, count = np.unique(np.sort(meshes.half_edges(triangles)[:, :2], axis=1), axis=0, return_counts=True)
        assert count.max() == 2
    border = [
        np.unique(np.sort(meshes.half_edges(t)[:, :2], axis=1), axis=0, return_counts=True) for t in (faces, other)
    ]
    assert_array_equal(border[0][0][border[0][1] == 1], border[1][0][border[1][1] == 1])


def test_the_record_measures_against_the_reference(tmp_path):
    record = main(["--quick", "--garment", "tank", "--threads", "1", "--out", str(tmp_path / "r.json")])
    assert json.loads((tmp_path / "r.json").read_text()) == record
    rows = {row["mesh"]: row for row in record["rows"]}
    assert rows[record["reference"]]["mean_mm"] < 1e-3
    assert 0.0 < rows["2,000, diagonals flipped"]["mean_mm"] < 20.0
    assert rows["2,000, diagonals flipped"]["rest_mm"] < 1e-3
    assert 0.0 < rows["1,000"]["rest_mm"] < 5.0
