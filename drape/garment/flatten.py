"""One piece of cloth laid flat without a fold, near a plane that is given.

Tutte's embedding (1963) of a disc cannot fold; SLIM (Rabinovich et al. 2017) relaxes it in steps that keep that,
towards the projection onto the plane, so that places move only where they must. A piece that runs round a sleeve
or a leg is no disc: it is cut open first.
"""

from __future__ import annotations

from collections.abc import Iterator

import igl
import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from drape.garment.charts import ridge_fit
from drape.geometry import jets, mesh_graphs, meshes
from drape.geometry.symmetric import symmetric_factor

# Weights of the projection against the symmetric Dirichlet energy, and the steps of SLIM after which places are judged:
# those with the best fit of jets stay. More pull fits tighter creases and drapes worse, since places crowd along the
# fold (docs/decisions/0005-polyfit.md); steps beyond two fit no better. If the rim crosses itself, places nearer to
# Tutte's take over.
TIGHT, LOOSE = ((10.0, (2,)),), ((1.0, (1, 1, 1, 1, 1, 1)), (0.0, (1, 1, 1, 1, 1, 1)))
# Then places go back to the projection wherever it does not fold. Triangles keep this share of their area; the share of
# the way back changes by at most so much per patch scale along an edge.
RETURN_AREA, RETURN_SLOPE, RETURN_ROUNDS = 0.2, 1.0, 40
WORSE = 1.5  # largest misfit of places taken from the same cloth on another body, over their misfit there
RING_SHARE = 0.3  # a second rim this long, over the first, means that the piece runs around a limb
DENSE = 200  # up to so many unknowns a dense matrix is solved sooner than a sparse one
CUT_FLOOR = 0.02  # what a cut costs where the chart has no weight, so that cuts stay short


def rims_cross(uv: np.ndarray, triangles: np.ndarray) -> bool:
    """Returns whether two boundary edges of ``triangles`` (T, 3) cross in the plane, where their vertices are at ``uv``
    (n, 2). A disc with no triangle upside down covers no point of the plane twice unless its rim crosses itself."""
    return edges_cross(uv, meshes.boundary_edges(triangles))


def edges_cross(uv: np.ndarray, rim: np.ndarray) -> bool:
    """Returns whether two of the edges ``rim`` (E, 2) cross in the plane, where their vertices are at ``uv`` (n, 2).
    Edges that share a vertex do not cross."""
    start, along = uv[rim[:, 0]], uv[rim[:, 1]] - uv[rim[:, 0]]

    def side(points: np.ndarray) -> np.ndarray:
        """On which side of edge i point j lies (E, E)."""
        x, y = (points[:, axis] - start[:, axis, None] for axis in (0, 1))
        return along[:, :1] * y - along[:, 1:] * x

    parted = side(start) * side(uv[rim[:, 1]]) < 0.0
    one, other = rim[np.argwhere(parted & parted.T)].swapaxes(0, 1)
    joined = (one[:, :, None] == other[:, None, :]).any(axis=(1, 2))
    return not joined.all()


