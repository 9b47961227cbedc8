"""Lines that cut panels, and joins of panels: closed forms of lengths, areas and angles; nothing is lost or bent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, Pattern, Stitch
from recovery.pattern.split import JOIN_M, Chain, Curve, curves, cut_level, divide_edges, fit_curve, join_panels, strips
from tests.recovery.pattern_setup import curved, rectangle, tube


def polygon(name: str, corners) -> Panel:
    count = len(corners)
    return Panel(name, np.array(corners), tuple(Edge(n, (n + 1) % count) for n in range(count)))


def lengths(pattern: Pattern, name: str) -> list[float]:
    panel = pattern.panel(name)
    return [geometry.edge_length(panel, number) for number in range(len(panel.edges))]


def area(pattern: Pattern) -> float:
    return sum(geometry.area(panel) for panel in pattern.panels)


def corners_deg(panel: Panel) -> np.ndarray:
    """Inner angles at the corners, between chords."""
    ahead = np.roll(panel.vertices, -1, axis=0) - panel.vertices
    back = np.roll(panel.vertices, 1, axis=0) - panel.vertices
    turn = np.arctan2(back[:, 1], back[:, 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    return np.degrees(turn) % 360.0


@pytest.mark.parametrize("number", range(4), ids=[str(kind) for kind in EdgeKind])
def test_a_divided_edge_is_the_same_curve(number):
    """Pieces have the shares of the length that were asked for, and the points of the whole."""
    whole = Pattern("one", (curved(),))
    found, pieces = divide_edges(whole, {EdgeRef("curved", number): [0.2, 0.5]})
    assert [ref.edge for ref in pieces[EdgeRef("curved", number)]] == [number, number + 1, number + 2]
    length = geometry.edge_length(whole.panels[0], number)
    assert_allclose(lengths(found, "curved")[number : number + 3], np.array([0.2, 0.3, 0.5]) * length, rtol=1e-9)
    edge, t = whole.panels[0].edges[number], np.linspace(0.0, 1.0, 9)
    for ref, (low, high) in zip(pieces[EdgeRef("curved", number)], ((0.0, 0.2), (0.2, 0.5), (0.5, 1.0)), strict=True):
        ends = geometry.parameters_at(edge, np.array([low, high]))
        here = geometry.edge_points(found.panels[0], ref.edge, t)
        assert_allclose(
            here, geometry.edge_points(whole.panels[0], number, ends[0] + t * (ends[1] - ends[0])), atol=1e-9
        )
    assert_allclose(area(found), area(whole), rtol=1e-12)


def test_the_partner_of_a_divided_edge_is_divided_where_it_meets_it():
    whole = tube()
    crossed = replace(whole.stitches[1], right_to_wrong=True)
    whole = replace(whole, stitches=(whole.stitches[0], crossed))
    found, _ = divide_edges(whole, {EdgeRef("front", 1): [0.25], EdgeRef("front", 3): [0.25]})
    assert_allclose(lengths(found, "front"), [0.4, 0.15, 0.45, 0.4, 0.15, 0.45], rtol=0.0, atol=1e-12)
    # Sewn face to face the partner runs the other way, right to wrong the same way.
    assert_allclose(lengths(found, "back"), [0.4, 0.15, 0.45, 0.4, 0.45, 0.15], rtol=0.0, atol=1e-12)
    assert len(found.stitches) == 4 and all(abs(seam.mismatch) < 1e-12 for seam in geometry.seams(found))


def test_a_place_that_both_edges_of_a_seam_ask_for_is_one_corner():
    found, _ = divide_edges(tube(), {EdgeRef("front", 1): [0.25, 0.0], EdgeRef("back", 3): [0.75, 1.0]})
    assert [len(panel.edges) for panel in found.panels] == [5, 5]


def test_a_strip_of_a_rectangle_is_a_rectangle():
    chains = [Chain((EdgeRef(name, 2),), f"{name}_band") for name in ("front", "back")]
    found = strips(tube(), chains, 0.05)
    assert [panel.name for panel in found.panels] == ["front", "front_band", "back", "back_band"]
    for name in ("front", "back"):
        assert_allclose(sorted(lengths(found, f"{name}_band")), [0.05, 0.05, 0.4, 0.4], rtol=0.0, atol=1e-12)
        assert_allclose(sorted(lengths(found, name)), [0.4, 0.4, 0.55, 0.55], rtol=0.0, atol=1e-12)
        assert_allclose(corners_deg(found.panel(f"{name}_band")), 90.0, atol=1e-9)
        assert found.panel(f"{name}_band").placement == tube().panel(name).placement
    assert_allclose(area(found), area(tube()), rtol=1e-12)
    assert len(found.stitches) == 6
    assert_allclose([seam.mismatch for seam in geometry.seams(found)], 0.0, atol=1e-12)


def test_the_width_is_measured_along_leaning_sides():
    """Of a triangle's stump with sides at 60 degrees: the new line is as much narrower on either side as it is cut."""
    side = 1.0
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0 - 0.5 * side, side * 0.75**0.5 - 0.1), (0.5 * side, side * 0.75**0.5 - 0.1)]
    low = 0.2
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0 - low, low * 3.0**0.5), (low, low * 3.0**0.5)]
    found = strips(Pattern("stump", (polygon("stump", corners),)), [Chain((EdgeRef("stump", 0),), "band")], 0.1)
    assert_allclose(sorted(lengths(found, "band")), [0.1, 0.1, 0.9, 1.0], rtol=0.0, atol=1e-12)
    assert_allclose(sorted(corners_deg(found.panel("band"))), [60.0, 60.0, 120.0, 120.0], atol=1e-9)
    assert_allclose(geometry.area(found.panel("band")), 0.95 * 0.1 * 0.75**0.5, rtol=1e-12)


