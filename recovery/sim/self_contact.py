"""Cloth that meets itself: springs between vertices and triangles, and between edges, that come too close.

Every near pair is a signed distance d = n . sum_i w_i x_i of four nodes, n constant during a step. It is pushed apart
by the energy k / 2 max(0, h - d)^2 while d is below the thickness h. A pair keeps the side that it has at the beginning
of a step: what has passed through stays through, so steps must be short.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch

from drape.geometry import mesh_graphs, meshes
from drape.geometry.triangle_pairs import pairs_within
from recovery.sim.linearised import SpringForces

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
        ring = (graph + scipy.sparse.identity(self.count, format="csr")).tocsr()
        ring.sort_indices()
        self._keys = np.repeat(np.arange(self.count), np.diff(ring.indptr)) * self.count + ring.indices

    def springs(self, x: np.ndarray) -> SpringForces:
        """The springs that push near pairs of nodes ``x`` [m] (V, 3) apart."""
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
        return SpringForces(torch.from_numpy(force), (gradient.T @ gradient).tocsc())

    def near(self, x: np.ndarray) -> Near:
        """Pairs below the thickness at ``x`` (V, 3)."""
        pairs, weights, ways = pairs_within(np.ascontiguousarray(x), self.faces, self.edges, self.thickness_m)
        gap = np.linalg.norm(ways, axis=1)
        is_triangle = np.arange(len(gap)) < pairs.triangles
        keep = gap > SMALLEST_GAP
        keep &= is_triangle | (weights != 0.0).all(axis=1)  # ends of edges belong to vertices over triangles
        keep &= ~np.where(is_triangle, self._joined(pairs.corner, 1), self._joined(pairs.corner, 2))
        return Near(pairs.corner[keep].astype(np.int64), weights[keep], ways[keep] / gap[keep, None], gap[keep])

    def _joined(self, nodes: np.ndarray, split: int) -> np.ndarray:
        """Whether any of the first ``split`` columns of ``nodes`` (n, 4) is any of the others or next to it."""
        joined = np.zeros(len(nodes), dtype=bool)
        for i in range(split):
            for j in range(split, 4):
                key = nodes[:, i].astype(np.int64) * self.count + nodes[:, j]
                place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
                joined |= self._keys[place] == key
        return joined
