"""The ceiling of an inner garment: it gives way to the garment that is worn over it.

Layers are draped one by one, and the network knows no other layer. A dress stands out through the shirt that is worn
over it, and loose trousers crumple the T-shirt that rests on them. In life the outer garment presses the inner one to
the skin. So the outer garment's drape is a *ceiling*: over each sample of the skin the lowest of its vertices that lies
there. A sample beside it counts as covered where most of its neighbours are.

Before its folds the inner drape goes below the ceiling. Each vertex d too high comes down by d along the normal of its
own sample, to ``GAP_M`` below the ceiling, though no nearer than ``LEAST_M`` to what lies below it. The cloth around it
comes along: way D spreads over the triangles, of two neighbours at distance l

    D_v = (1 - l / FADE_M) D_u   where that is longer than D_v,

and is evened out. A step at the hem of the outer garment would crumple what shows below it. Folds grow on the drape
that was pressed. What they raise above the ceiling again is pressed at the end, covered vertices alone, and the memory
of folds keeps it as it was.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, dot, sub
from drape.live.fold_constants import FoldConstants
from drape.live.sheet import LANES
from drape.live.skin_contact import NEIGHBOURS, TouchedSamples, follow

GAP_M = 0.003  # contact's gap: the ground then leaves the outer garment where its own drape is
LEAST_M = 0.0025
HIGHEST_M = 0.12  # an outer garment farther out covers nothing
MOST = 5  # neighbours that are covered and make a sample covered
FILLS = 2  # times samples are filled so
FADE_M = 0.1
SHALLOW_M = 0.002  # a drape that is less too high is left to the end
EVENED = 4  # times that the way is averaged with that of the neighbours
LEAST_WAY_M = 1e-3  # by which a way must grow, or the line gets long


def ceiling_over(drape: np.ndarray, outer: FoldConstants, skin: np.ndarray) -> np.ndarray:
    """How high [m] (S,) over each sample of ``skin`` (S, 8) the garment ``outer`` lies, infinite where it does not.

    ``drape`` [m] (V, 3) is its motion without folds.
    """
    x, samples, own = _on_samples(drape, outer, skin)
    ceiling = np.full(len(samples), np.inf, x.dtype)
    _lower(x, own, samples, outer.graph, ceiling)
    return ceiling


def pressed(drape: np.ndarray, inner: FoldConstants, ground: np.ndarray, ceiling: np.ndarray) -> np.ndarray:
    """The ``drape`` [m] (V, 3) of the garment ``inner`` below the ``ceiling`` [m] (S,) over ``ground`` (S, 8), with the
    cloth around it; itself where nothing is more than ``SHALLOW_M`` too high."""
    x, samples, own = _on_samples(drape, inner, ground)
    down = np.zeros_like(x)
    if not _too_high(x, own, samples, inner.graph, ceiling.astype(x.dtype), down) > SHALLOW_M:
        return drape
    _spread(x, inner.sheet, down)
    return np.asarray(drape + np.take(down, inner.sheet.place, axis=0), drape.dtype)


def held_below(
    vertices: np.ndarray, inner: FoldConstants, own: np.ndarray, ground: np.ndarray, ceiling: np.ndarray
) -> np.ndarray:
    """The folded ``vertices`` [m] (V, 3) of ``inner``, those above the ``ceiling`` alone brought down; ``own`` (P,) is
    the sample that each place is at."""
    dtype = inner.sheet.own.dtype
    x, down = np.take(vertices, inner.sheet.vertex, axis=0).astype(dtype), np.zeros((len(own), 3), dtype)
    _too_high(x, own, np.ascontiguousarray(ground, dtype), inner.graph, ceiling.astype(dtype), down)
    return np.asarray(vertices + np.take(down, inner.sheet.place, axis=0), vertices.dtype)


def _on_samples(drape: np.ndarray, made: FoldConstants, skin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The places (P, 3) of a garment's ``drape``, the samples, and which of them each place is at (P,)."""
    dtype = made.sheet.own.dtype
    x, samples = np.take(drape, made.sheet.vertex, axis=0).astype(dtype), np.ascontiguousarray(skin, dtype)
    own = made.index.copy()
    follow(x, samples, made.graph, TouchedSamples(own, own))
    return x, samples, own


