"""Drafting of panels from named sides: corners, curves by their Bezier points, mirror images, seams by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from recovery.pattern.geometry import on_chord
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.model import Edge, EdgeKind, EdgeRef, Panel, Placement

Point = tuple[float, float]
KINDS = (EdgeKind.LINE, EdgeKind.QUADRATIC, EdgeKind.CUBIC)
FRONT, BACK = (0.0, 0.0, 0.0), (0.0, 180.0, 0.0)  # rotations [deg] of panels before and behind the body
STAND_OFF_M = 0.06  # panels hang this far before and behind the body


@dataclass(frozen=True)
class Side:
    """A side of a drafted panel: its ``name``, where it starts, and up to two Bezier points, all [m]."""

    name: str
    start: Point
    handles: tuple[Point, ...] = ()


@dataclass(frozen=True, eq=False)
class Drafted:
    """A panel and the numbers of its edges by the names of its sides."""

    panel: Panel
    numbers: dict[str, int]

    def edge(self, side: str) -> EdgeRef:
        """The edge named ``side``."""
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
    """The panel bounded by ``sides``, counter-clockwise, drawn in its place as its viewer sees it.

    ``rotation`` is ``FRONT`` or ``BACK``, ``z`` [m] its distance before the origin; ``flip`` mirrors left and right;
    ``apart_m`` moves it to the right, or flipped to the left. The panel's own origin is the middle of the box of its
    corners.
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
    placement = Placement(rotation, (across, float(middle[1]), z))
    return Drafted(
        Panel(name, points - middle, tuple(edges), placement), {side.name: i for i, side in enumerate(sides)}
    )


def mirror(sides: Sequence[Side]) -> list[Side]:
    """``sides`` with left and right exchanged, again counter-clockwise and under the same names."""

    def reflected(point: Point) -> Point:
        return (-point[0], point[1])

    result = []
    for number in range(len(sides) - 1, -1, -1):
        end = sides[(number + 1) % len(sides)].start
        handles = tuple(reflected(handle) for handle in reversed(sides[number].handles))
        result.append(Side(sides[number].name, reflected(end), handles))
    return result


def on_ring(centre_y: float, radius: float, angle: float) -> Point:
    """The point of a circle round (0, ``centre_y``) at ``angle`` [rad] from straight below, to the right."""
    return (radius * float(np.sin(angle)), centre_y - radius * float(np.cos(angle)))


def ring_handles(centre_y: float, radius: float, start: float, end: float) -> tuple[Point, Point]:
    """Bezier points of that circle's arc from angle ``start`` to ``end``; a quarter is 0.03 % off."""
    reach = 4.0 / 3.0 * float(np.tan(0.25 * (end - start))) * radius
    (ax, ay), (bx, by) = on_ring(centre_y, radius, start), on_ring(centre_y, radius, end)
    return (
        (ax + reach * float(np.cos(start)), ay + reach * float(np.sin(start))),
        (bx - reach * float(np.cos(end)), by - reach * float(np.sin(end))),
    )


def before_and_behind(body: BodyMeasurements) -> tuple[tuple[str, tuple[float, float, float], float], ...]:
    """Name, rotation [deg] and distance z [m] of the panel that hangs before ``body`` and of the one behind it."""
    return ("front", FRONT, body.front_z + STAND_OFF_M), ("back", BACK, body.back_z - STAND_OFF_M)


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Returns where ``function`` is zero between ``low`` and ``high``, at which it has different signs, to a
    nanometre."""
    return float(brentq(function, low, high, xtol=1e-9))  # pyright: ignore[reportArgumentType]
