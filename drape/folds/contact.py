"""Contact with the posed skin: the nearest sample, walked to from the frame before, and a plane blended from it and its
neighbours.

A frame moves a vertex by less than a few samples, so a walk over their graph, always to the nearest neighbour, ends at
the nearest one of the part that the vertex was at: a sleeve stays with its arm where that touches the trunk. A vertex
without a past starts at the sample that is nearest at rest.

One tangent plane for all that lies nearest to a sample would give a limb facets. The planes of sample and neighbours are
therefore blended with weights that end at the spacing. Over a sphere a point is off the tangent plane of a sample by what
the surface falls away meanwhile, but a chord stands at right angles to the mean of the normals at its ends: distances
are measured along the mean of the sample's normal and the blended one, and have no ripple then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.folds.sheet import LANES
from drape.folds.sweeps import PLANES
from drape.push.samples import FACING, Samples
from drape.solver.compiled import kernel

NEIGHBOURS = 8
CANDIDATES = 24  # of which those that face another way are left out


class SkinGraph(NamedTuple):
    """``neighbour`` (S, 8) of every sample, itself where there are fewer; ``reach_m2`` (S,): the spacing squared."""

    neighbour: np.ndarray
    reach_m2: np.ndarray


def skin_graph(skin: Samples) -> SkinGraph:
    """The graph of the samples of ``skin`` by their distance at rest."""
    _, near = KDTree(skin.point).query(skin.point, k=min(CANDIDATES, skin.count))
    facing = np.einsum("snc,sc->sn", skin.normal[near], skin.normal) > FACING
    own = np.arange(skin.count)[:, None]
    order = np.argsort(~facing | (near == own), axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = np.where(np.take_along_axis(facing, order, axis=1), np.take_along_axis(near, order, axis=1), own)
    return SkinGraph(np.ascontiguousarray(chosen, np.int32), skin.spacing_m**2)


def nearest_at_rest(vertices: np.ndarray, skin: Samples) -> np.ndarray:
    """The sample (V,) int32 nearest to each of ``vertices`` [m] (V, 3), both at rest."""
    return KDTree(skin.point).query(vertices)[1].astype(np.int32)


@kernel
def touch(x, skin, graph, k, index, planes):
    """Moves ``index`` (P,) on to the samples nearest to ``x`` [m] (P, 3), and writes their blended ``planes``.

    ``skin`` (S, 8): rows of ``drape.push.samples.sample_table``. ``planes`` flat, six rows a block: the foot of x, and
    the normal. ``k``: numbers in the type of x.
    """
    for v in range(len(x)):
        a, b, c = x[v, 0], x[v, 1], x[v, 2]
        own = index[v]
        nearest = (a - skin[own, 0]) ** 2 + (b - skin[own, 1]) ** 2 + (c - skin[own, 2]) ** 2
        moved = True
        while moved:
            moved = False
            here = own
            for n in range(NEIGHBOURS):
                j = graph.neighbour[here, n]
                square = (a - skin[j, 0]) ** 2 + (b - skin[j, 1]) ** 2 + (c - skin[j, 2]) ** 2
                if square < nearest:
                    nearest, own, moved = square, j, True
        index[v] = own
        # Sums over sample and neighbours: weights, points, normals, and normals times points.
        total, p0, p1, p2 = k.one, skin[own, 0], skin[own, 1], skin[own, 2]
        n0, n1, n2, across = skin[own, 4], skin[own, 5], skin[own, 6], skin[own, 7]
        for n in range(NEIGHBOURS):
            j = graph.neighbour[own, n]
            square = (a - skin[j, 0]) ** 2 + (b - skin[j, 1]) ** 2 + (c - skin[j, 2]) ** 2
            share = k.one - (square - nearest) / graph.reach_m2[own]
            if share > k.zero and j != own:
                w = share * share
                total += w
                p0, p1, p2 = p0 + w * skin[j, 0], p1 + w * skin[j, 1], p2 + w * skin[j, 2]
                n0, n1, n2 = n0 + w * skin[j, 4], n1 + w * skin[j, 5], n2 + w * skin[j, 6]
                across += w * skin[j, 7]
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if not length > k.zero:
            n0, n1, n2, across, length = skin[own, 4], skin[own, 5], skin[own, 6], skin[own, 7], k.one
            total, p0, p1, p2 = k.one, skin[own, 0], skin[own, 1], skin[own, 2]
        by_sample = (a * n0 + b * n1 + c * n2 - across) / total
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        by_blend = a * n0 + b * n1 + c * n2 - (n0 * p0 + n1 * p1 + n2 * p2) / total
        distance = k.half * (by_sample + by_blend)
        place = PLANES * (v // LANES) + v % LANES
        planes[place], planes[place + LANES], planes[place + 2 * LANES] = (
            a - distance * n0,
            b - distance * n1,
            c - distance * n2,
        )
        planes[place + 3 * LANES], planes[place + 4 * LANES], planes[place + 5 * LANES] = n0, n1, n2
