"""Frames of the network's surface, compiled. A fold is stored in them, so that it turns with the surface."""

from __future__ import annotations

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, cross, dot, scaled, sub
from drape.kernels.lanes import points_at, points_in, put, put3, root, row_at, rows3_at, where_above
from drape.live.sheet import LANES

COVER = 9 * LANES  # behind normal, edge and their product, three rows each: the share of the area at rest
FRAMES = COVER + LANES  # numbers of a block


@kernel
def surface_frames(surface, sheet, frames):
    """Writes the ``frames`` of ``surface`` [m] (P, 3): normal, edge and their product, flat, nine rows a block. A tenth
    row has the area of the triangles around each vertex over their area at rest.

    The edge is the first one of the vertex's first triangle, laid into the tangent plane; ``Sheet`` puts that triangle
    first whose edge is longest at rest. A vertex without an area or an edge gets a frame of zeros.
    """
    k = sheet.constants
    for block in range(len(sheet.fan_start) - 1):
        own = points_in(surface, LANES * block)
        normal = scaled(k.zero, own)
        edge, twice, whole = normal, normal[0], normal[0]
        begin = sheet.fan_start[block]
        for row in range(begin, sheet.fan_start[block + 1]):
            first = sub(points_at(surface, sheet.fan_other, 2 * LANES * row), own)
            second = sub(points_at(surface, sheet.fan_other, 2 * LANES * row + LANES), own)
            across = cross(first, second)
            normal = add(normal, across)
            twice = twice + root(dot(across, across))
            whole = whole + row_at(sheet.fan_slope, 5 * LANES * row + 4 * LANES)
            if row == begin:
                edge = first
        normal = _unit(normal, k)
        edge = _unit(sub(edge, scaled(dot(edge, normal), normal)), k)
        put3(frames, FRAMES * block, normal)
        put3(frames, FRAMES * block + 3 * LANES, edge)
        put3(frames, FRAMES * block + 6 * LANES, cross(normal, edge))
        put(frames, FRAMES * block + COVER, k.half * twice / where_above(whole, k.zero, whole, k.one))


@part
def _unit(a, k):
    square = dot(a, a)
    return scaled(where_above(square, k.zero, k.one / root(where_above(square, k.zero, square, k.one)), k.zero), a)


@part
def to_frame(frame, a):
    """The world vectors ``a``, three rows, in the axes of ``frame``."""
    n, e, b = frame
    return dot(n, a), dot(e, a), dot(b, a)


@part
def to_world(frame, a):
    """The vectors ``a``, three rows in the axes of ``frame``, in those of the world."""
    n, e, b = frame
    return add(add(scaled(a[0], n), scaled(a[1], e)), scaled(a[2], b))


@part
def in_frames(frames, block, a):
    """The world vectors ``a``, three rows, in the frames of a block."""
    return to_frame(_frame_of(frames, block), a)


@part
def in_world(frames, block, a):
    """The vectors ``a``, three rows in the frames of a block, in the axes of the world."""
    return to_world(_frame_of(frames, block), a)


@part
def _frame_of(frames, block):
    """The frames of a block: normal, edge and their product, three rows each."""
    first = FRAMES * block
    return rows3_at(frames, first), rows3_at(frames, first + 3 * LANES), rows3_at(frames, first + 6 * LANES)
