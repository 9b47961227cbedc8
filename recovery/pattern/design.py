"""A design: a pattern with the names of its edges and seams, its ease, and the panels that start bent.

Darts are wedges in a waist that open to the outline, so that a flat panel takes the shape of a hip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.drafting import Drafted, Point, Side, Wrap
from recovery.pattern.pieces import CLOTH_WIDTH_M
from recovery.pattern.sewing_pattern import EdgeRef, Panel, Pattern, Stitch

SEAM_TOLERANCE = 0.02  # share of the length by which edges may differ; what is eased or gathered on purpose is named
EASE_SLACK = 0.03  # share of the length by which a named ease may be missed


@dataclass(frozen=True, eq=False)
class Design:
    """A ``pattern`` with the intentions of its maker, and the name of its ``fabric``.

    Edges whose name in ``edge_names`` begins with "hem" are turned up, those with "opening" are bound. ``seam_names``
    has one name per stitch. By seam name, ``eased`` is the share by which the second edge is longer than the first, and
    ``seam_angles`` [rad] the fold at rest. Panels named in ``wraps`` start bent, those in ``over`` lie over others.
    ``ease_m`` [m] is what was added to the body's girths, by "chest", "arm", "waist" and "hips".
    """

    pattern: Pattern
    fabric: str
    edge_names: Mapping[EdgeRef, str]
    seam_names: tuple[str, ...]
    wraps: Mapping[str, Wrap] = field(default_factory=dict)
    over: frozenset[str] = frozenset()
    eased: Mapping[str, float] = field(default_factory=dict)
    seam_angles: Mapping[str, float] = field(default_factory=dict)
    ease_m: Mapping[str, float] = field(default_factory=dict)

    @property
    def hems(self) -> tuple[EdgeRef, ...]:
        """The edges that are turned up or bound, so that the cloth is double there."""
        return tuple(ref for ref, name in self.edge_names.items() if name.startswith(("hem", "opening")))


class Assembly:
    """The panels, wraps, seams and names of a design that is being drafted; ``eased`` as in ``Design``."""

    def __init__(self) -> None:
        self.panels: list[Panel] = []
        self.stitches: list[Stitch] = []
        self.seam_names: list[str] = []
        self.edge_names: dict[EdgeRef, str] = {}
        self.wraps: dict[str, Wrap] = {}
        self.eased: dict[str, float] = {}

    def add(self, drafted: Drafted, wrap: Wrap | None = None) -> Drafted:
        """Adds the panel of ``drafted``, which ``wrap`` bends if it is given, and returns ``drafted``. Its edges are
        named as its sides are."""
        self.panels.append(drafted.panel)
        for side in drafted.numbers:
            self.edge_names[drafted.edge(side)] = side
        if wrap is not None:
            self.wraps[drafted.panel.name] = wrap
        return drafted

    def sew(
        self, name: str, first: Drafted, first_side: str, second: Drafted, second_side: str, *, over: bool = False
    ) -> None:
        """Adds a seam called ``name`` between a side of each of two panels. With ``over`` the outside of the first
        continues in the inside of the second."""
        self.stitches.append(Stitch(first.edge(first_side), second.edge(second_side), right_to_wrong=over))
        self.seam_names.append(name)

    def sew_sides(self, parts: Sequence[str], front: Drafted, back: Drafted) -> None:
        """Adds a seam of front and back for each of ``parts``, such as "side", on both sides of the wearer.

        The sides of panels are called PART_left and PART_right as their viewer sees them. The wearer's left is on the
        viewer's right in front and on the viewer's left behind.
        """
        for seen, worn in (("right", "left"), ("left", "right")):
            for part in parts:
                self.sew(f"{part}_{worn}", front, f"{part}_{seen}", back, f"{part}_{worn}")

    def design(
        self,
        name: str,
        fabric: str,
        ease_m: Mapping[str, float],
        *,
        over: frozenset[str] = frozenset(),
        seam_angles: Mapping[str, float] = MappingProxyType({}),
    ) -> Design:
        """Returns the design of all panels and stitches so far. ``ease_m`` [m], ``over`` and ``seam_angles`` [rad] are
        those of ``Design``."""
        pattern = Pattern(name, tuple(self.panels), tuple(self.stitches), material=fabric)
        return Design(
            pattern,
            fabric,
            self.edge_names,
            tuple(self.seam_names),
            wraps=self.wraps,
            over=over,
            eased=self.eased,
            seam_angles=seam_angles,
            ease_m=ease_m,
        )


def check_seams(design: Design) -> None:
    """Raises ``InputError`` for a seam whose edges differ by more than ``SEAM_TOLERANCE`` of their length, or, if it is
    eased, by more than ``EASE_SLACK`` from its ease."""
    for seam, name in zip(geometry.seams(design.pattern), design.seam_names, strict=True):
        wanted = design.eased.get(name, 0.0)
        share = seam.second_m / seam.first_m - 1.0
        slack = SEAM_TOLERANCE if name not in design.eased else EASE_SLACK
        if abs(share - wanted) > slack:
            raise InputError(
                f"seam {name} of {design.pattern.name}",
                expected=f"{seam.stitch.second} longer than {seam.stitch.first} by {100 * wanted:.0f} %",
                got=f"{100 * share:.1f} %: {1e3 * seam.first_m:.0f} and {1e3 * seam.second_m:.0f} mm",
                cure="Move the corners until both edges are as long, or name the ease of a gathered seam.",
            )


def check_laid_flat(design: Design) -> None:
    """Raises ``InputError`` for a panel that is wider than the cloth, so that it cannot be laid out on it along the
    grain."""
    for panel in design.pattern.panels:
        width = float(np.ptp(geometry.outline(panel)[:, 0]))
        if width > CLOTH_WIDTH_M:
            raise InputError(
                f"panel {panel.name} of {design.pattern.name}",
                expected=f"at most {CLOTH_WIDTH_M} m across the grain, the width of the cloth",
                got=f"{width:.3f} m",
                cure="Cut it in two and sew the halves, or make the garment shorter.",
            )


@dataclass(frozen=True)
class Dart:
    """A wedge that is sewn closed, ``width_m`` [m] wide at the waist and ``depth_m`` [m] deep, with its middle at
    ``share`` of the waist's length."""

    share: float
    width_m: float
    depth_m: float


def waist_with_darts(name: str, start: Point, end: Point, darts: Sequence[Dart]) -> list[Side]:
    """Returns the sides of a panel from ``start`` to ``end`` [m]: pieces of waist NAME_0, NAME_1, ..., and after piece
    number i the legs NAME_dart_i_in and NAME_dart_i_out of a dart.

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
    """Adds seams to ``work`` that join both legs of every dart in the panel ``drafted``."""
    for side in drafted.numbers:
        if side.endswith("_in"):
            work.sew(f"dart_{drafted.panel.name}_{side[:-3]}", drafted, side, drafted, side[:-3] + "_out")


def waist_pieces(drafted: Drafted, name: str) -> list[tuple[Drafted, str]]:
    """Returns the pieces of the waist ``name`` in the order in which a band above meets them, from the viewer's left to
    the right, each as the panel and the name of its side."""
    pieces = [side for side in drafted.numbers if side.startswith(f"{name}_") and side[len(name) + 1 :].isdigit()]
    return [(drafted, side) for side in reversed(pieces)]
