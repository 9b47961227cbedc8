"""The ceiling of an inner garment: it gives way to the garment that is worn over it.

Layers are draped one by one, and the network knows no other layer. A dress stands out through the shirt that is worn
over it, and loose trousers crumple the T-shirt that rests on them. In life the outer garment presses the inner one to
the skin. So the outer garment is a *ceiling*: for each sample of the skin the tangent plane of the outer cloth at the
lowest of its vertices that lies over the sample. A sample beside it counts as covered where most of its neighbours are,
and gets the mean of their planes.

What is above the ceiling comes down along the planes' normals, to ``GAP_M`` below the lowest of those of its own sample
and of the samples around, though no nearer than ``LEAST_M`` to what lies below it. The planes of a shirt between two
legs agree where the normals of the legs' skin point at each other. The cloth around comes along: way D spreads over the
triangles, of two neighbours at distance l

    D_v = (1 - l / FADE_M) D_u   where that is longer than D_v,

and is evened out, since a step at the hem of the outer garment would show below it. Evened, it stays above the skin
as well. What is above the ceiling still then comes down alone.

Folds are of the drape as the network has it, and what is pressed are the folded vertices, while the memory of folds
keeps them as they were: cloth that is pressed before it folds is too long for its place and crumples below the hem. The
outer garment's drape without folds presses before that garment folds on what is left, and its folds press once more.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, dot, scaled, sub
from drape.live.clock import writable
from drape.live.fold_constants import LaidCloth
from drape.live.sheet import LANES
from drape.live.skin_walks import NEIGHBOURS, TouchedSamples, follow
from drape.live.surface_frames import FRAMES, surface_frames

GAP_M = 0.003  # contact's gap: the ground then leaves the outer garment where its own drape is
LEAST_M = 0.0025
HIGHEST_M = 0.12  # an outer garment farther out covers nothing
MOST = 5  # neighbours that are covered and make a sample covered
FILLS = 2  # times samples are filled so
FADE_M = 0.1
EVENED = 4  # times that the way is averaged with that of the neighbours
LEAST_WAY_M = 1e-3  # by which a way must grow, or the line gets long
ASLANT = 0.05  # cosine between plane and skin below which the skin bounds no way along the plane's normal


def ceiling_over(vertices: np.ndarray, outer: LaidCloth, skin: np.ndarray) -> np.ndarray:
    """The ceiling (S, 5) that the garment ``outer`` with ``vertices`` [m] (V, 3) is over the samples ``skin`` (S, 8).

    A row has the height [m] over the sample, infinite where nothing covers it, the unit normal n of a plane and its
    offset d [m]: n . x - d is how far x is above it.
    """
    dtype = outer.sheet.own.dtype
    x, samples = np.take(vertices, outer.sheet.vertex, axis=0).astype(dtype, copy=False), writable(skin, dtype)
    own = outer.index.copy()
    follow(x, samples, outer.graph, TouchedSamples(own, own))
    ceiling = np.zeros((len(samples), 5), dtype)
    ceiling[:, 0] = np.inf
    _lower(x, outer.sheet, own, samples, outer.graph, ceiling)
    return ceiling


def lower(ceiling: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The lower of two ceilings (..., S, 5), sample by sample."""
    return np.where(other[..., :1] < ceiling[..., :1], other, ceiling)


def pressed(
    vertices: np.ndarray, inner: LaidCloth, own: np.ndarray, ground: np.ndarray, ceiling: np.ndarray
) -> np.ndarray:
    """The ``vertices`` [m] (V, 3) of the garment ``inner`` below the ``ceiling`` (S, 5) over ``ground`` (S, 8), with
    the cloth around; themselves where nothing is too high. ``own`` (P,) is the sample that each place is at."""
    dtype = inner.sheet.own.dtype
    x, samples = np.take(vertices, inner.sheet.vertex, axis=0).astype(dtype, copy=False), writable(ground, dtype)
    down, ceiling = np.zeros_like(x), writable(ceiling, dtype)
    if not _too_high(x, own, samples, inner.graph, ceiling, down):
        return vertices
    _spread(x, inner.sheet, down)
    _above_skin(x, own, samples, inner.graph, down)
    x += down
    down[:] = 0.0
    _too_high(x, own, samples, inner.graph, ceiling, down)
    return np.asarray(np.take(x + down, inner.sheet.place, axis=0), vertices.dtype)


