"""What a cutting line leaves out and goes into: darts, which stay closed, and hollows narrower than two allowances."""

from __future__ import annotations

import numpy as np

from recovery.pattern import geometry
from recovery.pattern.sewing_pattern import Panel, Pattern
from recovery.pattern.triangulate import boundary_distance

STEP_M = 0.002  # along the outline, between places whose gap is measured
SLIT_M = 0.001  # width of a cut in the middle of a narrow hollow; a quarter of a gap that is narrower than two
FAN_RAD = 0.1  # between the directions in which a gap is measured at a corner
FACING = -0.68  # the cosine between the ways to both sides of a hollow: of a wedge of 47 degrees, mitred by 2.5
NARROWEST_M = 2.5e-4  # half a gap
TIP_M, TIP_RAD = 0.004, 0.5  # a cut ends so far from a hollow's corner, which turns by more than so much
REACH = 1.1  # allowances from the outline, to where the middle of a hollow that widens is followed


def dart_legs(pattern: Pattern, panel: Panel, tolerance_m: float) -> set[int]:
    """Numbers of the edges that are legs of darts: neighbours that are sewn together, with a wedge between them."""
    sewn = {}
    for stitch in pattern.stitches:
        if stitch.first.panel == stitch.second.panel == panel.name:
            sewn |= {stitch.first.edge: stitch.second.edge, stitch.second.edge: stitch.first.edge}
    left, count = list(range(len(panel.edges))), len(panel.edges)

    def is_dart(first: int, second: int) -> bool:
        run = [(first + k) % count for k in range((second - first) % count + 1)]
        line = np.concatenate([geometry.flatten(panel, number, tolerance_m) for number in run])
        x, y = (line - line[0]).T
        width = float(np.linalg.norm(line[-1] - line[0]))
        return x @ np.roll(y, -1) < y @ np.roll(x, -1) and width < geometry.edge_length(panel, first)

    # Legs of several edges close from the tip on.
    while len(left) > 2 and (
        pair := next(
            (p for p in zip(left, left[1:] + left[:1], strict=True) if sewn.get(p[0]) == p[1] and is_dart(*p)), None
        )
    ):
        left = [number for number in left if number not in pair]
    return set(range(count)) - set(left)


def slits(polygon: np.ndarray, reach_m: float, mitre: float) -> list[tuple[np.ndarray, float]]:
    """Middle lines [m] (N, 2) of hollows of the counter-clockwise ``polygon`` narrower than twice ``reach_m``, and half
    the widths [m] of the cuts there; each runs out of its hollow by ``mitre`` times ``reach_m``.

    A point of the middle line is the centre of the largest circle that touches the outline from outside at one place
    (the medial axis; Blum 1967). It counts where the circle touches the other side across the hollow.
    """
    side = np.roll(polygon, -1, axis=0) - polygon
    angle = np.arctan2(-side[:, 0], side[:, 1])  # of the normals
    turn = np.mod(np.roll(angle, -1) - angle + np.pi, 2.0 * np.pi) - np.pi
    places, angles, at_corner = [], [], []
    for start, along, normal, bend in zip(polygon, side, angle, turn, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(along) / STEP_M)))
        fan = max(0, int(bend / FAN_RAD))
        share = np.concatenate([(np.arange(count) + 0.5) / count, np.ones(fan)])
        places.append(start + share[:, None] * along)
        angles.append(normal + np.concatenate([np.zeros(count), bend * (np.arange(fan) + 0.5) / max(fan, 1)]))
        at_corner.append(np.arange(count + fan) >= count)
    point, normal, corner = np.concatenate(places), np.concatenate(angles), np.concatenate(at_corner)
    normal = np.stack([np.cos(normal), np.sin(normal)], axis=1)
    high = np.where(corner, mitre, REACH) * reach_m

    def is_free(radius: np.ndarray) -> np.ndarray:
        return boundary_distance(point + radius[:, None] * normal, polygon) > 0.999 * radius - 1e-7

    number = np.flatnonzero(~is_free(high))
    point, normal, corner, high, low = (
        point[number],
        normal[number],
        corner[number],
        high[number],
        np.zeros(len(number)),
    )
    for _ in range(14):
        middle = 0.5 * (low + high)
        free = is_free(middle)
        low, high = np.where(free, middle, low), np.where(free, high, middle)
    centre = point + low[:, None] * normal
    beyond = boundary_distance(centre + 0.1 * low[:, None] * normal, polygon) - boundary_distance(centre, polygon)
    faces = beyond < FACING * 0.1 * low
    tips = polygon[np.roll(turn, 1) < -TIP_RAD]
    clear = (np.linalg.norm(centre[:, None] - tips, axis=2) > TIP_M).all(axis=1)
    kept = np.flatnonzero((low > NARROWEST_M) & (faces | corner) & clear)
    cuts = []
    for run in np.split(kept, np.flatnonzero(np.diff(number[kept]) > 1) + 1):
        if len(run) > 1 and (faces[run] & (low[run] < reach_m)).any():
            # Beyond a neck the hollow widens: the cut goes on to where there is room.
            first, last = run[[0, -1]]
            while first > 0 and number[first - 1] == number[first] - 1 and low[first - 1] > low[first]:
                first -= 1
            while last + 1 < len(low) and number[last + 1] == number[last] + 1 and low[last + 1] > low[last]:
                last += 1
            cuts.append((centre[first : last + 1], min(0.5 * SLIT_M, 0.5 * float(low[run].min()))))
    return cuts
