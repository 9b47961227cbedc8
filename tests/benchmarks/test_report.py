"""Tables in the documents come from the committed records."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import records, report
from benchmarks.tables import cells, rows_table

WHERE = {"machine": "a machine", "commit": "abc", "command": "python -m benchmarks.quality"}


@pytest.mark.parametrize("name", sorted({Path(document).name for _, document, _, _ in records.TABLES}))
def test_a_page_of_records_holds_what_the_records_give(name: str):
    text = (report.FOLDER / name).read_text(encoding="utf-8")
    assert text == report.pages()[name]
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):  # every line has a cell for every head
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_no_page_of_records_is_left_over():
    assert {path.name for path in report.FOLDER.glob("*.md")} == set(report.pages())


def test_what_was_not_measured_is_a_dash_and_the_source_stands_below():
    columns = {"garment": ("garment", "s"), "gain": ("gain", ".2f"), "jitter": ("jitter", ".2f")}
    row = {"garment": "sash", "gain": 0.731, "jitter": None}
    assert cells({"garment": "sash"}, columns) == ["sash", "-", "-"]
    assert rows_table({**columns, "newer": ("of a newer record", "d")}, [row], WHERE).split("\n") == [
        "| garment | gain | jitter |",
        "|---|---|---|",
        "| sash | 0.73 | - |",
        "",
        "Measured on a machine, commit abc: `python -m benchmarks.quality`.",
    ]
