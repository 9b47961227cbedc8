"""Panels as they are drafted: outlines whose sides have names, flat before the body or bent round a part of it.

Sleeves start bent round an arm, bands round waist, neck and wrist, a ring hung in flutes. A panel that encloses a limb
cannot start flat beside it: the threads between its two edges would pass through the limb. On a cylinder it lies
without stretch: with the panel's point (u, v)

    world = origin + v axis + R (sin(u / R) (axis x front) + cos(u / R) front)
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from recovery.pattern.geometry import on_chord
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, PanelPlacement

Point = tuple[float, float]
KINDS = (EdgeKind.LINE, EdgeKind.QUADRATIC, EdgeKind.CUBIC)
FRONT, BACK = (0.0, 0.0, 0.0), (0.0, 180.0, 0.0)  # rotations [deg] of panels before and behind the body
STAND_OFF_M = 0.06  # panels hang this far before and behind the body
SLANT = 0.36  # how far the middle surface of a fluted ring goes outward, per metre down
UNEVEN = 0.5  # share of a flute's width by which its neighbours differ from it
DEPTH_STEPS = 64
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Side:
    """A side of a drafted panel: its ``name``, its ``start`` [m], and up to two Bezier points ``handles`` [m]. It ends
    where the next side starts."""

    name: str
    start: Point
    handles: tuple[Point, ...] = ()


@dataclass(frozen=True, eq=False)
class Drafted:
    """A drafted ``panel``, and the ``numbers`` of its edges by the names of its sides."""

    panel: Panel
    numbers: dict[str, int]

    def edge(self, side: str) -> EdgeRef:
        """Returns the reference to the edge that is the side called ``side``."""
        return EdgeRef(self.panel.name, self.numbers[side])


def draft(
    name: str,
    sides: Sequence[Side],
    *,
    rotation: tuple[float, float, float],
    z: float,
    flip: bool = False,
    apart_m: float = 0.0,
) -> Drafted:
    """Returns the panel called ``name`` bounded by ``sides``, which run counter-clockwise. Their points [m] are where
    the panel hangs, x to the right of a viewer who faces its outside, y up.

    ``rotation`` is ``FRONT`` or ``BACK``, ``z`` [m] the panel's place along the world's z. ``flip`` mirrors left and
    right. ``apart_m`` [m] moves the panel to the viewer's right, a flipped one to the left. The panel's own origin is
    the middle of the box of its corners.
    """
    if flip:
        sides = mirror(sides)
    points = np.array([side.start for side in sides])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    edges = []
    for number, side in enumerate(sides):
        following = (number + 1) % len(sides)
        handles = on_chord(np.array(side.handles).reshape(-1, 2), points[number], points[following])
        edges.append(Edge(number, following, KINDS[len(handles)], handles))
    seen = float(middle[0]) + (-apart_m if flip else apart_m)
    across = -seen if rotation == BACK else seen
    placement = PanelPlacement(rotation, (across, float(middle[1]), z))
    return Drafted(
        Panel(name, points - middle, tuple(edges), placement), {side.name: i for i, side in enumerate(sides)}
    )


def mirror(sides: Sequence[Side]) -> list[Side]:
    """Returns ``sides`` with left and right exchanged, again counter-clockwise and under the same names."""

    def reflected(point: Point) -> Point:
        return (-point[0], point[1])

    result = []
    for number in range(len(sides) - 1, -1, -1):
        end = sides[(number + 1) % len(sides)].start
        handles = tuple(reflected(handle) for handle in reversed(sides[number].handles))
        result.append(Side(sides[number].name, reflected(end), handles))
    return result


def on_ring(centre_y: float, radius: float, angle: float) -> Point:
    """Returns the point [m] of a circle of ``radius`` [m] round (0, ``centre_y``) at ``angle`` [rad] from straight
    below, to the right."""
    return (radius * float(np.sin(angle)), centre_y - radius * float(np.cos(angle)))


def ring_handles(centre_y: float, radius: float, start: float, end: float) -> tuple[Point, Point]:
    """Returns the Bezier points [m] of the arc from angle ``start`` to ``end`` [rad] on the circle of ``on_ring``; a
    quarter of it is 0.03 % off."""
    reach = 4.0 / 3.0 * float(np.tan(0.25 * (end - start))) * radius
    (ax, ay), (bx, by) = on_ring(centre_y, radius, start), on_ring(centre_y, radius, end)
    return (
        (ax + reach * float(np.cos(start)), ay + reach * float(np.sin(start))),
        (bx - reach * float(np.cos(end)), by - reach * float(np.sin(end))),
    )


def before_and_behind(body: BodyMeasurements) -> tuple[tuple[str, tuple[float, float, float], float], ...]:
    """Returns the name, the rotation [deg] and the place z [m] of the panel that hangs before ``body``, and those of
    the one behind it."""
    return ("front", FRONT, body.front_z + STAND_OFF_M), ("back", BACK, body.back_z - STAND_OFF_M)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Returns the number between ``low`` and ``high`` at which ``function`` is zero, to 1e-9. The signs of ``function``
    at both differ."""
    return float(brentq(function, low, high, xtol=1e-9))  # pyright: ignore[reportArgumentType]


