"""What folds keep of the frame before: residuals that tear are mended, and those of another pose are forgotten.

Memory keeps what one pose folded where the next one needs no fold, and thin cloth in motion crumples. A few steps do
not undo that: to bend costs cloth hardly anything. So in every frame a residual r goes towards the mean m of those of
its neighbours,

    r += f (m - r),   f = s / (1 + s),   s = FORGET |e - e0| / |e| / (1 + (l / LACK)^2).

e is the vertex's first edge in the network's drape of this frame and e0 that edge in the frame before, so that s grows
with the way by which the cloth turns and not with the number of frames. Cloth on a body that stands still forgets
nothing, and comes to rest as a still does. l is the share of its area that the network leaves out around the vertex,

    l = max(0, 1 - sum |a x b| / 2 / sum A),

a and b the sides of its triangles and A their areas at rest: there folds are needed, and stay.

Hems are sewn double and do not frill, but along a border the mesh has no hinges. Residuals there also go towards the
mean of their two neighbours' along the border, by s / (1 + s) with s = HEM |e - e0| / |e|, e the way to the next one.

Where cloth still crosses itself at the end of a frame its residual goes towards the mean as well (``ease``): the
network's surface is smooth, and a crumple that has passed through itself goes back with it.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, dot, scaled, sub
from drape.kernels.lanes import most, points_at, points_in, put, put_points, root, row_at, where_above, where_other
from drape.live.sheet import LANES
from drape.live.surface_frames import COVER, FRAMES

MEND_M = 0.03  # a residual that far from its neighbours' follows them
FORGET, LACK, HEM = 24.0, 0.003, 24.0
EASE = 0.5  # the share of its way to the mean where cloth crosses and the network moves by ``WAY_M`` or more


@kernel
def keep_residual(off, before, network, frames, sheet, hem):
    """Mends, forgets and evens the residuals ``off`` [m] (P, 3), world, in place.

    ``before`` and ``network`` [m] (P, 3) are the network's drapes of the frame before and of this one, ``frames`` those
    of the latter. ``hem`` (H, 3) is that of ``FoldConstants``.
    """
    forget = np.empty(len(off), off.dtype)
    write_forget(before, network, frames, sheet, forget)
    mend(off, sheet, off.dtype.type(MEND_M), forget)
    even_hem(off, before, network, hem)


@kernel
def write_forget(before, network, frames, sheet, forget):
    """Writes f (P,) to ``forget``: none where nothing moved."""
    k, kind = sheet.constants, network.dtype.type
    for block in range(len(sheet.fan_start) - 1):
        row = 2 * LANES * sheet.fan_start[block]
        if sheet.fan_start[block] == sheet.fan_start[block + 1]:
            put(forget, LANES * block, k.zero)
            continue
        edge = sub(points_at(network, sheet.fan_other, row), points_in(network, LANES * block))
        turn = sub(edge, sub(points_at(before, sheet.fan_other, row), points_in(before, LANES * block)))
        lacks = kind(1.0 / LACK) * most(k.one - row_at(frames, FRAMES * block + COVER), k.zero)
        length = dot(edge, edge)
        s = kind(FORGET) * root(dot(turn, turn) / where_above(length, k.zero, length, k.one))
        s = s / (k.one + lacks * lacks)
        put(forget, LANES * block, s / (k.one + s))


@kernel
def mend(off, sheet, far, forget):
    """Moves each of the vectors ``off`` (P, 3) by its share ``forget`` (P,) of the way to its neighbours' mean, and all
    of the way where that is longer than ``far``.

    The frames of a surface that folds over turn about from one frame to the next, and a residual turns with them.
    """
    k, before, places = sheet.constants, off.copy(), np.arange(len(off)).astype(np.int32)
    for block in range(len(sheet.fan_start) - 1):
        own = points_in(before, LANES * block)
        mean = scaled(k.zero, own)
        count = mean[0]
        for row in range(2 * sheet.fan_start[block], 2 * sheet.fan_start[block + 1]):
            # An empty row has the place itself.
            real = where_other(sheet.fan_other, LANES * row, places, LANES * block, k.zero * own[0] + k.one)
            mean = add(mean, scaled(real, points_at(before, sheet.fan_other, LANES * row)))
            count = count + real
        mean = scaled(k.one / where_above(count, k.zero, count, k.one), mean)
        way = sub(mean, own)
        share = where_above(dot(way, way), far * far, k.one, row_at(forget, LANES * block))
        share = where_above(count, k.zero, share, k.zero)
        put_points(off, LANES * block, add(own, scaled(share, way)))


@kernel
def ease(x, network, crossed, share, sheet):
    """Moves the residuals of ``x`` [m] (P, 3) by a ``share`` of the way to their neighbours' mean, in place, where
    ``crossed`` (P,) is above zero."""
    if not crossed.any():
        return
    forget = np.zeros_like(crossed)
    for v in range(len(x)):
        forget[v] = share if crossed[v] > 0 else x.dtype.type(0)
    off = x - network
    mend(off, sheet, x.dtype.type(np.inf), forget)
    for v in range(len(x)):
        if crossed[v] > 0:
            for i in range(3):
                x[v, i] = network[v, i] + off[v, i]


@kernel
def even_hem(off, before, network, hem):
    """Moves ``off`` of every border vertex towards the mean of its neighbours' along the ``hem`` (H, 3)."""
    zero, one, half = off.dtype.type(0), off.dtype.type(1), off.dtype.type(0.5)
    even = np.empty((len(hem), 3), off.dtype)
    for e in range(len(hem)):
        v, after = hem[e, 1], hem[e, 2]
        edge = sub(at(network, after), at(network, v))
        turn, length = sub(edge, sub(at(before, after), at(before, v))), dot(edge, edge)
        s = off.dtype.type(HEM) * np.sqrt(dot(turn, turn) / length) if length > zero else zero
        own, mean = at(off, v), scaled(half, add(at(off, hem[e, 0]), at(off, after)))
        moved = add(own, scaled(s / (one + s), sub(mean, own)))
        even[e, 0], even[e, 1], even[e, 2] = moved
    for e in range(len(hem)):
        off[hem[e, 1]] = even[e]
