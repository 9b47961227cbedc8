"""Cloth that is turned in under itself: made sleeves, pleats and hems."""

import numpy as np
from scipy.spatial import KDTree

from drape.garment.facings import without_facings

AROUND = 24


def strip(profile: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a sheet: each row of ``profile`` (P, 2), two of its coordinates, at each of ``across``."""
    rows, columns = len(profile), len(across)
    points = np.array([[a, b, c] for a, b in profile for c in across])
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].reshape(-1)
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return points, np.concatenate([lower, upper])


def sleeve(turned_in_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A sleeve along x with a facing, the points of an arm in it, and which faces are the facing."""
    out, back = np.arange(0.0, 0.301, 0.015), np.arange(0.3, 0.3 - turned_in_m - 1e-9, -0.015)
    profile = np.concatenate([np.c_[out, np.full(len(out), 0.06)], np.c_[back, np.full(len(back), 0.055)]])
    points, faces = strip(profile, np.linspace(0.0, 2.0 * np.pi, AROUND + 1))
    inner = np.all(points[faces][..., 1] < 0.059, axis=1)
    faces = np.where(faces % (AROUND + 1) == AROUND, faces - AROUND, faces)  # the two ends of a ring are one
    turn, arm = np.linspace(0.0, 2.0 * np.pi, 40), np.linspace(0.0, 0.3, 40)
    skin = np.array([[x, 0.04 * np.cos(a), 0.04 * np.sin(a)] for x in arm for a in turn])
    x, radius, angle = points.T
    return np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=1), faces, skin, inner


def test_a_deep_facing_is_left_out_and_the_sleeve_stays():
    points, faces, skin, inner = sleeve(0.15)
    keep = without_facings(points, faces, KDTree(skin))
    assert keep[~inner].all()
    assert keep[inner].mean() < 0.15


def test_a_facing_is_found_however_faces_are_wound():
    points, faces, skin, inner = sleeve(0.15)
    faces[::3] = faces[::3, ::-1]
    keep = without_facings(points, faces, KDTree(skin))
    assert keep[~inner].all() and keep[inner].mean() < 0.15


def test_a_narrow_hem_stays():
    points, faces, skin, _ = sleeve(0.0)
    assert without_facings(points, faces, KDTree(skin)).all()


def test_a_pleat_stays_though_its_middle_lies_under_cloth():
    across = np.arange(0.0, 0.081, 0.01)
    x = np.concatenate([0.2 + 0.0 * across[:1], 0.2 + across, 0.28 - across, 0.2 + across, 0.28 + across[1:]])
    z = np.concatenate([[0.0], np.full(9, 0.0), np.full(9, -0.006), np.full(9, -0.012), np.full(8, -0.012)])
    points, faces = strip(np.c_[x, z], np.arange(0.0, 0.601, 0.02))
    y, x = np.meshgrid(np.arange(0.0, 0.61, 0.02), np.arange(0.1, 0.5, 0.02))
    skin = np.stack([x.reshape(-1), np.full(x.size, -0.05), y.reshape(-1)], axis=1)
    assert without_facings(points, faces, KDTree(skin)).all()


def test_a_lone_face_beside_cloth_wound_both_ways_does_not_end_it():
    points, faces, skin, inner = sleeve(0.15)
    faces[::3] = faces[::3, ::-1]
    far = np.array([[1.0, 0.0, 0.0], [1.1, 0.0, 0.0], [1.0, 0.1, 0.0]])
    keep = without_facings(
        np.concatenate([points, far]), np.concatenate([faces, [len(points) + np.arange(3)]]), KDTree(skin)
    )
    assert keep[-1] and keep[:-1][~inner].all()
