"""Of cloth drawn with a thickness one side stays, in armpits too, where four layers lie near each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.body.assets import load_body
from drape.garment.registration import posed_by
from drape.garment.walls import opposite_faces, outer_sides
from drape.garment.wearer_fields import known_parameters
from drape.geometry import meshes
from drape.geometry.closest import SearchedMesh
from tests.drape.garment.garment_files import shirt

THICK_M = 0.006


def test_a_coat_for_hanging_arms_has_no_holes_where_its_sides_are_hard_to_tell():
    """Skin showed on its shoulders: 87 of 3,626 places of the wall had neither side, now 13."""
    body = load_body()
    skin = posed_by(body, known_parameters(body, "woman", 1.22, 0.0))
    outer, faces = shirt(body, skin)
    points = np.concatenate([outer, outer - THICK_M * meshes.vertex_normals(outer, faces)])
    border, inner, count = meshes.boundary_edges(faces), faces[:, ::-1] + len(outer), len(faces)
    (a, b), beyond = border.T, len(outer)
    rims = np.concatenate([np.stack([a, b, a + beyond], axis=1), np.stack([b, b + beyond, a + beyond], axis=1)])
    keep = outer_sides(points, np.concatenate([faces, inner, rims]), KDTree(skin))
    out, in_ = keep[:count], keep[count : 2 * count]
    assert (~out & ~in_).mean() < 0.006
    assert (out & in_).mean() < 0.008 and out.mean() > 0.98


def test_faces_find_what_is_opposite_at_any_depth_and_nothing_where_they_lie_alone():
    """Two sheets 4, 14 and 24 mm apart, and a part of the first with nothing below it."""
    x, y = np.meshgrid(np.arange(0.0, 0.301, 0.02), np.arange(0.0, 0.201, 0.02))
    flat = np.stack([x.reshape(-1), y.reshape(-1), np.zeros(x.size)], axis=1)
    corner = (np.arange(x.shape[0] - 1)[:, None] * x.shape[1] + np.arange(x.shape[1] - 1)).reshape(-1)
    step = x.shape[1]
    sheet = np.stack([corner, corner + 1, corner + step], axis=1)
    for gap_m in (0.004, 0.014, 0.024):
        below = sheet[flat[sheet][:, 0, 0] < 0.15] + len(flat)
        points, faces = np.concatenate([flat, flat - [0.0, 0.0, gap_m]]), np.concatenate([sheet, below])
        middles, normals = points[faces].mean(axis=1), meshes.face_normals(points, faces)
        other = opposite_faces(SearchedMesh(points, faces), np.arange(len(sheet)), middles, normals)
        inner, alone = middles[: len(sheet), 0] < 0.12, middles[: len(sheet), 0] > 0.2
        assert (other[inner] >= len(sheet)).all() and (other[alone] == -1).all()
        assert np.abs(middles[other[inner]] - middles[: len(sheet)][inner])[:, :2].max() < 0.015
