"""Files for people who cut: read back with other readers, lengths agree to a tenth of a millimetre."""

from __future__ import annotations

import base64
import re
import zlib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from ezdxf.entities import Point, Polyline
from numpy.testing import assert_allclose

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.__main__ import main
from recovery.pattern.bases import tshirt
from recovery.pattern.export_dxf import write_dxf
from recovery.pattern.export_pdf import write_pdf
from recovery.pattern.export_svg import write_svg
from recovery.pattern.garmentcode import read_pattern, write_pattern
from recovery.pattern.geometry import boundary_distance
from recovery.pattern.pattern_files import FORMATS, export_pattern
from recovery.pattern.pieces import CuttingSheet, make_sheet
from recovery.pattern.sewing_pattern import EdgeKind, EdgeRef, Panel, Pattern
from recovery.pattern.style import Style, add_style_lines, finish_pattern
from tests.recovery.pattern_setup import (
    assert_same_pattern,
    default_measurements,
    every_curve,
    polygon_mm,
    rectangle,
    tube,
)

SVG = "{http://www.w3.org/2000/svg}"
ALLOWANCE_M = 0.01


def perimeter_mm(panel: Panel) -> float:
    return 1000.0 * sum(geometry.edge_length(panel, number) for number in range(len(panel.edges)))


def svg_curves(d: str) -> list[tuple[str, np.ndarray]]:
    """Letters and fine polylines (2001, 2) of an SVG path of M, L, Q, C, A and Z with absolute coordinates.

    Arcs are circles, by the construction of the SVG specification.
    """
    curves, first, at = [], np.zeros(2), np.zeros(2)
    t = np.linspace(0.0, 1.0, 2001)[:, None]
    for letter, text in re.findall(r"([MLQCAZ])([^MLQCAZ]*)", d):
        numbers = np.array([float(value) for value in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)])
        if letter == "M":
            first = at = numbers
            continue
        end = first if letter == "Z" else numbers[-2:]
        if letter == "A":
            radius, large, sweep = numbers[0], numbers[3], numbers[4]
            chord = end - at
            root = np.sqrt(max(radius**2 - 0.25 * chord @ chord, 0.0))
            normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
            arm = at - (centre := 0.5 * (at + end) + (root if large != sweep else -root) * normal)
            half = np.arcsin(np.clip(np.linalg.norm(chord) / (2.0 * radius), 0.0, 1.0))
            angle = (2.0 * np.pi - 2.0 * half if large else 2.0 * half) * (1.0 if sweep else -1.0) * t
            points = centre + np.cos(angle) * arm + np.sin(angle) * np.array([-arm[1], arm[0]])
        else:
            points = np.vstack([at, numbers.reshape(-1, 2) if letter != "Z" else first])[None]
            while points.shape[1] > 1:  # de Casteljau
                points = (1.0 - t[:, :, None]) * points[:, :-1] + t[:, :, None] * points[:, 1:]
            points = points[:, 0]
        curves.append((letter, points))
        at = end
    return curves


