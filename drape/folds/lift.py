"""The last of a frame: what is still in the skin, or nearer to it than it may be, goes up to there.

Contact in the energy is a spring, and a few steps leave in the skin what came into it quickly. So each vertex below the
clearance h of a plane, at the point p with the normal n, is lifted along it,

    x += share max(0, h - n . (x - p)) n,

a quarter of the way out of the plane of another part first, then all of it out of that of its own: where body lies in
body there is no room for either, all of both would tear cloth apart at the border, and the own skin is what has to be
covered. Planes are those of the frame's contact, so that no skin is searched. The lifted cloth is what the next frame
begins with, as in position-based dynamics (Mueller et al. 2007, "Position Based Dynamics", J. Vis. Commun. Image
Represent. 18(2)).
"""

from __future__ import annotations

from drape.folds.sheet import LANES
from drape.folds.sweeps import PLANES
from drape.solver.compiled import kernel, part
from drape.solver.elements import add, dot, scaled, sub
from drape.solver.lanes import points_in, put, put_points, root, rows3_at, where_above

OTHER = 0.25  # of the way out of another part


@kernel
def lift(x, planes, clearance, way):
    """Moves ``x`` [m] (P, 3) in place towards the ``clearance`` [m] of its ``planes``, as ``touch`` writes them, and
    writes how far, in ``way`` [m] (P,)."""
    one, other = x.dtype.type(1), x.dtype.type(OTHER)
    for block in range(len(x) // LANES):
        before = points_in(x, LANES * block)
        after = _above(before, planes, PLANES * block + 6 * LANES, clearance, other)
        after = _above(after, planes, PLANES * block, clearance, one)
        put_points(x, LANES * block, after)
        moved = sub(after, before)
        put(way, LANES * block, root(dot(moved, moved)))


@part
def _above(points, planes, row, clearance, share):
    """``points`` with a ``share`` of their way to ``clearance`` over the planes that begin at ``row``, where they are
    lower. A plane that is not there has no normal."""
    normal = rows3_at(planes, row + 3 * LANES)
    low = clearance - dot(sub(points, rows3_at(planes, row)), normal)
    return add(points, scaled(share * where_above(low, clearance - clearance, low, clearance - clearance), normal))
