"""Figures within a sentence, each taken of the record that its page marks there.

A page writes ``<!-- figure: PATH [KEY=VALUE ...] FIELD FORMAT -->text<!-- . -->``, and ``fill_figures`` makes the text:

- PATH is a record, or a list in it: ``churn.rows``.
- KEY=VALUE keeps the rows that have this value; a space of the value is written as ``_``.
- FIELD is one value, or ``min(FIELD)``, ``max``, ``mean``, ``sum``, ``count`` of those of the rows that have it.
  ``FIELD/NUMBER`` is divided by a number: ``kb/1000``.
- FORMAT is that of Python: ``.1f``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean
from typing import Any

from benchmarks.tables import Record

FIGURE = re.compile(
    r"(<!-- figure: (?P<path>\S+) (?P<where>(?:[a-z_]+=\S* )*)(?P<field>\S+) (?P<form>\S+) -->).*?(<!-- \. -->)"
)
FIELD = re.compile(r"(?:(?P<way>[a-z]+)\((?P<of>[\w.]+)\)|(?P<one>[\w.]+))(?:/(?P<by>[\d.]+))?")
WAYS: dict[str, Callable[[Sequence[Any]], Any]] = {
    "min": min, "max": max, "mean": fmean, "sum": sum, "count": len,
}  # fmt: skip


def fill_figures(text: str, records: Mapping[str, Record]) -> str:
    """Returns the page ``text`` with each of its marked figures as the ``records`` have it. Raises ``ValueError`` for a
    mark that finds nothing, or several values where it asks for one."""
    return FIGURE.sub(lambda mark: f"{mark[1]}{_figure(mark, records)}{mark.groups()[-1]}", text)


def _figure(mark: re.Match[str], records: Mapping[str, Record]) -> str:
    name, *inside = mark["path"].split(".")
    place: Any = records[name]
    for key in inside:
        place = place[key]
    wanted = [pair.split("=") for pair in mark["where"].split()]
    rows = [
        row
        for row in (place if isinstance(place, list) else [place])
        if all(str(row.get(key, "")).replace(" ", "_") == value for key, value in wanted)
    ]
    field = FIELD.fullmatch(mark["field"])
    if field is None:
        raise ValueError(f"{mark[0]}: not a field")
    values = [row[key] for row in rows if row.get(key := field["of"] or field["one"]) is not None]
    if not values or (field["one"] and len(values) > 1):
        raise ValueError(f"{mark[0]}: {len(values)} values in {len(rows)} rows")
    value = WAYS[field["way"]](values) if field["way"] else values[0]
    return format(value / float(field["by"]) if field["by"] else value, mark["form"])
