"""Pieces of a pattern on a sheet: allowances, notches, grain, hems and labels, and their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from recovery.pattern import geometry
from recovery.pattern.bases import tshirt
from recovery.pattern.model import EdgeKind, EdgeRef, Pattern
from recovery.pattern.pieces import NOTCH_DEPTH_M, hems, make_sheet, offset
from recovery.pattern.triangulate import boundary_distance, inside
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
