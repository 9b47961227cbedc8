"""Style lines of whole patterns: bands, yokes, joined sleeves and collars, and openings that say where they are."""

from __future__ import annotations

from dataclasses import replace

import ezdxf
import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError, NotFound
from recovery.catalogue.design_drape import design
from recovery.pattern import geometry
from recovery.pattern.__main__ import main
from recovery.pattern.bases import BASES
from recovery.pattern.export_dxf import write_dxf
from recovery.pattern.garmentcode import read_pattern, write_pattern
from recovery.pattern.openings import openings, openings_by_name
from recovery.pattern.pieces import FACED, cut_count, hems, make_sheet, mirror_words
from recovery.pattern.sewing_pattern import EdgeKind, EdgeRef, Pattern
from recovery.pattern.split import Curve, curves, divide_edges, part_panel
from recovery.pattern.style import NO_STYLE, RIB_SHORTER, Style, add_style_lines, cap_corners_deg, finish_pattern
from recovery.pattern.symmetry import find_symmetries, symmetrised
from recovery.pattern.trousers import LegCut
from recovery.pattern.trousers import trousers as draft_trousers
from tests.recovery.pattern_setup import bent_cap, default_measurements, tube

STYLES = {
    "trousers": {"waistband": 0.04, "hemband": 0.05},
    "skirt": {"waistband": 0.04, "hemband": 0.06},
    "tshirt": {"neckband": 0.025, "cuffs": 0.03, "yoke": 0.09, "hemband": 0.04},
    "tank": {"neckband": 0.025, "yoke": 0.05},
    "sleeved_dress": {"neckband": 0.02, "front_yoke": 0.03, "cuffs": 0.03},
    "dress": {"hemband": 0.05},
    "tube": {"waistband": 0.04, "hemband": 0.05},
    "strapless_dress": {"hemband": 0.05},
}


def base(name: str, **settings: float) -> Pattern:
    """A base, its symmetries exact as they are in a recovery."""
    pattern = BASES[name](default_measurements(), **settings)
    return symmetrised(pattern, find_symmetries(pattern))


def made(pattern: Pattern, whole_sleeves: bool = False, **widths_m: float) -> Pattern:
    style = Style(widths_m, whole_sleeves)
    return finish_pattern(add_style_lines(pattern, style), style)


def area(pattern: Pattern) -> float:
    return sum(geometry.area(panel) for panel in pattern.panels)


@pytest.mark.parametrize("name", BASES)
def test_openings_of_the_bases_have_names(name):
    found = {key: len(ones) for key, ones in openings_by_name(base(name)).items()}
    assert found == {
        **{name: {"waist": 1, "hem": 1} for name in ("skirt", "tube", "strapless_dress")},
        "trousers": {"waist": 1, "hem": 2},
        "tank": {"neck": 1, "hem": 1, "cuff": 0},
        "dress": {"neck": 1, "hem": 1, "cuff": 0},
    }.get(name, {"neck": 1, "hem": 1, "cuff": 2})


@pytest.mark.parametrize("name", BASES)
def test_lines_take_no_cloth_and_every_seam_stays_as_it_was(name):
    whole = base(name)
    found = add_style_lines(whole, Style(STYLES[name]))
    geometry.check_pattern(found)
    assert_allclose(area(found), area(whole), rtol=1e-12)
    assert len(openings(found)) == len(openings(whole))
    eases = {round(seam.mismatch, 9) for seam in geometry.seams(whole)}
    for seam in geometry.seams(found):
        assert min(abs(seam.mismatch - ease) for ease in eases) < 1e-6, seam.stitch
    # Edges round the openings are the same ones, and bands lie where their panels did.
    round_openings = [
        sorted(
            sum(geometry.edge_length(one.panel(ref.panel), ref.edge) for ref in opening.refs)
            for opening in openings(one)
        )
        for one in (found, whole)
    ]
    assert_allclose(*round_openings, rtol=1e-9)
    twins = {name: words for name, words in mirror_words(whole).items() if "mirror of" in words}
    assert twins.items() <= mirror_words(found).items()
    bands = {panel.name: panel for panel in found.panels if cut_count(panel) == 2}
    assert len(bands) >= 2 and not {ref.panel for ref in hems(found)} & bands.keys()
    for band in bands.values():
        parent = next(panel for panel in whole.panels if band.name.startswith(panel.name))
        assert band.placement == parent.placement


