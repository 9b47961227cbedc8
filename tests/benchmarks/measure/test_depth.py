"""How deep cloth is in the skin."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmarks.measure.depth import depths_mm

BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.1)


def test_the_deepest_vertex_counts():
    points = np.array([[0.0, 0.0, 0.095], [0.0, 0.07, 0.0], [0.2, 0.0, 0.0]])
    assert depths_mm(points, BALL.vertices, BALL.faces).max() == pytest.approx(30.0, abs=1.0)


def test_cloth_over_the_skin_is_not_deep():
    assert depths_mm(1.1 * BALL.vertices, BALL.vertices, BALL.faces).max() == 0.0


def test_what_is_turned_inside_out_is_no_skin():
    """Where a part of the skin is inside out within another, nearest faces say inside, and it is air."""
    pocket = 0.9 * BALL.vertices + [0.0, 0.0, 0.15]
    skin = np.concatenate([BALL.vertices, pocket])
    faces = np.concatenate([BALL.faces, BALL.faces[:, ::-1] + len(BALL.vertices)])
    assert depths_mm(np.array([[0.0, 0.0, 0.095]]), skin, faces).max() == 0.0
    assert depths_mm(np.array([[0.0, 0.0, -0.08]]), skin, faces).max() > 15.0
