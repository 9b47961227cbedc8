"""Fold-over of charts: counted triangle by triangle, and taken out.

A chart is a bijection where every one of its triangles keeps its orientation in (u, v) and its rim does not cross
itself. A projection onto the patch's plane folds where the cloth turns past the plane's normal: at armholes,
crotches, lapels. Such a chart is laid flat instead (``drape.garment.flatten``). What the in-plane polynomials of
order two cannot follow stays in the residual, as in other charts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import dijkstra

from drape.forked import each
from drape.garment.cache import Atlas
from drape.garment.charts import ChartBlend, ridge_fit, rows_of_patches
from drape.garment.flatten import edges_cross, lay_alike, lay_flat
from drape.geometry import jets, mesh_graphs
from drape.geometry.meshes import boundary_edges, signed_areas

TRIM, TRIM_ROUNDS = 0.85, 12  # a chart that cannot be laid flat is made smaller by this factor, so often
FADE = 0.35  # patch scales from a vertex that leaves a chart over which the chart's weight comes back


def chart_triangles(blend: ChartBlend, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the triangles of all charts: the patch (T,) of each, and its corners (T, 3). A corner is the number
    ``4 * vertex + slot``; the slot says which of the vertex's four charts it is. A face of ``faces`` (F, 3) is a
    triangle of each chart in which all its three vertices have a weight."""
    slots = blend.patch.shape[1]
    used = blend.weight > 0
    owners, corners = [], []
    for slot in range(slots):
        patch = blend.patch[faces[:, 0], slot]
        inside = used[faces[:, 0], slot]
        rows = [faces[:, 0] * slots + slot]
        for k in (1, 2):
            same = (blend.patch[faces[:, k]] == patch[:, None]) & used[faces[:, k]]
            inside = inside & same.any(axis=1)
            rows.append(faces[:, k] * slots + same.argmax(axis=1))
        owners.append(patch[inside])
        corners.append(np.stack(rows, axis=1)[inside])
    return np.concatenate(owners), np.concatenate(corners)


def folded_triangles(blend: ChartBlend, uv: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns for each patch the number (K,) int of its chart's triangles that lie upside down or edge-on. ``uv`` (N,
    4, 2): the (u, v) of each vertex in its four charts, which are those of ``blend``."""
    owner, corners = chart_triangles(blend, faces)
    folded = signed_areas(uv.reshape(-1, 2).astype(np.float64), corners) <= 0.0
    return np.bincount(owner[folded], minlength=int(blend.patch.max()) + 1)


def folded_charts(blend: ChartBlend, uv: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns bool (K,), True for patches whose chart is no bijection: a triangle lies upside down or edge-on, or the
    rim crosses itself. ``uv`` (N, 4, 2) as in ``folded_triangles``."""
    owner, corners = chart_triangles(blend, faces)
    places, count = uv.reshape(-1, 2).astype(np.float64), int(blend.patch.max()) + 1
    folded = np.bincount(owner[signed_areas(places, corners) <= 0.0], minlength=count) > 0
    rim = boundary_edges(corners)  # the rims of all charts, since no two of them share an entry
    rows = rows_of_patches(blend.patch.reshape(-1)[rim[:, 0]], count)
    for k in np.flatnonzero(~folded):
        folded[k] = edges_cross(places, rim[rows[k]])
    return folded


@dataclass(frozen=True)
class Flattened:
    """Charts of N vertices in K patches, none of them folded over. ``blend``: the four patches of each vertex, and its
    weights in them. ``uv`` (N, 4, 2): the (u, v) of each vertex in these four [patch scales]. ``unfolded`` (K,) bool:
    True where the patch's chart was laid flat, False where it is the projection onto the patch's plane."""

    blend: ChartBlend
    uv: np.ndarray
    unfolded: np.ndarray


