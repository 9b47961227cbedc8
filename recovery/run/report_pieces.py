"""The page of the fit report, and the part that a pattern maker works with: pieces to scale, seams, allowances.

The page is one HTML file without outside files."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from recovery.pattern import geometry
from recovery.pattern.export_svg import drawing
from recovery.pattern.labels import place_label
from recovery.pattern.pieces import (
    BACK_GAP_M,
    FACED,
    CuttingSheet,
    Piece,
    cut_count,
    hems,
    is_of_back,
    make_sheet,
    mirror_words,
    side_of,
)
from recovery.pattern.sewing_pattern import EdgeRef, Panel, Pattern

EQUAL_MM = 0.05  # below: both edges are equally long, as far as a ruler shows
PAGE_MM = 180.0  # width of the drawing on paper
# Style of the drawing on the page; every rule stays inside it.
STYLE = (
    ".pieces path,.pieces line,.pieces rect{{fill:none;stroke:#000;stroke-width:1px;vector-effect:non-scaling-stroke}}"
    ".pieces .cut{{fill:#f6f6f2}}.pieces .sew{{stroke:#06c;stroke-dasharray:4 2}}.pieces .grain{{stroke:#999}}"
    ".pieces .notch{{stroke-width:1.6px}}.pieces text{{font-family:sans-serif;fill:#000}}"
    ".pieces .seam{{font-size:{seam:g}px;fill:#06c;text-anchor:middle}}"
)
SCALES = (1, 2, 4, 5, 8, 10, 12, 15, 20, 25, 30, 40)


def add_pieces(page: ReportPage, pattern: Pattern) -> None:
    """Adds the sections on pieces, seams and edges of ``pattern`` to ``page``."""
    sheet = make_sheet(pattern)
    page.section("The pieces")
    page.say(
        f"Fabric: {pattern.material}. Grain lines run along the warp. Full lines are cut, dashed ones are sewn; equal "
        "numbers are sewn together. A seam has notches at its ends and in its middle: two, "
        f"{1e3 * BACK_GAP_M:.0f} mm apart, where it is of the back only, and one elsewhere."
    )
    page.drawing(*scaled_drawing(sheet))
    page.table(("piece", "side", "cut", "width [cm]", "height [cm]", "area [cm²]"), _piece_rows(pattern))
    page.section("Seams in pairs")
    page.say("Ease is what the longer edge has more than the shorter: spread it between the notches while sewing.")
    page.table(
        ("seam", "first edge", "second edge", "first [cm]", "second [cm]", "ease", "hold in", "middle notches"),
        _seam_rows(pattern),
    )
    page.section("Open edges and allowances")
    page.say("Allowances are in the cutting lines already.")
    page.table(("edge", "length [cm]", "allowance [mm]", "finish"), _open_rows(pattern, sheet))
    page.signature(("Checked by", "Date", "Sample sewn"))


def scaled_drawing(sheet: CuttingSheet) -> tuple[str, str]:
    """Returns the drawing of ``sheet`` as SVG text for a page, and its caption with the scale.

    Lines, names and numbers are as large on the page as at true size; of the labels the pieces' names are left.
    """
    scale = next((n for n in SCALES if 1e3 * sheet.width_m / n <= PAGE_MM), SCALES[-1])
    root = drawing(replace(sheet, pieces=tuple(_named(piece, scale) for piece in sheet.pieces)))
    for name in ("width", "height"):
        root.set(name, f"{float(root.attrib[name].removesuffix('mm')) / scale:.3f}mm")
    root.set("class", "pieces")
    style = root.find("style")
    if style is not None:
        style.text = STYLE.format(seam=2.8 * scale)
    for group in root.iter("g"):
        for line in group.findall("line"):  # a notch of 4 mm cannot be seen at this size
            for axis in "xy":
                start, end = (float(line.attrib[f"{axis}{n}"]) for n in (1, 2))
                line.set(f"{axis}2", f"{start + 0.3 * scale * (end - start):.3f}")
    for text in root.findall("text"):
        root.remove(text)
    caption = f"All pieces at 1:{scale}; the square is 50 mm at true size. The files have them at 1:1."
    return ElementTree.tostring(root, encoding="unicode"), caption


def _named(piece: Piece, scale: int) -> Piece:
    """``piece`` with its panel's name for a label, as large as reads well at 1:``scale``."""
    marks = np.array([point for point, _ in piece.seam_marks]).reshape(-1, 2)
    heights = [1e-3 * scale * mm for mm in (2.4, 2.0, 1.7, 1.4, 1.1, 0.9)]
    outline = geometry.outline(piece.panel, 1e-3)
    return replace(piece, label=place_label(piece.panel.name.split("_"), outline, piece.grain, marks, heights))


def _piece_rows(pattern: Pattern) -> list[tuple[str, ...]]:
    twins = mirror_words(pattern)
    rows = []
    for panel in pattern.panels:
        width, height = np.ptp(geometry.outline(panel), axis=0)
        mirrored = " ".join(twins.get(panel.name, ()))
        rows.append(
            (
                panel.name,
                side_of(panel),
                f"{cut_count(panel)}" + (f", {mirrored}" if mirrored else ""),
                f"{100 * width:.1f}",
                f"{100 * height:.1f}",
                f"{1e4 * geometry.area(panel):.0f}",
            )
        )
    return rows


