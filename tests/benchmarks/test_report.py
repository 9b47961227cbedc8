"""Tables in the documents come from the committed records."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import record_tables, report


@pytest.mark.parametrize("name", sorted({Path(document).name for _, document, _, _ in record_tables.TABLES}))
def test_a_page_of_records_holds_what_the_records_give(name: str):
    text = (report.FOLDER / name).read_text(encoding="utf-8")
    assert text == report.pages()[name]
    for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):  # every line has a cell for every head
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_no_page_of_records_is_left_over():
    assert {path.name for path in report.FOLDER.glob("*.md")} == set(report.pages())