def without_folds(
    blend: ChartBlend, local: np.ndarray, scale: np.ndarray, faces: np.ndarray, like: Atlas | None = None
) -> Flattened:
    """Returns the charts of ``blend`` without fold-over. A chart is the projection onto the plane of its patch; where
    that folds, the chart is laid flat. ``local`` [m] (N, 4, 3): the position of each vertex in the frames of its four
    patches. ``scale`` (K,) [m per unit of u, v]. ``faces`` (F, 3).

    A chart that is laid flat may lose vertices (``lay_flat``). Around them its weight fades to zero, so that the blend
    stays continuous. A vertex that would lose all its charts keeps the heaviest. ``like``: an atlas with the same
    ``blend``, the same cloth on another body. A chart is then laid as there, unless ``lay_alike`` returns None for it.
    """
    slots = blend.patch.shape[1]
    uv = local[..., :2] / scale[blend.patch][..., None]
    count = len(scale)
    folded = np.zeros(count, dtype=bool)
    found = folded_charts(blend, uv.astype(np.float32), faces)  # the precision of caches
    folded[: len(found)] = found
    if not folded.any():
        return Flattened(blend, uv, folded)
    owner, corners = chart_triangles(blend, faces)
    rows = rows_of_patches(owner, count)
    flat_uv, weight = uv.reshape(-1, 2).copy(), blend.weight.reshape(-1).copy()
    places = local.reshape(-1, 3)
    if like is not None:
        known = like.chart_uv.reshape(-1, 2).astype(np.float64), like.chart_local().reshape(-1, 3)

    def laid(k: int) -> tuple[np.ndarray, np.ndarray | None, tuple[np.ndarray, np.ndarray, np.ndarray] | None]:
        """The entries of chart ``k``, and their places as in ``like``, or else what ``_chart`` makes of them."""
        entries, triangles = np.unique(corners[rows[k]], return_inverse=True)
        points, triangles = places[entries] / scale[k], triangles.reshape(-1, 3)
        if like is not None:
            before = known[1][entries] / like.patch_scale[k]
            alike = lay_alike(known[0][entries], before, points, triangles, weight[entries])
            if alike is not None:
                return entries, alike, None
        return entries, None, _chart(points, triangles, weight[entries])

    numbers = np.flatnonzero(folded)
    for k, (entries, alike, chart) in zip(numbers, each(laid, numbers.tolist()), strict=True):
        if chart is None:
            flat_uv[entries] = alike
            continue
        kept, placed, fade = chart
        flat_uv[entries[kept]] = placed
        weight[entries] *= fade
        # Entries of this patch that are in no triangle of it say nothing of the surface: they go too.
        lone = (blend.patch.reshape(-1) == k) & (weight > 0)
        lone[entries] = False
        weight[lone] = 0.0
    weight = _keep_one(weight.reshape(-1, slots), blend.weight)
    return Flattened(replace(blend, weight=weight), flat_uv.reshape(uv.shape), folded)


def _chart(points: np.ndarray, triangles: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (m,) of one chart's ``points`` (n, 3) that stay, their places (m, 2), and factors (n,) of the weights."""
    graph = mesh_graphs.edge_graph(points, triangles)
    reach = dijkstra(graph, directed=False, indices=[int(np.argmax(weight))])[0]
    limit = float(reach[np.isfinite(reach)].max()) * 1.0001
    kept, placed = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    for _ in range(TRIM_ROUNDS):
        inside = triangles[(reach[triangles] < limit).all(axis=1)]
        laid = lay_flat(points, points[:, :2], inside, weight)
        if laid is not None:
            kept, placed = laid
            break
        limit *= TRIM
    left = np.ones(len(points), dtype=bool)
    left[kept] = False
    if not left.any():
        return kept, placed, np.ones(len(points))
    away = np.minimum(dijkstra(graph, directed=False, indices=np.flatnonzero(left), min_only=True) / FADE, 1.0)
    return kept, placed, away**2 * (3.0 - 2.0 * away)


def _keep_one(weight: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Rows that sum to one; a vertex that no chart would keep keeps its heaviest."""
    empty = weight.sum(axis=1) < 1e-9
    weight = weight.copy()
    weight[empty] = 0.0
    weight[np.flatnonzero(empty), before[empty].argmax(axis=1)] = 1.0
    return weight / weight.sum(axis=1, keepdims=True)


def fit_planes(jet: np.ndarray, flattened: Flattened, local: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Returns ``jet`` (K, 27) with in-plane polynomials that follow ``local`` [m] (N, 4, 3), vertices in the patches'
    frames, in the charts that were laid flat; other patches keep theirs. ``scale`` (K,) [m per unit of u, v]. It is
    ridge least squares on the departure from the identity, weighed as the blend does."""
    jet = jet.copy()
    patch, weight = flattened.blend.patch, flattened.blend.weight
    for k in np.flatnonzero(flattened.unfolded):
        row, slot = np.nonzero((patch == k) & (weight > 0))
        if not len(row):
            continue
        uv = flattened.uv[row, slot]
        departure = local[row, slot, :2] / scale[k] - uv
        fitted = ridge_fit(jets.basis(uv, jets.IN_PLANE_ORDER), departure, np.sqrt(weight[row, slot]))
        jet[k, : 2 * jets.IN_PLANE_COUNT] += fitted.T.reshape(-1)
    return jet