@pytest.mark.parametrize("name", ["skirt", "trousers"])
def test_a_band_in_one_piece_is_open_behind(name):
    """A seam is left: of trousers in the middle of the back; the ends of the others lie on each other."""
    whole = base(name)
    style = Style({"waistband": 0.03}, whole_bands=True)
    cut = add_style_lines(whole, style)
    found = finish_pattern(cut, style)
    bands = [panel for panel in found.panels if panel.name.endswith("waistband")]
    assert [panel.name for panel in bands] == ["waistband"] and style.words().endswith("bands in one piece")
    assert_allclose(area(found), area(whole), rtol=1e-4)  # edges a fraction of a millimetre apart became one
    geometry.check_pattern(found)
    (closing,) = [one for one in found.stitches if one.first.panel == one.second.panel == bands[0].name]
    assert abs(geometry.seams(found)[found.stitches.index(closing)].mismatch) < 1e-9
    waist = [edge for edge in bands[0].edges if edge.label == f"waist {FACED}"]
    assert len(waist) == len(whole.panels) and len(bands[0].edges) == 2 * len(waist) + 2


def test_mirrored_panels_have_mirrored_bands():
    words = mirror_words(add_style_lines(base("trousers"), Style(STYLES["trousers"])))
    assert words["front_right_waistband"] == ("mirror of", "front_left_waistband")
    assert words["back_right_hemband"] == ("mirror of", "back_left_hemband")


def test_a_waistband_through_darts_is_one_piece_with_the_darts_closed():
    cut = LegCut("trousers", "twill", 0.10, 0.5, band_m=0.0)
    whole = draft_trousers(default_measurements(), cut).pattern
    found = add_style_lines(whole, Style({"waistband": 0.03}))
    geometry.check_pattern(found)
    assert len(found.panels) == 8 and "front_left_waistband" in {panel.name for panel in found.panels}
    assert_allclose(area(found), area(whole), rtol=1e-9)
    for panel in found.panels:
        if panel.name.endswith("waistband"):
            waist = [edge for edge in panel.edges if edge.label == f"waist {FACED}"]
            assert len(waist) == 2 and len(panel.edges) == 6
    # Below the band the darts are as wide as they were there, and closed as before.
    darts = [one for one in found.stitches if one.first.panel == one.second.panel]
    assert len(darts) == 4 and not any("band" in one.first.panel for one in darts)


def test_a_waistband_is_as_wide_as_it_was_asked_for_at_every_seam():
    found = add_style_lines(base("trousers"), Style({"waistband": 0.04}))
    for panel in found.panels:
        if panel.name.endswith("waistband"):
            sides = sorted(geometry.edge_length(panel, number) for number in range(4))[:2]
            assert_allclose(sides, 0.04, atol=1e-9)


def test_a_neckband_is_parallel_to_the_neckline():
    """But at the shoulders, which the neckline does not meet squarely."""
    whole = base("tshirt")
    found = add_style_lines(whole, Style({"neckband": 0.025}))
    band = found.panel("front_neckband")
    lines = [n for n in range(len(band.edges)) if geometry.edge_length(band, n) > 0.03]
    upper = [n for n in lines if band.edges[n].label == f"neck {FACED}"]
    points = [
        np.concatenate([geometry.edge_points(band, n, np.linspace(0.0, 1.0, 200)) for n in part])
        for part in (upper, [n for n in lines if n not in upper])
    ]
    far = np.linalg.norm(points[1][:, None] - points[0], axis=2).min(axis=1)
    assert_allclose(far, 0.025, atol=2.5e-3)


def test_a_yoke_goes_through_the_armholes_and_divides_the_sleeves():
    whole, found = base("tshirt"), add_style_lines(base("tshirt"), Style({"yoke": 0.09}))
    neck = [ref for ref in openings_by_name(whole)["neck"][0].refs if ref.panel == "back"]
    low = min(geometry.flatten(whole.panel("back"), ref.edge, 1e-4)[:, 1].min() for ref in neck)
    assert_allclose(found.panel("back_yoke").vertices[:, 1].min(), low - 0.09, atol=1e-4)
    assert [len(found.panel(name).edges) for name in ("sleeve_left_back", "sleeve_left_front")] == [5, 4]
    assert len(found.stitches) == len(whole.stitches) + 3


def test_yokes_of_front_and_back_are_joined_at_the_shoulders():
    whole = base("tshirt")
    found = made(whole, yoke=0.09, front_yoke=0.04)
    assert [panel.name for panel in found.panels][:3] == ["front", "back", "yoke"]
    assert_allclose(area(found), area(whole), rtol=1e-9)
    geometry.check_pattern(found)
    assert mirror_words(found)["yoke"] == ("symmetric",)
    assert len(openings_by_name(found)["neck"]) == 1


