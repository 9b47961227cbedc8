"""A sewing pattern: flat panels, the edges that bound them, and the stitches that join edges.

A panel is drawn as the right side of the cloth is seen from outside; x is the weft and y the warp
(the grain). Its outline runs counter-clockwise. Lengths in metres, angles in degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drape.arrays import check_finite, check_shape
from drape.errors import InputError

SHORTEST_EDGE_M = 1e-6


class EdgeKind(StrEnum):
    """The curve of an edge from its start to its end: a line, a Bezier curve, or an arc of a circle."""

    LINE = "line"
    QUADRATIC = "quadratic"
    CUBIC = "cubic"
    CIRCLE = "circle"


HANDLE_COUNT: Mapping[EdgeKind, int] = MappingProxyType(
    {EdgeKind.LINE: 0, EdgeKind.QUADRATIC: 1, EdgeKind.CUBIC: 2, EdgeKind.CIRCLE: 1}
)


@dataclass(frozen=True)
class Edge:
    """One side of a panel, from vertex ``start`` to vertex ``end``.

    ``handles`` are (along, left) in the edge's own frame: shares of its chord along it and to its left, so that a curve
    keeps its shape when the chord moves. They are the inner Bezier points, or for a circular arc (0.5, h), its highest
    point: h is positive to the left, beyond 0.5 the arc is more than half a circle.
    """

    start: int
    end: int
    kind: EdgeKind = EdgeKind.LINE
    handles: tuple[tuple[float, float], ...] = ()
    label: str | None = None

    def __post_init__(self) -> None:
        handles = np.array(self.handles, dtype=np.float64).reshape(-1, 2)
        object.__setattr__(self, "handles", tuple((float(along), float(left)) for along, left in handles))
        if len(self.handles) != HANDLE_COUNT[self.kind]:
            raise InputError(
                "handles",
                expected=f"{HANDLE_COUNT[self.kind]} for a {self.kind} edge",
                got=f"{len(self.handles)}",
                cure="Give a quadratic edge one handle, a cubic edge two, an arc its highest point.",
            )
        check_finite("handles", handles)
        if self.kind is EdgeKind.CIRCLE and (self.handles[0][0] != 0.5 or self.handles[0][1] == 0.0):
            raise InputError(
                "handles",
                expected="(0.5, h) with h other than 0 for an arc",
                got=f"{self.handles[0]}",
                cure="Put the arc's highest point over the middle of its chord; without height it is a line.",
            )

    def reflected(self) -> Edge:
        """Returns the edge of the mirrored panel: left becomes right."""
        return replace(self, handles=tuple((along, -left) for along, left in self.handles))


@dataclass(frozen=True)
class PanelPlacement:
    """The place of a panel before it is sewn: world = R @ (x, y, 0) + translation.

    R turns about the fixed axes x, then y, then z by ``rotation_deg``. The panel's normal R @ z points
    away from the wearer.
    """

    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("rotation_deg", "translation_m"):
            values = np.array(getattr(self, name), dtype=np.float64)
            check_shape(name, values, (3,))
            check_finite(name, values)

    def matrix(self) -> np.ndarray:
        """Returns the rotation R (3, 3)."""
        return Rotation.from_euler("xyz", self.rotation_deg, degrees=True).as_matrix()

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Returns world positions [m] (N, 3) of panel ``points`` [m] (N, 2)."""
        return np.asarray(points) @ self.matrix()[:, :2].T + np.array(self.translation_m)


