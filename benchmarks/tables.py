"""Tables of rows, as text for a terminal and as Markdown for a document.

``Columns`` name the keys of a row in order, each with its format, or with its head and its format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Row = dict[str, Any]
Record = dict[str, Any]
Columns = Mapping[str, str | tuple[str, str]]


def heads(columns: Columns) -> list[str]:
    """Returns the head of each of ``columns``: its own, or else its key."""
    return [key if isinstance(form, str) else form[0] for key, form in columns.items()]


def cells(row: Row, columns: Columns, *, missing: str = "-") -> list[str]:
    """Returns the formatted values of ``row`` under ``columns``; ``missing`` where a value is absent or not finite."""
    texts = []
    for key, form in columns.items():
        value = row.get(key)
        unknown = value is None or (isinstance(value, float) and not math.isfinite(value))
        texts.append(missing if unknown else format(value, form if isinstance(form, str) else form[1]))
    return texts


def text_table(rows: Sequence[Row], columns: Columns) -> str:
    """Returns ``rows`` as text under aligned heads. Unknown values are blank; a column that no row has is left out."""
    known = _of_any(rows, columns)
    lines = [heads(known), *(cells(row, known, missing="") for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    left = ["s" in (form if isinstance(form, str) else form[1]) for form in known.values()]
    aligned = []
    for line in lines:
        sides = zip(line, widths, left, strict=True)
        aligned.append("  ".join(c.ljust(w) if to_left else c.rjust(w) for c, w, to_left in sides).rstrip())
    return "\n".join(aligned)


def markdown_table(titles: Sequence[str], lines: Iterable[Sequence[str]], source: Record | None = None) -> str:
    """Returns a Markdown table of ``lines``, which have a cell for each of ``titles``; below it stands where ``source``
    was measured, if it is given (``provenance``)."""
    rule = "|---" * len(titles) + "|"
    table = "\n".join([f"| {' | '.join(titles)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)])
    return f"{table}\n\n{provenance(source)}" if source else table


def rows_table(columns: Columns, rows: Iterable[Row], source: Record | None = None) -> str:
    """Returns a Markdown table with a line for each of ``rows``; a column that no row has is left out. ``source`` is
    that of ``markdown_table``."""
    rows = list(rows)
    known = _of_any(rows, columns)
    return markdown_table(heads(known), (cells(row, known) for row in rows), source)


def _of_any(rows: Sequence[Row], columns: Columns) -> Columns:
    return {key: form for key, form in columns.items() if any(key in row for row in rows)}


def provenance(record: Record) -> str:
    """Returns the sentence that says on which machine, from which commit and by which command ``record`` was
    measured."""
    load = ""
    if "load_before" in record:
        load = f", {record['threads']} threads, load {record['load_before']:.1f} before it"
    return f"Measured on {record['machine']}{load}, commit {record['commit']}: `{record['command']}`."
