"""The hem of a garment, and how low it hangs."""

from __future__ import annotations

import numpy as np

from drape.geometry import meshes

HEM_SHARE = 0.1  # of the garment's height, from below, in which a boundary is a hem


def hem_vertices(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Boundary vertices in the lowest tenth of the garment's height, ``rest`` (V, 3) [m]: of trousers both legs'.

    Empty where the mesh has no border.
    """
    border = np.unique(np.concatenate([np.zeros(0, np.int64), *meshes.boundary_loops(faces)]))
    low, high = rest[:, 1].min(), rest[:, 1].max()
    return border[rest[border, 1] <= low + HEM_SHARE * (high - low)]


def hang_mm(vertices: np.ndarray, skinned: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How much lower [mm] (F,) the hem of ``vertices`` (F, V, 3) is than that of the ``skinned`` garment (F, V, 3) [m].

    Vertically, y upwards, the mean along the hem at rest: every vertex counts by half of its border edges that lie in
    the hem. What is cut the same hangs lower in a cloth that gives more. NaN where there is no hem.
    """
    hem = hem_vertices(rest, faces)
    length_m = np.zeros(len(rest))
    for loop in meshes.boundary_loops(faces):
        after = np.roll(loop, -1)
        inside = np.isin(loop, hem) & np.isin(after, hem)
        half = 0.5 * np.linalg.norm(rest[after] - rest[loop], axis=1) * inside
        np.add.at(length_m, loop, half)
        np.add.at(length_m, after, half)
    if not length_m.any():
        return np.full(len(vertices), np.nan)
    lower_m = skinned[:, hem, 1].astype(np.float64) - vertices[:, hem, 1]
    return 1e3 * lower_m @ length_m[hem] / length_m[hem].sum()
