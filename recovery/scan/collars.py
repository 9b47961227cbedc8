"""Cuts a collar off a garment, because no base has one: the garment ends at the neckline, where the neck begins.

A collar stands round the neck and may be folded over. Near the neck, what lies above the neckline of a plain shirt is
cut off: that is highest at the sides and lowest in front. What then lies loose on the shoulders is the collar's fall.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drape.body.skeleton import JOINT_NAMES
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import main_sheet, with_used_vertices
from drape.geometry import meshes

NECK_RADIUS_M = 0.13  # from the neck's axis; no collar's fold lies farther
AHEAD, BEHIND = 0.6, 0.2  # that a neckline falls from the sides of the neck, over the way forward and backward
RISE_M = 0.01  # of the neckline at the sides above the neck's joint: cloth lies off the skin


def without_collar(mesh: GarmentMesh, joints: np.ndarray) -> tuple[GarmentMesh, float]:
    """``mesh`` cut along the neck of a body with ``joints`` [m] (24, 3), and the share of its area that is gone."""
    neck, chest = (joints[JOINT_NAMES.index(name)] for name in ("neck", "spine3"))
    up = (neck - chest) / np.linalg.norm(neck - chest)
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    off = mesh.vertices - neck
    forward = off @ ahead
    height = off @ up + np.maximum(AHEAD * forward, -BEHIND * forward) - RISE_M
    away = np.linalg.norm(off - np.outer(off @ up, up), axis=1)
    before = meshes.face_areas(mesh.vertices, mesh.faces).sum()
    kept = main_sheet(below(mesh, np.minimum(height, NECK_RADIUS_M - away)))[0]
    gone = 1.0 - meshes.face_areas(kept.vertices, kept.faces).sum() / before
    return replace(kept, notes=mesh.notes), float(gone)


def below(mesh: GarmentMesh, height: np.ndarray) -> GarmentMesh:
    """``mesh``, without texture, where ``height`` (V,), taken as linear in every triangle, is not positive."""
    up = height > 0.0
    above = up[mesh.faces].sum(axis=1)
    vertices, faces, parent = [mesh.vertices], [mesh.faces[above == 0]], [np.flatnonzero(above == 0)]
    edges = meshes.unique_edges(mesh.faces)
    crossed = edges[up[edges[:, 0]] != up[edges[:, 1]]]
    h = np.abs(height[crossed])
    share = (h[:, 0] / h.sum(axis=1))[:, None]
    vertices.append((1.0 - share) * mesh.vertices[crossed[:, 0]] + share * mesh.vertices[crossed[:, 1]])
    count = len(mesh.vertices)
    key = np.sort(crossed, axis=1) @ [count, 1]
    order = np.argsort(key)

    def cut(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The new vertices on the edges from ``a`` to ``b`` (n,)."""
        wanted = np.minimum(a, b) * count + np.maximum(a, b)
        return count + order[np.searchsorted(key[order], wanted)]

    for number in (1, 2):
        mine = np.flatnonzero(above == number)
        corners = mesh.faces[mine]
        # The corner that is alone on its side comes first.
        alone = (up[corners] == (number == 1)).argmax(axis=1)
        a, b, c = (corners[np.arange(len(mine)), (alone + k) % 3] for k in range(3))
        ab, ac = cut(a, b), cut(a, c)
        new = [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)] if number == 1 else [np.stack([a, ab, ac], 1)]
        faces += new
        parent += [mine] * len(new)
    return with_used_vertices(
        replace(
            mesh,
            vertices=np.concatenate(vertices),
            faces=np.concatenate(faces),
            uv=np.zeros((0, 2)),
            uv_faces=np.zeros((0, 3), dtype=np.int64),
            face_material=mesh.face_material[np.concatenate(parent)],
        )
    )
