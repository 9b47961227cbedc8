"""Figures that README and other pages state are those of the records, and do not contradict each other."""

from __future__ import annotations

import json
import re

import pytest

from benchmarks import figures, report
from benchmarks.harness import RESULTS_DIR, ROOT
from benchmarks.marked_figures import FIGURE, fill_figures

RECORDS = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in RESULTS_DIR.glob("*.json")}
STATING = report.stating()
GUIDES = [path for folder in ("reference", "guide") for path in sorted((ROOT / "docs" / folder).glob("*.md"))]
ADDRESS_OR_CODE = re.compile(r"\]\([^)]*\)|`[^`]*`")
MEASURED = re.compile(r"\d+\.\d|\d\s?(?:%|mm|ms|s|MB|times)(?!\w)")  # a number with decimals or a unit


@pytest.mark.parametrize("path", STATING)
def test_a_page_states_what_the_records_hold(path: str):
    stated = (ROOT / path).read_text(encoding="utf-8")
    assert stated == STATING[path], "python -m benchmarks.report writes it"
    assert not re.search(r"^\s*(?:[-*] )?<!-- figure", stated, re.MULTILINE), "Markdown would end the paragraph there"


def test_every_block_stands_on_a_page():
    assert {name for text in STATING.values() for _, name, _ in report.BLOCK.findall(text)} == set(report.BLOCKS)


@pytest.mark.parametrize("path", [ROOT / "README.md", *GUIDES], ids=lambda path: path.name)
def test_a_paragraph_that_quotes_a_record_takes_its_figures_of_it(path):
    for paragraph in re.split(r"\n\s*\n", report.BLOCK.sub("", path.read_text(encoding="utf-8"))):
        quoted = set(re.findall(r"results/(\w+)\.json", paragraph))
        marked = {mark["path"].partition(".")[0] for mark in FIGURE.finditer(paragraph)}
        typed = MEASURED.search(ADDRESS_OR_CODE.sub("", FIGURE.sub("", paragraph)))
        assert not typed or quoted <= marked, f"{quoted - marked}: mark what is of the record"


def test_a_mark_takes_one_value_or_what_it_makes_of_several():
    records = {"walk": {"fps": 30, "rows": [{"who": "a b", "mm": 1250.0}, {"who": "c", "mm": 2.0}, {"who": "c"}]}}
    wanted = {
        "walk fps d": "30",
        "walk.rows who=a_b mm ,.0f": "1,250",
        "walk.rows who=a_b mm/1000 .2f": "1.25",
        "walk.rows mean(mm) .0f": "626",
        "walk.rows who=c count(mm) d": "1",
    }
    for mark, text in wanted.items():
        page = f"It is <!-- figure: {mark} -->old<!-- . --> m."
        assert fill_figures(page, records) == page.replace("old", text)
    for mark in ("walk.rows mm .0f", "walk.rows who=d mm .0f", "walk.rows max(km) .0f", "walk fps% d"):
        with pytest.raises(ValueError, match="walk"):
            fill_figures(f"<!-- figure: {mark} -->old<!-- . -->", records)


def test_another_record_gives_another_page():
    trade = RECORDS["tradeoff"]
    means = [row | {"gain": 0.123} if row["tier"] == figures.DEFAULT_TIER else row for row in trade["means"]]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    changed = report.fill(readme, RECORDS | {"tradeoff": trade | {"means": means}})
    assert "**0.123**" in changed and changed != readme
    assert report.BLOCK.sub("", changed) == report.BLOCK.sub("", readme)  # nothing else moves


def test_the_streams_fit_on_the_cores_and_none_is_cheaper_than_its_frame():
    one = figures.headline(RECORDS)
    assert one.streams * one.fps * one.pose_ms <= 1e3 * one.cores
    assert one.frame_ms <= 1.25 * one.pose_ms  # two runs of one machine differ by less than a quarter


def test_readme_names_the_three_numbers_once():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    outside = report.BLOCK.sub("", text)
    one = figures.headline(RECORDS)
    for number in (f"{one.gain:.3f}", f"{one.frame_ms:.1f} ms", f"{one.streams} streams"):
        assert number not in outside
