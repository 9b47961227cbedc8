"""Charts and their consensus, compiled: what each says of its members, where anchors are, and fits to that.

The formulas are those of ``training.consensus``. A member's columns are its weight w times its rest place and the
basis (1, u, v, uu, uv, vv); those of the third and fourth order are products of two of them, over w.
"""

from __future__ import annotations

from drape.garment.consensus import FIT_COUNT, MEMBERS
from drape.geometry import jets
from drape.graph.packed import LOWER_COLUMNS
from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, points_at, put, put_points, row_at
from drape.network.frames import FRAME, SCALE, centres_of, into_frame, out_of_frame

COLUMNS, PLANE, HEIGHT = LOWER_COLUMNS, jets.IN_PLANE_COUNT, jets.HEIGHT_COUNT


@kernel
def say(jets_of, frames, rows, said):
    """Writes where charts put their members, times their weights, to ``said`` [m] (members, 3).

    ``jets_of`` (``Rows``) are their jets, none where charts are at rest in their frames.
    """
    jet, count = jets_of.values, jets_of.count
    for block in range(len(rows.scale) // LANES):
        centre, scale = centres_of(frames, block), row_at(frames, LANES * (FRAME * block + SCALE))
        own = LANES * count * block
        for member in range(MEMBERS):
            at = LANES * COLUMNS * (MEMBERS * block + member)
            x, y, z = row_at(rows.columns, at), row_at(rows.columns, at + LANES), row_at(rows.columns, at + 2 * LANES)
            weight = row_at(rows.columns, at + 3 * LANES)
            if len(jet):
                u, v = row_at(rows.columns, at + 4 * LANES), row_at(rows.columns, at + 5 * LANES)
                uu, uv = row_at(rows.columns, at + 6 * LANES), row_at(rows.columns, at + 7 * LANES)
                vv = row_at(rows.columns, at + 8 * LANES)
                plane = weight, u, v, uu, uv, vv
                x, y = x + _plane(jet, own, plane), y + _plane(jet, own + LANES * PLANE, plane)
                z = z + _plane(jet, own + 2 * LANES * PLANE, plane)
                per, high = 1.0 / most(weight, 1e-30), own + 3 * LANES * PLANE
                more = row_at(jet, high) * (uu * u) + row_at(jet, high + LANES) * (uu * v)
                more = more + row_at(jet, high + 2 * LANES) * (vv * u) + row_at(jet, high + 3 * LANES) * (vv * v)
                more = more + row_at(jet, high + 4 * LANES) * (uu * uu) + row_at(jet, high + 5 * LANES) * (uu * uv)
                more = more + row_at(jet, high + 6 * LANES) * (uv * uv) + row_at(jet, high + 7 * LANES) * (uv * vv)
                z = z + per * (more + row_at(jet, high + 8 * LANES) * (vv * vv))
            world = out_of_frame(frames, block, (scale * x, scale * y, scale * z))
            moved = world[0] + weight * centre[0], world[1] + weight * centre[1], world[2] + weight * centre[2]
            put_points(said, LANES * (MEMBERS * block + member), moved)


@part
def _plane(jet, at, plane):
    return (
        row_at(jet, at) * plane[0] + row_at(jet, at + LANES) * plane[1] + row_at(jet, at + 2 * LANES) * plane[2]
        + row_at(jet, at + 3 * LANES) * plane[3] + row_at(jet, at + 4 * LANES) * plane[4]
        + row_at(jet, at + 5 * LANES) * plane[5]
    )  # fmt: skip


@kernel
def place_anchors(said, anchor, anchors):
    """Writes the ``anchors`` [m] (A, 3): the sums of what the four charts of each have said."""
    for a in range(len(anchors)):
        i, j, k, m = anchor[a, 0], anchor[a, 1], anchor[a, 2], anchor[a, 3]
        for axis in range(3):
            anchors[a, axis] = said[i, axis] + said[j, axis] + (said[k, axis] + said[m, axis])


@kernel
def fit(anchors, frames, rows, off, closing, jets_of):
    """Writes jets that fit the ``anchors`` [m] (A, 3) to ``jets_of`` (``Rows``): 45 numbers where ``closing``, else 27.
    ``off`` is scratch of 3 x 56 rows."""
    jet = jets_of.values
    for block in range(len(rows.scale) // LANES):
        centre, scale = centres_of(frames, block), row_at(frames, LANES * (FRAME * block + SCALE))
        per = 1.0 / scale
        for member in range(MEMBERS):
            place = points_at(anchors, rows.member, LANES * (MEMBERS * block + member))
            way = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
            x, y, z = into_frame(frames, block, way)
            put(off, LANES * member, per * x)
            put(off, LANES * (MEMBERS + member), per * y)
            put(off, LANES * (2 * MEMBERS + member), per * z)
        at, rest = LANES * (jets_of.count * block + jets_of.first), LANES * 3 * FIT_COUNT * block
        if closing:
            for axis in range(3):
                _fit_rows(off, axis, rows, block, jet, at + LANES * HEIGHT * axis)
        else:
            _fit_plane(off, rows, block, rest, jet, at)
            _fit_rows(off, 2, rows, block, jet, at + LANES * 2 * PLANE)


@kernel
def _fit_rows(off, axis, rows, block, jet, at):
    """Writes the fifteen numbers of the fit along one ``axis``, less those at rest."""
    for first in range(0, HEIGHT, 5):
        place = LANES * (FIT_COUNT * MEMBERS * block + first)
        a = row_at(off, 0) * 0.0
        b, c, d, e = a, a, a, a
        for member in range(MEMBERS):
            own, f = row_at(off, LANES * (MEMBERS * axis + member)), place + LANES * FIT_COUNT * member
            a, b = a + own * row_at(rows.fit, f), b + own * row_at(rows.fit, f + LANES)
            c, d = c + own * row_at(rows.fit, f + 2 * LANES), d + own * row_at(rows.fit, f + 3 * LANES)
            e = e + own * row_at(rows.fit, f + 4 * LANES)
        still, to = LANES * (FIT_COUNT * (3 * block + axis) + first), at + LANES * first
        put(jet, to, a - row_at(rows.rest, still))
        put(jet, to + LANES, b - row_at(rows.rest, still + LANES))
        put(jet, to + 2 * LANES, c - row_at(rows.rest, still + 2 * LANES))
        put(jet, to + 3 * LANES, d - row_at(rows.rest, still + 3 * LANES))
        put(jet, to + 4 * LANES, e - row_at(rows.rest, still + 4 * LANES))


@kernel
def _fit_plane(off, rows, block, rest, jet, at):
    """Writes the six numbers of both polynomials in the plane."""
    place = LANES * (FIT_COUNT * MEMBERS * block + HEIGHT)
    for i in range(0, PLANE, 3):
        a = row_at(off, 0) * 0.0
        b, c, d, e, f = a, a, a, a, a
        for member in range(MEMBERS):
            p, q = row_at(off, LANES * member), row_at(off, LANES * (MEMBERS + member))
            w = place + LANES * (FIT_COUNT * member + i)
            x, y, z = row_at(rows.fit, w), row_at(rows.fit, w + LANES), row_at(rows.fit, w + 2 * LANES)
            a, b, c = a + p * x, b + p * y, c + p * z
            d, e, f = d + q * x, e + q * y, f + q * z
        still = rest + LANES * (HEIGHT + i)
        put(jet, at + LANES * i, a - row_at(rows.rest, still))
        put(jet, at + LANES * (i + 1), b - row_at(rows.rest, still + LANES))
        put(jet, at + LANES * (i + 2), c - row_at(rows.rest, still + 2 * LANES))
        still += LANES * FIT_COUNT
        put(jet, at + LANES * (PLANE + i), d - row_at(rows.rest, still))
        put(jet, at + LANES * (PLANE + i + 1), e - row_at(rows.rest, still + LANES))
        put(jet, at + LANES * (PLANE + i + 2), f - row_at(rows.rest, still + 2 * LANES))