@pytest.mark.parametrize("inner", [True, False])
def test_a_strip_of_a_ring_is_a_ring(inner):
    """Of a quarter ring between 0.3 and 0.8 m: the line beside either arc has the length of its own circle."""
    angle = 0.25 * np.pi
    ends = np.array([(np.sin(-angle), np.cos(-angle)), (np.sin(angle), np.cos(angle))])
    height = 0.5 * np.tan(0.5 * angle)
    corners = np.array([*(0.3 * ends), *(0.8 * ends[::-1])])
    arcs = [Edge(0, 1, EdgeKind.CIRCLE, ((0.5, height),)), Edge(1, 2), Edge(2, 3, EdgeKind.CIRCLE, ((0.5, -height),))]
    whole = Pattern("ring", (Panel("ring", corners, (*arcs, Edge(3, 0))),))
    found = strips(whole, [Chain((EdgeRef("ring", 0 if inner else 2),), "band")], 0.04)
    radius = 0.34 if inner else 0.76
    line = [seam for seam in geometry.seams(found) if "band" in seam.stitch.first.panel]
    assert len(line) == 1 and abs(line[0].mismatch) < 1e-12
    assert_allclose(line[0].first_m, 2.0 * angle * radius, rtol=1e-3)
    # One cubic curve is a quarter of a circle within 0.03 %.
    ring = angle * abs(radius**2 - (0.3 if inner else 0.8) ** 2)
    assert_allclose(geometry.area(found.panel("band")), ring, rtol=0.0, atol=3e-4 * radius * line[0].first_m)
    points = geometry.edge_points(found.panel("band"), line[0].stitch.first.edge, np.linspace(0.0, 1.0, 33))
    assert_allclose(np.linalg.norm(points, axis=1), radius, atol=2e-4)
    assert_allclose(area(found), area(whole), rtol=1e-12)


def test_a_line_beside_a_corner_turns_on_its_bisector():
    """Two sides of a square, 0.1 m inside: the line's corner lies 0.1 m from both."""
    square = Pattern("square", (rectangle("square", width=1.0, height=1.0),))
    found = strips(square, [Chain((EdgeRef("square", 0), EdgeRef("square", 1)), "band")], 0.1)
    assert_allclose(sorted(lengths(found, "band")), [0.1, 0.1, 0.9, 0.9, 1.0, 1.0], rtol=0.0, atol=1e-12)
    assert_allclose(geometry.area(found.panel("band")), 0.19, rtol=1e-12)
    assert len(found.stitches) == 2


def test_the_fitted_curve_is_the_cubic_one_that_the_points_lie_on():
    points = np.array([(0.0, 0.0), (0.1, 0.3), (0.5, -0.1), (0.7, 0.2)])
    curve = Curve(EdgeKind.CUBIC, points)
    assert_allclose(curve.at(np.array([0.0, 1.0])), points[[0, -1]], atol=1e-15)
    again = Curve(EdgeKind.CUBIC, fit_curve(curve.at(np.linspace(0.0, 1.0, 33))))
    assert_allclose(again.points, points, atol=1e-9)


