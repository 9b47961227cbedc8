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
    """The head of each column: its key, where it has no other."""
    return [key if isinstance(form, str) else form[0] for key, form in columns.items()]


def cells(row: Row, columns: Columns, *, missing: str = "-") -> list[str]:
    """The formatted values of ``row`` under ``columns``; ``missing`` where a value is absent or not finite."""
    found = []
    for key, form in columns.items():
        value = row.get(key)
        unknown = value is None or (isinstance(value, float) and not math.isfinite(value))
        found.append(missing if unknown else format(value, form if isinstance(form, str) else form[1]))
    return found


def text_table(rows: Sequence[Row], columns: Columns) -> str:
    """Returns ``rows`` as text under aligned heads. Unknown values are blank; a column that no row has is left out."""
    kept = {key: form for key, form in columns.items() if any(key in row for row in rows)}
    lines = [heads(kept), *(cells(row, kept, missing="") for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    left = ["s" in (form if isinstance(form, str) else form[1]) for form in kept.values()]
    drawn = []
    for line in lines:
        sides = zip(line, widths, left, strict=True)
        drawn.append("  ".join(c.ljust(w) if to_left else c.rjust(w) for c, w, to_left in sides).rstrip())
    return "\n".join(drawn)


def markdown_table(titles: Sequence[str], lines: Iterable[Sequence[str]], source: Record | None = None) -> str:
    """A Markdown table of ``lines``, which have a cell for each of ``titles``; the sentence of ``source`` below it."""
    rule = "|---" * len(titles) + "|"
    drawn = "\n".join([f"| {' | '.join(titles)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)])
    return f"{drawn}\n\n{provenance(source)}" if source else drawn


def rows_table(columns: Columns, rows: Iterable[Row], source: Record | None = None) -> str:
    """A Markdown table with a line for each of ``rows``; a column that no row has is left out."""
    found = list(rows)
    kept = {key: form for key, form in columns.items() if any(key in row for row in found)}
    return markdown_table(heads(kept), (cells(row, kept) for row in found), source)


def provenance(record: Record) -> str:
    """The sentence that says on which machine, from which commit and by which command a record was measured."""
    load = ""
    if "load_before" in record:
        load = f", {record['threads']} threads, load {record['load_before']:.1f} before it"
    return f"Measured on {record['machine']}{load}, commit {record['commit']}: `{record['command']}`."
