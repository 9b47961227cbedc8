"""Pieces of known shape are laid flat as geometry says: isometries stay, rings are cut, nothing folds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import flatten
from drape.garment.flatten import lay_flat
from drape.geometry import mesh_graphs, meshes
from drape.geometry.meshes import signed_areas
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.geometry.geometry_shapes import box


def laid(points: np.ndarray, faces: np.ndarray, weight: np.ndarray | None = None):
    """Kept rows, places and the triangles among them, in rows of the places: whatever is laid, none is folded over."""
    found = lay_flat(points, points[:, :2], faces, np.ones(len(points)) if weight is None else weight)
    assert found is not None
    kept, places = found
    triangles = np.searchsorted(kept, faces[np.isin(faces, kept).all(axis=1)])
    assert (signed_areas(places, triangles) > 0.0).all()
    return kept, places, triangles


def round_grid(size: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of side two about the origin."""
    points, faces = grid(size, size, cell_m=2.0 / size)
    return points - [1.0, 1.0, 0.0], faces


def half_tube(radius: float = 0.4, turn: float = 1.4 * np.pi) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A strip bent round the y axis by ``turn``, and the flat strip (n, 2) that it is an isometry of."""
    points, faces = grid(40, 12, cell_m=radius * turn / 40)
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    angle = flat[:, 0] / radius
    return np.stack([radius * np.sin(angle), flat[:, 1], radius * np.cos(angle)], axis=1), faces, flat


def test_rims_cross_where_a_flat_ring_winds_over_itself():
    points, faces = grid(40, 2, cell_m=0.05)
    for turn, crosses in ((0.9, False), (1.1, True)):
        angle = np.pi * turn * points[:, 0]  # the strip is two long: a full turn for 1.0
        radius = 1.0 - points[:, 1]
        places = np.stack([radius * np.sin(angle), -radius * np.cos(angle)], axis=1)
        assert (signed_areas(places, faces) > 0.0).all()
        assert flatten.rims_cross(places, faces) is crosses


def test_a_band_that_would_wind_over_itself_is_laid_so_that_it_does_not():
    points, faces = grid(60, 4, cell_m=0.05)
    angle = 1.2 * 2.0 * np.pi * points[:, 0] / 3.0  # a flat spiral by a full turn and a fifth, one end over the other
    radius = 0.6 - points[:, 1]
    spiral = np.stack([radius * np.sin(angle), -radius * np.cos(angle), 0.02 * angle], axis=1)
    assert (signed_areas(spiral[:, :2], faces) > 0.0).all() and flatten.rims_cross(spiral[:, :2], faces)
    _, places, triangles = laid(spiral, faces)
    assert not flatten.rims_cross(places, triangles)


def test_graph_holds_every_edge_once_each_way():
    points, faces = grid(2, 1, cell_m=1.0)
    graph = mesh_graphs.edge_graph(points, faces)
    assert_array_equal(graph.toarray(), graph.T.toarray())
    assert graph.nnz == 2 * len(meshes.unique_edges(faces))
    assert_allclose(np.unique(graph.data), [1.0, np.sqrt(2.0)], rtol=1e-12)


def test_a_flat_piece_stays_where_it_is():
    points, faces = round_grid()
    kept, places, _ = laid(points, faces)
    assert_array_equal(kept, np.arange(len(points)))
    # The energy and the pull agree on the projection; what is left is how far SLIM has come in its few steps.
    assert_allclose(places, points[:, :2], rtol=0, atol=0.01)


def test_a_bent_strip_is_unrolled_without_a_fold(monkeypatch):
    points, faces, flat = half_tube()
    monkeypatch.setattr(flatten, "TIGHT", ((0.0, (60,)),))
    monkeypatch.setattr(flatten, "RETURN_ROUNDS", 0)
    assert (signed_areas(points[:, :2], faces) <= 0.0).any()
    _, places, _ = laid(points, faces)
    edges = meshes.unique_edges(faces)  # nothing pulls: the strip is developable, so its lengths come back
    assert_allclose(meshes.edge_lengths(places, edges), meshes.edge_lengths(flat, edges), rtol=0.02, atol=0)


def test_a_stronger_pull_keeps_places_nearer_the_projection(monkeypatch):
    points, faces, _ = half_tube()
    monkeypatch.setattr(flatten, "RETURN_ROUNDS", 0)
    away = []
    for pull in (1.0, 100.0):
        monkeypatch.setattr(flatten, "TIGHT", ((pull, (10,)),))
        _, places, _ = laid(points, faces)
        away.append(float(np.sqrt(np.mean((places - points[:, :2]) ** 2))))
    assert away[1] < 0.8 * away[0]


def test_a_ring_is_cut_where_the_chart_weighs_least():
    points, faces = tube(32, 12, radius_m=0.3, height_m=0.6)
    weight = np.exp(2.0 * points[:, 2])  # heaviest at the front
    kept, _, _ = laid(points, faces, weight)
    left = np.setdiff1d(np.arange(len(points)), kept)
    assert len(left) == 13  # one vertex per ring: the shortest way from rim to rim
    assert points[left, 2].max() < -0.29  # along the back


def test_trousers_need_two_cuts():
    points, faces = round_grid(24)
    middle = points[faces].mean(axis=1)
    holes = [(np.abs(middle[:, 0] - x) < 0.4) & (np.abs(middle[:, 1]) < 0.8) for x in (-0.5, 0.5)]
    pants = faces[~(holes[0] | holes[1])]
    assert len(meshes.boundary_loops(pants)) == 3
    kept, _, triangles = laid(points, pants)
    assert len(kept) < len(np.unique(pants))
    assert len(meshes.boundary_loops(triangles)) == 1


def test_a_small_hole_is_kept_open_and_not_cut():
    points, faces = round_grid()
    middle = points[faces].mean(axis=1)
    pierced = faces[np.hypot(middle[:, 0], middle[:, 1]) > 0.2]
    kept, places, triangles = laid(points, pierced)
    assert_array_equal(kept, np.unique(pierced))
    assert len(triangles) == len(pierced)
    assert_allclose(places, points[kept, :2], rtol=0, atol=0.02)


def test_places_turn_with_the_plane_that_is_given():
    points, faces, _ = half_tube()
    rotation = np.array([[0.28, -0.96], [0.96, 0.28]])
    turned = np.concatenate([points[:, :2] @ rotation.T, points[:, 2:]], axis=1)
    first, second = laid(points, faces)[1], laid(turned, faces)[1]
    assert_allclose(second, first @ rotation.T, rtol=0, atol=1e-6)


@pytest.mark.parametrize("corner", [True, False])
def test_only_the_largest_piece_stays(corner):
    points, faces = round_grid(8)
    far = points[39:42] + np.array([5.0, 0.0, 0.0])
    more = np.concatenate([points, far])
    hanging = np.array([[len(points) - 1 if corner else len(points), len(points) + 1, len(points) + 2]])
    found = lay_flat(more, more[:, :2], np.concatenate([faces, hanging]), np.ones(len(more)))
    assert found is not None
    assert_array_equal(found[0], np.arange(len(points)))


def test_a_corner_by_which_a_piece_touches_itself_is_left_out():
    points, faces = round_grid(8)
    corner = 4 * 9 + 4  # the middle: the piece lies round it but for two opposite quarters' triangles beside it
    around = faces[(faces == corner).any(axis=1)]
    opposite = around[np.abs(points[around].mean(axis=1) @ [1.0, 1.0, 0.0]) > 0.1]
    assert 0 < len(opposite) < len(around)
    pinched = faces[~(faces[:, None] == opposite[None]).all(axis=2).any(axis=1)]
    kept, _, _ = laid(points, pinched)
    assert corner in np.unique(pinched) and corner not in kept


def test_closed_and_empty_pieces_have_no_place():
    points, faces = box()
    for piece in (faces, faces[:0]):
        assert lay_flat(points, points[:, :2], piece, np.ones(8)) is None


def test_places_go_all_the_way_back_where_nothing_folds():
    points, faces = round_grid(12)
    placed = points[:, :2] @ np.array([[1.0, 0.2], [0.0, 1.1]]) + 0.1
    back = flatten._returned(placed, points[:, :2], points, faces)
    assert_array_equal(back, points[:, :2].astype(np.float32))


def test_places_go_back_beside_a_fold_and_not_in_it():
    points, faces, flat = half_tube()
    plane = points[:, :2]
    back = flatten._returned(flat, plane, points, faces)
    assert (signed_areas(back, faces) > flatten.RETURN_AREA * signed_areas(flat, faces)).all()
    share = np.linalg.norm(back - flat, axis=1) / np.maximum(np.linalg.norm(plane - flat, axis=1), 1e-12)
    angle = np.abs(flat[:, 0] / 0.4)  # from the top of the arch: past a quarter turn the projection is upside down
    assert share[(angle > 0.55 * np.pi)].max() < 0.7
    assert share[(angle > 0.1) & (angle < 0.2 * np.pi)].min() > 0.8
    # Along an edge the share changes by no more than its length allows.
    edges = meshes.unique_edges(faces)
    moved = np.linalg.norm(plane - flat, axis=1)
    both = edges[(moved[edges] > 1e-3).all(axis=1)]
    step = np.abs(share[both[:, 0]] - share[both[:, 1]])
    assert (step <= flatten.RETURN_SLOPE * meshes.edge_lengths(points, both) + 1e-3).all()


def test_places_stay_where_the_way_back_is_all_fold():
    points, faces = round_grid(6)
    mirrored = points[:, :2] * [-1.0, 1.0]
    assert (signed_areas(flatten._returned(points[:, :2], mirrored, points, faces), faces) > 0.0).all()


def test_a_laid_chart_keeps_the_projection_away_from_its_fold():
    points, faces = grid(40, 12, cell_m=0.05)  # two long, its last quarter folded back over the rest
    x = points[:, 0]
    angle = np.clip((x - 1.5) / 0.05, 0.0, np.pi)
    beyond = np.maximum(x - 1.5 - 0.05 * np.pi, 0.0)
    along = np.minimum(x, 1.5) + 0.05 * np.sin(angle) - beyond
    folded = np.stack([along, points[:, 1], 0.05 * (1.0 - np.cos(angle))], axis=1)
    assert (signed_areas(folded[:, :2], faces) <= 0.0).any()
    kept, places, triangles = laid(folded, faces)
    assert not flatten.rims_cross(places, triangles)
    away = np.linalg.norm(places - folded[kept, :2], axis=1)
    assert away[x[kept] < 0.4].max() < 1e-6 < away[x[kept] > 1.8].min()