def _seam_rows(pattern: Pattern) -> list[tuple[str, ...]]:
    rows = []
    for number, seam in enumerate(geometry.seams(pattern), start=1):
        first, second = seam.stitch.first, seam.stitch.second
        ease_mm = 1e3 * (seam.second_m - seam.first_m)
        longer = "second" if ease_mm > 0.0 else "first"
        equal = abs(ease_mm) < EQUAL_MM
        rows.append(
            (
                str(number),
                str(first),
                str(second),
                f"{100 * seam.first_m:.2f}",
                f"{100 * seam.second_m:.2f}",
                "0" if equal else f"{abs(ease_mm):.1f} mm, {100 * abs(seam.mismatch):.1f} %",
                "" if equal else longer,
                "2" if is_of_back(pattern, first, second) else "1",
            )
        )
    return rows


def _place(panel: Panel, edge: int) -> str:
    """An edge by its place in its panel, such as "front, bottom"."""
    low, size = panel.vertices.min(axis=0), np.ptp(panel.vertices, axis=0)
    across, up = (geometry.edge_points(panel, edge, np.array([0.5]))[0] - low) / size
    words = [("left", "", "right")[min(2, max(0, int(3 * across)))], ("bottom", "", "top")[min(2, max(0, int(3 * up)))]]
    return f"{panel.name}, {' '.join(word for word in reversed(words) if word) or 'middle'}"


def _open_rows(pattern: Pattern, sheet: CuttingSheet) -> list[tuple[str, ...]]:
    turned_up = hems(pattern)
    rows = []
    for piece in sheet.pieces:
        for number, allowance in enumerate(piece.allowances_m):
            ref = EdgeRef(piece.panel.name, number)
            if ref in pattern.sewn:
                continue
            length = geometry.edge_length(piece.panel, number)
            finish = "hem, turned up" if ref in turned_up else "neckline, armhole or waist: facing or band"
            if FACED in (piece.panel.edges[number].label or ""):
                finish = "cut twice: sewn to its facing"
            rows.append((_place(piece.panel, number), f"{100 * length:.2f}", f"{1e3 * allowance:g}", finish))
    return rows


PAGE_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:64rem;margin:2rem auto;padding:0 1rem}"
    "h1{font-size:1.7rem}h2{font-size:1.2rem;margin-top:2.2rem;border-bottom:1px solid #ddd}"
    "img{max-width:100%}figcaption{color:#555;font-size:.9rem}figure{margin:1rem 0}"
    "table{border-collapse:collapse;font-size:.9rem}td,th{padding:.15rem .7rem;border-bottom:1px solid #e5e5e5;"
    "text-align:right;white-space:nowrap}td:first-child,th:first-child{text-align:left}td:first-child{white-space:normal}"
    ".warn{background:#fff4d6;border-left:4px solid #d90;padding:.4rem .9rem;margin:.4rem 0}"
    ".good{background:#e9f6ec;border-left:4px solid #3a5;padding:.4rem .9rem;margin:.4rem 0}"
    "figure svg{max-width:100%;height:auto}.sign{display:flex;gap:2rem;margin:3rem 0 1rem}"
    ".sign div{flex:1;border-top:1px solid #222;font-size:.9rem;color:#555}"
    "@media print{body{margin:0;max-width:none}figure,tr,.warn,.good{break-inside:avoid}figure svg{max-width:none}}"
)


class ReportPage:
    """An HTML page that grows section by section."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._parts = [f"<h1>{html.escape(title)}</h1>"]

    def section(self, title: str) -> None:
        """Adds the heading ``title``."""
        self._parts.append(f"<h2>{html.escape(title)}</h2>")

    def say(self, *sentences: str) -> None:
        """Adds a paragraph of ``sentences``."""
        self._parts.append(f"<p>{html.escape(' '.join(sentences))}</p>")

    def notes(self, lines: Sequence[str], *, good: bool = False) -> None:
        """Adds a box for each of ``lines``: what to look at, or with ``good`` what is well."""
        kind = "good" if good else "warn"
        self._parts += [f'<div class="{kind}">{html.escape(line)}</div>' for line in lines]

    def picture(self, payload: bytes, caption: str) -> None:
        """Adds the PNG ``payload``, held inside the page, with its ``caption``."""
        data = base64.b64encode(payload).decode("ascii")
        text = html.escape(caption)
        self._parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{text}"><figcaption>{text}</figcaption></figure>'
        )

    def drawing(self, svg: str, caption: str) -> None:
        """Adds the drawing ``svg``, text that this program wrote, with its ``caption``."""
        self._parts.append(f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>")

    def signature(self, fields: Sequence[str]) -> None:
        """Adds a line for each of ``fields``, to be filled in by hand."""
        cells = "".join(f"<div>{html.escape(field)}</div>" for field in fields)
        self._parts.append(f'<div class="sign">{cells}</div>')

    def table(self, heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """Adds a table with ``heads`` above ``rows``; the first column is text."""
        top = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
        self._parts.append(f"<table><tr>{top}</tr>{body}</table>")

    def text(self) -> str:
        """Returns the whole page as HTML."""
        head = f'<meta charset="utf-8"><title>{html.escape(self.title)}</title><style>{PAGE_STYLE}</style>'
        return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(self._parts)}</body></html>\n'