@dataclass(frozen=True, eq=False)
class Panel:
    """One piece of cloth: corner ``vertices`` [m] (C, 2) in its own frame, each used once, the closed loop of
    ``edges``, and its ``placement`` in the world."""

    name: str
    vertices: np.ndarray
    edges: tuple[Edge, ...]
    placement: PanelPlacement = PanelPlacement()
    label: str | None = None

    def __post_init__(self) -> None:
        where = f"panel {self.name}"
        vertices = np.array(self.vertices, dtype=np.float64)
        check_shape(f"{where}: vertices", vertices, (None, 2))
        check_finite(f"{where}: vertices", vertices)
        vertices.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "edges", tuple(self.edges))
        starts = [edge.start for edge in self.edges]
        ends = [edge.end for edge in self.edges]
        if not starts or ends != starts[1:] + starts[:1]:
            raise InputError(
                f"{where}: edges",
                expected="a closed loop, each edge starting where the one before it ends",
                got=f"{list(zip(starts, ends, strict=True))}",
                cure="List the edges in the order of the outline.",
            )
        if sorted(starts) != list(range(len(vertices))):
            raise InputError(
                f"{where}: edges",
                expected=f"one loop through each of the {len(vertices)} vertices once",
                got=f"starts {starts}",
                cure="Remove loose vertices; cut a panel with a hole into two.",
            )
        chords = vertices[ends] - vertices[starts]
        if (np.linalg.norm(chords, axis=1) < SHORTEST_EDGE_M).any():
            raise InputError(
                f"{where}: edges",
                expected=f"corners at least {SHORTEST_EDGE_M} m apart",
                got=f"edge {int(np.linalg.norm(chords, axis=1).argmin())} without length",
                cure="Merge the two corners; split a closed curve in two.",
            )


@dataclass(frozen=True)
class EdgeRef:
    """A reference to edge number ``edge`` of the panel named ``panel``."""

    panel: str
    edge: int

    def __str__(self) -> str:
        return f"{self.panel}[{self.edge}]"


@dataclass(frozen=True)
class Stitch:
    """Two edges sewn together over their whole length.

    The start of one meets the end of the other, which puts right side on right side. With ``right_to_wrong`` start
    meets start, and the outside of one panel continues in the inside of the other.
    """

    first: EdgeRef
    second: EdgeRef
    right_to_wrong: bool = False


@dataclass(frozen=True, eq=False)
class Pattern:
    """The panels of a garment and the stitches that join them.

    ``panel_order`` is the order of names that a data set agreed on, or None. ``material`` is a free note. ``template``
    holds what a file said beyond this model (template parameters, constraints), lengths in metres; ``notes`` say what
    reading changed.
    """

    name: str
    panels: tuple[Panel, ...]
    stitches: tuple[Stitch, ...] = ()
    material: str = ""
    panel_order: tuple[str, ...] | None = None
    template: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "panels", tuple(self.panels))
        object.__setattr__(self, "stitches", tuple(self.stitches))
        names = [panel.name for panel in self.panels]
        if not names or len(set(names)) != len(names):
            raise InputError(
                "panels", expected="one or more, each with its own name", got=f"{names}", cure="Rename the panels."
            )
        if self.panel_order is not None and sorted(self.panel_order) != sorted(names):
            raise InputError(
                "panel_order",
                expected=f"the names {sorted(names)}",
                got=f"{list(self.panel_order)}",
                cure="Leave it out.",
            )
        used: dict[EdgeRef, int] = {}
        for number, stitch in enumerate(self.stitches):
            for side in (stitch.first, stitch.second):
                if side.panel not in names or not 0 <= side.edge < len(self.panel(side.panel).edges):
                    raise InputError(
                        f"stitch {number}",
                        expected="edges that the pattern has",
                        got=f"{side}",
                        cure=f"Panels: {', '.join(names)}; edges count from 0 in the order of the outline.",
                    )
                if side in used:
                    raise InputError(
                        f"stitch {number}",
                        expected="every edge in one stitch",
                        got=f"{side}, already in stitch {used[side]}",
                        cure="Split the edge into the parts that are sewn to different edges.",
                    )
                used[side] = number

    def panel(self, name: str) -> Panel:
        """Returns the panel called ``name``. Raises ``InputError`` where there is none."""
        for panel in self.panels:
            if panel.name == name:
                return panel
        raise InputError("panel", expected=f"one of {[p.name for p in self.panels]}", got=name, cure="Check the name.")

    @property
    def sewn(self) -> set[EdgeRef]:
        """The edges that are in a stitch."""
        return {ref for stitch in self.stitches for ref in (stitch.first, stitch.second)}

    def edge_refs(self) -> list[EdgeRef]:
        """Every edge, panel by panel in the order of their outlines."""
        return [EdgeRef(panel.name, number) for panel in self.panels for number in range(len(panel.edges))]