@kernel
def _lower(x, own, skin, graph, ceiling):
    """Lowers ``ceiling`` (S,) to the places ``x`` that lie over the samples."""
    highest = x.dtype.type(HIGHEST_M)
    for v in range(len(x)):
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            way = sub(at(x, v), at(skin, s))
            up = dot(way, (skin[s, 4], skin[s, 5], skin[s, 6]))
            if up < min(ceiling[s], highest) and dot(way, way) - up * up < graph.reach_m2[s]:
                ceiling[s] = up
    for _ in range(FILLS):
        before = ceiling.copy()
        for s in range(len(ceiling)):
            total, covered = x.dtype.type(0), 0
            for n in range(NEIGHBOURS):
                height = before[graph.neighbour[s, n]]
                if height < np.inf:
                    total, covered = total + height, covered + 1
            if before[s] == np.inf and covered >= MOST:
                ceiling[s] = total / x.dtype.type(covered)


@kernel
def _too_high(x, own, skin, graph, ceiling, down):
    """Writes the way [m] (P, 3) of what is above the ceiling of any sample that it lies over to ``down``; the longest
    [m]."""
    kind = x.dtype.type
    deepest = kind(0)
    for v in range(len(x)):
        most = kind(0)
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            if ceiling[s] == np.inf:
                continue
            way = sub(at(x, v), at(skin, s))
            up = dot(way, (skin[s, 4], skin[s, 5], skin[s, 6]))
            high = up - max(ceiling[s] - kind(GAP_M), kind(LEAST_M))
            if high > most and dot(way, way) - up * up < graph.reach_m2[s]:
                most = high
        if most > 0:
            deepest = max(deepest, most)
            for i in range(3):
                down[v, i] = -most * skin[own[v], 4 + i]
    return deepest


@kernel
def _spread(x, sheet, down):
    """Takes the cloth around along: ``down`` [m] (P, 3), in place. A place that moves waits in line for its neighbours
    to be looked at."""
    kind, count = x.dtype.type, len(x)
    length, waits = np.empty(count, x.dtype), np.zeros(count, np.bool_)
    line, first, last = np.empty(count, np.int32), 0, 0
    for v in range(count):
        length[v] = np.sqrt(dot(at(down, v), at(down, v)))
        if length[v] > 0:
            line[last], waits[v], last = v, True, last + 1
    waiting = last
    while waiting > 0:
        v, first, waiting = line[first % count], first + 1, waiting - 1
        waits[v] = False
        begin, end, lane = _fan(sheet, v)
        for row in range(begin, end):
            other = sheet.fan_other[LANES * row + lane]
            if length[v] > length[other]:
                way = sub(at(x, v), at(x, other))
                share = kind(1) - np.sqrt(dot(way, way)) / kind(FADE_M)
                if share * length[v] > length[other] + kind(LEAST_WAY_M):
                    length[other] = share * length[v]
                    for i in range(3):
                        down[other, i] = share * down[v, i]
                    if not waits[other]:
                        line[last % count], waits[other] = other, True
                        last, waiting = last + 1, waiting + 1
    moving, moved = line, 0
    for v in range(count):
        if length[v] > 0:
            moving[moved], moved = v, moved + 1
    before = down.copy()
    for _ in range(EVENED):
        for entry in range(moved):
            v = moving[entry]
            total, number = at(before, v), kind(1)
            begin, end, lane = _fan(sheet, v)
            for row in range(begin, end):
                total, number = add(total, at(before, sheet.fan_other[LANES * row + lane])), number + kind(1)
            for i in range(3):
                down[v, i] = total[i] / number
        for entry in range(moved):
            for i in range(3):
                before[moving[entry], i] = down[moving[entry], i]


@kernel
def _fan(sheet, v):
    """The rows of ``fan_other`` of place v, from the first to the last, and its lane."""
    block = v // LANES
    return 2 * sheet.fan_start[block], 2 * sheet.fan_start[block + 1], v % LANES
