"""The pieces as a PDF at true size: one large page, or sheets of A4 to be glued along their marks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from reportlab.pdfgen.canvas import Canvas

from drape.errors import InputError
from recovery.pattern.geometry import inside
from recovery.pattern.pieces import FOOTER_M, MARGIN_M, NOTCH_DEPTH_M, SCALE_SQUARE_M, CuttingSheet, Piece

POINT_MM = 25.4 / 72.0
A4_MM = (210.0, 297.0)
BORDER_MM = 10.0  # unprinted rim of a sheet; pages join at its inner line
LARGEST_PAGE_MM = 5080.0  # 14,400 points, the format's limit
PAGES = ("A4", "single")
FORM = "pieces"
CAPITAL = 0.72  # height of Helvetica's capitals over its size


def write_pdf(sheet: CuttingSheet, path: Path, *, page: str = "A4") -> int:
    """Writes ``sheet`` to ``path`` as a PDF on ``page``, "A4" or "single", and returns the number of its pages. A4
    pages that no piece reaches are left out."""
    if page not in PAGES:
        raise InputError("page", expected=f"one of {PAGES}", got=page, cure="Choose one of them.")
    width, height = 1000.0 * sheet.width_m, 1000.0 * sheet.height_m
    single = page == "single"
    if single and max(width, height) > LARGEST_PAGE_MM:
        raise InputError(
            "page",
            expected=f"a sheet of at most {LARGEST_PAGE_MM:.0f} mm",
            got=f"{max(width, height):.0f} mm",
            cure='Pass page="A4".',
        )
    size = (width, height) if single else A4_MM
    canvas = Canvas(str(path), pagesize=(size[0] / POINT_MM, size[1] / POINT_MM), invariant=1)
    canvas.setTitle(sheet.title)
    canvas.setAuthor("drape")
    canvas.beginForm(FORM, 0, 0, width / POINT_MM, height / POINT_MM)
    _draw_sheet(canvas, sheet)
    canvas.endForm()
    if single:
        canvas.doForm(FORM)
        canvas.showPage()
        canvas.save()
        return 1
    tile = np.array(A4_MM) - 2.0 * BORDER_MM
    columns, rows = (int(np.ceil(length / step - 1e-9)) for length, step in zip((width, height), tile, strict=True))
    used = 0
    for row in range(rows):  # from the top, as one reads
        for column in range(columns):
            corner = np.array([column * tile[0], height - (row + 1) * tile[1]])
            if not _is_used(sheet, corner / 1000.0, (corner + tile) / 1000.0):
                continue
            _tile(canvas, corner, tile, f"{chr(ord('A') + row % 26)}{column + 1}", f"{sheet.title}: {columns} x {rows}")
            used += 1
    canvas.save()
    return used


def _is_used(sheet: CuttingSheet, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a piece of ``sheet`` or the scale square reaches into the box from ``low`` to ``high`` [m]."""
    if low[0] < MARGIN_M + SCALE_SQUARE_M and low[1] < FOOTER_M:
        return True
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        outline = piece.cutting + place
        along = np.roll(outline, -1, axis=0) - outline
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = np.stack([(low - outline) / along, (high - outline) / along])
        enter, leave = np.nanmax(walls.min(axis=0), axis=1), np.nanmin(walls.max(axis=0), axis=1)
        if (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)).any() or inside(low[None], outline)[0]:
            return True
    return False


def _tile(canvas: Canvas, corner: np.ndarray, tile: np.ndarray, name: str, title: str) -> None:
    border, width, height = BORDER_MM / POINT_MM, tile[0] / POINT_MM, tile[1] / POINT_MM
    canvas.saveState()
    window = canvas.beginPath()
    window.rect(border, border, width, height)
    canvas.clipPath(window, stroke=0, fill=0)
    canvas.translate(border - corner[0] / POINT_MM, border - corner[1] / POINT_MM)
    canvas.doForm(FORM)
    canvas.restoreState()
    canvas.setLineWidth(0.3)
    canvas.setDash(1, 3)
    canvas.rect(border, border, width, height)
    canvas.setDash()
    for x in (border, border + width):
        for y in (border, border + height):
            canvas.line(x - 8, y, x + 8, y)
            canvas.line(x, y - 8, x, y + 8)
    canvas.setFont("Helvetica", 8)
    canvas.drawString(border + 10, border - 14, f"{name}   {title}, scale 1:1")
    canvas.showPage()


def _draw_sheet(canvas: Canvas, sheet: CuttingSheet) -> None:
    for piece, place in zip(sheet.pieces, sheet.offsets, strict=True):
        _draw_piece(canvas, piece, place)
    low = _points(np.array([MARGIN_M, MARGIN_M]))
    side = 1000.0 * SCALE_SQUARE_M / POINT_MM
    canvas.setLineWidth(0.6)
    canvas.rect(low[0], low[1], side, side)
    canvas.setFont("Helvetica", 12)
    canvas.drawString(low[0] + 8, low[1] + side / 2, f"{1000.0 * SCALE_SQUARE_M:g} mm")
    canvas.drawString(low[0] + side + 16, low[1] + side / 2, sheet.title)


def _points(metres: np.ndarray) -> np.ndarray:
    return np.asarray(metres) * (1000.0 / POINT_MM)


def _polygon(canvas: Canvas, corners: np.ndarray) -> None:
    path = canvas.beginPath()
    path.moveTo(*corners[0])
    for corner in corners[1:]:
        path.lineTo(*corner)
    path.close()
    canvas.drawPath(path, stroke=1, fill=0)


def _draw_piece(canvas: Canvas, piece: Piece, place: np.ndarray) -> None:
    canvas.setStrokeColorRGB(0, 0, 0)
    canvas.setLineWidth(1.0)
    _polygon(canvas, _points(piece.cutting + place))
    canvas.setLineWidth(0.6)
    if piece.cutting is not piece.sewing:
        canvas.setStrokeColorRGB(0, 0.4, 0.8)
        canvas.setDash(8, 4)
        _polygon(canvas, _points(piece.sewing + place))
        canvas.setDash()
        canvas.setStrokeColorRGB(0, 0, 0)
    bottom, top = _points(piece.grain + place)
    canvas.line(bottom[0], bottom[1], top[0], top[1])
    for end, sense in ((top, -1.0), (bottom, 1.0)):
        for across in (-6.0, 6.0):
            canvas.line(end[0], end[1], end[0] + across, end[1] + sense * 16.0)
    for notch in piece.notches:
        start, end = _points(notch.point + place), _points(notch.point + NOTCH_DEPTH_M * notch.inward + place)
        canvas.line(start[0], start[1], end[0], end[1])
    canvas.setFont("Helvetica", 12)
    for point, text in piece.seam_marks:
        x, y = _points(point + place)
        canvas.drawCentredString(x, y, text)
    canvas.setFont("Helvetica", 1000.0 * piece.label.height_m / CAPITAL / POINT_MM)
    for point, line in piece.label.baselines():
        canvas.saveState()
        canvas.translate(*_points(point + place))
        canvas.rotate(90.0 if piece.label.upright else 0.0)
        canvas.drawString(0.0, 0.0, line)
        canvas.restoreState()
