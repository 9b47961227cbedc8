"""Tables for the documents, made of committed records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Record = dict[str, Any]
Columns = Mapping[str, tuple[str, str]]  # key of a row -> head and format


def provenance(record: Record) -> str:
    """The sentence under a table: machine, commit and command."""
    return f"Measured on {record['machine']}, commit {record['commit']}: `{record['command']}`."


def cells(row: Record, columns: Columns) -> list[str]:
    """The values of ``row`` that ``columns`` name, formatted; a dash for what it lacks."""
    return ["-" if row.get(key) is None else format(row[key], form) for key, (_, form) in columns.items()]


def heads(columns: Columns) -> list[str]:
    """The heads of ``columns``."""
    return [head for head, _ in columns.values()]


def table(heads: Sequence[str], lines: Iterable[Sequence[str]], source: Record | None = None) -> str:
    """A Markdown table of ``heads`` and of ``lines``, which have a cell for each; under it where ``source`` is from."""
    rule = "|---" * len(heads) + "|"
    drawn = "\n".join([f"| {' | '.join(heads)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)])
    return f"{drawn}\n\n{provenance(source)}" if source else drawn


def rows_table(columns: Columns, rows: Iterable[Record], source: Record | None = None) -> str:
    """A Markdown table of a line for each of ``rows``."""
    return table(heads(columns), (cells(row, columns) for row in rows), source)
