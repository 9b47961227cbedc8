"""Local frames of a surface, compiled: what a vertex is away from a moving surface, carried along with it."""

from __future__ import annotations

import numpy as np

from drape.solver.compiled import kernel
from drape.solver.elements import add, at, cross, dot, scaled, sub


@kernel
def surface_frames(surface, triangles, frames):
    """Frames (V, 3, 3) of ``surface`` [m] (V, 3): rows are the normal, an edge laid into the plane, and their product.

    The edge is that of the vertex's first triangle. A vertex without an area or an edge gets a frame of zeros.
    """
    zero = surface[0, 0] - surface[0, 0]
    for v in range(len(surface)):
        own, normal = at(surface, v), (zero, zero, zero)
        for entry in range(triangles.start[v], triangles.start[v + 1]):
            j, l = triangles.other[entry, 0], triangles.other[entry, 1]
            normal = add(normal, cross(sub(at(surface, j), own), sub(at(surface, l), own)))
        edge = normal
        if triangles.start[v] < triangles.start[v + 1]:
            edge = sub(at(surface, triangles.other[triangles.start[v], 0]), own)
        normal = _unit(normal, zero)
        edge = _unit(sub(edge, scaled(dot(edge, normal), normal)), zero)
        third = cross(normal, edge)
        for i in range(3):
            frames[v, 0, i], frames[v, 1, i], frames[v, 2, i] = normal[i], edge[i], third[i]


@kernel
def _unit(a, zero):
    length = np.sqrt(dot(a, a))
    if length > zero:
        return a[0] / length, a[1] / length, a[2] / length
    return zero, zero, zero


@kernel
def to_local(frames, vectors, local):
    """``local`` (V, 3): the world ``vectors`` (V, 3) in the frames; may be the same array."""
    for v in range(len(vectors)):
        a, b, c = vectors[v, 0], vectors[v, 1], vectors[v, 2]
        for i in range(3):
            local[v, i] = frames[v, i, 0] * a + frames[v, i, 1] * b + frames[v, i, 2] * c


@kernel
def to_world(frames, local, vectors):
    """``vectors`` (V, 3): what is ``local`` (V, 3) in the frames, in world axes; may be the same array."""
    for v in range(len(local)):
        a, b, c = local[v, 0], local[v, 1], local[v, 2]
        for i in range(3):
            vectors[v, i] = frames[v, 0, i] * a + frames[v, 1, i] * b + frames[v, 2, i] * c
