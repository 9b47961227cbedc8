"""The skin that an outer garment feels, raised by the cloth that lies on it.

A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over it, within the
samples' spacing. The planes of raised samples are blended as those of the skin are. So an outer garment rests on the
inner one as that does on the body, with the same gap. Nothing changes where nothing is worn below. The skin tells on
which side of the inner garment the outer one is, so that this side cannot be lost.

Cloth may span a crease: trousers hang before the belly of one who squats, far from both of its walls. Walls that were
raised to that cloth would stand in each other and crumple the outer garment. A sample therefore goes no farther than
half of the way to skin that faces it; but it goes at least as far as the height of the vertex times the cosine between
the cloth's normal and the skin's.

A sample that rises above ``CLOSE_M`` rises above its neighbours below cloth by no more than ``STEEPEST`` of their
distance. Loose cloth raises one sample by centimetres more than the next, and no outer garment follows such a ground
without passing through itself.
"""

from __future__ import annotations

import numpy as np

from drape.contact.samples import sample_table
from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, dot, scaled, sub
from drape.kernels.grid import cells_within, column, grid_of
from drape.live.clock import writable
from drape.live.sheet import LANES, Sheet
from drape.live.skin_contact import PER_CELL
from drape.live.skin_walks import NEIGHBOURS, SkinGraph
from drape.live.surface_frames import FRAMES, surface_frames

HIGHEST_M = 0.06  # cloth higher than that hangs free, and is left to the push-out
SPANNED_M = 0.005  # where height and height times cosine differ by less, no look is taken at what lies across
CLOSE_M, STEEPEST, TURNS = 0.02, 0.7, 3  # the turns that look for steep samples, there and back
ASIDE = 3.0  # in spacings: skin farther than that off a sample's normal does not face it


def raised(skin: np.ndarray, height: np.ndarray) -> np.ndarray:
    """``skin`` (..., S, 8), a ``drape.contact.samples.sample_table``, ``height`` [m] (..., S) out along its normals."""
    normal = skin[..., 4:7]
    return np.ascontiguousarray(sample_table(skin[..., :3] + height[..., None] * normal, normal))


def heights_over(vertices: np.ndarray, sheet: Sheet, own: np.ndarray, skin: np.ndarray, graph: SkinGraph) -> np.ndarray:
    """How high [m] (S,) a garment raises each of the samples ``skin`` (S, 8): 0 where no vertex lies over it.

    The garment is a ``sheet`` with its ``vertices`` [m] (V, 3), and its triangles face outward. Each place raises the
    sample that it is at, ``own`` (P,), and that sample's neighbours in ``graph``.
    """
    x = np.take(vertices, sheet.vertex, axis=0)
    height = np.zeros(len(skin), x.dtype)
    _raise(x, sheet, own, writable(skin, x.dtype), graph, height)
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
    grid = grid_of(skin, PER_CELL)
    for s in range(len(skin)):
        if far[s] > height[s] + spanned:
            height[s] = max(height[s], _half_way(s, far[s], skin, graph, grid))
        else:
            height[s] = far[s]
    _flatten(height, graph)


@kernel
def _flatten(height, graph):
    """Lowers what is too steep, in place."""
    close, steepest = height.dtype.type(CLOSE_M), height.dtype.type(STEEPEST)
    for turn in range(2 * TURNS):
        for entry in range(len(height)):
            s = entry if turn % 2 == 0 else len(height) - 1 - entry
            if not height[s] > close:
                continue
            for n in range(NEIGHBOURS):
                other = graph.neighbour[s, n]
                if not height[other] > 0:
                    continue
                apart = sub(at(graph.rest, s), at(graph.rest, other))
                height[s] = min(height[s], max(height[other] + steepest * np.sqrt(dot(apart, apart)), close))


@kernel
def _half_way(s, far, skin, graph, grid):
    """Half of the distance [m] along the normal from sample ``s`` to skin that faces it, ``far`` [m] at most."""
    normal, aside = (skin[s, 4], skin[s, 5], skin[s, 6]), skin.dtype.type(ASIDE * ASIDE) * graph.reach_m2[s]
    middle, reach = add(at(skin, s), scaled(far, normal)), far + np.sqrt(aside)
    nearest, around = far + far, (reach, reach, reach)
    first, last = cells_within(grid, sub(middle, around), add(middle, around))
    for i in range(first[0], last[0]):
        for j in range(first[1], last[1]):
            begin, end = column(grid, i, j, first, last)
            for entry in range(begin, end):
                other = grid.member[entry]
                way = sub(at(skin, other), at(skin, s))
                along = dot(way, normal)
                facing = dot(normal, (skin[other, 4], skin[other, 5], skin[other, 6]))
                if 0.0 < along < nearest and facing < 0.0 and dot(way, way) - along * along < aside:
                    nearest = along
    return skin.dtype.type(0.5) * nearest
