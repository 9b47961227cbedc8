"""Closed ends of sleeves, legs and hems, as characters for games have them: discs inside a tube, behind its rim.

Hands and legs go through them, so they are no cloth that could be worn.
"""

from __future__ import annotations

import numpy as np

from drape.geometry import mesh_graphs, meshes

SHARP = 0.5  # cosine between faces beside the edges of a rim
BENT = 0.3  # most mean cosine round a cap, which lies across its tube or goes back into it
ROUND = (0.4, 2.5)  # a cap's area over that of a circle as long as its rim
LEAST_FACES = 6
MOST_SHARE = 0.15  # of the area of its piece
APART = 0.25  # of the extent: a sleeve's cap has another so far away; a shoe keeps its soles, and a hat its crown
RIM_SHARE = 0.15  # of the extent: a shorter rim lets no hand through


def without_caps(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which ``faces`` (F,) of the mesh with ``points`` (N, 3) are not of a cap."""
    areas = meshes.face_areas(points, faces)
    piece = mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]
    label, likely = _likely_caps(points, faces, areas, piece)
    keep, extent = np.ones(len(faces), dtype=bool), float(np.ptp(points[faces], axis=(0, 1)).max())
    caps: list[tuple[int, int, np.ndarray]] = []
    for number in likely:
        own = label == number
        rim = _rim_of_disc(points, faces[own])
        length = float(np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1).sum())
        area = float(areas[own].sum())
        circle = length**2 / (4.0 * np.pi)
        if length > RIM_SHARE * extent and ROUND[0] * circle < area < ROUND[1] * circle:
            caps.append((number, piece[own][0], rim.mean(axis=0)))
    for number, home, middle in caps:
        others = [other for _, whose, other in caps if whose == home]
        keep[label == number] = max(float(np.linalg.norm(middle - other)) for other in others) < APART * extent
    return keep


def _likely_caps(
    points: np.ndarray, faces: np.ndarray, areas: np.ndarray, piece: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The smooth part (F,) of each face, and the numbers of those that are small, have a sharp edge all round, and go
    across or back there; ``areas`` (F,) of the faces, and the ``piece`` (F,) of each."""
    pairs = meshes.edge_pairs(faces)
    cosine = meshes.edge_cosines(pairs, meshes.face_normals(points, faces))
    a, b = pairs[1] // 3, pairs[2] // 3
    smooth = cosine > SHARP
    label = mesh_graphs.joined_parts(len(faces), a[smooth], b[smooth])
    count = int(label.max()) + 1
    crossed = label[a] != label[b]
    ends = np.concatenate([label[a][crossed], label[b][crossed]])
    rims = np.bincount(ends, minlength=count)
    bend = np.bincount(ends, np.tile(cosine[crossed], 2), minlength=count) / np.maximum(rims, 1)
    inner, size = (np.bincount(each, minlength=count) for each in (label[a][~crossed], label))
    whole = np.bincount(piece, areas)[piece[np.unique(label, return_index=True)[1]]]
    closed = 3 * size == 2 * inner + rims  # no edge of it is open
    small = np.bincount(label, areas) < MOST_SHARE * whole
    return label, np.flatnonzero(closed & small & (size >= LEAST_FACES) & (bend < BENT))


def _rim_of_disc(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The rim (n, 3) of ``faces`` if they are a disc, else none (0, 3)."""
    loops = meshes.boundary_loops(faces)
    euler = len(np.unique(faces)) - len(meshes.unique_edges(faces)) + len(faces)
    return points[loops[0]] if len(loops) == 1 and euler == 1 else np.zeros((0, 3))
