"""Figures that README and other pages state are those of the records, and do not contradict each other."""

from __future__ import annotations

import json

import pytest

from benchmarks import figures, report
from benchmarks.harness import RESULTS_DIR, ROOT
from tests.architecture.repository import repository_files

RECORDS = {name: json.loads((RESULTS_DIR / f"{name}.json").read_text(encoding="utf-8")) for name in report.NEEDED}
MARKED = sorted(
    path.relative_to(ROOT).as_posix()
    for path in repository_files()
    if path.suffix == ".md" and report.BLOCK.search(path.read_text(encoding="utf-8"))
)


@pytest.mark.parametrize("path", MARKED)
def test_a_page_states_what_the_records_hold(path: str):
    stated = (ROOT / path).read_text(encoding="utf-8")
    assert stated == report.stating()[path], "python -m benchmarks.report writes it"


def test_report_writes_every_page_that_has_a_block_and_every_block_stands_on_a_page():
    assert set(MARKED) == set(report.STATING)
    named = {name for path in MARKED for _, name, _ in report.BLOCK.findall((ROOT / path).read_text(encoding="utf-8"))}
    assert named == set(report.BLOCKS)


def test_another_record_gives_another_page():
    trade = RECORDS["tradeoff"]
    means = [row | {"gain": 0.123} if row["tier"] == figures.DEFAULT_TIER else row for row in trade["means"]]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    changed = report.fill_blocks(readme, RECORDS | {"tradeoff": trade | {"means": means}})
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
