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

import numpy as np

from drape.folds.sheet import LANES
from drape.folds.sweeps import PLANES, row3
from drape.solver.compiled import kernel
from drape.solver.elements import add, at, dot, scaled, sub

CLEARANCE_M = 0.0025  # that of the push-out, and less than contact's gap: cloth at rest is not lifted
OTHER = 0.25  # of the way out of another part


@kernel
def lift(x, planes, clearance, way):
    """Moves ``x`` [m] (P, 3) in place towards the ``clearance`` [m] of its ``planes``, as ``touch`` writes them, and
    writes how far, in ``way`` [m] (P,)."""
    one, other = x.dtype.type(1), x.dtype.type(OTHER)
    for block in range(len(x) // LANES):
        for lane in range(LANES):
            v = LANES * block + lane
            before = at(x, v)
            after = _above(before, planes, PLANES * block + 6 * LANES, lane, clearance, other)
            after = _above(after, planes, PLANES * block, lane, clearance, one)
            x[v, 0], x[v, 1], x[v, 2] = after
            moved = sub(after, before)
            way[v] = np.sqrt(dot(moved, moved))


@kernel
def _above(point, planes, row, lane, clearance, share):
    """``point`` with a ``share`` of its way to ``clearance`` over the plane that begins at ``row``, where it is lower.

    A plane that is not there has no normal.
    """
    normal = row3(planes, row + 3 * LANES, lane)
    low = clearance - dot(sub(point, row3(planes, row, lane)), normal)
    return add(point, scaled(share * low if low > clearance - clearance else low - low, normal))
