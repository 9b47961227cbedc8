"""Writes a pattern in the formats that others read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drape.errors import InputError
from recovery.pattern.export_dxf import write_dxf
from recovery.pattern.export_pdf import write_pdf
from recovery.pattern.export_svg import write_svg
from recovery.pattern.garmentcode import write_pattern
from recovery.pattern.pieces import make_sheet
from recovery.pattern.sewing_pattern import Pattern

FORMATS = ("json", "svg", "dxf", "pdf")


def export_pattern(
    pattern: Pattern,
    folder: str | Path,
    formats: Sequence[str] = FORMATS,
    *,
    allowance_m: float = 0.01,
    page: str = "A4",
    dxf_unit_mm: float = 1.0,
    dxf_dialect: str = "aama",
) -> list[Path]:
    """Writes ``folder``/NAME.FORMAT for each of ``formats`` and returns the paths; only the JSON holds the stitches.

    ``allowance_m`` [m] is the width of the seam allowances. The other options are those of ``write_pdf`` and
    ``write_dxf``.
    """
    if unknown := [name for name in formats if name not in FORMATS]:
        raise InputError("format", expected=f"some of {FORMATS}", got=f"{unknown}", cure="Choose among them.")
    sheet = make_sheet(pattern, allowance_m=allowance_m)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    writers = {
        "json": partial(write_pattern, pattern),
        "svg": partial(write_svg, sheet),
        "dxf": partial(write_dxf, sheet, unit_mm=dxf_unit_mm, dialect=dxf_dialect),
        "pdf": partial(write_pdf, sheet, page=page),
    }
    paths = [folder / f"{pattern.name}.{name}" for name in formats]
    for name, path in zip(formats, paths, strict=True):
        writers[name](path)
    return paths
