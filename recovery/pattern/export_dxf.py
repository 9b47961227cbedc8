"""The pieces as DXF R12 in the manner of AAMA and ASTM D6673: a block per piece, features by layer number.

Curves become polylines, as the standard wants. Stitches have no place in it: keep the JSON beside the file.
"""

from __future__ import annotations

import logging
import re
import unicodedata
from pathlib import Path

import ezdxf
import numpy as np
from ezdxf.addons import gerber_D6673
from ezdxf.document import Drawing
from ezdxf.layouts import BlockLayout, Modelspace

from drape.errors import InputError
from recovery.pattern.pieces import NOTCH_DEPTH_M, CuttingSheet, Piece, cut_count

CUT, TURN_POINT, CURVE_POINT, NOTCH, GRAIN, INTERNAL, SEW, ANNOTATION = "1", "2", "3", "4", "7", "8", "14", "15"
LAYERS = (CUT, TURN_POINT, CURVE_POINT, NOTCH, GRAIN, INTERNAL, SEW, ANNOTATION)
TURN_DEG = 15.0  # a vertex where the outline turns by more is a corner
TEXT_MM, LINE_MM = 6.0, 9.0
UNITS_MM = (1.0, 10.0)
DIALECTS = ("aama", "gerber")


def write_dxf(sheet: CuttingSheet, path: Path, *, unit_mm: float = 1.0, dialect: str = "aama") -> None:
    """Writes ``sheet`` to ``path`` as DXF R12 with drawing units of ``unit_mm`` [mm].

    R12 files state no unit, and what "METRIC" means differs: most readers ask, some take centimetres (10). ``dialect``
    "gerber" leaves out tables and layout blocks, which Gerber's reader takes for pieces.
    """
    if unit_mm not in UNITS_MM:
        raise InputError("unit_mm", expected=f"one of {UNITS_MM}", got=f"{unit_mm}", cure="1 is mm, 10 is cm.")
    if dialect not in DIALECTS:
        raise InputError("dialect", expected=f"one of {DIALECTS}", got=dialect, cure="Choose one of them.")
    document = _new_document()
    for layer in LAYERS:
        document.layers.add(layer)
    space = document.modelspace()
    style = [f"Style Name: {_ascii(sheet.title)}", "Sample Size: ONE", "Units: METRIC", "Author: drape"]
    _texts(space, style, np.zeros(2), 1.0 / unit_mm, CUT)
    names: set[str] = set()
    scale = 1000.0 / unit_mm
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        block = document.blocks.new(_block_name(piece.panel.name, names))
        _add_piece(block, piece, scale, 1.0 / unit_mm)
        space.add_blockref(block.name, tuple(scale * place), dxfattribs={"layer": CUT})
    _save(document, path, dialect)


def _new_document() -> Drawing:
    """An empty R12 drawing, without the library's warning that R12 states no unit."""
    logger = logging.getLogger("ezdxf")

    def is_other(record: logging.LogRecord) -> bool:
        return "$INSUNITS" not in record.getMessage()

    logger.addFilter(is_other)
    try:
        return ezdxf.new("R12")
    finally:
        logger.removeFilter(is_other)


def _save(document: Drawing, path: Path, dialect: str) -> None:
    if dialect == "gerber":
        with path.open("w", encoding="ascii", errors="dxfreplace") as stream:
            gerber_D6673.export_stream(document, stream)
    else:
        document.saveas(path)


def _add_piece(block: BlockLayout, piece: Piece, scale: float, per_mm: float) -> None:
    has_allowance = piece.cutting is not piece.sewing
    for polygon, layer in ((piece.cutting, CUT), (piece.sewing, SEW)):
        if layer == SEW and not has_allowance:
            continue
        block.add_polyline2d((scale * polygon).tolist(), close=True, dxfattribs={"layer": layer})
    corner = _is_corner(piece.cutting)
    for point, turns in zip(scale * piece.cutting, corner, strict=True):
        block.add_point(tuple(point), dxfattribs={"layer": TURN_POINT if turns else CURVE_POINT})
    block.add_line(*map(tuple, scale * piece.grain), dxfattribs={"layer": GRAIN})
    for notch in piece.notches:
        angle = float(np.degrees(np.arctan2(notch.inward[1], notch.inward[0])))
        attributes = {"layer": NOTCH, "thickness": scale * NOTCH_DEPTH_M, "angle": angle}
        block.add_point(tuple(scale * notch.point), dxfattribs=attributes)
    for point, text in piece.seam_marks:
        _texts(block, [f"seam {text}"], scale * point, per_mm, ANNOTATION)
    texts = [_ascii(line) for line in piece.label.lines]
    # The standard's words for the same lines are longer: they are written as much smaller, and stay inside.
    sizes = ["Size: ONE", f"Quantity: {cut_count(piece.panel)}"]
    system = [f"Piece Name: {texts[1]}", *sizes, *(f"Annotation: {line}" for line in texts[3:])]
    shorter = max(map(len, piece.label.lines)) / max(map(len, system))
    label = piece.label._replace(lines=tuple(system), height_m=piece.label.height_m * min(1.0, shorter))
    for point, line in label.baselines():
        turn = {"layer": CUT, "rotation": 90.0 if label.upright else 0.0}
        text = block.add_text(line, height=scale * label.height_m, dxfattribs=turn)
        text.set_placement(tuple(scale * point))


def _is_corner(polygon: np.ndarray) -> np.ndarray:
    before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.abs(np.degrees(np.arctan2(cross, (before * after).sum(axis=1)))) > TURN_DEG


def _texts(space: BlockLayout | Modelspace, lines: list[str], at: np.ndarray, per_mm: float, layer: str) -> None:
    for number, line in enumerate(lines):
        text = space.add_text(line, height=TEXT_MM * per_mm, dxfattribs={"layer": layer})
        text.set_placement((float(at[0]), float(at[1]) - LINE_MM * per_mm * number))


def _ascii(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return plain or "unnamed"


def _block_name(name: str, names: set[str]) -> str:
    """A block name of R12: letters, digits, - and _, up to 31, unlike the others."""
    stem = re.sub(r"[^A-Z0-9_-]", "_", _ascii(name).upper())[:27]
    candidate, number = stem, 2
    while candidate in names:
        candidate, number = f"{stem}_{number}", number + 1
    names.add(candidate)
    return candidate
