"""Crossing triangles: closed cases, and libigl's test of two triangles over all pairs as the judge."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks.measure.intersections import intersecting_pairs, intersection_count
from drape.errors import MeshError
from drape.geometry import triangle_pairs
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube

FLAT = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
PAIR = np.array([[0, 1, 2], [3, 4, 5]])


def together(other: list[list[float]]) -> np.ndarray:
    return np.concatenate([FLAT, np.array(other, dtype=float)])


def every_pair(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The same by libigl, one pair after the other."""
    found = []
    for i in range(len(faces)):
        for j in range(i + 1, len(faces)):
            if np.intersect1d(faces[i], faces[j]).size:
                continue
            corners = [np.ascontiguousarray(vertices[k][None]) for k in (*faces[i], *faces[j])]
            hit, coplanar, _, _ = igl.tri_tri_intersection_test_3d(*corners)
            if hit and not coplanar:
                found.append([i, j])
    return np.array(found, dtype=np.int64).reshape(-1, 2)


@pytest.mark.parametrize(
    ("other", "crosses"),
    [
        ([[0.2, 0.2, -1.0], [0.2, 0.2, 1.0], [0.3, 0.9, 1.0]], True),  # an edge through the middle
        ([[-1.0, 0.3, -1.0], [2.0, 0.3, -1.0], [0.3, 0.3, 2.0]], True),  # larger: only FLAT's edges pass through it
        ([[0.2, 0.2, 0.1], [0.2, 0.2, 1.0], [0.3, 0.9, 1.0]], False),  # above
        ([[2.0, 2.0, -1.0], [2.0, 2.0, 1.0], [3.0, 2.0, 1.0]], False),  # beside
        ([[0.8, 0.8, -1.0], [0.8, 0.8, 1.0], [0.7, 0.9, 1.0]], False),  # boxes overlap, beyond the long edge
        ([[0.2, 0.2, 0.0], [0.2, 0.2, 1.0], [0.3, 0.9, 1.0]], False),  # a corner on the face: touches
        ([[0.2, 0.2, 0.0], [0.4, 0.2, 0.0], [0.3, 0.2, 1.0]], False),  # an edge on the face: touches
        ([[0.1, 0.1, 0.0], [0.5, 0.1, 0.0], [0.1, 0.5, 0.0]], False),  # within the same plane
        ([[0.0, 0.0, 0.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 1.0]], False),  # a seam's other vertex at the same corner
    ],
)
def test_two_triangles(other, crosses, rng):
    expected = [[0, 1]] if crosses else []
    assert intersecting_pairs(together(other), PAIR).tolist() == expected
    if crosses:  # touching hangs on the last digit, so only the rest survives a turn
        turned = together(other) @ random_rotation(rng).T + [3.0, -2.0, 5.0]
        assert intersecting_pairs(turned, PAIR[::-1, [2, 0, 1]]).tolist() == expected


def test_triangles_with_a_common_vertex_do_not_count():
    # The second triangle hangs on a corner of the first and passes through it.
    vertices = np.array([*FLAT, [0.6, 0.3, 0.5], [0.6, 0.1, -0.5]])
    assert intersecting_pairs(vertices, np.array([[0, 1, 2], [0, 3, 4]])).shape == (0, 2)
    apart = np.array([*vertices, [0.0, 0.0, 0.0]])
    assert intersecting_pairs(apart, np.array([[0, 1, 2], [5, 3, 4]])).tolist() == [[0, 1]]


def test_a_smooth_tube_has_none():
    vertices, faces = tube(48, 20)
    assert len(intersecting_pairs(vertices, faces)) == 0


def test_a_blade_through_a_sheet_crosses_two_triangles_of_every_cell():
    rest, faces = grid(6, 9, cell_m=0.01)
    x = 0.023  # between two columns of vertices
    blade = np.array([[x, -0.5, -0.5], [x, 0.5, -0.5], [x, 0.045, 0.5]])
    vertices = np.concatenate([rest, blade])
    both = np.concatenate([faces, [[len(rest), len(rest) + 1, len(rest) + 2]]])
    assert intersection_count(vertices, both) == 2 * 9
    assert (intersecting_pairs(vertices, both)[:, 1] == len(faces)).all()


def test_a_sheet_folded_through_itself():
    """A strip rolled into a spiral whose end passes through its beginning, beside the same strip unrolled."""
    rest, faces = grid(40, 3, cell_m=0.01)
    angle = rest[:, 0] / 0.4 * 2.6 * np.pi
    radius = 0.05 + 0.02 * np.cos(0.9 * angle)
    rolled = np.stack([radius * np.cos(angle), rest[:, 1], radius * np.sin(angle)], axis=1)
    counts = intersection_count(np.stack([rest, rolled]), faces)
    assert counts[0] == 0
    assert counts[1] == len(every_pair(rolled, faces)) > 0


@pytest.mark.parametrize("chunk", [40, triangle_pairs.CHUNK_PAIRS])
def test_a_soup_of_all_sizes_equals_all_pairs(rng, monkeypatch, chunk):
    monkeypatch.setattr(triangle_pairs, "CHUNK_PAIRS", chunk)
    size = 10.0 ** rng.uniform(-2.0, 0.3, size=(90, 1, 1))
    vertices = (rng.uniform(-0.5, 0.5, size=(90, 1, 3)) + size * rng.normal(size=(90, 3, 3))).reshape(-1, 3)
    faces = np.arange(270).reshape(90, 3)
    faces[60:, 0] = faces[:30, 1]  # some share a vertex
    found = intersecting_pairs(vertices, faces)
    assert len(found) > 20
    assert_array_equal(found, every_pair(vertices, faces))


def test_far_from_the_origin_and_in_any_unit(rng):
    vertices = rng.normal(size=(90, 3))
    faces = np.arange(90).reshape(30, 3)
    expected = intersecting_pairs(vertices, faces)
    assert len(expected) > 10
    assert_array_equal(intersecting_pairs(1e-3 * vertices + 4096.0, faces), expected)


def test_frames_are_counted_one_by_one(rng):
    vertices = rng.normal(size=(2, 3, 60, 3))
    faces = np.arange(60).reshape(20, 3)
    counts = intersection_count(vertices, faces)
    assert counts.shape == (2, 3)
    assert counts[1, 2] == len(intersecting_pairs(vertices[1, 2], faces))


def test_meshes_without_pairs():
    assert intersecting_pairs(FLAT, PAIR[:1]).shape == (0, 2)
    assert intersecting_pairs(FLAT, np.zeros((0, 3), dtype=int)).shape == (0, 2)
    assert intersecting_pairs(np.zeros((6, 3)), PAIR).shape == (0, 2)  # all in one point


@pytest.mark.parametrize(
    ("vertices", "faces", "said"),
    [
        (np.zeros((6, 2)), PAIR, "vertices"),
        (np.full((6, 3), np.nan), PAIR, "finite"),
        (np.zeros((5, 3)), PAIR, "indices"),
        (np.zeros((6, 3)), PAIR[:, :2], "faces"),
    ],
)
def test_what_is_no_mesh_is_refused(vertices, faces, said):
    with pytest.raises(MeshError, match=said):
        intersecting_pairs(vertices, faces)