def test_the_svg_has_a_group_for_each_piece_in_millimetres(tmp_path):
    pattern = every_curve()
    sheet = make_sheet(pattern, allowance_m=ALLOWANCE_M)
    write_svg(sheet, tmp_path / "sheet.svg")
    root = ElementTree.parse(tmp_path / "sheet.svg").getroot()
    size = np.array([float(root.attrib[name].removesuffix("mm")) for name in ("width", "height")])
    assert_allclose(size, [1000 * sheet.width_m, 1000 * sheet.height_m], atol=1e-3)
    # One unit is one millimetre.
    assert root.attrib["viewBox"] == f"0 0 {size[0]:.3f} {size[1]:.3f}"
    groups = {group.attrib["id"]: group for group in root.iter(f"{SVG}g")}
    assert list(groups) == [panel.name for panel in pattern.panels]
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        paths = {path.attrib["class"]: path.attrib["d"] for path in groups[piece.panel.name].iter(f"{SVG}path")}
        first = piece.panel.vertices[piece.panel.edges[0].start] + place
        assert paths["sew"].startswith(f"M{1000 * first[0]:.4f} {1000 * (sheet.height_m - first[1]):.4f}")
        assert len(list(groups[piece.panel.name].iter(f"{SVG}line"))) == len(piece.notches)
        arcs = [number for number, edge in enumerate(piece.panel.edges) if edge.kind is EdgeKind.CIRCLE]
        drawn = [points for letter, points in svg_curves(paths["sew"]) if letter == "A"]
        for number, points in zip(arcs, drawn, strict=True):
            highest = 1000.0 * (geometry.edge_points(piece.panel, number, np.array([0.5]))[0] + place)
            assert_allclose(points[1000], [highest[0], 1000.0 * sheet.height_m - highest[1]], atol=2e-3)
    scale = next(element for element in root.iter(f"{SVG}rect"))
    assert scale.attrib["width"] == scale.attrib["height"] == "50"
    texts = [element.text for element in root.iter(f"{SVG}text")]
    assert "cut 1" in texts and "seam allowance 10 mm" in texts and pattern.material in texts


@pytest.mark.parametrize("dialect", ["aama", "gerber"])
@pytest.mark.parametrize("unit_mm", [1.0, 10.0])
def test_the_dxf_has_a_block_for_each_piece_with_its_layers(dialect, unit_mm, tmp_path, caplog):
    pattern = every_curve()
    sheet = make_sheet(pattern, allowance_m=ALLOWANCE_M)
    path = tmp_path / "pattern.dxf"
    write_dxf(sheet, path, unit_mm=unit_mm, dialect=dialect)
    assert not caplog.records
    assert path.read_bytes().isascii()
    assert ("TABLES" in path.read_text()) == (dialect == "aama")
    document = ezdxf.readfile(path)
    assert document.dxfversion == "AC1009"  # R12
    inserts = list(document.modelspace().query("INSERT"))
    assert [insert.dxf.name for insert in inserts] == ["CURVED", "ROUND_END"]
    for piece, place, insert in zip(sheet.pieces, sheet.offsets, inserts, strict=True):
        assert_allclose(unit_mm * np.array(insert.dxf.insert)[:2], 1000.0 * place, atol=1e-6)
        block = document.blocks[insert.dxf.name]
        lines = [one for one in block.query("POLYLINE") if isinstance(one, Polyline) and one.is_closed]
        assert sorted(one.dxf.layer for one in lines) == ["1", "14"]
        (grain,) = block.query("LINE[layer=='7']")
        ends = np.array([grain.dxf.start, grain.dxf.end])[:, :2]
        assert_allclose(unit_mm * ends, 1000.0 * piece.grain, atol=1e-6)
        notches = [point for point in block.query("POINT[layer=='4']") if isinstance(point, Point)]
        found = unit_mm * np.array([point.dxf.location for point in notches])[:, :2]
        assert_allclose(found, [1000.0 * notch.point for notch in piece.notches], atol=1e-6)
        corners = len(block.query("POINT[layer=='2']"))
        assert 2 <= corners <= 10 and corners + len(block.query("POINT[layer=='3']")) == len(piece.cutting)
        texts = [text.dxf.text for text in block.query("TEXT[layer=='1']")]
        assert texts[1:3] == ["Size: ONE", "Quantity: 1"] and "Annotation: wool" in texts
    assert "Piece Name: round end" in [text.dxf.text for text in document.blocks["ROUND_END"].query("TEXT")]
    assert "Units: METRIC" in [text.dxf.text for text in document.modelspace().query("TEXT")]


