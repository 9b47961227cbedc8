"""A shirt: two fronts that meet buttoned, back, sleeves with cuffs, a collar of stand and fall."""

from __future__ import annotations

import numpy as np

from recovery.pattern import geometry
from recovery.pattern.bands import BandShape, sew_band
from recovery.pattern.design import Assembly, Design
from recovery.pattern.drafting import (
    BACK,
    FRONT,
    Cone,
    Drafted,
    Point,
    Side,
    Tube,
    Vector,
    before_and_behind,
    draft,
    draft_round,
    on_ring,
    ring_handles,
)
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.tops import HOLLOWS, TopCut, bodice, lines, set_sleeves

NECK_LEAN_DEG = 24.0  # tilt of the neckline's plane, which is lower in front
BUTTONS_APART_M = 0.004  # distance of each front from the middle
STAND_RADIUS_M, FALL_RADIUS_M, FALL_SLANT = 0.088, 0.098, 0.75
STAND_M, FALL_M = 0.03, 0.048  # widths
SPREAD_M, POINT_M = 0.075, 0.022  # by which the fall's outer edge is longer than its fold, and its points are longer
TAIL_M = 0.05  # the hem is lower in the middle than at the sides by this
FOLD_RAD = -2.4  # angle of the fall over the stand, nearly flat on it; negative is away from the outside


def shirt(body: BodyMeasurements, cut: TopCut) -> Design:
    """Returns the shirt that ``cut`` describes, drafted for ``body``. Raises ``InputError`` where its lines do not
    meet."""
    neck, tip, _, hem = corners = lines(body, cut)
    work = Assembly()
    (_, _, front_z), (_, _, back_z) = before_and_behind(body)
    half, whole = (
        bodice(corners, depth=depth, hollow=hollow, inset=cut.armhole_inset, lower="hem")
        for depth, hollow in zip((cut.neck_depth_m, cut.back_neck_depth_m), HOLLOWS, strict=True)
    )
    back = work.add(draft("back", [*whole[:-1], _tail(hem, TAIL_M)], rotation=BACK, z=back_z))
    low = (0.0, hem[1] - TAIL_M)
    sides = [
        Side("hem", low, ((0.4 * hem[0], low[1]), (0.6 * hem[0], hem[1]))),
        *(Side(side.name.removesuffix("_right"), side.start, side.handles) for side in half[:4]),
        Side("centre", (0.0, neck[1] - cut.neck_depth_m)),
    ]
    fronts = {
        side: work.add(
            draft(f"front_{side}", sides, rotation=FRONT, z=front_z, flip=side == "right", apart_m=BUTTONS_APART_M)
        )
        for side in ("left", "right")
    }
    work.sew("buttons", fronts["left"], "centre", fronts["right"], "centre")
    for side, front in fronts.items():
        work.sew(f"side_{side}", front, "side", back, f"side_{side}")
        work.sew(f"shoulder_{side}", front, "shoulder", back, f"shoulder_{side}")
    if cut.sleeve is not None:
        armholes = {side: ((front, "armhole"), (back, f"armhole_{side}")) for side, front in fronts.items()}
        set_sleeves(work, body, cut.sleeve, tip, armholes)
    _collar(work, body, cut, fronts, back)
    over, angles = frozenset({"collar_fall"}), {"collar_fold": FOLD_RAD}
    return work.design(cut.name, cut.fabric, cut.ease_m, over=over, seam_angles=angles)


def _tail(hem: Point, tail: float) -> Side:
    """The back's hem, lower in the middle: one curve from side to side, level where it begins and ends."""
    return Side(
        "hem",
        (-hem[0], hem[1]),
        ((-0.3 * hem[0], hem[1] - 4.0 / 3.0 * tail), (0.3 * hem[0], hem[1] - 4.0 / 3.0 * tail)),
    )


def _collar(work: Assembly, body: BodyMeasurements, cut: TopCut, fronts: dict[str, Drafted], back: Drafted) -> None:
    """Stand and fall, from the middle of the front over the wearer's left round the neck."""
    edges = [(fronts["left"], "neck"), (back, "neck_left"), (back, "neck_right"), (fronts["right"], "neck")]
    lean = np.radians(NECK_LEAN_DEG)
    axis: Vector = (0.0, float(np.cos(lean)), float(np.sin(lean)))
    behind: Vector = (0.0, float(np.sin(lean)), -float(np.cos(lean)))
    low = np.array([0.0, body.neck_y - 0.3 * (cut.neck_depth_m + cut.back_neck_depth_m) + 0.01, body.arm_z])
    tube = Tube(_vector(low), axis, behind, STAND_RADIUS_M)
    stand = sew_band(work, BandShape("collar_stand", STAND_M, 0.0, above=True, free="fold"), edges, tube)
    top = "fold_collar_stand"
    length = geometry.edge_length(stand.panel, stand.numbers[top])
    turn = SPREAD_M / FALL_M  # angle [rad] of the ring sector that the fall is
    ring = length / turn
    half, outer = 0.5 * turn, ring + FALL_M

    def edge(longer: float, share: float) -> Point:
        """A point of the outer edge, ``longer`` of the collar's point, at ``share`` of the half angle."""
        return on_ring(ring, outer + longer * POINT_M, share * half)

    sides = [
        Side("hem_collar_left", edge(1.0, -1.0), (edge(0.3, -0.75), edge(0.0, -0.35))),
        Side("hem_collar_right", edge(0.0, 0.0), (edge(0.0, 0.35), edge(0.3, 0.75))),
        Side("opening_right", edge(1.0, 1.0)),
        Side("fold", on_ring(ring, ring, half), ring_handles(ring, ring, half, -half)),
        Side("opening_left", on_ring(ring, ring, -half)),
    ]
    origin = _vector(low + STAND_M * np.array(axis))
    cone = Cone(origin, axis, behind, FALL_RADIUS_M, ring, FALL_SLANT)
    fall = work.add(*draft_round("collar_fall", sides, cone))
    work.sew("collar_fold", stand, top, fall, "fold", over=True)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
