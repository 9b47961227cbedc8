"""The lift: the last thing in a frame, which brings cloth that is still in the skin up to the clearance.

Contact in the energy is a spring, and a few steps leave in the skin what came into it quickly. Each vertex that is
lower than the clearance h over a plane through p with the normal n goes up along it,

    x += share fade max(0, low) n,   low = h - n . (x - p),

``fade`` 1 up to ``DEEP_M`` and 0 from ``TOO_DEEP_M`` on: no contact leaves cloth so deep, the plane goes on there
beside the skin that it stands for. A quarter of the way out of the plane of another part comes first, then all of the
way out of that of the own part. Two parts of the body that overlap leave room for neither; going all of the way out of
both would tear the cloth at the border, and it is the own skin that has to be hidden. The planes are those of the
frame's contact, so that no skin is searched. The next frame begins with the lifted cloth, as in position-based dynamics
(Mueller et al. 2007, "Position Based Dynamics", J. Vis. Commun. Image Represent. 18(2)).
"""

from __future__ import annotations

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, dot, scaled, sub
from drape.kernels.lanes import least, most, points_in, put, put_points, root, rows3_at, where_above
from drape.live.sheet import LANES
from drape.live.skin_contact import own_plane
from drape.live.skin_walks import walk_lanes
from drape.live.sweeps import OTHER_PLANE, PLANES

OTHER = 0.25  # the share of the way out of another part
DEEP_M, TOO_DEEP_M = 0.006, 0.02  # below the clearance


@kernel
def lift(x, planes, clearance, way):
    """Moves ``x`` [m] (P, 3) in place up to the ``clearance`` [m] over the ``planes`` that ``touch`` wrote, and writes
    how far each vertex went to ``way`` [m] (P,)."""
    share, own, fade = x.dtype.type(OTHER), x.dtype.type(1), _fade(x)
    for block in range(len(x) // LANES):
        before, row = points_in(x, LANES * block), PLANES * block
        other = row + OTHER_PLANE
        after = _above(before, rows3_at(planes, other), rows3_at(planes, other + 3 * LANES), clearance, (share, fade))
        after = _above(after, rows3_at(planes, row), rows3_at(planes, row + 3 * LANES), clearance, (own, fade))
        _put(x, block, before, after, way)


@kernel
def lift_off_skin(x, skin, graph, touched, clearance, way):
    """``lift`` over the planes of ``drape.live.skin_contact.put_own_planes``, none of which is kept."""
    lanes, how = walk_lanes(skin), (x.dtype.type(1), _fade(x))
    for block in range(len(x) // LANES if clearance > 0.0 else 0):
        before = points_in(x, LANES * block)
        foot, unit = own_plane(before, LANES * block, touched, lanes, skin, graph)
        _put(x, block, before, _above(before, foot, unit, clearance, how), way)


@part
def _put(x, block, before, after, way):
    put_points(x, LANES * block, after)
    moved = sub(after, before)
    put(way, LANES * block, root(dot(moved, moved)))


@part
def _fade(x):
    """The depth from which a lift fades, and by how much of it a metre."""
    kind = x.dtype.type
    deep = kind(DEEP_M)
    return deep, kind(1) / (kind(TOO_DEEP_M) - deep)


@part
def _above(points, foot, normal, clearance, how):
    """``points`` after a share of their way up to ``clearance`` over the planes through ``foot``.

    Points that are higher or too deep stay. Where there is no plane its normal is zero.
    """
    share, (deep, fade) = how
    zero, one = share - share, share / share
    low = clearance - dot(sub(points, foot), normal)
    left = least(most(one - fade * (low - deep), zero), one)
    return add(points, scaled(where_above(low, zero, share * left * low, zero), normal))
