"""Overlapping charts: which patches a vertex belongs to, with continuous weights, and the patch frames."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from drape.garment.cache import CHARTS_PER_VERTEX

RIDGE = 1e-4  # of a fit of jets; coordinates are scaled to one


@dataclass(frozen=True)
class ChartBlend:
    """The four charts of N vertices: ``patch`` (N, 4) int32, the patch of each chart, and ``weight`` (N, 4), its weight
    in the vertex. Rows of weights sum to one; a chart of weight 0 is not used."""

    patch: np.ndarray
    weight: np.ndarray


def rows_of_patches(patch: np.ndarray, count: int) -> list[np.ndarray]:
    """Returns for each patch from 0 to ``count`` - 1 the ascending rows of ``patch`` (n,) that hold its number. Rows
    with a negative number are in no list."""
    order = np.argsort(patch, kind="stable")
    bounds = np.searchsorted(patch[order], np.arange(count + 1))
    return [order[start:end] for start, end in pairwise(bounds)]


def ridge_fit(basis: np.ndarray, values: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Returns the coefficients (m, ...) by which the columns of ``basis`` (n, m) fit ``values`` (n, ...) best: weighted
    least squares with a small ridge. The weight of a row is the square of ``root`` (n,)."""
    a = basis * root[:, None]
    target = values * root.reshape(-1, *[1] * (values.ndim - 1))
    return np.linalg.solve(a.T @ a + RIDGE * np.eye(a.shape[1]), a.T @ target)


def cluster_centres(label: np.ndarray, vertices: np.ndarray, area: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns for each of K clusters its area-weighted centroid [m] (K, 3), and its member nearest to that, as a row
    (K,) of ``vertices``. ``label`` (N,) is the cluster of each vertex, ``area`` (N,) [m^2] its area."""
    count = int(label.max()) + 1
    mass = np.bincount(label, area, count)
    moment = np.stack([np.bincount(label, area * vertices[:, axis], count) for axis in range(3)], axis=1)
    centre = moment / mass[:, None]
    distance = np.linalg.norm(vertices - centre[label], axis=1)
    order = np.argsort(-distance, kind="stable")
    seed = np.zeros(count, dtype=int)
    seed[label[order]] = order  # the nearest member is written last
    return centre, seed


def blend_charts(graph: scipy.sparse.csr_matrix, seeds: np.ndarray, *, spacing_m: float) -> ChartBlend:
    """Returns the four geodesically nearest patches of each vertex and their weights.

    With d the distance to a patch's seed and d5 that to the fifth patch, ``w = max(0, 1 - (d / d5)^2)^2``, normalised.
    The weight is zero where the fourth and fifth patch trade places, so the blend is continuous over the surface.
    ``graph`` (N, N): edge lengths [m]. ``seeds`` (K,): the vertex of each patch. ``spacing_m``: the usual distance of
    seeds, in which the search begins.
    """
    piece = connected_components(graph, directed=False)[1]
    wanted = np.minimum(np.bincount(piece[seeds], minlength=int(piece.max()) + 1)[piece], CHARTS_PER_VERTEX + 1)
    distance, limit, asked = np.full((len(seeds), len(piece)), np.inf), 2.5 * spacing_m, np.ones(len(seeds), dtype=bool)
    while asked.any():
        distance[asked] = dijkstra(graph, directed=False, indices=seeds[asked], limit=limit)
        short = np.isfinite(distance).sum(axis=0) < wanted
        asked, limit = np.isin(piece[seeds], piece[short]), 2.0 * limit
    count = distance.shape[1]
    kept = min(CHARTS_PER_VERTEX + 1, len(seeds))
    nearest = np.argpartition(distance, kept - 1, axis=0)[:kept]
    order = np.argsort(np.take_along_axis(distance, nearest, axis=0), axis=0, kind="stable")
    ordered = np.take_along_axis(nearest, order, axis=0)
    d = np.take_along_axis(distance, ordered, axis=0)
    finite = np.isfinite(d)
    # Where no fifth patch exists the blend fades at a little beyond the farthest one.
    reach = np.where(finite, d, -np.inf).max(axis=0) * 1.25 + 1e-6
    fifth = np.where(finite[-1], d[-1], reach) if kept == CHARTS_PER_VERTEX + 1 else reach
    slots = min(CHARTS_PER_VERTEX, kept)
    ratio = np.where(finite[:slots], d[:slots] / np.maximum(fifth, 1e-9), 1.0)
    weight = np.maximum(0.0, 1.0 - ratio**2) ** 2
    weight[0] = np.maximum(weight[0], 1e-12)
    patch = np.zeros((count, CHARTS_PER_VERTEX), dtype=np.int32)
    full = np.zeros((count, CHARTS_PER_VERTEX))
    patch[:, :slots] = np.where(finite[:slots], ordered[:slots], ordered[:1]).T
    full[:, :slots] = weight.T
    return ChartBlend(patch, full / full.sum(axis=1, keepdims=True))


def patch_frames(label: np.ndarray, normals: np.ndarray, area: np.ndarray, bone_direction: np.ndarray) -> np.ndarray:
    """Returns the frames (K, 3, 3) of patches, in the frame of ``normals``: columns u axis, v axis, normal. The normal
    is the patch's mean normal, and the u axis its blended bone direction ``bone_direction`` (K, 3) laid into the
    tangent plane. Both vary smoothly over the body and carry no arbitrary sign, which lets one network serve partitions
    that it has never seen. Where bone and normal agree, u looks to the front, or up. Of each vertex: ``label`` (N,),
    its patch; ``normals`` (N, 3); ``area`` (N,)."""
    count = len(bone_direction)
    weighted = area[:, None] * normals
    mean = np.stack([np.bincount(label, weighted[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mass = np.bincount(label, area, count)[:, None]
    normal = np.where(length > 1e-3 * mass, mean / np.maximum(length, 1e-12), [[0.0, 0.0, 1.0]])
    along = bone_direction - np.sum(bone_direction * normal, axis=1, keepdims=True) * normal
    weak = np.linalg.norm(along, axis=1, keepdims=True) < 1e-2
    fallback = np.array([0.0, 0.0, 1.0]) - normal[:, 2:3] * normal  # towards the front of the body
    # Bone and normal both face the front (the tip of a shoe): upwards.
    upright = np.array([0.0, 1.0, 0.0]) - normal[:, 1:2] * normal
    fallback = np.where(np.linalg.norm(fallback, axis=1, keepdims=True) < 1e-2, upright, fallback)
    along = np.where(weak, fallback, along)
    u = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return np.stack([u, np.cross(normal, u), normal], axis=-1)