# --- bent panels -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tube:
    """A cylinder of ``radius_m`` [m] about the line through ``origin`` [m] along the unit vector ``axis``, on which
    panels are bent.

    A panel's point (u, v) [m] lies u round it, from the direction of the unit vector ``front``, and v along it, which
    is the warp.
    """

    origin: Vector
    axis: Vector
    front: Vector
    radius_m: float

    def place(self, points: np.ndarray) -> np.ndarray:
        """Returns world positions [m] (N, 3) of ``points`` (u, v) [m] (N, 2)."""
        axis = np.array(self.axis)
        around = _around(axis, np.array(self.front), points[:, :1] / self.radius_m)
        return np.array(self.origin) + points[:, 1:] * axis + self.radius_m * around

    def tangent(self, point: np.ndarray) -> PanelPlacement:
        """Returns the placement of a flat panel that touches the tube at ``point`` (u, v) [m] (2,)."""
        axis = np.array(self.axis)
        place = self.place(point[None])[0]
        normal = (place - np.array(self.origin) - point[1] * axis) / self.radius_m
        turn = np.stack([np.cross(axis, normal), axis, normal], axis=1)
        with warnings.catch_warnings():
            # A panel seen edge-on has no single set of angles; any will do.
            warnings.simplefilter("ignore", UserWarning)
            angles = Rotation.from_matrix(turn).as_euler("xyz", degrees=True)
        return PanelPlacement(tuple(angles.tolist()), tuple(place.tolist()))


@dataclass(frozen=True)
class Flutes:
    """The shape of a flat ring of cloth that hangs from its inner circle round ``origin`` [m] in ``count`` flutes,
    turned by ``turn_rad``.

    The ring reaches from the radius ``inner_m`` to ``outer_m`` [m]. Panels are parts of it. A panel's point (u, v) [m]
    has its origin in the ring's middle, and the middle of the panel lies at u = 0, v < 0. Hanging, each circle of the
    flat ring is a wave of the same length round a cone. Flutes are a little uneven, as they fall.
    """

    origin: Vector
    inner_m: float
    outer_m: float
    count: int
    turn_rad: float = 0.0

    def place(self, points: np.ndarray) -> np.ndarray:
        """Returns world positions [m] (N, 3) of ``points`` (u, v) [m] (N, 2)."""
        angle = np.arctan2(points[:, 0], -points[:, 1]) + self.turn_rad
        down = np.hypot(points[:, 0], points[:, 1]) - self.inner_m
        along = np.linspace(0.0, self.outer_m - self.inner_m, DEPTH_STEPS)
        cone = self.inner_m + SLANT * along
        depth = np.array([self._depth(r, self.inner_m + s) for r, s in zip(cone, along, strict=True)])
        depth[0] = 0.0
        fall = np.sqrt(np.clip(1.0 - SLANT**2 - 0.5 * np.gradient(depth, along) ** 2, 0.2, 1.0))
        height = np.concatenate([[0.0], np.cumsum(0.5 * (fall[1:] + fall[:-1]) * np.diff(along))])
        wave = np.cos(self.count * angle + UNEVEN * np.sin(2.0 * angle + 0.7) + UNEVEN * np.sin(3.0 * angle + 2.0))
        radius = np.interp(down, along, cone) + np.interp(down, along, depth) * wave
        x, z = radius * np.sin(angle), radius * np.cos(angle)
        return np.array(self.origin) + np.stack([x, -np.interp(down, along, height), z], axis=1)

    def _depth(self, cone: float, circle: float) -> float:
        """The depth [m] of a wave round the radius ``cone`` that is as long as the circle of radius ``circle``."""
        angle = np.linspace(0.0, 2.0 * np.pi / self.count, 65)

        def excess(depth: float) -> float:
            across, on = cone + depth * np.cos(self.count * angle), self.count * depth * np.sin(self.count * angle)
            return float(np.hypot(across, on).mean()) - circle

        return 0.0 if excess(0.0) >= 0.0 else float(brentq(excess, 0.0, 2.0 * circle))  # pyright: ignore[reportArgumentType]

    def tangent(self, point: np.ndarray) -> PanelPlacement:
        """Returns a flat placement before or behind the body for ``point`` (u, v) [m] (2,), for programs that place
        panels flat."""
        turn = (0.0, float(np.degrees(self.turn_rad)), 0.0)
        offset = PanelPlacement(turn).apply(np.array([point]))[0]
        ahead = self.outer_m * np.array([np.sin(self.turn_rad), 0.0, np.cos(self.turn_rad)])
        return PanelPlacement(turn, tuple((np.array(self.origin) + offset + 0.3 * ahead).tolist()))


