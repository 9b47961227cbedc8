"""Cloth that hangs: it keeps its lengths, sinks by its weight, and lies on what is below it."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.cloth.hanging import GAP_M, GRAVITY_M_S2, STEP_S, HangingCloth, HoldingSkin
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, round_tube

FAR = np.array([0.0, -5.0, 0.0])


def ball(radius_m: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
    turns = np.linspace(-1.5, 1.5, 41)
    return round_tube(radius_m * np.cos(turns), radius_m * np.sin(turns), 64)


def skin(vertices: np.ndarray, faces: np.ndarray) -> HoldingSkin:
    return HoldingSkin(vertices, faces, np.zeros(len(vertices)))


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """A level square of 60 cm, 17 cm over the middle of the ball."""
    flat, faces = grid(20, 20, cell_m=0.03)
    return flat[:, [0, 2, 1]] - [0.3, -0.17, 0.3], faces[:, ::-1]


def test_free_cloth_falls_as_a_whole():
    """A step without velocity is g h^2, and no vertex moves against another."""
    vertices, faces = sheet()
    fallen = HangingCloth(vertices, faces).hang(vertices, skin(ball()[0] + FAR, ball()[1]), 3)
    assert_allclose(
        fallen - vertices, np.tile([0.0, -3.0 * GRAVITY_M_S2 * STEP_S**2, 0.0], (len(vertices), 1)), atol=1e-9
    )


def test_a_sheet_on_a_ball_hangs_down_on_all_sides_unstretched_and_outside():
    vertices, faces = sheet()
    x = HangingCloth(vertices, faces).hang(vertices, skin(*ball()), 150)
    away = np.linalg.norm(x, axis=1)
    assert away.min() > 0.149
    middle = np.linalg.norm(vertices[:, [0, 2]], axis=1).argmin()
    assert 0.14 < x[middle, 1] < 0.15 + 2.0 * GAP_M
    corners = np.abs(vertices[:, [0, 2]]).min(axis=1) > 0.29
    assert x[corners, 1].max() < x[middle, 1] - 0.05
    edges = meshes.unique_edges(faces)
    stretch = meshes.edge_lengths(x, edges) / meshes.edge_lengths(vertices, edges) - 1.0
    assert np.quantile(np.abs(stretch), 0.95) < 0.08
    assert abs(meshes.face_areas(x, faces).sum() / 0.36 - 1.0) < 0.05