def test_without_allowance_the_boundary_is_the_sewing_line(tmp_path):
    write_dxf(make_sheet(tube(), allowance_m=0.0), tmp_path / "tube.dxf")
    block = ezdxf.readfile(tmp_path / "tube.dxf").blocks["FRONT"]
    assert [line.dxf.layer for line in block.query("POLYLINE")] == ["1"]


def test_blocks_keep_their_own_names(tmp_path):
    names = ["a b", "a_b", "日本", "x" * 40, "x" * 41]
    pattern = Pattern("names", tuple(rectangle(name) for name in names))
    write_dxf(make_sheet(pattern), tmp_path / "names.dxf")
    document = ezdxf.readfile(tmp_path / "names.dxf")
    blocks = [insert.dxf.name for insert in document.modelspace().query("INSERT")]
    assert len(set(blocks)) == 5 and max(map(len, blocks)) <= 31


def pdf_streams(path: Path) -> list[str]:
    """The drawing instructions in a PDF: its streams, unpacked."""
    found = []
    for packed in re.findall(rb"stream\r?\n(.*?)endstream", path.read_bytes(), re.DOTALL):
        text = packed.strip()
        data = zlib.decompress(base64.a85decode(text.removesuffix(b"~>"))) if text.endswith(b"~>") else text
        found.append(data.decode("latin-1"))
    return found


def pdf_polygons_mm(stream: str) -> list[np.ndarray]:
    """Closed polygons [mm] of a stream of m, l and h instructions."""
    polygons = []
    for found in re.findall(r"((?:-?[\d.]+ -?[\d.]+ [ml]\s+)+)h", stream):
        polygons.append(np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+) [ml]", found), dtype=float) * 25.4 / 72.0)
    return polygons


def media_boxes_mm(path: Path) -> np.ndarray:
    found = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", path.read_bytes())
    return np.array(found, dtype=float) * 25.4 / 72.0


def checked_form(path: Path, sheet: CuttingSheet) -> None:
    (form,) = [
        stream for stream in pdf_streams(path) if sheet.title in stream and " l" in stream and "Do" not in stream
    ]
    polygons = pdf_polygons_mm(form)
    for number, (piece, place) in enumerate(zip(sheet.pieces, sheet.offsets, strict=True)):
        cut, sew = polygons[2 * number : 2 * number + 2]
        assert_allclose(cut, 1000.0 * (piece.cutting + place), atol=2e-3)
        assert abs(polygon_mm(sew) - perimeter_mm(piece.panel)) < 0.1


def test_one_page_holds_the_pieces_at_true_size(tmp_path):
    sheet = make_sheet(every_curve(), allowance_m=ALLOWANCE_M)
    assert write_pdf(sheet, tmp_path / "sheet.pdf", page="single") == 1
    assert_allclose(
        media_boxes_mm(tmp_path / "sheet.pdf")[-1], [1000 * sheet.width_m, 1000 * sheet.height_m], atol=1e-2
    )
    checked_form(tmp_path / "sheet.pdf", sheet)


def test_sheets_of_a4_cover_every_piece_at_true_size(tmp_path):
    sheet = make_sheet(every_curve(), allowance_m=ALLOWANCE_M)
    path = tmp_path / "tiles.pdf"
    count = write_pdf(sheet, path)
    pages = [stream for stream in pdf_streams(path) if " Do" in stream]
    assert len(pages) == count
    assert_allclose(media_boxes_mm(path)[-count:], np.broadcast_to([210.0, 297.0], (count, 2)), atol=1e-2)
    checked_form(path, sheet)
    # Each page shifts the same drawing: window corner in the sheet = border - shift.
    shifts = [re.search(r"1 0 0 1 (-?[\d.]+) (-?[\d.]+) cm\s+/\S+ Do", page) for page in pages]
    corners = np.array([10.0 - 25.4 / 72.0 * np.array(shift.groups(), dtype=float) for shift in shifts if shift])
    assert len(corners) == count
    assert_allclose(np.mod(corners[:, 0] + 1e-3, 190.0), 1e-3, atol=2e-3)
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        outline = 1000.0 * (piece.cutting + place)
        within = outline[:, None] - corners
        covered = ((within >= -1e-2) & (within <= np.array([190.01, 277.01]))).all(axis=2)
        assert covered.any(axis=1).all()
    columns, rows = np.ceil(1000.0 * sheet.width_m / 190.0), np.ceil(1000.0 * sheet.height_m / 277.0)
    assert count < columns * rows  # the empty corner is left out