def test_a_level_line_cuts_a_rectangle_in_two():
    found = cut_level(tube(), "back", 0.1, "back_yoke")
    assert [panel.name for panel in found.panels] == ["front", "back", "back_yoke"]
    assert_allclose(geometry.area(found.panel("back_yoke")), 0.4 * 0.2, rtol=1e-9)
    assert_allclose(area(found), area(tube()), rtol=1e-12)
    assert_allclose(found.panel("back_yoke").vertices[:, 1].min(), 0.1, atol=1e-12)
    assert [len(panel.edges) for panel in found.panels] == [6, 4, 4]
    assert_allclose([seam.mismatch for seam in geometry.seams(found)], 0.0, atol=1e-9)


def test_a_join_takes_a_cut_back():
    """The parts joined have the outline of the whole, whatever the frame of the second."""
    whole = tube()
    cut = strips(whole, [Chain((EdgeRef("front", 2),), "band")], 0.05)
    turned = np.array([[0.6, 0.8], [-0.8, 0.6]])
    panels = [replace(p, vertices=p.vertices @ turned + 0.3) if p.name == "band" else p for p in cut.panels]
    number = next(n for n, one in enumerate(cut.stitches) if {one.first.panel, one.second.panel} == {"front", "band"})
    stitches = list(cut.stitches)
    stitches[number] = Stitch(stitches[number].second, stitches[number].first)  # in the frame of the front
    again = join_panels(replace(cut, panels=tuple(panels), stitches=tuple(stitches)), number, "whole")
    assert [panel.name for panel in again.panels] == ["whole", "back"]
    assert_allclose(geometry.area(again.panel("whole")), 0.24, rtol=1e-12)
    assert_allclose(np.ptp(again.panel("whole").vertices, axis=0), [0.4, 0.6], rtol=0.0, atol=1e-12)
    assert len(again.stitches) == 4 and all(abs(seam.mismatch) < 1e-12 for seam in geometry.seams(again))


def test_curved_edges_that_lie_on_each_other_are_joined():
    bent = Panel(
        "a", rectangle().vertices, (Edge(0, 1), Edge(1, 2, EdgeKind.QUADRATIC, ((0.5, 0.1),)), Edge(2, 3), Edge(3, 0))
    )
    other = Panel(
        "b", rectangle().vertices, (Edge(0, 1), Edge(1, 2), Edge(2, 3), Edge(3, 0, EdgeKind.QUADRATIC, ((0.5, -0.1),)))
    )
    whole = Pattern("two", (bent, other), (Stitch(EdgeRef("a", 1), EdgeRef("b", 3)),))
    found = join_panels(whole, 0, "ab")
    assert_allclose(geometry.area(found.panels[0]), area(whole), rtol=1e-12)
    assert_allclose(np.ptp(found.panels[0].vertices, axis=0), [0.8, 0.6], rtol=0.0, atol=1e-12)
    # Mirrored, the edges leave a gap between them.
    mirrored = replace(whole, panels=(bent, replace(other, edges=(*other.edges[:3], other.edges[3].reflected()))))
    with pytest.raises(InputError, match="mm apart"):
        join_panels(mirrored, 0, "ab")


NOTCHED = polygon("notched", [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.5, 0.02), (0.0, 0.5)])


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        (lambda: strips(tube(), [Chain((EdgeRef("front", 2),), "band")], 0.6), r"up to 0\.598 m"),
        (lambda: strips(tube(), [Chain((EdgeRef("front", 2),), "band")], 0.0), "got 0 m"),
        (
            lambda: strips(Pattern("n", (NOTCHED,)), [Chain((EdgeRef("notched", 0),), "band")], 0.1),
            "one that leaves it",
        ),
        (lambda: cut_level(tube(), "back", 0.4, "yoke"), "0 crossings"),
        (lambda: cut_level(Pattern("n", (NOTCHED,)), "notched", 0.3, "yoke"), "4 crossings"),
        (
            lambda: join_panels(replace(tube(), stitches=(replace(tube().stitches[0], right_to_wrong=True),)), 0, "x"),
            "right",
        ),
        (lambda: join_panels(tube(rectangle("front", height=0.6 + 3.0 * JOIN_M)), 0, "x"), "lie on each other"),
    ],
)
def test_lines_that_no_panel_has_room_for_are_refused(cut, message):
    with pytest.raises(InputError, match=message):
        cut()


def test_curves_are_the_panel_again():
    panel = curved()
    for number, curve in enumerate(curves(panel)):
        back = curve.edge(panel.edges[number].start, panel.edges[number].end)
        assert back.kind is panel.edges[number].kind
        assert_allclose(back.handles, panel.edges[number].handles, atol=1e-12)
