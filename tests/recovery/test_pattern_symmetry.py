"""Symmetries between and within panels, and the control points that they leave free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recovery.pattern import geometry
from recovery.pattern.bases import skirt, trousers, tshirt
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.sewing_pattern import EdgeKind, Panel, Pattern
from recovery.pattern.symmetry import Kind, find_symmetries, free_controls, procrustes, symmetrised
from tests.recovery.pattern_setup import curved, default_measurements, rectangle, tube


def names(pattern: Pattern, **options) -> tuple[set, set]:
    """Symmetries by the names of the panels."""
    found = find_symmetries(pattern, **options)
    name = [panel.name for panel in pattern.panels]
    return {(name[s.first], name[s.second], str(s.kind)) for s in found.between}, {name[s.first] for s in found.within}


def moved(panel: Panel, name: str, angle: float, *, mirror: bool, start: int) -> Panel:
    """``panel`` turned, mirrored, and its outline begun at another edge."""
    count = len(panel.edges)
    vertices, edges = panel.vertices, list(panel.edges)
    if mirror:  # run backwards, so that the outline stays counter-clockwise
        vertices = vertices * [-1.0, 1.0]
        edges = [
            replace(
                edge,
                start=edge.end,
                end=edge.start,
                handles=tuple(
                    (1.0 - along, left) if edge.kind is not EdgeKind.CIRCLE else (along, left)
                    for along, left in reversed(edge.handles)
                ),
            )
            for edge in reversed(edges)
        ]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return Panel(name, vertices @ turn + [0.3, -0.1], tuple(edges[(start + k) % count] for k in range(count)))


def perturbed(pattern: Pattern, size_m: float, seed: int = 0) -> Pattern:
    """``pattern`` with every corner and handle moved at random."""
    controls = control_points(pattern, free_curves=True)
    noise = np.random.default_rng(seed).normal(size=controls.positions.shape) * size_m
    return with_controls(pattern, controls, controls.positions + noise)


def test_procrustes_finds_the_motion_and_keeps_its_hand(rng):
    first = rng.normal(size=(7, 2))
    for reflect in (False, True):
        motion = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        motion[:, 0] *= np.linalg.det(motion) * (-1.0 if reflect else 1.0)
        matrix, error = procrustes(first, first @ motion + [0.4, -2.0], reflect=reflect)
        assert_allclose(matrix, motion, atol=1e-12)
        assert error < 1e-12
        other, worse = procrustes(first, first @ motion, reflect=not reflect)
        assert worse > 0.1
        assert_allclose(np.linalg.det(other), 1.0 if reflect else -1.0, atol=1e-12)


def test_base_patterns_have_the_symmetries_they_are_drafted_with():
    body = default_measurements()
    assert names(tshirt(body)) == (
        {
            ("sleeve_left_front", "sleeve_right_front", "reflection"),
            ("sleeve_left_back", "sleeve_right_back", "reflection"),
        },
        {"front", "back"},
    )
    assert names(trousers(body)) == (
        {("front_left", "front_right", "reflection"), ("back_left", "back_right", "reflection")},
        set(),
    )
    assert names(skirt(body)) == (set(), {"front", "back"})
    # The skirt's halves differ by their waistlines only; asked less of, they are one.
    assert names(skirt(body), tolerance_m=0.005) == ({("front", "back", "reflection")}, {"front"})


def test_identical_panels_are_tied_upright():
    """A rectangle lies on its like in eight ways; the one that keeps top on top is meant."""
    found = find_symmetries(tube())
    (between,) = found.between
    assert between.kind is Kind.REFLECTION
    assert_allclose(between.matrix, np.diag([-1.0, 1.0]), atol=1e-12)
    assert [between.edge(number, 4) for number in range(4)] == [0, 3, 2, 1]
    assert len(found.within) == 1


@pytest.mark.parametrize("mirror", [False, True])
def test_motion_and_shift_of_a_curved_panel_are_found(mirror):
    first = curved()
    second = moved(first, "other", 0.7, mirror=mirror, start=2)
    (found,) = find_symmetries(Pattern("pair", (first, second))).between
    assert found.kind is (Kind.REFLECTION if mirror else Kind.ROTATION)
    assert found.error_m < 1e-12
    for number in range(4):
        there = found.edge(number, 4)
        assert_allclose(geometry.edge_length(first, number), geometry.edge_length(second, there), rtol=1e-12)
        ends = first.vertices[[first.edges[number].start, first.edges[number].end]]
        image = (ends - first.vertices.mean(axis=0)) @ found.matrix + second.vertices.mean(axis=0)
        reached = second.vertices[[second.edges[there].start, second.edges[there].end]]
        assert_allclose(image, reached[::-1] if mirror else reached, atol=1e-12)


def test_a_pattern_without_symmetry_has_none_and_everything_stays_free():
    pattern = Pattern("pair", (curved("one"), rectangle("two"), curved("three", ("line", "cubic", "line", "line"))))
    lonely = Pattern("one", (curved(),))
    assert names(lonely) == (set(), set())
    assert names(pattern)[0] == set()
    free = free_controls(lonely, find_symmetries(lonely))
    assert free.count == 2 * len(free.controls)
    assert_allclose(free.origin, free.controls.positions)
    assert find_symmetries(lonely).describe(lonely) == []


def test_perturbed_patterns_need_the_tolerance_and_become_exact():
    pattern = perturbed(tshirt(default_measurements()), 0.0003)
    assert names(pattern, tolerance_m=0.0001) == (set(), set())
    found = find_symmetries(pattern, tolerance_m=0.0012)
    assert {s.kind for s in found.between} == {Kind.REFLECTION} and len(found.within) == 2
    exact = symmetrised(pattern, found)
    again = find_symmetries(exact, tolerance_m=1e-9)
    assert len(again.between) == len(found.between) and len(again.within) == 2
    assert max(s.error_m for s in (*again.between, *again.within)) < 1e-12
    every = control_points(pattern, free_curves=True)
    moved_by = np.linalg.norm(control_points(exact, free_curves=True).positions - every.positions, axis=1)
    assert 0.0 < moved_by.max() < 0.0012
    assert any("is symmetric by a reflection, within" in line for line in found.describe(pattern))


def test_arcs_of_tied_panels_get_one_height():
    first = curved()
    second = moved(first, "other", 0.7, mirror=True, start=1)
    bent = tuple(
        replace(edge, handles=((0.5, edge.handles[0][1] + 0.004),)) if edge.kind is EdgeKind.CIRCLE else edge
        for edge in second.edges
    )
    pattern = Pattern("pair", (first, replace(second, edges=bent)))
    found = find_symmetries(pattern)
    assert len(found.between) == 1 and found.between[0].error_m > 1e-5
    exact = symmetrised(pattern, found)
    heights = [e.handles[0][1] for panel in exact.panels for e in panel.edges if e.kind is EdgeKind.CIRCLE]
    assert_allclose(heights, 0.202, atol=1e-12)
    assert find_symmetries(exact, tolerance_m=1e-9).between


def test_arcs_of_a_symmetric_panel_get_one_height():
    plain = rectangle()
    sides = {1: -0.100, 3: -0.104}
    edges = tuple(
        replace(edge, kind=EdgeKind.CIRCLE, handles=((0.5, sides[number]),)) if number in sides else edge
        for number, edge in enumerate(plain.edges)
    )
    narrower = np.where(plain.vertices[:, 1:] > 0.0, plain.vertices * [0.7, 1.0], plain.vertices)
    pattern = Pattern("barrel", (replace(plain, vertices=narrower, edges=edges),))
    (panel,) = symmetrised(pattern, find_symmetries(pattern, tolerance_m=0.005)).panels
    assert_allclose([panel.edges[number].handles[0][1] for number in sides], -0.102, atol=1e-12)


@pytest.mark.parametrize("draft", [tshirt, trousers, skirt])
def test_what_is_free_keeps_the_symmetries_wherever_it_goes(draft):
    pattern = draft(default_measurements())
    found = find_symmetries(pattern)
    free = free_controls(pattern, found)
    assert_allclose(free.basis.T @ free.basis, np.eye(free.count), atol=1e-12)
    assert_allclose(free.origin, free.controls.positions, atol=1e-12)
    values = 0.01 * np.random.default_rng(3).normal(size=free.count)
    positions = free.positions(values)
    assert_allclose(free.values(positions), values, atol=1e-12)
    again = find_symmetries(with_controls(pattern, free.controls, positions), tolerance_m=1e-9)
    assert len(again.between) == len(found.between) and len(again.within) == len(found.within)
    assert max(s.error_m for s in (*again.between, *again.within)) < 1e-12


def test_a_symmetric_panel_leaves_half_of_its_coordinates_free():
    """Skirt: six corners, three pairs on each panel: six numbers. Tied panels count once."""
    body = default_measurements()
    pattern = skirt(body)
    assert free_controls(pattern, find_symmetries(pattern)).count == 2 * 6
    tied = find_symmetries(pattern, tolerance_m=0.005)
    assert free_controls(pattern, tied).count == 6
    # The T-shirt's necks have a corner on the axis, which moves along it: one number. Sleeves: four corners each.
    shirt = tshirt(body)
    assert free_controls(shirt, find_symmetries(shirt)).count == 2 * (2 * 4 + 1) + 2 * 8
