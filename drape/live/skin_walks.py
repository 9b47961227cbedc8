"""Walks on the samples of the skin, by which a vertex keeps to its own part of the body.

The skin is a graph of samples. From the sample that a vertex had in the frame before it walks to the nearest one,
always on to the nearest neighbour. A frame moves a vertex by less than a few samples, so that the walk stays on the
part where the vertex was: a sleeve keeps to its arm where the arm touches the trunk. A vertex without a past starts at
the sample that is nearest at rest. Walks are computed for ``LANES`` vertices at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.contact.samples import FACING, Samples
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import at, dot, sub
from drape.kernels.lanes import number_at, points_in, put, samples_at, where_above
from drape.live.sheet import LANES

NEIGHBOURS = 8
CANDIDATES = 24  # nearest samples, from which those that face another way are left out


class SkinGraph(NamedTuple):
    """The samples of a skin: the ``neighbour`` samples (S, 8) of each, itself where there are fewer; ``reach_m2`` (S,),
    the square of its spacing; ``rest`` [m] (S, 3), its place at rest."""

    neighbour: np.ndarray
    reach_m2: np.ndarray
    rest: np.ndarray

    def of_type(self, dtype: type[np.floating]) -> SkinGraph:
        """The same with floats of ``dtype``."""
        return self._replace(reach_m2=self.reach_m2.astype(dtype), rest=self.rest.astype(dtype))


def skin_graph(skin: Samples) -> SkinGraph:
    """The graph of the samples of ``skin`` by their distance at rest."""
    _, near = KDTree(skin.point).query(skin.point, k=min(CANDIDATES, skin.count))
    facing = np.einsum("snc,sc->sn", skin.normal[near], skin.normal) > FACING
    own = np.arange(skin.count)[:, None]
    order = np.argsort(~facing | (near == own), axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = np.where(np.take_along_axis(facing, order, axis=1), np.take_along_axis(near, order, axis=1), own)
    return SkinGraph(np.ascontiguousarray(chosen, np.int32), skin.spacing_m**2, skin.point)


def nearest_at_rest(vertices: np.ndarray, skin: Samples) -> np.ndarray:
    """The sample (V,) int32 nearest to each of ``vertices`` [m] (V, 3), both at rest."""
    return np.asarray(KDTree(skin.point).query(vertices)[1], dtype=np.int32)


class TouchedSamples(NamedTuple):
    """The sample ``own`` (P,) that the network has each place at, and ``other`` (P,), one of another part near it or
    -1."""

    own: np.ndarray
    other: np.ndarray


SCRATCH = 6 * LANES  # rows: which neighbour of each lane's sample is nearer than it, or what a plane has


class WalkLanes(NamedTuple):
    """``LANES`` walks at once: in each lane a place ``vertex`` and the ``sample`` (``LANES``,) that it is at, whose
    neighbours are ``near`` (8 ``LANES``,), a row each; ``scratch`` for rows of numbers."""

    vertex: np.ndarray
    sample: np.ndarray
    near: np.ndarray
    scratch: np.ndarray


@kernel
def walk_lanes(skin):
    return WalkLanes(
        np.empty(LANES, np.int32),
        np.empty(LANES, np.int32),
        np.empty(NEIGHBOURS * LANES, np.int32),
        np.empty(SCRATCH, skin.dtype),
    )


@kernel
def follow(network, skin, graph, touched):
    """Moves ``touched.own`` on to the samples nearest to the ``network``'s vertices [m] (P, 3)."""
    lanes = walk_lanes(skin)
    for block in range(len(network) // LANES):
        for lane in range(LANES):
            lanes.sample[lane] = touched.own[LANES * block + lane]
        walk(points_in(network, LANES * block), lanes, skin, graph.neighbour, len(skin))
        for lane in range(LANES):
            touched.own[LANES * block + lane] = lanes.sample[lane]


@part
def walk(points, lanes, skin, neighbour, steps):
    """``walked`` for a point in every lane, from ``lanes.sample``, moved in place."""
    own, near, nearer = lanes.sample, lanes.near, lanes.scratch
    square = squares(points, skin, own, 0)
    for _ in range(steps):
        look_around(own, neighbour, near)
        which = 0.0 * square - 1.0  # none
        for n in range(NEIGHBOURS):
            other = squares(points, skin, near, LANES * n)
            which = where_above(square, other, float(n), which)
            square = where_above(square, other, other, square)
        put(nearer, 0, which)
        moved = False
        for lane in range(LANES):
            if nearer[lane] >= 0.0:
                own[lane], moved = number_at(near, LANES * int(nearer[lane]) + lane), True
        if not moved:
            break


@part
def look_around(own, neighbour, near):
    """Writes the neighbours of the samples ``own`` (``LANES``,) to ``near``, a row each."""
    for lane in range(LANES):
        for n in range(NEIGHBOURS):
            near[LANES * n + lane] = number_at(neighbour, NEIGHBOURS * own[lane] + n)


@part
def squares(points, skin, index, start):
    """Squares of the distances from ``points`` to the samples of a row."""
    x, y, z, _ = samples_at(skin, index, start)
    way = sub((x, y, z), points)
    return dot(way, way)


@part
def square_to(point, skin, sample):
    way = sub(point, at(skin, sample))
    return dot(way, way)


@part
def walked(point, skin, graph, own, steps):
    """Where a walk from the sample ``own`` ends, of ``steps`` at most."""
    nearest = square_to(point, skin, own)
    for _ in range(steps):
        here = own
        for n in range(NEIGHBOURS):
            square = square_to(point, skin, graph.neighbour[here, n])
            if square < nearest:
                nearest, own = square, graph.neighbour[here, n]
        if own == here:
            break
    return own