def test_halves_of_a_sleeve_become_one_piece_with_one_seam():
    whole = base("tshirt", sleeve_length_m=0.5, sleeve_hem_girth_m=0.24)
    found = made(whole, True, cuffs=0.06)
    names = ["front", "back", "sleeve_left", "sleeve_left_cuff", "sleeve_right", "sleeve_right_cuff"]
    assert sorted(panel.name for panel in found.panels) == sorted(names)
    assert_allclose(area(found), area(whole), rtol=1e-12)
    for side in ("left", "right"):
        own = [one for one in found.stitches if one.first.panel == one.second.panel == f"sleeve_{side}"]
        assert len(own) == 1
        assert len([one for one in found.stitches if {one.first.panel, one.second.panel} == {f"sleeve_{side}"}]) == 1
    assert mirror_words(found)["sleeve_right_cuff"] == ("mirror of", "sleeve_left_cuff")


def test_a_cap_that_is_not_fair_where_halves_met_is_told():
    """Caps are level at the top of the arm; a shoulder corner that was moved in 2 cm makes them turn there."""
    whole = base("tshirt")
    assert cap_corners_deg(whole) == {}  # halves
    fair = cap_corners_deg(made(whole, True, yoke=0.05))
    assert fair.keys() == {"sleeve_left", "sleeve_right"} and max(fair.values()) < 1e-6
    turned = cap_corners_deg(made(bent_cap(whole), True))
    assert turned["sleeve_left"] > 5.0 and turned["sleeve_right"] < 1e-6


def test_a_collar_is_as_long_as_the_neckline_it_is_sewn_to():
    whole = base("tshirt")
    found = made(whole, collar=0.07)
    (neck,) = openings_by_name(whole)["neck"]
    length = sum(geometry.edge_length(whole.panel(ref.panel), ref.edge) for ref in neck.refs)
    collar = found.panel("collar")
    sewn = [seam for seam in geometry.seams(found) if "collar" in seam.stitch.first.panel]
    assert {seam.stitch.second for seam in sewn} == set(neck.refs)
    assert_allclose([seam.mismatch for seam in sewn], 0.0, atol=1e-12)
    assert_allclose(sum(seam.first_m for seam in sewn), length, rtol=1e-12)
    assert_allclose(np.ptp(collar.vertices, axis=0), [length + 0.02, 0.07], atol=1e-9)
    assert mirror_words(found)["collar"] == ("symmetric",) and cut_count(collar) == 2
    # From the middle of the front to the middle of the front: the first edge meets the last there.
    ends = [found.panel(sewn[n].stitch.second.panel) for n in (0, -1)]
    assert [panel.name for panel in ends] == ["front", "front"]
    # Neighbours on the collar are neighbours on the neckline: the garment has one edge more, not five.
    assert len(openings(found)) == len(openings(whole))


@pytest.mark.parametrize("opening", RIB_SHORTER)
def test_a_rib_is_a_closed_strip_shorter_than_what_holds_it(opening):
    whole, name = base("tshirt"), "rib_cuffs" if opening == "cuff" else f"rib_{opening}"
    style = Style({name: 0.03})
    cut = add_style_lines(whole, style)
    found = finish_pattern(cut, style)
    geometry.check_pattern(found)
    ribs = [panel for panel in found.panels if panel.name.startswith("rib_")]
    names = {"rib_cuff_left", "rib_cuff_right"} if opening == "cuff" else {name}
    assert {panel.name for panel in ribs} == names and all(cut_count(panel) == 2 for panel in ribs)
    assert_allclose(area(cut), area(whole), rtol=1e-12)
    assert len(openings(found)) == len(openings(whole))
    for rib in ribs:
        seams = [seam for seam in geometry.seams(found) if seam.stitch.first.panel == rib.name]
        held = [seam for seam in seams if seam.stitch.second.panel != rib.name]
        assert len(held) == len(seams) - 1 == len(rib.edges) - 3  # one closes it
        assert_allclose([seam.first_m / seam.second_m for seam in held], 1.0 - RIB_SHORTER[opening], rtol=1e-12)
        assert_allclose(np.ptp(rib.vertices, axis=0), [sum(seam.first_m for seam in held), 0.03], rtol=1e-9)
        assert (rib.placement.translation_m[0] > 0.01) == rib.name.endswith("left")


