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
    assert rows_table(columns, [row], WHERE).split("\n") == [
        "| garment | gain | jitter |",
        "|---|---|---|",
        "| sash | 0.73 | - |",
        "",
        "Measured on a machine, commit abc: `python -m benchmarks.quality`.",
    ]


def test_the_networks_table_has_a_line_per_garment_and_set():
    network = {"gain": 0.7, "edge_over_physics_pp": 1.84, "chart_gap_p99_mm": 2.5, "jitter_ratio": None}
    crossings = {"skinning": 7.0, "network": 3.0, "physics": 0.5}

    def rows(garment: str, kind: str) -> list[dict]:
        return [
            {"garment": garment, "set": kind, "method": method, **(network if method == "network" else {})}
            | ({"self_intersections": crossings[method]} if method in crossings else {"jitter_ratio": 1.25})
            for method in ("skinning", "network", "network_push", "physics")
        ]

    record = {"rows": rows("sash", "unseen"), "summary": [*rows("all", "trained"), *rows("all", "unseen")]}
    _, _, *lines = records.network_table(record).split("\n")
    assert lines[0] == "| sash | 0.70 | 1.8 | - | 2.5 | - | - | - | 1.25 | 7.0 | 3.0 | 0.5 |"
    assert [line.split(" | ")[0] for line in lines] == ["| sash", "| all trained", "| all unseen"]


def test_detail_and_fabrics_stand_where_they_were_measured():
    row = {"garment": "sash", "set": "unseen", "edge_pct": 1.0, "gain": 0.5, "self_intersections": 0.0}
    rows = [row | {"method": method} for method in ("skinning", "skinning_push", "network", "network_push", "physics")]
    figures = {"detail_mm": 1.26, "detail_share": 0.4}
    measured = [one | figures | {"fabric": name} for name in ("rib", "satin") for one in rows]
    for made in (records.quality_table, records.network_table):
        before, now = (made({"rows": found, "summary": [], **WHERE}).split("\n") for found in (rows, measured))
        assert "fabric" not in before[0] and "detail" not in before[0]
        assert now[0].startswith("| garment | fabric |")
        for name in ("rib", "satin"):
            assert any(line.startswith(f"| sash | {name} |") for line in now)
    assert "| 1.26 |" in records.quality_table({"rows": measured, **WHERE})
    assert "| 0.40 |" in records.network_table({"rows": measured, "summary": []})


def test_the_trade_is_shown_along_its_front_the_cheapest_first():
    def row(knobs: str, ratio: float, *, pareto: bool = True, tier: str = "") -> dict:
        return {"tier": tier, "knobs": knobs, "time_ratio": ratio, "gain": 0.9, "pareto": pareto}

    means = [row("b", 0.6), row("a", 0.3), row("dear", 0.9, pareto=False), row("", 1.0, pareto=False, tier="a_b")]
    lines = records.trade_table({"means": means} | WHERE).splitlines()
    assert [line.split("|")[2].strip() for line in lines[2:5]] == ["a", "b", ""]
    assert lines[4].split("|")[1].strip() == "a b" and len(lines) == 7


def test_streams_under_load_are_told_with_who_carries_how_many():
    row = {"case": "streams", "server": "service", "tier": "fast", "clients": 2, "goodput_pct": 99.6}
    record = {"rows": [row], "max_clients": {"service fast": 2}, "model_ms": {"fast": 7.25}} | WHERE
    text = records.serving_table(record | {"threads": 1, "load_before": 0.1})
    assert "| streams | service | fast | 2 | 100 | - |" in text
    assert "Clients carried: service fast 2. A frame alone: fast 7.2 ms." in text
