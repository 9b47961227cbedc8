"""The pieces as an SVG drawing at true size: one sheet, millimetres, curves as curves."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from recovery.pattern.pieces import FOOTER_M, MARGIN_M, NOTCH_DEPTH_M, SCALE_SQUARE_M, CuttingSheet, Piece
from recovery.pattern.sewing_pattern import EdgeKind, Panel

MM = 1000.0
ARROW_MM = 6.0
CAPITAL = 0.72  # height of capitals over the size of a plain face
STYLE = (
    "path,line,rect{fill:none;stroke:#000;stroke-width:.3}"
    ".cut{stroke-width:.5}.sew{stroke:#06c;stroke-dasharray:4 2}.grain{stroke:#444}"
    "text{font-family:sans-serif;font-size:6px;fill:#000}.seam{font-size:5px;fill:#06c;text-anchor:middle}"
)


def write_svg(sheet: CuttingSheet, path: Path) -> None:
    """Writes ``sheet`` to ``path`` as SVG: a group per piece, whose lines have the classes cut, sew, grain and
    notch."""
    ElementTree.ElementTree(drawing(sheet)).write(path, encoding="utf-8", xml_declaration=True)


def drawing(sheet: CuttingSheet) -> ElementTree.Element:
    """Returns the SVG element of ``sheet``, in millimetres, that ``write_svg`` writes."""
    width, height = MM * sheet.width_m, MM * sheet.height_m
    root = ElementTree.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{width:.3f}mm",
            "height": f"{height:.3f}mm",
            "viewBox": f"0 0 {width:.3f} {height:.3f}",
        },
    )
    ElementTree.SubElement(root, "title").text = sheet.title
    ElementTree.SubElement(root, "style").text = STYLE
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        _piece(ElementTree.SubElement(root, "g", {"id": piece.panel.name}), piece, place, sheet.height_m)
    corner = (MM * MARGIN_M, height - MM * (MARGIN_M + SCALE_SQUARE_M))
    side = f"{MM * SCALE_SQUARE_M:g}"
    ElementTree.SubElement(
        root, "rect", {"class": "scale", "x": f"{corner[0]:g}", "y": f"{corner[1]:.3f}", "width": side, "height": side}
    )
    _text(root, [f"{side} mm"], (corner[0] + 4.0, corner[1] + 27.0), "scale")
    _text(root, [sheet.title], (corner[0] + float(side) + 8.0, height - MM * FOOTER_M / 2.0), "title")
    ElementTree.indent(root)
    return root


def _piece(group: ElementTree.Element, piece: Piece, place: np.ndarray, height_m: float) -> None:
    def page(point: np.ndarray) -> tuple[float, float]:
        return MM * float(point[0] + place[0]), MM * float(height_m - point[1] - place[1])

    def pair(point: np.ndarray) -> str:
        x, y = page(point)
        return f"{x:.4f} {y:.4f}"

    outline = "M" + " L".join(pair(point) for point in piece.cutting) + " Z"
    ElementTree.SubElement(group, "path", {"class": "cut", "d": outline})
    ElementTree.SubElement(group, "path", {"class": "sew", "d": _sewing_path(piece.panel, pair)})
    (x, low), (_, high) = page(piece.grain[0]), page(piece.grain[1])
    arrows = f"M{x:.4f} {low:.4f} L{x:.4f} {high:.4f}"
    for y, sense in ((high, 1.0), (low, -1.0)):
        tip = f"{x:.4f} {y:.4f}"
        arrows += f" M{x - ARROW_MM / 3:.4f} {y + sense * ARROW_MM:.4f} L{tip} L{x + ARROW_MM / 3:.4f} "
        arrows += f"{y + sense * ARROW_MM:.4f}"
    ElementTree.SubElement(group, "path", {"class": "grain", "d": arrows})
    for notch in piece.notches:
        (x1, y1), (x2, y2) = page(notch.point), page(notch.point + NOTCH_DEPTH_M * notch.inward)
        ends = {"x1": f"{x1:.4f}", "y1": f"{y1:.4f}", "x2": f"{x2:.4f}", "y2": f"{y2:.4f}"}
        ElementTree.SubElement(group, "line", {"class": "notch", **ends})
    for point, text in piece.seam_marks:
        _text(group, [text], page(point), "seam")
    size = f"font-size:{MM * piece.label.height_m / CAPITAL:.3f}px"
    for point, line in piece.label.baselines():
        x, y = page(point)
        turn = {"transform": f"rotate(-90 {x:.3f} {y:.3f})"} if piece.label.upright else {}
        _text(group, [line], (x, y), "label", style=size, **turn)


def _sewing_path(panel: Panel, pair) -> str:
    parts = [f"M{pair(panel.vertices[panel.edges[0].start])}"]
    for edge in panel.edges:
        start, end = panel.vertices[edge.start], panel.vertices[edge.end]
        chord = end - start
        turned = np.array([-chord[1], chord[0]])
        if edge.kind is EdgeKind.CIRCLE:
            height = edge.handles[0][1]
            radius = MM * float(np.linalg.norm(chord)) * (0.25 + height * height) / (2.0 * abs(height))
            # On the page y points down, so an arc to the left of its chord turns clockwise: sweep 1.
            parts.append(f"A{radius:.5f} {radius:.5f} 0 {int(abs(height) > 0.5)} {int(height > 0.0)} {pair(end)}")
            continue
        inner = " ".join(pair(start + along * chord + left * turned) for along, left in edge.handles)
        letter = {EdgeKind.LINE: "L", EdgeKind.QUADRATIC: "Q", EdgeKind.CUBIC: "C"}[edge.kind]
        parts.append(f"{letter}{inner}{' ' if inner else ''}{pair(end)}")
    return " ".join(parts) + " Z"


def _text(group: ElementTree.Element, lines: list[str], at: tuple[float, float], kind: str, **more: str) -> None:
    for number, line in enumerate(lines):
        place = {"class": kind, "x": f"{at[0]:.3f}", "y": f"{at[1] + 7.0 * number:.3f}", **more}
        ElementTree.SubElement(group, "text", place).text = line
