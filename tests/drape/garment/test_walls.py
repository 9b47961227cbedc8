"""Of cloth drawn with a thickness one side stays, in armpits too, where four layers lie near each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.body.assets import load_body
from drape.garment.registration import posed_by
from drape.garment.walls import outer_sides
from drape.garment.wearer_fields import known_parameters
from drape.geometry import meshes
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
