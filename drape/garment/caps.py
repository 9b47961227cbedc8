"""Closed ends of sleeves, legs and hems, as characters for games have them: discs inside a tube, behind its rim.

Hands and legs go through them, so they are no cloth to wear. Those with a sharp rim are told by it, pits with
a round one by the bones of a wearer.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from drape.garment.contours import bone_chains, crossed
from drape.garment.mesh_checks import consistent_turn
from drape.geometry import mesh_graphs, meshes

SHARP = 0.5  # cosine between faces beside the edges of a rim
BENT = 0.3  # the mean cosine around a cap is less: it lies across its tube or goes back into it
ROUND = (0.4, 2.5)  # a cap's area over that of a circle as long as its rim
LEAST_FACES = 6
MOST_SHARE = 0.15  # a cap has at most this share of its piece's area
APART = 0.25  # a cap has another this far away, over the extent; so a shoe keeps its sole, and a hat its crown
# A pit has at most PIT_SHARE of its piece's area. The cosine between the bone and the normal of its floor is above
# ACROSS. Its walls look towards the bone: their cosine to the direction away from it is below LOOKS_IN. Which way
# normals look is known from the tube around the bone, cloth within about NEAR_M, which looks away.
PIT_SHARE, ACROSS, LOOKS_IN, NEAR_M = 0.3, 0.5, 0.15, 0.1
EVEN = 0.3  # least distance of a pit's rim from the bone, over the largest
RIM_SHARE = 0.15  # a rim shorter than this share of the extent lets no hand through


def without_caps(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns bool (F,), False for those of ``faces`` (F, 3) that belong to a cap. ``points`` [m] (N, 3) are the mesh's
    vertices. A cap is a disc with a sharp rim that closes a sleeve, a leg or a hem; the same piece has another one far
    from it."""
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


def without_pits(points: np.ndarray, faces: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Returns bool (F,), False for those of ``faces`` (F, 3) that belong to a pit. ``points`` [m] (N, 3) are the mesh's
    vertices. A pit closes a tube inside: a floor that a bone between ``joints`` [m] (24, 3) goes through, and the walls
    around it that look towards the bone. Raises ``MeshError`` for a one-sided surface."""
    keep, piece = np.ones(len(faces), dtype=bool), mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]
    areas, middles = meshes.face_areas(points, faces), points[faces].mean(axis=1)
    wound, (_, first, second) = np.where(consistent_turn(faces), -1.0, 1.0), meshes.edge_pairs(faces)
    normals = wound[:, None] * meshes.face_normals(points, faces)
    border, corners = np.unique(meshes.boundary_edges(faces)), points[faces].transpose(1, 0, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    for start, end in (pair for chain, _ in bone_chains(joints).values() for pair in pairwise(chain)):
        axis = (end - start) / np.linalg.norm(end - start)
        near = np.flatnonzero(((low <= np.maximum(start, end)) & (high >= np.minimum(start, end))).all(axis=1))
        for face in near[(crossed(start, end, *corners[:, near]) != 0) & (np.abs(normals[near] @ axis) > ACROSS)]:
            own, outward = piece == piece[face], middles - start
            outward = outward - (outward @ axis)[:, None] * axis
            away = np.maximum(np.linalg.norm(outward, axis=1), 1e-9)
            looks = np.einsum("fc,fc->f", normals, outward) / away
            looks *= np.sign((own * areas * looks / (away**2 + NEAR_M**2)).sum())  # the tube itself looks away
            inner = own & ((looks < LOOKS_IN) | (np.arange(len(faces)) == face))
            label = _parts(inner, first // 3, second // 3)
            pit = inner & (label == label[face])
            label = _parts(own & ~pit, first // 3, second // 3)  # all but the largest part are islands in it
            outside = np.bincount(label, areas * (own & ~pit)).argmax()
            pit = own & (pit | (label != outside))
            rim = meshes.boundary_loops(faces[pit])
            far = np.linalg.norm(np.cross(points[rim[0]] - start, axis), axis=1) if len(rim) == 1 else np.zeros(1)
            small = areas[pit].sum() < PIT_SHARE * areas[own].sum() and not np.isin(faces[pit], border).any()
            if small and far.min() > EVEN * far.max():  # a wall that a bone goes through aslant has its rim there
                keep &= ~pit
    return keep


def _parts(chosen: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The part (F,) of the ``chosen`` faces (F,) that each is of; ``first`` and ``second`` (P,) share an edge."""
    both = chosen[first] & chosen[second]
    return mesh_graphs.joined_parts(len(chosen), first[both], second[both])


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