def lay_flat(
    points: np.ndarray, plane: np.ndarray, triangles: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Returns the rows (m,) of ``points`` (n, 3) that are kept, and their positions (m, 2) in the plane, where no two
    of ``triangles`` (T, 3) overlap. None where no disc is left to lay out. ``plane`` (n, 2): positions to stay near.
    ``weight`` (n,): the weight of each vertex in the chart. Only the largest piece is laid out; if that is no disc it
    is cut, where weights are small. Vertices of cuts are left out, and those at which parts of the piece only touch."""
    disc = _largest_piece(triangles)
    while len(disc):
        rims = meshes.boundary_loops(disc)
        lengths = [float(np.linalg.norm(points[rim] - points[np.roll(rim, -1)], axis=1).sum()) for rim in rims]
        order = np.argsort(lengths)[::-1]
        if not rims:
            return None  # closed: there is no rim to lay out
        if len(rims) == 1 or lengths[order[1]] <= RING_SHARE * lengths[order[0]]:
            holes = [rims[index] for index in order[1:]]
            return _flatten(points, plane, disc, weight, rims[order[0]], holes)
        cut = _cut(points, disc, weight, rims[order[1]], np.concatenate([rims[i] for i in order if i != order[1]]))
        disc = _largest_piece(disc[~np.isin(disc, cut).any(axis=1)])
    return None


def _cut(points: np.ndarray, disc: np.ndarray, weight: np.ndarray, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Vertices of the path from the rim ``start`` to one of ``ends`` along which the chart weighs least."""
    graph = mesh_graphs.edge_graph(points, disc).tocoo()
    cost = graph.data * (0.5 * (weight[graph.row] + weight[graph.col]) / weight.max() + CUT_FLOOR)
    priced = scipy.sparse.csr_matrix((cost, (graph.row, graph.col)), shape=graph.shape)
    distance, before, _ = dijkstra(priced, indices=start, min_only=True, return_predecessors=True)
    path = [int(ends[np.argmin(distance[ends])])]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return np.array(path)


def _flatten(
    points: np.ndarray,
    plane: np.ndarray,
    disc: np.ndarray,
    weight: np.ndarray,
    outer: np.ndarray,
    holes: list[np.ndarray],
) -> tuple[np.ndarray, np.ndarray] | None:
    """``lay_flat`` of the triangles ``disc`` with the rim ``outer`` and small ``holes``."""
    filled, hub = [disc], len(points)
    surface, target = [points], [plane]
    for hole in holes:  # closed by a fan, so that Tutte's theorem holds
        filled.append(np.stack([np.roll(hole, -1), hole, np.full(len(hole), hub)], axis=1))
        surface.append(points[hole].mean(axis=0, keepdims=True))
        target.append(plane[hole].mean(axis=0, keepdims=True))
        hub += 1
    used, mesh = np.unique(np.concatenate(filled), return_inverse=True)
    mesh = mesh.reshape(-1, 3)
    surface, target = np.concatenate(surface)[used], np.concatenate(target)[used]
    start = _tutte(surface, target, mesh, np.searchsorted(used, outer))
    if start is None:
        return None
    real = int(np.searchsorted(used, len(points)))
    inner = mesh[(mesh < real).all(axis=1)]
    rim = meshes.boundary_edges(inner)
    best, least = None, np.inf
    for ways in (TIGHT, LOOSE):
        for pull, steps in ways if best is None else ():
            for placed in _relaxed(surface, mesh, start, target[:real], pull, steps):
                if not np.isfinite(placed).all() or (meshes.signed_areas(placed, inner) <= 0.0).any():
                    break
                misfit = _misfit(placed, surface[:real], weight[used[:real]])
                if misfit < least and not edges_cross(placed, rim):
                    best, least = placed, misfit
    # A rim on a circle crosses nothing: Tutte's own places are the last resort.
    best = start[:real] if best is None else best
    return used[:real], _settled(best, target[:real], surface[:real], inner)


def lay_alike(
    placed: np.ndarray, before: np.ndarray, points: np.ndarray, triangles: np.ndarray, weight: np.ndarray
) -> np.ndarray | None:
    """Returns positions (n, 2) in the plane for ``points`` (n, 3), taken from ``before`` (n, 3): the same cloth
    elsewhere, which was laid at ``placed`` (n, 2). A point goes from ``placed`` to its projection as far as none of
    ``triangles`` (T, 3) folds. None where the cloth folds at ``placed`` already, as in caches made before charts were
    laid flat. None also where jets fit the result worse than ``WORSE`` times as they fit ``before``. ``weight`` (n,):
    the weights in the chart."""
    settled = _settled(placed, points[:, :2], points, triangles)
    folds = (meshes.signed_areas(settled, triangles) <= 0.0).any() or (
        settled is placed and rims_cross(placed, triangles)
    )
    return None if folds or _misfit(settled, points, weight) > WORSE * _misfit(placed, before, weight) else settled


def _settled(placed: np.ndarray, target: np.ndarray, surface: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """``placed`` (m, 2), where no triangle of ``surface`` (m, 3) folds, moved to ``target`` (m, 2) wherever none folds
    there either."""
    back = _returned(placed, target, surface, triangles)
    return placed if rims_cross(back, triangles) else back


def _returned(placed: np.ndarray, target: np.ndarray, surface: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """``placed`` (m, 2) moved to ``target`` (m, 2) where that does not fold, and part of the way near where it does.

    The network has learnt its motions over projections, so a place that need not differ from one should not.
    """
    least = RETURN_AREA * meshes.signed_areas(placed, triangles)
    edges = meshes.unique_edges(triangles)
    first, second = np.concatenate([edges, edges[:, ::-1]]).T
    slope = RETURN_SLOPE * np.linalg.norm(surface[first] - surface[second], axis=1)
    share = np.ones(len(placed))
    for _ in range(RETURN_ROUNDS):
        moved = placed + share[:, None] * (target - placed)
        moved = moved.astype(np.float32).astype(np.float64)  # the precision of caches
        bad = meshes.signed_areas(moved, triangles) <= least
        if not bad.any():
            return moved
        corners = np.unique(triangles[bad])
        share[corners] = np.where(share[corners] < 0.1, 0.0, 0.6 * share[corners])
        before = np.full_like(share, np.inf)
        while (share < before).any():  # no step along an edge is steeper than its slope
            before = share.copy()
            np.minimum.at(share, first, before[second] + slope)
    return placed


def _relaxed(
    surface: np.ndarray, mesh: np.ndarray, start: np.ndarray, target: np.ndarray, pull: float, steps: tuple[int, ...]
) -> Iterator[np.ndarray]:
    """Places (m, 2) of the first m points of ``surface``, pulled towards ``target`` (m, 2), after each of ``steps``."""
    bound = np.arange(len(target) if pull else 0, dtype=np.int32)
    data = igl.slim_precompute(
        np.asfortranarray(surface), np.asfortranarray(mesh.astype(np.int32)), np.asfortranarray(start),
        igl.MappingEnergyType.SYMMETRIC_DIRICHLET, bound, np.asfortranarray(target[bound]), pull,
    )  # fmt: skip
    for count in steps:
        # In the precision of caches: what is no fold here must be none there.
        yield np.array(igl.slim_solve(data, count), dtype=np.float32)[: len(target), :2].astype(np.float64)


def _misfit(uv: np.ndarray, points: np.ndarray, weight: np.ndarray) -> float:
    """The weighted sum of squares by which jets over ``uv`` (n, 2) miss ``points`` (n, 3)."""
    total = 0.0
    root = np.sqrt(weight)
    in_plane, height = points[:, :2] - uv, points[:, 2:]
    for order, values in ((jets.IN_PLANE_ORDER, in_plane), (jets.HEIGHT_ORDER, height)):
        basis = jets.basis(uv, order)
        left = values * root[:, None] - (basis * root[:, None]) @ ridge_fit(basis, values, root)
        total += float(np.sum(left**2))
    return total


def _largest_piece(triangles: np.ndarray) -> np.ndarray:
    """The largest piece of ``triangles`` joined along edges, without the corners by which parts only touch."""
    while len(triangles):
        halves = meshes.half_edges(triangles)[:, :2]
        (edge, uses), face = meshes.edges_of_halves(halves), np.arange(len(halves)) // 3
        links = scipy.sparse.coo_matrix(
            (np.ones(len(halves)), (face, len(triangles) + edge)), shape=(len(triangles) + len(uses),) * 2
        )
        piece = connected_components(links, directed=False)[1][: len(triangles)]
        largest = piece == np.bincount(piece).argmax()
        rim = halves[(uses[edge] == 1) & largest[face]]
        touching = np.flatnonzero(np.bincount(rim.reshape(-1)) > 2) if len(rim) else rim[:0, 0]
        triangles = triangles[largest]
        if not len(touching):
            break
        triangles = triangles[~np.isin(triangles, touching).any(axis=1)]
    return triangles


def _tutte(surface: np.ndarray, target: np.ndarray, mesh: np.ndarray, ring: np.ndarray) -> np.ndarray | None:
    """Places (n, 2): ``ring`` on a circle, every other vertex in the mean of its neighbours, turned to ``target``.

    None where a triangle is flat: the mesh is not a disc then.
    """
    count = len(surface)
    sides = np.linalg.norm(surface[ring] - surface[np.roll(ring, -1)], axis=1)
    angle = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(sides)[:-1]]) / sides.sum()
    first, second = (surface[mesh[:, k]] - surface[mesh[:, 0]] for k in (1, 2))
    area = 0.5 * np.linalg.norm(np.cross(first, second), axis=1).sum()
    places = np.zeros((count, 2))
    places[ring] = np.sqrt(area / np.pi) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = np.ones(count, dtype=bool)
    inner[ring] = False
    if inner.any():
        places[inner] = _means(meshes.unique_edges(mesh), inner, places)
    if not np.isfinite(places).all() or (meshes.signed_areas(places, mesh) <= 0.0).any():
        return None
    centre = places.mean(axis=0)
    u, _, vt = np.linalg.svd((places - centre).T @ (target - target.mean(axis=0)))
    turn = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return (places - centre) @ turn + target.mean(axis=0)


def _means(edges: np.ndarray, inner: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The places (m, 2) of ``inner`` (n,) vertices, each in the mean of its neighbours over ``edges`` (E, 2), between
    the ``places`` (n, 2) of the others."""
    number = np.cumsum(inner) - 1
    one, other = np.concatenate([edges, edges[:, ::-1]]).T
    one, other = one[inner[one]], other[inner[one]]
    count, near = int(inner.sum()), inner[other]
    row, every = number[one], np.arange(count)
    entries = np.concatenate([np.bincount(row, minlength=count), np.full(int(near.sum()), -1.0)])
    index = np.concatenate([every, row[near]]), np.concatenate([every, number[other[near]]])
    ends = places[other[~near]]
    pulled = np.stack([np.bincount(row[~near], axis, count) for axis in ends.T], axis=1)
    if count <= DENSE:
        dense = np.zeros((count, count))
        dense[index] = entries
        return np.linalg.solve(dense, pulled)
    return symmetric_factor(scipy.sparse.csc_matrix((entries, index), shape=(count, count))).solve(pulled)