def test_the_same_pattern_gives_the_same_pdf(tmp_path):
    for name in ("one.pdf", "two.pdf"):
        write_pdf(make_sheet(tube()), tmp_path / name)
    assert (tmp_path / "one.pdf").read_bytes() == (tmp_path / "two.pdf").read_bytes()


LONG = Pattern("long", tuple(rectangle(str(number), width=1.4, height=1.5) for number in range(4)))


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: write_dxf(make_sheet(tube()), path, unit_mm=25.4), "unit_mm"),
        (lambda path: write_dxf(make_sheet(tube()), path, dialect="astm"), "dialect"),
        (lambda path: write_pdf(make_sheet(tube()), path, page="A0"), "page"),
        (lambda path: write_pdf(make_sheet(LONG), path, page="single"), "at most 5080 mm"),
        (lambda path: export_pattern(tube(), path.parent, ["svg", "ps"]), "format"),
        (lambda path: make_sheet(tube(), allowance_m=-0.01), "allowance_m"),
        (lambda path: make_sheet(tube(), allowance_m=0.5), "allowance_m"),
        (lambda path: make_sheet(tube(), allowance_m=np.nan), "allowance_m"),
    ],
)
def test_options_that_do_not_exist_are_refused(write, message, tmp_path):
    with pytest.raises(InputError, match=message):
        write(tmp_path / "x")
    assert list(tmp_path.iterdir()) == []


