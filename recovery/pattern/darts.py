"""Darts in a waist: wedges that open to the outline, so that a flat panel takes the shape of a hip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.errors import InputError
from recovery.pattern.design import Assembly
from recovery.pattern.drafting import Drafted, Point, Side


@dataclass(frozen=True)
class Dart:
    """A wedge ``width_m`` wide at the waist and ``depth_m`` deep, its middle at ``share`` of the waist's length."""

    share: float
    width_m: float
    depth_m: float


def waist_with_darts(name: str, start: Point, end: Point, darts: Sequence[Dart]) -> list[Side]:
    """Sides from ``start`` to ``end``: pieces of waist NAME_0, NAME_1, ... with a dart between each two.

    The distance from start to end is that of the sewn waist and the darts. Raises ``InputError`` where darts overlap.
    """
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    inward = np.array([-along[1], along[0]])  # the outline runs counter-clockwise
    sides = []
    here = a
    for number, dart in enumerate(darts):
        before = a + (dart.share * length - 0.5 * dart.width_m) * along
        after, tip = before + dart.width_m * along, before + 0.5 * dart.width_m * along + dart.depth_m * inward
        if (before - here) @ along < 0.01 or (b - after) @ along < 0.01:
            raise InputError(
                f"dart {number} of {name}",
                expected="a centimetre of waist beside every dart",
                got=f"darts of {[round(d.width_m, 3) for d in darts]} m in {length:.3f} m",
                cure="Take fewer or narrower darts.",
            )
        sides += [
            Side(f"{name}_{number}", _point(here)),
            Side(f"{name}_dart_{number}_in", _point(before)),
            Side(f"{name}_dart_{number}_out", _point(tip)),
        ]
        here = after
    return [*sides, Side(f"{name}_{len(darts)}", _point(here))]


def _point(place: np.ndarray) -> Point:
    return (float(place[0]), float(place[1]))


def sew_darts(work: Assembly, drafted: Drafted) -> None:
    """Sews both legs of every dart in the panel ``drafted`` to each other."""
    for side in drafted.numbers:
        if side.endswith("_in"):
            work.sew(f"dart_{drafted.panel.name}_{side[:-3]}", drafted, side, drafted, side[:-3] + "_out")


def waist_pieces(drafted: Drafted, name: str) -> list[tuple[Drafted, str]]:
    """Returns the pieces of the waist ``name`` in the order in which a band above meets them, from the viewer's left to
    the right: each the panel and the name of its side."""
    pieces = [side for side in drafted.numbers if side.startswith(f"{name}_") and side[len(name) + 1 :].isdigit()]
    return [(drafted, side) for side in reversed(pieces)]
