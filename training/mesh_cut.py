"""Meshes cut along the zero line of a smooth field.

Vertices near the line are moved onto it, the other crossed triangles are split, so edges are clean.
"""

from __future__ import annotations

import numpy as np
import trimesh

from drape.geometry import meshes

SNAP_SHARE = 0.45  # a vertex moves onto the cut when the cut passes this near along an edge


def cut_mesh(
    vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, extra: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices [m] (n, 3), faces (f, 3) and rows of ``extra`` (n, C) of the largest connected piece of the mesh
    in which ``field`` (N,) is above 0, cut along its zero line. Rows at the cut are interpolated from ``extra`` (N, C).
    """
    vertices, field, extra = vertices.copy(), field.copy(), extra.copy()
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    a, b = edges[:, 0], edges[:, 1]
    crossing = field[a] * field[b] < 0
    a, b = a[crossing], b[crossing]
    t = field[a] / (field[a] - field[b])
    candidate = np.concatenate([np.stack([a, b], 1)[t < SNAP_SHARE], np.stack([b, a], 1)[t > 1 - SNAP_SHARE]])
    share = np.concatenate([t[t < SNAP_SHARE], 1 - t[t > 1 - SNAP_SHARE]])
    order = np.argsort(-share)  # the nearest crossing of a vertex is written last
    start, end, share = candidate[order, 0], candidate[order, 1], share[order, None]
    old_vertices, old_extra = vertices.copy(), extra.copy()
    vertices[start] = old_vertices[start] + share * (old_vertices[end] - old_vertices[start])
    extra[start] = old_extra[start] + share * (old_extra[end] - old_extra[start])
    field[start] = 0.0
    new_vertices, new_extra, new_of = list(vertices), list(extra), {}

    def crossing_vertex(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in new_of:
            s = field[key[0]] / (field[key[0]] - field[key[1]])
            new_of[key] = len(new_vertices)
            new_vertices.append(vertices[key[0]] + s * (vertices[key[1]] - vertices[key[0]]))
            new_extra.append(extra[key[0]] + s * (extra[key[1]] - extra[key[0]]))
        return new_of[key]

    sign = np.sign(field)[faces]
    inside = list(faces[(sign >= 0).all(axis=1) & (sign > 0).any(axis=1)])
    for face in faces[(sign > 0).any(axis=1) & (sign < 0).any(axis=1)]:
        polygon = []
        for i, j in ((face[0], face[1]), (face[1], face[2]), (face[2], face[0])):
            if field[i] >= 0:
                polygon.append(i)
            if field[i] * field[j] < 0:
                polygon.append(crossing_vertex(i, j))
        inside += [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, len(polygon) - 1)]
    return compact(np.asarray(new_vertices), np.asarray(inside), np.asarray(new_extra))


def compact(vertices: np.ndarray, faces: np.ndarray, extra: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns vertices [m] (n, 3), faces (f, 3) and rows of ``extra`` (n, C) of the largest connected piece."""
    pieces = trimesh.graph.connected_component_labels(trimesh.graph.face_adjacency(faces), node_count=len(faces))
    faces = faces[pieces == np.bincount(pieces).argmax()]
    used, renumbered = meshes.in_use(faces)
    return vertices[used], renumbered, extra[used]
