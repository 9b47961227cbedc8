"""Cloth that meets itself: springs between vertices and triangles, and between edges, that come too close.

Every near pair is a signed distance d = n . sum_i w_i x_i of four nodes, n constant during a step. It is pushed apart
by the energy k / 2 max(0, h - d)^2 while d is below the thickness h. The side on which a pair lies is the one it is on
at the beginning of a step: what has passed through stays through, so steps must be short.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch
from scipy.spatial import KDTree

from drape.geometry import mesh_graphs, meshes
from recovery.sim.linearised import Springs

SMALLEST_GAP = 1e-9


class Near(NamedTuple):
    """Pairs of four ``nodes`` (n, 4) with ``weights`` (n, 4) and unit ``normals`` (n, 3); ``gap_m`` (n,) along them."""

    nodes: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gap_m: np.ndarray


class SelfContact:
    """Repulsion of cloth of ``faces`` (F, 3) from itself below ``thickness_m``; ``fixed`` (V,) nodes do not move.

    Elements that share a node, or whose nodes are joined by an edge, are never a pair.
    """

    def __init__(
        self, faces: np.ndarray, fixed: np.ndarray, *, thickness_m: float = 0.003, stiffness_n_per_m: float = 100.0
    ) -> None:
        self.faces, self.edges = faces, meshes.unique_edges(faces)
        self.thickness_m, self.stiffness = thickness_m, stiffness_n_per_m
        self.count = len(fixed)
        self._free = ~np.repeat(fixed, 3)
        graph = mesh_graphs.adjacency(faces, self.count)
        self._ring = (graph + scipy.sparse.identity(self.count, format="csr")).tocsr()
        self._ring.sort_indices()
        rows = np.repeat(np.arange(self.count), np.diff(self._ring.indptr))
        self._keys = rows * self.count + self._ring.indices

    def springs(self, x: np.ndarray) -> Springs:
        """What pushes the near pairs of nodes ``x`` [m] (V, 3) apart."""
        near = self.near(x)
        push = self.stiffness * (self.thickness_m - near.gap_m)
        along = near.weights[:, :, None] * near.normals[:, None]  # (n, 4, 3): derivative of the gap
        force = np.zeros((self.count, 3))
        np.add.at(force, near.nodes, push[:, None, None] * along)
        force.reshape(-1)[~self._free] = 0.0
        index = (3 * near.nodes[:, :, None] + np.arange(3)).reshape(-1)
        rows = np.repeat(np.arange(len(near.gap_m)), 12)
        values = (np.sqrt(self.stiffness) * along).reshape(-1) * self._free[index]
        gradient = scipy.sparse.csr_matrix((values, (rows, index)), shape=(len(near.gap_m), 3 * self.count))
        return Springs(torch.from_numpy(force), (gradient.T @ gradient).tocsc())

    def near(self, x: np.ndarray) -> Near:
        """Pairs below the thickness at ``x`` (V, 3)."""
        parts = [self._corners(x), self._sides(x)]
        return Near(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def _corners(self, x: np.ndarray) -> Near:
        """Vertices over triangles."""
        corners = x[self.faces]
        middle = corners.mean(axis=1)
        reach = float(np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1).max())
        vertex, face = _within(x, middle, reach + self.thickness_m)
        apart = ~self._joined(vertex[:, None], self.faces[face])
        vertex, face = vertex[apart], face[apart]
        a, b, c = (x[self.faces[face, k]] for k in range(3))
        weights = _on_triangle(x[vertex], a, b, c)
        nodes = np.column_stack([vertex, self.faces[face]])
        return self._kept(x, nodes, np.column_stack([np.ones(len(vertex)), -weights]))

    def _sides(self, x: np.ndarray) -> Near:
        """Edges over edges."""
        start, end = x[self.edges[:, 0]], x[self.edges[:, 1]]
        middle = 0.5 * (start + end)
        reach = float(np.linalg.norm(end - start, axis=1).max())
        first, second = _within(middle, middle, reach + self.thickness_m)
        length = np.linalg.norm(end - start, axis=1)
        far = np.linalg.norm(middle[first] - middle[second], axis=1)
        once = (first < second) & (far < 0.5 * (length[first] + length[second]) + self.thickness_m)
        first, second = first[once], second[once]
        apart = ~self._joined(self.edges[first], self.edges[second])
        first, second = first[apart], second[apart]
        s, t = _on_segments(start[first], end[first], start[second], end[second])
        inner = (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)  # ends belong to vertices over triangles
        first, second, s, t = first[inner], second[inner], s[inner], t[inner]
        nodes = np.column_stack([self.edges[first], self.edges[second]])
        return self._kept(x, nodes, np.column_stack([1.0 - s, s, t - 1.0, -t]))

    def _kept(self, x: np.ndarray, nodes: np.ndarray, weights: np.ndarray) -> Near:
        apart = np.einsum("nk,nkc->nc", weights, x[nodes])
        gap = np.linalg.norm(apart, axis=1)
        keep = (gap < self.thickness_m) & (gap > SMALLEST_GAP)
        return Near(nodes[keep], weights[keep], apart[keep] / gap[keep, None], gap[keep])

    def _joined(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Whether any node of ``first`` (n, A) is the same as or next to any of ``second`` (n, B)."""
        joined = np.zeros(len(first), dtype=bool)
        for i in range(first.shape[1]):
            for j in range(second.shape[1]):
                key = first[:, i] * self.count + second[:, j]
                place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
                joined |= self._keys[place] == key
        return joined


def _within(points: np.ndarray, others: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n,) of points and of others no farther apart than ``radius`` [m]."""
    pairs = KDTree(points).sparse_distance_matrix(KDTree(others), radius, output_type="ndarray")
    return pairs["i"].astype(np.int64), pairs["j"].astype(np.int64)


def _on_triangle(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n, 3) of the points of triangles nearest to ``p`` (n, 3)."""
    first, second, off = b - a, c - a, p - a
    aa, ab, bb = ((u * v).sum(axis=1) for u, v in ((first, first), (first, second), (second, second)))
    d, e = (off * first).sum(axis=1), (off * second).sum(axis=1)
    det = np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = (bb * d - ab * e) / det, (aa * e - ab * d) / det
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    outside = weights.min(axis=1) < 0.0
    if outside.any():
        best = np.full(int(outside.sum()), np.inf)
        found = np.zeros((len(best), 3))
        q = p[outside]
        for i, (start, end) in enumerate(((a, b), (b, c), (c, a))):
            start, along = start[outside], (end - start)[outside]
            share = np.clip(((q - start) * along).sum(1) / np.maximum((along * along).sum(1), 1e-30), 0.0, 1.0)
            far = np.linalg.norm(q - start - share[:, None] * along, axis=1)
            nearer = far < best
            row = np.zeros((len(best), 3))
            row[:, i], row[:, (i + 1) % 3] = 1.0 - share, share
            found[nearer], best = row[nearer], np.minimum(best, far)
        weights[outside] = found
    return weights


def _on_segments(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (n,) along a-b and c-d of the nearest points of both segments."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    det = uu * vv - uv * uv
    s = np.clip(np.where(det > 1e-12 * uu * vv, (uv * vw - vv * uw) / np.maximum(det, 1e-30), 0.5), 0.0, 1.0)
    t = np.clip((uv * s + vw) / np.maximum(vv, 1e-30), 0.0, 1.0)
    s = np.clip((uv * t - uw) / np.maximum(uu, 1e-30), 0.0, 1.0)
    return s, t
