"""Layers: the skin that an outer garment feels is raised by the cloth that lies on it.

A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over it, within its
spacing. Cloth that spans a crease (trousers before the belly of one who squats) is far from both of its walls, which
raised by that would stand in each other and crumple what is worn over them. So a sample goes no farther than half of
the way to skin that faces it, but where the cloth faces as the skin does, by its height times the cosine between both
normals at least. Planes of the raised samples are blended as those of the skin are: an outer garment rests on the inner
one as that does on the body, with the same gap, and where nothing is worn below nothing changes. The skin tells on
which side a layer is, so that this cannot be lost.
"""

from __future__ import annotations

import numpy as np

from drape.contact.samples import sample_table
from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, dot, scaled, sub
from drape.live.sheet import LANES, Sheet
from drape.live.skin_contact import NEIGHBOURS, PER_CELL, SkinGraph, cells_of
from drape.live.surface_frames import FRAMES, surface_frames

HIGHEST_M = 0.06  # cloth higher than that hangs free, and is left to the push-out
SPANNED_M = 0.005  # how much farther cloth is than it faces where a look at what is across is worth while
ASIDE = 3.0  # in spacings: how far off a sample's normal is what it faces


def raised(skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """``skin`` (..., S, 8), a ``drape.contact.samples.sample_table``, ``height`` [m] (..., S) out along its normals."""
    normal = skin[..., 4:7]
    return np.asarray(sample_table(skin[..., :3] + height[..., None] * normal, normal))


def covered(vertices: np.ndarray, sheet: Sheet, own: np.ndarray, skin: np.ndarray, graph: SkinGraph) -> np.ndarray:
    """Heights [m] (S,) of a garment over the samples ``skin`` (S, 8), 0 where none of its vertices is over one.

    ``vertices`` [m] (V, 3) of a ``sheet`` whose triangles face outward, each place at the sample ``own`` (P,): it and
    its neighbours are raised.
    """
    x = np.take(vertices, sheet.vertex, axis=0)
    height = np.zeros(len(skin), x.dtype)
    _raise(x, sheet, own, np.array(skin, dtype=x.dtype, order="C"), graph, height)
    return height


@kernel
def _raise(x, sheet, own, skin, graph, height):
    kind = x.dtype.type
    highest, spanned = kind(HIGHEST_M), kind(SPANNED_M)
    frames = np.empty(FRAMES // LANES * len(x), x.dtype)
    surface_frames(x, sheet, frames)
    far = np.zeros_like(height)
    for v in range(len(x)):
        row = FRAMES * (v // LANES) + v % LANES
        lies = (frames[row], frames[row + LANES], frames[row + 2 * LANES])
        for n in range(-1, NEIGHBOURS):
            s = own[v] if n < 0 else graph.neighbour[own[v], n]
            normal = (skin[s, 4], skin[s, 5], skin[s, 6])
            way = sub(at(x, v), at(skin, s))
            up = dot(way, normal)
            if up > height[s] and dot(way, way) - up * up < graph.reach_m2[s]:
                up = min(up, highest)
                far[s] = max(far[s], up)
                height[s] = max(height[s], up * dot(lies, normal))
    cells = cells_of(skin, PER_CELL)
    for s in range(len(skin)):
        if far[s] > height[s] + spanned:
            height[s] = max(height[s], _half_way(s, far[s], skin, graph, cells))
        else:
            height[s] = far[s]


@kernel
def _half_way(s, far, skin, graph, cells):
    """Half of the distance [m] along the normal from sample ``s`` to skin that faces it, ``far`` [m] at most."""
    start, member, low, size = cells
    normal, aside = (skin[s, 4], skin[s, 5], skin[s, 6]), skin.dtype.type(ASIDE * ASIDE) * graph.reach_m2[s]
    middle, reach = add(at(skin, s), scaled(far, normal)), far + np.sqrt(aside)
    nearest = far + far
    first = (
        max(int((middle[0] - reach - low[0]) * PER_CELL), 0),
        max(int((middle[1] - reach - low[1]) * PER_CELL), 0),
        max(int((middle[2] - reach - low[2]) * PER_CELL), 0),
    )
    last = (
        min(int((middle[0] + reach - low[0]) * PER_CELL) + 1, size[0]),
        min(int((middle[1] + reach - low[1]) * PER_CELL) + 1, size[1]),
        min(int((middle[2] + reach - low[2]) * PER_CELL) + 1, size[2]),
    )
    for i in range(first[0], last[0]):
        for j in range(first[1], last[1]):
            for k in range(first[2], last[2]):
                c = (i * size[1] + j) * size[2] + k
                for m in range(start[c], start[c + 1]):
                    other = member[m]
                    way = sub(at(skin, other), at(skin, s))
                    along = dot(way, normal)
                    facing = dot(normal, (skin[other, 4], skin[other, 5], skin[other, 6]))
                    if 0.0 < along < nearest and facing < 0.0 and dot(way, way) - along * along < aside:
                        nearest = along
    return skin.dtype.type(0.5) * nearest
