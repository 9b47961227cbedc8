"""Points drawn at random from triangles."""

from __future__ import annotations

import numpy as np

from drape.geometry import meshes


def draw_points(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int | np.random.Generator) -> np.ndarray:
    """Returns random points [m] (``count``, 3) on the triangles, evenly by area; ``seed``, or a generator, decides
    which."""
    rng = np.random.default_rng(seed)
    areas = meshes.face_areas(vertices, faces)
    return within(vertices[faces[rng.choice(len(faces), size=count, p=areas / areas.sum())]], rng)


def within(corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns a random point (N, 3) in each of the triangles ``corners`` (N, 3, 3), evenly by area."""
    root, share = np.sqrt(rng.random(len(corners))), rng.random(len(corners))
    weights = np.stack([1.0 - root, root * (1.0 - share), root * share], axis=1)
    return np.einsum("nk,nkc->nc", weights, corners)
