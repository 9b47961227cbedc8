"""Which cloth is a sleeve: that near an arm which goes round it, and what hangs together with it up to the shoulder.

The side of a skirt that a hand hangs by is near the arm, but does not go round it and is far away along the cloth.
Capes and ponchos cover arms without going round them.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csgraph

from drape.body.skeleton import JOINT_NAMES
from drape.garment.wearer_fields import BONES, SLAB_M, Bones, bones_of, enclosed
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import nearest_vertices

ROUND_SHARE = 0.8  # share of the directions around a bone in which a sleeve has cloth
LOOKS_AWAY = -0.5  # cosine to the way from the bone: cloth that looks at the arm is the trunk's or an inner wall
CUFF_M = 0.03  # the last part of a sleeve, from which it is followed up
ARMHOLE_M = 0.1  # the last part of the way to the shoulder, where cloth is the arm's and the trunk's
LOOSE_M = 0.03  # a button this near to a sleeve is a part of it
SHOULDER = 3
OUTER_M, OUTER = 0.35, 0.77  # cloth that covers an arm lies this far out at most, within 40 degrees
INNER_M, INNER_SHARE, BESIDE_M = 0.5, 0.7, 0.025  # how far towards the trunk nothing lies; share of the way; width
# A mantle covers at least so many points of the arms, and of the upper arms, without a sleeve; over these so many at
# most are in sleeves.
OPEN_COUNT, UPPER_COUNT, SLEEVED_SHARE = 4, 2, 0.34
UPPER_POINTS = sum(count for name, count, _, start, _ in BONES if name.endswith("arm") and start.endswith("shoulder"))


def sleeve_of(vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Returns for each of ``vertices`` [m] (V, 3) a number (V,) int: 1 in the left sleeve, 2 in the right one,
    ``SHOULDER`` (3) at the upper ends of both, 0 elsewhere. The body inside has ``joints`` [m] (24, 3) and ``skin`` [m]
    (N, 3)."""
    bones = bones_of(joints, skin)
    nearest = enclosed(vertices, bones)[1]
    axis, way = bones.frames[nearest, 2], vertices - bones.at[nearest]
    along = np.einsum("vc,vc->v", way, axis)
    outward = way - along[:, None] * axis
    looks = np.einsum("vc,vc->v", meshes.vertex_normals(vertices, faces), outward)
    faces_away = looks > LOOKS_AWAY * np.linalg.norm(outward, axis=1)
    edges = meshes.unique_edges(faces)
    lengths = np.maximum(meshes.edge_lengths(vertices, edges), 1e-9)
    graph = mesh_graphs.edge_matrix(edges, lengths, len(vertices))
    sleeve = np.zeros(len(vertices), dtype=np.int64)
    for number, side in enumerate(("left", "right"), start=1):
        own = np.array(bones.part) == f"{side} arm"
        chain = np.concatenate([joints[[JOINT_NAMES.index(f"{side}_shoulder")]], bones.at[own]])
        place = np.zeros(len(own))
        place[own] = np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))
        from_shoulder = place[nearest] + along
        near = own[nearest] & faces_away
        piece = mesh_graphs.connected_components(faces[near[faces].all(axis=1)], len(vertices))
        for one in np.unique(piece[near]):
            cloth = np.flatnonzero(near & (piece == one))
            if len(cloth) < 3 or (enclosed(vertices[cloth], bones)[0] > ROUND_SHARE).mean() < 0.5:
                continue
            length = float(from_shoulder[cloth].max())
            cuff = cloth[from_shoulder[cloth] > length - CUFF_M]
            far = csgraph.dijkstra(graph, directed=False, indices=cuff, min_only=True, limit=length + CUFF_M)
            rest = np.where((far < np.inf) & (sleeve == 0), SHOULDER, sleeve)
            sleeve = np.where(far < length - ARMHOLE_M, number, rest)
    if sleeve.any():  # buttons are pieces of their own
        label = mesh_graphs.connected_components(faces, len(vertices))
        loose = ~np.isin(label, label[sleeve > 0])
        cloth = np.flatnonzero(~loose)
        away, near = nearest_vertices(vertices, vertices[cloth])
        beside = np.where(loose & (away < LOOSE_M), sleeve[cloth[near]], 0)
        for number in (1, 2, SHOULDER):  # a piece follows as a whole, so that a belt that an arm hangs by is not torn
            share = np.bincount(label, beside == number) / np.maximum(np.bincount(label), 1)
            sleeve[loose & (share[label] > 0.5)] = number
    return sleeve


def covers_arms(points: np.ndarray, bones: Bones) -> bool:
    """Returns whether cloth at ``points`` [m] (N, 3), at most 2 cm from each other, covers the arms of the body with
    ``bones`` without sleeves, as a cape does: it lies out from the arms, and not between them and the trunk."""
    arms = [number for number, part in enumerate(bones.part) if part.endswith("arm")]
    covered = np.array([_covered(points, bones, number) for number in arms])
    is_open, sleeved = (covered == [True, False]).all(axis=1), covered.all(axis=1).sum()
    upper = is_open[:UPPER_POINTS].sum()
    return bool(is_open.sum() >= OPEN_COUNT and upper >= UPPER_COUNT and sleeved <= SLEEVED_SHARE * is_open.sum())


def _covered(points: np.ndarray, bones: Bones, number: int) -> tuple[bool, bool]:
    """Whether cloth at ``points`` [m] (N, 3) lies out from a point on an arm's bone, and between it and the trunk."""
    at, axis = bones.at[number], bones.frames[number, 2]
    inward = bones.joints[0] - at
    inward -= (inward @ axis) * axis
    inward /= np.linalg.norm(inward)
    reach = min(INNER_M, INNER_SHARE * abs(at[0] - bones.joints[0, 0]) / max(abs(inward[0]), 1e-3))
    way = points - at
    along = way @ axis
    near = np.abs(along) < 0.5 * SLAB_M
    way, along = way[near], along[near]
    inside, away = way @ inward, np.linalg.norm(way - along[:, None] * axis, axis=1)
    beside = np.sqrt(np.maximum(away**2 - inside**2, 0.0))
    outside = (inside < -OUTER * away) & (away < OUTER_M)
    between = (inside > 0.0) & (inside < reach) & (beside < BESIDE_M)
    return bool(outside.any()), bool(between.any())