@dataclass(frozen=True)
class Cone:
    """A funnel that opens downward from a circle of ``radius_m`` [m] round ``origin``, ``slant`` outward per metre of
    cloth; ``axis`` and ``front`` are those of a tube.

    A panel's point (u, v) [m] is drawn on a ring round (0, ``ring_m``) whose inner arc, through (0, 0), goes round that
    circle.
    """

    origin: Vector
    axis: Vector
    front: Vector
    radius_m: float
    ring_m: float
    slant: float

    def place(self, points: np.ndarray) -> np.ndarray:
        """Returns world positions [m] (N, 3) of ``points`` (u, v) [m] (N, 2)."""
        axis = np.array(self.axis)
        off = points - np.array([0.0, self.ring_m])
        down = np.hypot(off[:, :1], off[:, 1:]) - self.ring_m
        angle = np.arctan2(off[:, :1], -off[:, 1:]) * self.ring_m / self.radius_m
        radius = self.radius_m + self.slant * down
        outward = radius * _around(axis, np.array(self.front), angle)
        return np.array(self.origin) - np.sqrt(1.0 - self.slant**2) * down * axis + outward

    def tangent(self, point: np.ndarray) -> PanelPlacement:
        """Returns a flat placement beside the funnel for ``point`` (u, v) [m] (2,)."""
        tube = Tube(self.origin, self.axis, self.front, self.radius_m)
        return tube.tangent(np.array([0.0, point[1]]))


def _around(axis: np.ndarray, front: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) at ``angle`` [rad] (N, 1) about ``axis`` (3,) from ``front`` (3,)."""
    return np.sin(angle) * np.cross(axis, front) + np.cos(angle) * front


@dataclass(frozen=True)
class Wrap:
    """The bend of a panel round ``tube``; the origin of the panel's frame lies at ``offset`` = (u, v) [m] there."""

    tube: Tube | Flutes | Cone
    offset: tuple[float, float]

    def place(self, points: np.ndarray) -> np.ndarray:
        """Returns world positions [m] (N, 3) of the panel's ``points`` [m] (N, 2)."""
        return self.tube.place(points + np.array(self.offset))


def draft_round(
    name: str, sides: Sequence[Side], tube: Tube | Flutes | Cone, *, flip: bool = False
) -> tuple[Drafted, Wrap]:
    """Returns the panel bounded by ``sides``, drawn in the tube's (u, v) as seen from outside, with a flat placement,
    and its bend round ``tube``. ``flip`` mirrors u."""
    drafted = draft(name, sides, rotation=FRONT, z=0.0, flip=flip)
    u, v, _ = drafted.panel.placement.translation_m
    wrap = Wrap(tube, (u, v))
    placement = tube.tangent(np.array([u, v]))
    return Drafted(replace(drafted.panel, placement=placement), drafted.numbers), wrap
