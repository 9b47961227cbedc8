"""Layers: the skin that an outer garment feels is raised by the cloth that lies on it.

A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over it, within its
spacing: by the vertex's height times the cosine between both normals, since cloth that spans a crease, or is folded
over in it, lies on neither of its walls, which would else be raised into each other and crumple what is worn over them.
A quarter of the mean of its neighbours then takes the place of a quarter of that, so that no sample stands alone.
Planes of the raised samples are blended as those of the skin are: an outer garment rests on the inner one as that does
on the body, with the same gap, and where nothing is worn below nothing changes. The skin tells on which side a layer
is, so that this cannot be lost.
"""

from __future__ import annotations

import numpy as np

from drape.folds.contact import NEIGHBOURS, SkinGraph
from drape.push.samples import sample_table
from drape.solver.compiled import kernel
from drape.solver.elements import at, cross, dot, sub

HIGHEST_M = 0.06  # cloth higher than that hangs free, and is left to the push-out
EVENED = 0.25  # of a sample's height: what its neighbours have on the mean


def raised(skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """``skin`` (..., S, 8), of ``drape.push.samples.sample_table``, ``height`` [m] (..., S) out along its normals."""
    normal = skin[..., 4:7]
    return np.asarray(sample_table(skin[..., :3] + height[..., None] * normal, normal))


def covered(vertices: np.ndarray, faces: np.ndarray, own: np.ndarray, skin: np.ndarray, graph: SkinGraph) -> np.ndarray:
    """Heights [m] (S,) of a garment over the samples ``skin`` (S, 8), 0 where none of its vertices is over one.

    ``vertices`` [m] (V, 3) of ``faces`` (F, 3) that face outward, each at the sample ``own`` (V,): it and its
    neighbours are raised.
    """
    height = np.zeros(len(skin), vertices.dtype)
    _raise(vertices, faces, own, np.array(skin, dtype=vertices.dtype, order="C"), graph, height)
    return height


@kernel
def _raise(x, faces, own, skin, graph, height):
    kind = x.dtype.type
    highest, evened, zero = kind(HIGHEST_M), kind(EVENED), kind(0)
    lies = _normals(x, faces)
    alone = np.zeros_like(height)
    for v in range(len(x)):
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            normal = (skin[s, 4], skin[s, 5], skin[s, 6])
            way = sub(at(x, v), at(skin, s))
            up = dot(way, normal)
            if up > alone[s] and dot(way, way) - up * up < graph.reach_m2[s]:
                alone[s] = max(alone[s], min(up, highest) * dot(at(lies, v), normal))
    for s in range(len(skin)):
        if alone[s] > zero:
            mean = zero
            for n in range(NEIGHBOURS):
                mean += alone[graph.neighbour[s, n]] / kind(NEIGHBOURS)
            height[s] = alone[s] + evened * (mean - alone[s])


@kernel
def _normals(x, faces):
    """Unit normals (V, 3) of the vertices ``x`` (V, 3), by the areas of their ``faces``; 0 where there is no area."""
    found = np.zeros_like(x)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = cross(sub(at(x, b), at(x, a)), sub(at(x, c), at(x, a)))
        for v in (a, b, c):
            for axis in range(3):
                found[v, axis] += area[axis]
    for v in range(len(x)):
        length = np.sqrt(dot(at(found, v), at(found, v)))
        for axis in range(3):
            found[v, axis] = found[v, axis] / length if length > 0.0 else length
    return found