def test_the_command_line_converts_and_shows(tmp_path, capsys):
    source = write_pattern(every_curve(), tmp_path / "in" / "pattern.json")
    out = tmp_path / "out"
    assert main(["convert", str(source), "--out", str(out), "--name", "coat", "--allowance", "0.015"]) == 0
    assert capsys.readouterr().out.split() == [str(out / f"coat.{name}") for name in FORMATS]
    assert "seam allowance 15 mm" in (out / "coat.svg").read_text()
    back = read_pattern(out / "coat.json")
    assert back.name == "coat" and len(back.stitches) == 1
    assert main(["show", str(source), "--edge-length", "0.05", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "every curve: 2 panels, 1 stitches" in printed and "lengths differ" in printed and "nodes" in printed
    assert (out / "every curve.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_line_drafts_a_dress(tmp_path, capsys):
    arguments = ["draft", "tshirt", "--out", str(tmp_path), "--name", "dress", "--format", "json"]
    assert main([*arguments, "--set", "length_m=1.0", "flare_m=0.1"]) == 0
    expected = tshirt(default_measurements(), length_m=1.0, flare_m=0.1)
    assert_same_pattern(read_pattern(tmp_path / "dress.json"), replace(expected, name="dress"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["convert", "nothing.json", "--out", "x"], "Check the path"),
        (["draft", "skirt", "--out", "x", "--set", "wideness=1"], "flare_m"),
        (["draft", "skirt", "--out", "x", "--set", "flare_m=wide"], "NAME=NUMBER"),
        (["draft", "skirt", "--out", "x", "--body", "nobody"], "nobody"),
    ],
)
def test_the_command_line_says_what_is_wrong(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert message in printed.err and printed.out == "" and list(tmp_path.iterdir()) == []


STYLE = Style({"neckband": 0.025, "yoke": 0.09, "front_yoke": 0.04, "cuffs": 0.03, "collar": 0.07}, whole_sleeves=True)
LINED = finish_pattern(add_style_lines(tshirt(default_measurements()), STYLE), STYLE)


@pytest.mark.parametrize(
    "pattern",
    [every_curve(), tshirt(default_measurements()), replace(LINED, name="lined")],
    ids=lambda pattern: pattern.name,
)
def test_all_formats_say_the_same_to_a_tenth_of_a_millimetre(pattern, tmp_path):
    """Every sewing and cutting line and both lengths of every seam, from JSON, SVG, DXF and PDF read back."""
    sheet = make_sheet(pattern)
    export_pattern(pattern, tmp_path, page="single")
    stem = tmp_path / pattern.name
    again = read_pattern(f"{stem}.json")
    root = ElementTree.parse(f"{stem}.svg").getroot()
    groups = {group.attrib["id"]: group for group in root.iter(f"{SVG}g")}
    document = ezdxf.readfile(f"{stem}.dxf")
    inserts = list(document.modelspace().query("INSERT"))
    (form,) = [text for text in pdf_streams(tmp_path / f"{pattern.name}.pdf") if " l" in text and "Do" not in text]
    polygons = pdf_polygons_mm(form)
    assert_allclose(np.ptp(polygons[-1], axis=0) if len(polygons[-1]) == 4 else 50.0, 50.0, atol=1e-3)
    lengths: dict[str, dict[EdgeRef, float]] = {name: {} for name in ("json", "svg", "dxf", "pdf")}
    for number, (piece, place, insert) in enumerate(zip(sheet.pieces, sheet.offsets, inserts, strict=True)):
        read = again.panels[number]
        paths = {path.attrib["class"]: path.attrib["d"] for path in groups[piece.panel.name].iter(f"{SVG}path")}
        drawn = {
            kind: [
                np.array([1.0, -1.0]) * points + [0.0, 1e3 * sheet.height_m] - 1e3 * place
                for _, points in svg_curves(paths[kind])
            ]
            for kind in ("sew", "cut")
        }
        entities = [one for one in document.blocks[insert.dxf.name].query("POLYLINE") if isinstance(one, Polyline)]
        blocks = {one.dxf.layer: np.array([v.dxf.location for v in one.vertices])[:, :2] for one in entities}
        cut, sew = (polygon - 1e3 * place for polygon in polygons[2 * number : 2 * number + 2])
        outlines = {
            "json": 1e3 * geometry.outline(read, 1e-5),
            "svg": np.concatenate([points[:-1:20] for points in drawn["sew"]]),
            "dxf": blocks["14"],
            "pdf": sew,
        }
        cuts = {"svg": np.concatenate([points[:1] for points in drawn["cut"]]), "dxf": blocks["1"], "pdf": cut}
        for lines in (outlines, cuts):
            first = next(iter(lines.values()))
            for line in lines.values():
                assert boundary_distance(line, first).max() < 0.1 and boundary_distance(first, line).max() < 0.1
        for edge, panel_edge in enumerate(piece.panel.edges):
            ref = EdgeRef(piece.panel.name, edge)
            lengths["json"][ref] = 1e3 * geometry.edge_length(read, edge)
            lengths["svg"][ref] = float(np.linalg.norm(np.diff(drawn["sew"][edge], axis=0), axis=1).sum())
            ends = 1e3 * piece.panel.vertices[[panel_edge.start, panel_edge.end]]
            for name in ("dxf", "pdf"):  # the part of the outline between the edge's corners
                start, end = (int(np.linalg.norm(outlines[name] - corner, axis=1).argmin()) for corner in ends)
                part = np.roll(outlines[name], -start, axis=0)[: (end - start) % len(outlines[name]) + 1]
                lengths[name][ref] = float(np.linalg.norm(np.diff(part, axis=0), axis=1).sum())
    for stitch in pattern.stitches:
        for ref in (stitch.first, stitch.second):
            found = [lengths[name][ref] for name in lengths]
            assert max(found) - min(found) < 0.1, (ref, found)