@kernel
def _lower(x, sheet, own, skin, graph, ceiling):
    """Lowers the ``ceiling`` (S, 5) to the places ``x`` that lie over the samples."""
    kind = x.dtype.type
    highest = kind(HIGHEST_M)
    frames = np.empty(FRAMES // LANES * len(x), x.dtype)
    surface_frames(x, sheet, frames)
    for v in range(len(x)):
        row = FRAMES * (v // LANES) + v % LANES
        lies = (frames[row], frames[row + LANES], frames[row + 2 * LANES])
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            up, aside = _over(at(x, v), s, skin)
            faces_out = dot(lies, (skin[s, 4], skin[s, 5], skin[s, 6])) > 0  # of a trunk's cloth not over an arm's skin
            if faces_out and up < min(ceiling[s, 0], highest) and (n < 0 or aside < graph.reach_m2[s]):
                ceiling[s, 0], ceiling[s, 4] = up, dot(lies, at(x, v))
                for i in range(3):
                    ceiling[s, 1 + i] = lies[i]
    total = np.empty(5, x.dtype)
    for _ in range(FILLS):
        before = ceiling.copy()
        for s in range(len(ceiling)):
            if before[s, 0] < np.inf:
                continue
            total[:], covered = 0, 0
            for n in range(NEIGHBOURS):
                other = graph.neighbour[s, n]
                if before[other, 0] < np.inf:
                    covered += 1
                    for i in range(len(total)):  # no sum of arrays, which would be a new one each time
                        total[i] += before[other, i]
            normal = (total[1], total[2], total[3])
            length = np.sqrt(dot(normal, normal))
            if covered >= MOST and length > 0:
                ceiling[s, 0] = total[0] / kind(covered)
                for i in range(1, len(total)):
                    ceiling[s, i] = total[i] / length


@kernel
def _over(point, s, skin):
    """How high [m] ``point`` is over sample ``s``, and how far from its normal [m^2]."""
    way = sub(point, at(skin, s))
    up = dot(way, (skin[s, 4], skin[s, 5], skin[s, 6]))
    return up, dot(way, way) - up * up


@kernel
def _too_high(x, own, skin, graph, ceiling, down):
    """Writes the way [m] (P, 3) of what is above the planes of the samples that it lies over to ``down``; whether any
    is."""
    kind = x.dtype.type
    found = False
    for v in range(len(x)):
        most, normal = kind(0), (kind(0), kind(0), kind(0))
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            up, aside = _over(at(x, v), s, skin)
            if ceiling[s, 0] == np.inf or (n >= 0 and not aside < graph.reach_m2[s]):
                continue
            plane = (ceiling[s, 1], ceiling[s, 2], ceiling[s, 3])
            high = dot(plane, at(x, v)) - ceiling[s, 4] + kind(GAP_M)
            along = dot(plane, (skin[s, 4], skin[s, 5], skin[s, 6]))
            if along > kind(ASLANT):
                high = min(high, (up - kind(LEAST_M)) / along)
            most, normal = max(most, high), add(normal, plane)
        length = np.sqrt(dot(normal, normal))
        if most > 0 and length > 0:
            found = True
            for i in range(3):
                down[v, i] = -most * normal[i] / length
    return found


@kernel
def _above_skin(x, own, skin, graph, down):
    """Shortens the ways ``down`` [m] (P, 3) that end nearer than ``LEAST_M`` to the skin, in place. The skin is the
    highest of the planes of the samples below: in a hollow, as at the neck, that of one is too low."""
    kind = x.dtype.type
    for v in range(len(x)):
        share = kind(1)
        if down[v, 0] == 0 and down[v, 1] == 0 and down[v, 2] == 0:
            continue
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            up, aside = _over(at(x, v), s, skin)
            deep = -dot(at(down, v), (skin[s, 4], skin[s, 5], skin[s, 6]))
            room = max(up - kind(LEAST_M), kind(0))
            if deep * share > room and (n < 0 or aside < graph.reach_m2[s]):
                share = room / deep
        if share < 1:
            short = scaled(share, at(down, v))
            for i in range(3):
                down[v, i] = short[i]


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