def test_a_band_is_cut_twice_in_the_files(tmp_path):
    pattern = made(base("skirt"), waistband=0.04)
    sheet = make_sheet(pattern)
    counts = {piece.panel.name: piece.label.lines[2] for piece in sheet.pieces}
    assert counts == {"front": "cut 1", "front_waistband": "cut 2", "back": "cut 1", "back_waistband": "cut 2"}
    for piece in sheet.pieces:
        if piece.panel.name.endswith("waistband"):
            assert set(piece.allowances_m) == {0.01}
    write_dxf(sheet, tmp_path / "skirt.dxf")
    document = ezdxf.readfile(tmp_path / "skirt.dxf")
    texts = [text.dxf.text for text in document.blocks["FRONT_WAISTBAND"].query("TEXT")]
    assert "Quantity: 2" in texts
    again = read_pattern(write_pattern(pattern, tmp_path / "skirt.json"))
    assert [cut_count(panel) for panel in again.panels] == [1, 2, 1, 2]


def test_a_style_has_words():
    assert not NO_STYLE and NO_STYLE.words() == ""
    style = Style({"waistband": 0.04, "front_yoke": 0.045}, True)
    assert style and style.words() == "waistband 4 cm, front yoke 4.5 cm, one-piece sleeves"


JACKET = replace(tube(), stitches=tube().stitches[:1])


def halved_back() -> Pattern:
    """A tank whose back has a seam in the middle."""
    whole = base("tank")
    panel = whole.panel("back")
    hem = int(np.argmin([curve.at(np.array([0.5]))[0, 1] for curve in curves(panel)]))
    pattern, pieces = divide_edges(whole, {EdgeRef("back", hem): [0.5]})
    outline = curves(pattern.panel("back"))
    top = next(n for n, curve in enumerate(outline) if abs(curve.points[0, 0]) < 1e-9 < curve.points[0, 1])
    low = pieces[EdgeRef("back", hem)][1].edge
    line = Curve(EdgeKind.LINE, np.array([outline[low].points[0], outline[top].points[0]]))
    return part_panel(pattern, "back", (top, low), [line], "back_other")[0]


def open_shirt() -> Pattern:
    """The catalogue's shirt without its collar, open in front: neck, fronts and hem are one opening, as a waist is."""
    shirt = design("shirt", default_measurements()).pattern
    taken = ("collar_stand", "collar_fall")
    stitches = [stitch for stitch in shirt.stitches if not {stitch.first.panel, stitch.second.panel} & {*taken}]
    stitches = [
        stitch for stitch in stitches if {stitch.first.panel, stitch.second.panel} != {"front_left", "front_right"}
    ]
    panels = tuple(panel for panel in shirt.panels if panel.name not in taken)
    return replace(shirt, panels=panels, stitches=tuple(stitches), panel_order=None)


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        (lambda: Style({"belt": 0.04}), "waistband, neckband"),
        (lambda: Style({"waistband": 4.0}), r"--style waistband: expected a width in \(0, 0.5\) m"),
        (lambda: made(base("trousers"), neckband=0.02), "a garment with a neck, got one with waist and hem"),
        (lambda: made(base("trousers"), collar=0.06), "a garment with a neck"),
        (lambda: made(base("trousers"), front_yoke=0.06), "a garment with a neck"),
        (lambda: made(base("tank"), cuffs=0.02), "a garment with a cuff"),
        (lambda: made(base("tank"), True), "sleeves in two halves"),
        (lambda: made(base("trousers"), waistband=0.3), "since front_left"),
        (lambda: made(JACKET, waistband=0.03), "0 in the middle and 1 beside it"),
        (lambda: made(open_shirt(), waistband=0.03), "1 in the middle and 2 beside it"),
        (lambda: made(halved_back(), yoke=0.03), "a back in one piece, got 2"),
    ],
)
def test_what_a_pattern_has_no_place_for_is_refused(cut, message):
    with pytest.raises((InputError, NotFound), match=message):
        cut()


@pytest.mark.parametrize("arguments", [["convert", "in.json"], ["draft", "skirt"]])
def test_the_command_line_draws_lines(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_pattern(base("skirt"), tmp_path / "in.json")
    more = ["--out", "out", "--name", "banded", "--format", "json"]
    assert main([*arguments, *more, "--style", "waistband=0.04"]) == 0
    names = [panel.name for panel in read_pattern(tmp_path / "out" / "banded.json").panels]
    assert names == ["front", "front_waistband", "back", "back_waistband"]
    assert main([*arguments, *more, "--style", "waistband"]) == 2
    assert "--style: expected NAME=NUMBER" in capsys.readouterr().err
