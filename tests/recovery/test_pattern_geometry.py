"""Curves, lengths and areas against closed forms, equal parts, and unfit outlines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.pattern_mesh import segment_counts
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, Pattern
from tests.recovery.pattern_setup import curved, rectangle, tube


def one_edge(kind: EdgeKind, handles, start=(0.2, -0.1), end=(0.7, 0.3)) -> Panel:
    """A panel whose edge 0 is under test and whose others are straight."""
    third = (start[0] - 0.4 * (end[1] - start[1]), start[1] + 1.5 * (end[0] - start[0]))
    return Panel("one", np.array([start, end, third]), (Edge(0, 1, kind, handles), Edge(1, 2), Edge(2, 0)))


def test_bezier_edges_are_the_curves_of_their_control_points():
    panel = one_edge(EdgeKind.CUBIC, ((0.2, 0.3), (0.9, -0.4)))
    (a, b), t = panel.vertices[:2], np.linspace(0.0, 1.0, 7)[:, None]
    left = np.array([-(b - a)[1], (b - a)[0]])
    c, d = a + 0.2 * (b - a) + 0.3 * left, a + 0.9 * (b - a) - 0.4 * left
    expected = (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * c + 3 * (1 - t) * t**2 * d + t**3 * b
    assert_allclose(geometry.edge_points(panel, 0, t[:, 0]), expected, atol=1e-15)


@pytest.mark.parametrize("height", [-2.0, -0.5, -0.03, 1e-7, 0.2, 0.5, 1.4])
def test_an_arc_lies_on_its_circle_and_bulges_to_its_side(height):
    panel = one_edge(EdgeKind.CIRCLE, ((0.5, height),))
    start, chord = geometry.chord(panel, 0)
    length = np.linalg.norm(chord)
    t = np.linspace(0.0, 1.0, 41)
    points = geometry.edge_points(panel, 0, t)
    assert_allclose(points[[0, -1]], [start, start + chord], atol=1e-14)
    left = np.array([-chord[1], chord[0]])
    assert_allclose(points[20], start + 0.5 * chord + height * left, atol=1e-12)
    radius = length * (0.25 + height**2) / (2.0 * abs(height))
    if radius < 1e3:
        centre = points[20] - np.sign(height) * radius * left / length
        assert_allclose(np.linalg.norm(points - centre, axis=1), radius, rtol=1e-12)
    angle = 4.0 * np.arctan(2.0 * abs(height))
    assert_allclose(geometry.edge_length(panel, 0), radius * angle, rtol=1e-12)


def test_lengths_of_curves_agree_with_closed_forms_and_fine_polygons():
    parabola = one_edge(EdgeKind.QUADRATIC, ((0.5, 0.5),), (0.0, 0.0), (1.0, 0.0))  # y = x - x^2
    assert_allclose(geometry.edge_length(parabola, 0), np.sqrt(2) / 2 + np.arcsinh(1.0) / 2, rtol=1e-13)
    for kind, handles in ((EdgeKind.QUADRATIC, ((0.3, 0.8),)), (EdgeKind.CUBIC, ((0.1, 0.6), (0.4, -0.9)))):
        panel = one_edge(kind, handles)
        points = geometry.edge_points(panel, 0, np.linspace(0.0, 1.0, 50_001))
        polygon = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert_allclose(geometry.edge_length(panel, 0), polygon, rtol=1e-8)


def test_slopes_and_tangents_are_derivatives():
    t, step = np.linspace(0.05, 0.95, 9), 1e-6
    panel = curved()
    for number, edge in enumerate(panel.edges):
        change = geometry.relative_curve(edge, t + step) - geometry.relative_curve(edge, t - step)
        assert_allclose(geometry.relative_slope(edge, t), change / (2 * step), atol=1e-8)
        moved = geometry.edge_points(panel, number, t + step) - geometry.edge_points(panel, number, t - step)
        expected = moved / np.linalg.norm(moved, axis=1, keepdims=True)
        assert_allclose(geometry.edge_tangents(panel, number, t), expected, atol=1e-8)


def test_a_vanishing_slope_takes_the_direction_of_the_chord():
    panel = one_edge(EdgeKind.CUBIC, ((0.0, 0.0), (0.8, 0.2)))  # stands still at its start
    chord = panel.vertices[1] - panel.vertices[0]
    assert_allclose(geometry.edge_tangents(panel, 0, np.zeros(1))[0], chord / np.linalg.norm(chord))


def test_the_area_of_a_curved_panel_agrees_with_its_fine_polygon():
    panel = curved()
    x, y = geometry.outline(panel, 1e-9).T
    shoelace = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert_allclose(geometry.area(panel), shoelace, rtol=1e-7)
    assert_allclose(geometry.area(rectangle()), 0.24, rtol=1e-14)
    half_disc = Panel(
        "half", np.array([(0.0, 0.0), (1.0, 0.0)]), (Edge(0, 1, EdgeKind.CIRCLE, ((0.5, -0.5),)), Edge(1, 0))
    )
    assert_allclose(geometry.area(half_disc), np.pi / 8, rtol=1e-13)


@pytest.mark.parametrize("number", range(4))
def test_equal_parameters_cut_equal_arc_lengths(number):
    edge = curved().edges[number]
    t = geometry.equal_parameters(edge, 7)
    assert t[0] == 0.0 and t[-1] == 1.0
    assert_allclose(np.diff(geometry.arc_lengths(edge, t)), geometry.relative_length(edge) / 7, rtol=1e-10)


def test_flattening_keeps_its_tolerance():
    panel = curved()
    for tolerance in (1e-3, 1e-5):
        for number in range(4):
            points = geometry.flatten(panel, number, tolerance)
            fine = geometry.edge_points(panel, number, np.linspace(0.0, 1.0, 501))
            a, d = points[:-1], np.diff(points, axis=0)
            share = np.clip(((fine[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0.0, 1.0)
            gap = np.linalg.norm(fine[:, None] - a - share[..., None] * d, axis=2).min(axis=1).max()
            assert gap <= tolerance


def test_both_sides_of_a_stitch_get_the_same_number_of_segments():
    pattern = tube(front=rectangle("front", height=0.6), back=rectangle("back", height=0.7))
    counts = segment_counts(pattern, 0.05)
    assert counts[EdgeRef("front", 1)] == counts[EdgeRef("back", 3)] == 13  # of the mean
    assert counts[EdgeRef("front", 0)] == 8
    assert segment_counts(pattern, 9.0)[EdgeRef("front", 1)] == 1
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="edge_length_m"):
            segment_counts(pattern, wrong)


def test_the_mismatch_of_a_seam_is_relative_to_the_mean():
    pattern = tube(front=rectangle("front", height=0.6), back=rectangle("back", height=0.63))
    assert_allclose([seam.mismatch for seam in geometry.seams(pattern)], 0.03 / 0.615, rtol=1e-12)
    assert_allclose([(seam.first_m, seam.second_m) for seam in geometry.seams(pattern)], [(0.6, 0.63)] * 2)


def test_stitches_join_the_ends_that_are_near():
    pattern = tube()
    for stitch in pattern.stitches:
        assert_allclose(geometry.stitch_ends(pattern, stitch), 0.4, rtol=1e-12)
        assert_allclose(geometry.stitch_ends(pattern, stitch, reverse=True), np.hypot(0.4, 0.6), rtol=1e-12)
        other = replace(stitch, right_to_wrong=True)
        assert_allclose(geometry.stitch_ends(pattern, other), np.hypot(0.4, 0.6), rtol=1e-12)


@pytest.mark.parametrize(
    ("corners", "meets"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], None),
        ([(0, 0), (1, 0), (0.5, 0.1), (1, 1), (0, 1)], None),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], (0.5, 0.5)),  # a bow tie
        ([(0, 0), (2, 0), (2, 1), (1, 0), (0, 1)], (1, 0)),  # a corner on a side
        ([(0, 0), (1, 0), (0.5, 0), (0.5, 1)], (1, 0)),  # a side that runs back
        ([(0, 0), (1, 0), (1, 1), (0.5, 1), (0.5, 0), (0.2, 0.5)], (0.5, 0)),
    ],
)
def test_crossings_of_outlines_are_found(corners, meets):
    polygon = np.array(corners, dtype=float)
    for first in range(len(polygon)):
        found = geometry.first_crossing(np.roll(polygon, first, axis=0))
        if meets is None:
            assert found is None
        else:
            assert found is not None
            assert_allclose(found, meets, atol=1e-9)


DEEP = replace(rectangle().edges[0], kind=EdgeKind.QUADRATIC, handles=((0.5, 3.5),))  # its corners alone do not cross


@pytest.mark.parametrize(
    ("panel", "message"),
    [
        (replace(rectangle(), edges=(DEEP, *rectangle().edges[1:])), "does not cross itself"),
        (replace(rectangle(), vertices=rectangle().vertices * [-1.0, 1.0]), "counter-clockwise"),
        (replace(rectangle(), vertices=rectangle().vertices * 100.0), "panel front.*units_in_meter"),
        (replace(rectangle(), vertices=rectangle().vertices * 1e-3), "panel front.*units_in_meter"),
        (replace(rectangle(), vertices=rectangle().vertices * 0.05), "pattern.*units_in_meter"),
    ],
)
def test_unfit_panels_are_refused(panel, message):
    assert geometry.first_crossing(panel.vertices) is None
    with pytest.raises(InputError, match=message):
        geometry.check_pattern(Pattern("unfit", (panel,)))
