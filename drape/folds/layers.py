"""Layers: the skin that an outer garment feels is raised by the cloth that lies on it.

A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over it, within its
spacing. Planes of the raised samples are blended as those of the skin are, so that an outer garment rests on the inner
one as that does on the body, with the same gap, and where nothing is worn below nothing changes. The skin tells on
which side a layer is, so that this cannot be lost.
"""

from __future__ import annotations

import numpy as np

from drape.folds.contact import NEIGHBOURS, SkinGraph
from drape.push.samples import sample_table
from drape.solver.compiled import kernel
from drape.solver.elements import at, dot, sub

HIGHEST_M = 0.06  # cloth higher than that hangs free, and is left to the push-out


def raised(skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """``skin`` (..., S, 8), of ``drape.push.samples.sample_table``, ``height`` [m] (..., S) out along its normals."""
    normal = skin[..., 4:7]
    return np.asarray(sample_table(skin[..., :3] + height[..., None] * normal, normal))


def covered(vertices: np.ndarray, own: np.ndarray, skin: np.ndarray, graph: SkinGraph) -> np.ndarray:
    """Heights [m] (S,) of a garment over the samples ``skin`` (S, 8), 0 where none of its vertices is over one.

    ``vertices`` [m] (V, 3), each at the sample ``own`` (V,): it and its neighbours are raised.
    """
    height = np.zeros(len(skin), vertices.dtype)
    _raise(vertices, own, np.array(skin, dtype=vertices.dtype, order="C"), graph, height)
    return height


@kernel
def _raise(x, own, skin, graph, height):
    for v in range(len(x)):
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            way = sub(at(x, v), at(skin, s))
            up = dot(way, (skin[s, 4], skin[s, 5], skin[s, 6]))
            if up > height[s] and dot(way, way) - up * up < graph.reach_m2[s]:
                height[s] = min(up, x.dtype.type(HIGHEST_M))
