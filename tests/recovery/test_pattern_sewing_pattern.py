"""What a pattern is made of, and what is refused as none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.errors import InputError
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, PanelPlacement, Pattern, Stitch
from tests.recovery.pattern_setup import FOLDS, curved, rectangle, tube

CORNERS = rectangle().vertices
LOOP = rectangle().edges
DOUBLED = np.concatenate([CORNERS[:1], CORNERS[:1], CORNERS[2:]])
WHOLE_CIRCLE = Edge(0, 0, EdgeKind.CUBIC, ((0.3, 0.3), (0.6, 0.3)))


def test_a_placement_turns_about_x_then_y_then_z(rng):
    angles = rng.uniform(-180, 180, size=3)
    placement = PanelPlacement(tuple(angles), (0.1, 0.2, 0.3))
    turns = [Rotation.from_rotvec(np.radians(angle) * axis) for angle, axis in zip(angles, np.eye(3), strict=True)]
    points = rng.normal(size=(5, 2))
    turned = (turns[2] * turns[1] * turns[0]).apply(np.column_stack([points, np.zeros(5)]))
    assert_allclose(placement.apply(points), turned + np.array([0.1, 0.2, 0.3]), atol=1e-14)


def test_reflecting_an_edge_twice_gives_it_back():
    for kind, handles in FOLDS.items():
        edge = Edge(0, 1, kind, handles)
        assert edge.reflected().reflected() == edge
        assert (edge.reflected() == edge) == (kind is EdgeKind.LINE)


def test_the_corners_of_a_panel_cannot_be_changed_behind_its_back():
    given = CORNERS.copy()
    panel = Panel("front", given, LOOP)
    given[0] = 99.0
    assert panel.vertices[0, 0] < 1.0
    with pytest.raises(ValueError):
        panel.vertices[0] = 0.0


def test_panels_and_edges_are_found_by_name():
    pattern = Pattern("two", (rectangle("front"), curved("back")))
    assert pattern.panel("back").name == "back"
    assert [str(ref) for ref in pattern.edge_refs()][3:5] == ["front[3]", "back[0]"]
    with pytest.raises(InputError, match="front"):
        pattern.panel("sleeve")


@pytest.mark.parametrize("kind", list(EdgeKind))
def test_an_edge_has_the_handles_of_its_kind(kind):
    with pytest.raises(InputError, match="handles"):
        Edge(0, 1, kind, (*FOLDS[kind], (0.5, 0.5)))
    if kind is not EdgeKind.LINE:
        with pytest.raises(InputError, match="finite"):
            Edge(0, 1, kind, ((np.nan, 0.0),) * len(FOLDS[kind]))


def sewn(*pairs: tuple[EdgeRef, EdgeRef]) -> Pattern:
    return Pattern("tube", tube().panels, tuple(Stitch(*pair) for pair in pairs))


def ref(panel: str, edge: int) -> EdgeRef:
    return EdgeRef(panel, edge)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Edge(0, 1, EdgeKind.CIRCLE, ((0.4, 0.2),)), "highest point"),
        (lambda: Edge(0, 1, EdgeKind.CIRCLE, ((0.5, 0.0),)), "highest point"),
        (lambda: PanelPlacement(rotation_deg=(0.0, 0.0)), "rotation_deg"),  # pyright: ignore[reportArgumentType]
        (lambda: PanelPlacement(translation_m=(0.0, np.inf, 0.0)), "translation_m"),
        (lambda: Panel("front", CORNERS, LOOP[:-1]), "closed loop"),
        (lambda: Panel("front", CORNERS, (LOOP[0], LOOP[2], LOOP[1], LOOP[3])), "closed loop"),
        (lambda: Panel("front", CORNERS, ()), "closed loop"),
        (lambda: Panel("front", np.vstack([CORNERS, [0.0, 0.0]]), LOOP), "each of the 5 vertices"),
        (lambda: Panel("front", CORNERS, (LOOP[0], Edge(1, 7), Edge(7, 3), LOOP[3])), "each of the 4 vertices"),
        (lambda: Panel("front", CORNERS[:, :1], LOOP), "vertices"),
        (lambda: Panel("front", CORNERS * np.nan, LOOP), "vertices"),
        (lambda: Panel("front", DOUBLED, LOOP), "edge 0 without length"),
        (lambda: Panel("front", DOUBLED[:1], (WHOLE_CIRCLE,)), "without length"),
        (lambda: Pattern("twins", (rectangle("front"), rectangle("front"))), "own name"),
        (lambda: Pattern("nothing", ()), "own name"),
        (lambda: Pattern("one", (rectangle("front"),), panel_order=("front", "back")), "panel_order"),
        (lambda: sewn((ref("front", 1), ref("sleeve", 0))), "stitch 0: expected edges that the pattern has"),
        (lambda: sewn((ref("front", 1), ref("back", 4))), "stitch 0: expected edges that the pattern has"),
        (lambda: sewn((ref("front", 1), ref("back", -1))), "stitch 0: expected edges that the pattern has"),
        (lambda: sewn((ref("front", 1), ref("front", 1))), "stitch 0: .*already in stitch 0"),
        (
            lambda: sewn((ref("front", 1), ref("back", 3)), (ref("front", 0), ref("front", 1))),
            "stitch 1: .*already in stitch 0",
        ),
    ],
)
def test_what_is_no_pattern_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
