"""Small panels and patterns with closed forms, shared by the tests of recovery.pattern."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from drape.body.assets import load_body
from recovery.pattern.measurements import BodyMeasurements, measure_body
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, PanelPlacement, Pattern, Stitch

FOLDS = {
    EdgeKind.LINE: (),
    EdgeKind.QUADRATIC: ((0.4, -0.2),),
    EdgeKind.CUBIC: ((0.3, 0.15), (0.7, -0.1)),
    EdgeKind.CIRCLE: ((0.5, 0.2),),
}


def rectangle(name: str = "front", width: float = 0.4, height: float = 0.6, **placement) -> Panel:
    """A rectangle [m] around its own origin; edges: hem, right side, top, left side."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * [width, height]
    edges = tuple(Edge(start, (start + 1) % 4) for start in range(4))
    return Panel(name, corners, edges, PanelPlacement(**placement))


def curved(name: str = "curved", kinds=tuple(EdgeKind)) -> Panel:
    """A quadrilateral, no two sides alike, with one edge of every kind."""
    corners = np.array([(0.0, 0.0), (0.5, 0.05), (0.45, 0.6), (-0.1, 0.4)])
    edges = tuple(Edge(number, (number + 1) % 4, kind, FOLDS[kind]) for number, kind in enumerate(kinds))
    return Panel(name, corners, edges)


def tube(front: Panel | None = None, back: Panel | None = None) -> Pattern:
    """Two rectangles joined at both sides, before and behind the body: a skirt of the simplest kind."""
    front = front or rectangle("front", translation_m=(0.0, 0.0, 0.2))
    back = back or rectangle("back", rotation_deg=(0.0, 180.0, 0.0), translation_m=(0.0, 0.0, -0.2))
    sides = [(EdgeRef("front", 1), EdgeRef("back", 3)), (EdgeRef("front", 3), EdgeRef("back", 1))]
    return Pattern("tube", (front, back), tuple(Stitch(first, second) for first, second in sides))


def lowered(pattern: Pattern, degrees: float, moved_m: tuple[float, float] = (0.0, 0.0)) -> Pattern:
    """``pattern`` with its sleeves as drawn for arms lowered by ``degrees``: turned, and moved inward and upward."""
    panels = []
    for panel in pattern.panels:
        if panel.name.startswith("sleeve"):
            place = panel.placement
            side = np.sign(place.apply(panel.vertices)[:, 0].mean())
            (a, b, c), (x, y, z) = place.rotation_deg, place.translation_m
            there = (x - side * moved_m[0], y + moved_m[1], z)
            panel = replace(panel, placement=PanelPlacement((a, b, c - float(side) * degrees), there))
        panels.append(panel)
    return replace(pattern, panels=tuple(panels))


def bent_cap(pattern: Pattern) -> Pattern:
    """``pattern`` with the tops of both halves of the left cap moved 2 cm towards the hand."""
    panels = []
    for panel in pattern.panels:
        vertices = panel.vertices.copy()
        if panel.name.startswith("sleeve_left"):
            vertices[0 if panel.name.endswith("front") else 1, 0] += 0.02
        panels.append(replace(panel, vertices=vertices))
    return replace(pattern, panels=tuple(panels))


@lru_cache(maxsize=1)
def default_measurements() -> BodyMeasurements:
    """The measurements of the shipped body."""
    return measure_body(load_body())


def assert_same_pattern(first: Pattern, second: Pattern, atol: float = 1e-9) -> None:
    """Fails unless both patterns say the same, lengths within ``atol`` metres and placements in the world too."""
    assert (first.name, first.material) == (second.name, second.material)
    assert first.panel_order == second.panel_order
    assert first.stitches == second.stitches
    assert [panel.name for panel in first.panels] == [panel.name for panel in second.panels]
    for one, other in zip(first.panels, second.panels, strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, rtol=0, atol=atol)
        np.testing.assert_allclose(one.placement.rotation_deg, other.placement.rotation_deg, rtol=0, atol=atol)
        np.testing.assert_allclose(one.placement.translation_m, other.placement.translation_m, rtol=0, atol=atol)
        assert one.label == other.label
        for left, right in zip(one.edges, other.edges, strict=True):
            assert (left.start, left.end, left.kind, left.label) == (right.start, right.end, right.kind, right.label)
            np.testing.assert_allclose(left.handles, right.handles, rtol=0, atol=atol)


def every_curve() -> Pattern:
    """Two panels with all kinds of edges, large and small arcs to both sides, sewn once."""
    round_ends = Panel(
        "röund end",
        np.array([(0.0, 0.0), (0.3, 0.0), (0.35, 0.5), (-0.05, 0.5)]),
        (
            Edge(0, 1, EdgeKind.CIRCLE, ((0.5, -0.2),)),
            Edge(1, 2),
            Edge(2, 3, EdgeKind.CIRCLE, ((0.5, -0.7),)),
            Edge(3, 0, EdgeKind.CIRCLE, ((0.5, 0.1),)),
        ),
    )
    stitch = Stitch(EdgeRef("curved", 1), EdgeRef("röund end", 1))
    return Pattern("every curve", (curved(), round_ends), (stitch,), material="wool")


def polygon_mm(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())
