"""Pieces of a pattern on a sheet: allowances, notches, grain, hems and labels, and their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recovery.catalogue.cuts import CATALOGUE
from recovery.pattern import geometry
from recovery.pattern.bases import tshirt
from recovery.pattern.geometry import boundary_distance, inside
from recovery.pattern.pieces import NOTCH_DEPTH_M, Piece, hems, make_sheet, offset
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, Pattern, Stitch
from tests.recovery.pattern_setup import default_measurements, every_curve, polygon_mm, rectangle, tube

ALLOWANCE_M = 0.01


def test_the_seam_allowance_is_parallel_to_the_sewing_line_and_has_no_spikes():
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    wide = offset(square, 0.05)
    assert_allclose(polygon_mm(wide), 4.4, rtol=1e-6)
    assert_allclose(wide.min(axis=0), -0.05, atol=1e-6)
    assert offset(square, 0.0) is square
    needle = np.array([(0, 0), (1.0, 0.0), (0.0, 0.05)])
    assert offset(needle, 0.01)[:, 0].max() < 1.0 + 3.0 * 0.01  # sharp corners are cut off
    for piece in make_sheet(every_curve(), allowance_m=ALLOWANCE_M).pieces:
        along = np.concatenate([a + np.linspace(0, 1, 9)[:-1, None] * (b - a) for a, b in _sides(piece.cutting)])
        gap = boundary_distance(along, piece.sewing)
        assert gap.min() > ALLOWANCE_M - 2e-6 and not inside(along, piece.sewing).any()
        assert np.quantile(gap, 0.7) < ALLOWANCE_M + 1e-4  # farther only towards mitred corners


def _sides(polygon: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(polygon, np.roll(polygon, -1, axis=0), strict=True))


def test_every_seam_has_notches_at_its_middle_and_its_ends():
    pattern = tube()
    for piece in make_sheet(pattern, allowance_m=ALLOWANCE_M).pieces:
        middles = [notch for notch in piece.notches if abs(notch.point[1]) < 1e-6]
        assert len(middles) == 2 and len(piece.notches) == 6
        for notch in piece.notches:
            assert boundary_distance(notch.point[None], piece.cutting)[0] < 1e-6
            assert_allclose(np.linalg.norm(notch.inward), 1.0)
            assert inside((notch.point + NOTCH_DEPTH_M * notch.inward)[None], piece.cutting)[0]
        assert sorted(text for _, text in piece.seam_marks) == ["1", "2"]
        assert inside(np.array([point for point, _ in piece.seam_marks]), piece.sewing).all()


def test_grain_lines_are_upright_and_inside():
    for pattern in (every_curve(), tshirt(default_measurements())):
        for piece in make_sheet(pattern).pieces:
            assert piece.grain[0, 0] == piece.grain[1, 0] and piece.grain[1, 1] > piece.grain[0, 1] + 0.05
            along = piece.grain[0] + np.linspace(0, 1, 50)[:, None] * (piece.grain[1] - piece.grain[0])
            assert inside(along, piece.sewing).all() and inside(np.array(piece.label.box()), piece.sewing).all()


def test_pieces_lie_on_the_sheet_without_overlap():
    for pattern in (every_curve(), tshirt(default_measurements())):
        sheet = make_sheet(pattern, allowance_m=0.02)
        boxes = []
        for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
            outline = piece.cutting + place
            boxes.append((outline.min(axis=0), outline.max(axis=0)))
            assert (boxes[-1][0] > 0.005).all() and (boxes[-1][1] < [sheet.width_m, sheet.height_m]).all()
        for i, (low, high) in enumerate(boxes):
            assert all((high < other[0]).any() or (low > other[1]).any() for other in boxes[:i])


def test_a_hem_has_more_allowance_than_a_seam_and_corners_meet_both():
    """Of a rectangle w by h with d at the sides and top and e below, the cutting line has w + 2 d by h + d + e."""
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    wide = offset(square, np.array([0.03, 0.01, 0.01, 0.01]))
    assert_allclose(wide[np.lexsort(wide.T)], [(-0.01, -0.03), (1.01, -0.03), (-0.01, 1.01), (1.01, 1.01)], atol=1e-6)
    hollow = np.array([(0, 0), (1, 0), (1, 1), (0.5, 0.02), (0, 1)], dtype=float)  # its notch closes
    assert boundary_distance(np.array([(0.5, 0.02)]), offset(hollow, 0.01))[0] > 0.01 - 1e-6
    front = make_sheet(tube()).pieces[0]
    assert front.allowances_m == (0.025, 0.01, 0.01, 0.01) and "hem 25 mm" in front.label.lines
    assert_allclose([front.cutting.min(axis=0), front.cutting.max(axis=0)], [(-0.21, -0.325), (0.21, 0.31)], atol=1e-6)
    assert set(make_sheet(tube(), hem_m=0.01).pieces[0].allowances_m) == {0.01}
    assert set(make_sheet(tube(), allowance_m=0.0).pieces[0].allowances_m) == {0.0}


def drawn(*corners: tuple[float, float]) -> Panel:
    """A panel with straight edges between ``corners`` [m]."""
    count = len(corners)
    return Panel("front", np.array(corners), tuple(Edge(n, (n + 1) % count) for n in range(count)))


def dense(polygon: np.ndarray) -> np.ndarray:
    """Points of its sides, 16 each."""
    return np.concatenate([a + np.linspace(0, 1, 17)[:-1, None] * (b - a) for a, b in _sides(polygon)])


def check_outside(piece: Piece) -> None:
    """The piece holds what is sewn, and is nowhere nearer to it than its least allowance, but on folds and in slits."""
    sewing, cutting = dense(piece.sewing), dense(piece.cutting)
    rim = boundary_distance(sewing, piece.cutting) < 1e-6
    assert (inside(sewing, piece.cutting) | rim).all()
    assert geometry.first_crossing(piece.cutting) is None
    if not (free := [allowance for allowance in piece.allowances_m if allowance]):
        return
    assert boundary_distance(cutting, piece.sewing).min() > (0.0 if 0.0 in piece.allowances_m else min(free)) - 2e-6


QUICK = ("tshirt", "shorts")  # the latter has darts

SLITS = {
    "one centimetre": ((0.2, 0.0), (0.2, 0.1), (0.21, 0.1), (0.21, 0.0)),
    "two millimetres": ((0.2, 0.0), (0.2, 0.1), (0.202, 0.1), (0.202, 0.0)),
    "slanted": ((0.2, 0.0), (0.25, 0.1), (0.257, 0.098), (0.21, 0.0)),
    "wedge": ((0.195, 0.0), (0.2, 0.15), (0.205, 0.0)),
    "keyhole": ((0.197, 0.0), (0.15, 0.05), (0.2, 0.1), (0.25, 0.05), (0.203, 0.0)),
    "two": ((0.1, 0), (0.1, 0.1), (0.105, 0.1), (0.105, 0), (0.12, 0), (0.12, 0.1), (0.125, 0.1), (0.125, 0)),
}


@pytest.mark.parametrize("kind", SLITS)
def test_a_hollow_narrower_than_two_allowances_is_cut_into(kind: str):
    panel = drawn((0.0, 0.0), *SLITS[kind], (0.4, 0.0), (0.4, 0.5), (0.0, 0.5))
    (piece,) = make_sheet(Pattern("slit", (panel,)), allowance_m=ALLOWANCE_M, hem_m=ALLOWANCE_M).pieces
    sewing = dense(piece.sewing)
    assert inside(sewing, piece.cutting).all() and geometry.first_crossing(piece.cutting) is None
    assert not inside(dense(piece.cutting), piece.sewing).any()
    # Each place of the sewing line is as near to a cut as at a mitred corner.
    assert boundary_distance(sewing, piece.cutting).max() < 2.5 * ALLOWANCE_M
    plain = boundary_distance(dense(piece.cutting), piece.sewing)[
        np.linalg.norm(dense(piece.cutting) - 0.2, axis=1) > 0.35
    ]
    assert plain.min() > ALLOWANCE_M - 2e-6


def dart(*, split: bool) -> Pattern:
    """A waist with a dart, each leg one edge or two."""
    tip = (
        ((1.5, 60.0), (1.0, 56.0), (0.0, 48.0), (-1.0, 56.0), (-1.5, 60.0))
        if split
        else ((1.5, 60), (0, 48), (-1.5, 60))
    )
    corners = np.array([(-25, 0), (25, 0), (25, 60), *tip, (-25, 60)]) / 100.0
    panel = drawn(*map(tuple, corners))
    legs = [(4, 5), (3, 6)] if split else [(3, 4)]
    return Pattern("dart", (panel,), tuple(Stitch(EdgeRef("front", a), EdgeRef("front", b)) for a, b in legs))


@pytest.mark.parametrize("split", [False, True])
def test_a_dart_stays_closed_and_its_legs_are_drawn(split: bool):
    (piece,) = make_sheet(dart(split=split), allowance_m=ALLOWANCE_M).pieces
    assert_allclose(piece.cutting[:, 1].max(), 0.61, atol=1e-6)
    assert inside(np.array([(0.0, 0.605), (0.0, 0.55)]), piece.cutting).all()
    assert min(np.linalg.norm(piece.sewing - [0.0, 0.48], axis=1)) < 1e-9
    assert piece.allowances_m[3:5] == (0.0, 0.0)
    mouth = sorted(notch.point[0] for notch in piece.notches)
    assert_allclose(mouth, [-0.015, 0.015], atol=1e-9)
    assert len(piece.cutting) == 4


def test_an_edge_on_the_fold_has_no_allowance():
    panel = drawn((0.0, 0.0), (0.25, 0.0), (0.25, 0.6), (0.0, 0.6))
    for label, on_fold in (("fold", True), ("centre_front_fold", True), ("Unfolded", False), (None, False)):
        edges = (*panel.edges[:3], replace(panel.edges[3], label=label))
        (piece,) = make_sheet(Pattern("half", (replace(panel, edges=edges),)), allowance_m=ALLOWANCE_M).pieces
        assert (piece.allowances_m[3] == 0.0) == on_fold == ("cut 1 on the fold" in piece.label.lines)
        assert_allclose(piece.cutting[:, 0].min(), -piece.allowances_m[3], atol=1e-6)
        check_outside(piece)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in CATALOGUE]
)
def test_the_catalogue_is_cut_outside_its_sewing_lines(name: str):
    for piece in make_sheet(CATALOGUE[name](default_measurements()).pattern).pieces:
        check_outside(piece)


def test_a_jagged_piece_holds_what_is_sewn_of_it():
    corners = [(19, 6), (-17, 58), (-15, 41), (-79, 204), (-23, -14), (94, -25), (57, -13)]
    star = np.array(corners) / 1000.0
    cutting = offset(star, np.array([0.01, 0.025, 0.01, 0.025, 0.01, 0.01, 0.025]))
    points = dense(star)
    assert (inside(points, cutting) | (boundary_distance(points, cutting) < 1e-6)).all()
    assert geometry.first_crossing(cutting) is None


def test_a_hem_beside_a_side_that_hardly_turns_is_a_step():
    bent = np.array([(0, 0), (0.4, 0), (0.41, 0.3), (0.4, 0.6), (0, 0.6)], dtype=float)
    wide = offset(bent, np.array([0.01, 0.01, 0.025, 0.01, 0.01]))
    along = bent[1] + np.linspace(0, 1, 50)[:, None] * (bent[2] - bent[1])
    assert_allclose(boundary_distance(along, wide)[:-1], 0.01, atol=1e-5)
    assert geometry.first_crossing(wide) is None


def test_hems_are_told_from_necklines_cuffs_and_armholes():
    pattern = tshirt(default_measurements())
    turned = hems(pattern)
    assert {(ref.panel, len([r for r in turned if r.panel == ref.panel])) for ref in turned} == {
        (panel.name, 1) for panel in pattern.panels
    }
    bent = replace(tube(), panels=(rectangle("front", translation_m=(0.0, 0.0, 0.2)), tube().panels[1]))
    hem = replace(bent.panels[0].edges[0], kind=EdgeKind.QUADRATIC, handles=((0.5, 0.4),))
    front = replace(bent.panels[0], edges=(hem, *bent.panels[0].edges[1:]))
    assert EdgeRef("front", 0) not in hems(replace(bent, panels=(front, bent.panels[1])))
    named = replace(front, edges=(replace(hem, label="hem"), *front.edges[1:]))
    assert EdgeRef("front", 0) in hems(replace(bent, panels=(named, bent.panels[1])))


def test_seams_of_the_back_have_two_notches_at_equal_places_on_both_edges():
    pattern = tshirt(default_measurements())
    pieces = {piece.panel.name: piece for piece in make_sheet(pattern).pieces}
    counts = []
    for stitch in pattern.stitches:
        places = []
        for ref in (stitch.first, stitch.second):
            panel = pattern.panel(ref.panel)
            fine = np.linspace(0.0, 1.0, 4001)
            line = geometry.edge_points(panel, ref.edge, fine)
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
            feet = [notch.point + ALLOWANCE_M * notch.inward for notch in pieces[ref.panel].notches]
            off = [np.linalg.norm(line - foot, axis=1) for foot in feet]
            at = sorted(float(along[d.argmin()]) for d in off if d.min() < 2e-4)
            places.append(np.array([s - 0.5 * along[-1] for s in at if 0.02 < s < along[-1] - 0.02]))
        assert len(places[0]) == len(places[1])
        assert_allclose(np.sort(places[0]), np.sort(-places[1]), atol=3e-4)
        counts.append(len(places[0]))
    assert sorted(counts) == [1] * 10 + [2] * 2  # both back halves of the sleeves in the back's armholes


def test_labels_lie_inside_whatever_the_piece_and_tell_its_mirror_image():
    narrow = Pattern("a long name of a pattern", (rectangle("strap", 0.03, 0.5),), material="jersey 200 g/m²")
    for pattern in (narrow, every_curve(), tshirt(default_measurements())):
        for piece in make_sheet(pattern).pieces:
            low, high = piece.label.box()
            frame = low + np.array([(x, y) for x in np.linspace(0, 1, 9) for y in np.linspace(0, 1, 9)]) * (high - low)
            assert inside(frame, piece.sewing).all()
            across = low[0] < piece.grain[0, 0] < high[0]
            assert not across or low[1] > piece.grain[1, 1] or high[1] < piece.grain[0, 1]
            assert piece.label.upright == (pattern is narrow)
    lines = {piece.panel.name: piece.label.lines for piece in make_sheet(tshirt(default_measurements())).pieces}
    assert lines["sleeve_right_back"][3:5] == ("mirror of", "sleeve_left_back") and lines["front"][3] == "symmetric"
