"""What a pattern is made of, and what is refused as none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.errors import InputError
from recovery.pattern.model import Edge, EdgeKind, EdgeRef, Panel, Pattern, Placement, Stitch
from tests.recovery.pattern_setup import FOLDS, curved, rectangle, tube


def test_a_placement_turns_about_x_then_y_then_z(rng):
    angles = rng.uniform(-180, 180, size=3)
    placement = Placement(tuple(angles), (0.1, 0.2, 0.3))
    turns = [Rotation.from_rotvec(np.radians(angle) * axis) for angle, axis in zip(angles, np.eye(3), strict=True)]
    points = rng.normal(size=(5, 2))
    turned = (turns[2] * turns[1] * turns[0]).apply(np.column_stack([points, np.zeros(5)]))
    assert_allclose(placement.apply(points), turned + np.array([0.1, 0.2, 0.3]), atol=1e-14)


def test_reflecting_an_edge_twice_gives_it_back():
    for kind, handles in FOLDS.items():
        edge = Edge(0, 1, kind, handles)
        assert edge.reflected().reflected() == edge
        assert (edge.reflected() == edge) == (kind is EdgeKind.LINE)


@pytest.mark.parametrize("kind", list(EdgeKind))
def test_an_edge_has_the_handles_of_its_kind(kind):
    with pytest.raises(InputError, match="handles"):
        Edge(0, 1, kind, (*FOLDS[kind], (0.5, 0.5)))
    if kind is not EdgeKind.LINE:
        with pytest.raises(InputError, match="finite"):
            Edge(0, 1, kind, ((np.nan, 0.0),) * len(FOLDS[kind]))


@pytest.mark.parametrize("handle", [(0.4, 0.2), (0.5, 0.0)])
def test_an_arc_is_given_by_its_highest_point(handle):
    with pytest.raises(InputError, match="highest point"):
        Edge(0, 1, EdgeKind.CIRCLE, (handle,))


def test_a_placement_takes_three_finite_numbers():
    with pytest.raises(InputError, match="rotation_deg"):
        Placement(rotation_deg=(0.0, 0.0))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="translation_m"):
        Placement(translation_m=(0.0, np.inf, 0.0))


def test_a_panel_is_one_closed_loop_through_its_corners():
    corners = rectangle().vertices
    loop = [Edge(0, 1), Edge(1, 2), Edge(2, 3), Edge(3, 0)]
    with pytest.raises(InputError, match="closed loop"):
        Panel("front", corners, tuple(loop[:-1]))
    with pytest.raises(InputError, match="closed loop"):
        Panel("front", corners, (loop[0], loop[2], loop[1], loop[3]))
    with pytest.raises(InputError, match="closed loop"):
        Panel("front", corners, ())
    with pytest.raises(InputError, match="each of the 5 vertices"):
        Panel("front", np.vstack([corners, [0.0, 0.0]]), tuple(loop))
    with pytest.raises(InputError, match="each of the 4 vertices"):
        Panel("front", corners, (Edge(0, 1), Edge(1, 7), Edge(7, 3), Edge(3, 0)))


def test_a_panel_has_finite_distinct_corners():
    edges = rectangle().edges
    for vertices in (rectangle().vertices[:, :1], rectangle().vertices * np.nan):
        with pytest.raises(InputError, match="vertices"):
            Panel("front", vertices, edges)
    doubled = rectangle().vertices.copy()
    doubled[1] = doubled[0]
    with pytest.raises(InputError, match="edge 0 without length"):
        Panel("front", doubled, edges)
    with pytest.raises(InputError, match="without length"):  # a whole circle in one edge
        Panel("front", doubled[:1], (Edge(0, 0, EdgeKind.CUBIC, ((0.3, 0.3), (0.6, 0.3))),))


def test_the_corners_of_a_panel_cannot_be_changed_behind_its_back():
    given = rectangle().vertices.copy()
    panel = Panel("front", given, rectangle().edges)
    given[0] = 99.0
    assert panel.vertices[0, 0] < 1.0
    with pytest.raises(ValueError):
        panel.vertices[0] = 0.0


def test_panels_have_their_own_names():
    with pytest.raises(InputError, match="own name"):
        Pattern("twins", (rectangle("front"), rectangle("front")))
    with pytest.raises(InputError, match="own name"):
        Pattern("nothing", ())
    with pytest.raises(InputError, match="panel_order"):
        Pattern("one", (rectangle("front"),), panel_order=("front", "back"))


@pytest.mark.parametrize("side", [EdgeRef("sleeve", 0), EdgeRef("back", 4), EdgeRef("back", -1)])
def test_a_stitch_to_a_missing_edge_is_refused(side):
    with pytest.raises(InputError, match=r"stitch 0: expected edges that the pattern has"):
        Pattern("tube", tube().panels, (Stitch(EdgeRef("front", 1), side),))


def test_an_edge_is_sewn_once():
    stitches = tube().stitches
    with pytest.raises(InputError, match=r"stitch 2: .*already in stitch 0"):
        Pattern("tube", tube().panels, (*stitches, Stitch(EdgeRef("front", 0), EdgeRef("front", 1))))
    with pytest.raises(InputError, match=r"stitch 0: .*already in stitch 0"):
        Pattern("tube", tube().panels, (Stitch(EdgeRef("front", 1), EdgeRef("front", 1)),))


def test_panels_and_edges_are_found_by_name():
    pattern = Pattern("two", (rectangle("front"), curved("back")))
    assert pattern.panel("back").name == "back"
    assert [str(ref) for ref in pattern.edge_refs()][3:5] == ["front[3]", "back[0]"]
    with pytest.raises(InputError, match="front"):
        pattern.panel("sleeve")
