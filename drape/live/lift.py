"""The last of a frame: what is still in the skin, or nearer to it than it may be, goes up to there.

Contact in the energy is a spring, and a few steps leave in the skin what came into it quickly. So each vertex below the
clearance h of a plane, at the point p with the normal n, is lifted along it,

    x += share max(0, h - n . (x - p)) n,

but where it is deeper than any contact leaves it, which is beside the skin that a plane goes on from, and not on it:
from ``DEEP_M`` on less, from ``TOO_DEEP_M`` on nothing. A quarter of the way out of the plane of another part comes
first, then all of it out of that of its own: where body lies in body there is no room for either, all of both would
tear cloth apart at the border, and the own skin is what has to be covered. Planes are those of the frame's contact, so
that no skin is searched. The lifted cloth is what the next frame begins with, as in position-based dynamics (Mueller et
al. 2007, "Position Based Dynamics", J. Vis. Commun. Image Represent. 18(2)).
"""

from __future__ import annotations

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, dot, scaled, sub
from drape.kernels.lanes import least, most, points_in, put, put_points, root, rows3_at, where_above
from drape.live.sheet import LANES
from drape.live.sweeps import PLANES

OTHER = 0.25  # of the way out of another part
DEEP_M, TOO_DEEP_M = 0.006, 0.02  # below the clearance


@kernel
def lift(x, planes, clearance, way):
    """Moves ``x`` [m] (P, 3) in place towards the ``clearance`` [m] of its ``planes``, as ``touch`` writes them, and
    writes how far, in ``way`` [m] (P,)."""
    kind = x.dtype.type
    one, other, deep = kind(1), kind(OTHER), kind(DEEP_M)
    fade = one / (kind(TOO_DEEP_M) - deep)
    for block in range(len(x) // LANES):
        before = points_in(x, LANES * block)
        after = _above(before, planes, PLANES * block + 6 * LANES, clearance, (other, deep, fade))
        after = _above(after, planes, PLANES * block, clearance, (one, deep, fade))
        put_points(x, LANES * block, after)
        moved = sub(after, before)
        put(way, LANES * block, root(dot(moved, moved)))


@part
def _above(points, planes, row, clearance, how):
    """``points`` with a share of their way to ``clearance`` over the planes that begin at ``row``, where they are lower
    but not too deep. A plane that is not there has no normal."""
    share, deep, fade = how
    zero, one = share - share, share / share
    normal = rows3_at(planes, row + 3 * LANES)
    low = clearance - dot(sub(points, rows3_at(planes, row)), normal)
    left = least(most(one - fade * (low - deep), zero), one)
    return add(points, scaled(where_above(low, zero, share * left * low, zero), normal))
