"""Tables of the studies: a line per row, every head with its cell, a dash for what was not measured."""

from __future__ import annotations

import pytest

from benchmarks import study_report

WHERE = {"machine": "a machine", "commit": "abc", "command": "python -m benchmarks.x"}
GENERALITY = [
    {"run": "one", "garments": 1, "partitions": 1, "steps": 1500, "mean_seen": 0.5, "mean_unseen": -3.25,
     "gain_sash": 0.5, "gain_cape": None},
    {"run": "all", "garments": 56, "partitions": 90, "steps": 1500, "mean_seen": 0.75, "mean_unseen": 0.625,
     "gain_sash": 0.75, "gain_cape": 0.625},
]  # fmt: skip
FINETUNING = [
    {"garment": "cape", "network": "tuned", "steps": 1000, "train_s": 90.0, "edge_pct": 2.0, "area_pct": 3.0,
     "colliding_vertex_pct": 0.25, "energy_j": 0.125, "gain": 0.9375},
]  # fmt: skip
RESOLUTION = [
    {"mesh": "1,000", "vertices": 1012, "patches": 110, "rest_mm": 0.5, "mean_mm": 1.25, "p95_mm": 2.0,
     "edge_pct": 4.0, "p50_ms": 1.5},
]  # fmt: skip
THROUGHPUT = [
    {"processes": 2, "threads": 1, "batch": 4, "frames_per_s": 88.4, "spread": 3.0, "network_ms": 4.0, "other_ms": 1.5},
]
INT8 = [
    {"garment": "cape", "form": "int8", "p50_ms": 4.5, "min_ms": 4.0, "batch_ms": 3.5, "energy_j": 0.125,
     "edge_pct": 4.0, "area_pct": 3.0, "jitter": 1.125, "apart_mm": 0.5, "apart_p99_mm": 2.0},
]  # fmt: skip
DYNAMICS = [
    {"kind": "potential", "garment": "cape", "clip": "turn", "own_dynamic_j": 0.5, "own_static_j": 0.25,
     "given_dynamic_j": 0.5, "given_static_j": 0.75},
    {"kind": "stop", "garment": "cape", "clip": "turn", "swings": 2, "millimetre_s": None, "rest_s": 1.5,
     "peak_mm": 12.0, "0s": 4.0, "0.1s": 6.0},
]  # fmt: skip


@pytest.mark.parametrize(
    ("table", "rows", "first"),
    [
        (study_report.generality_table, GENERALITY, "| one | 1 | 1 | 1,500 | 0.50 | -3.25 | 0.50 | - |"),
        (
            study_report.finetuning_table,
            FINETUNING,
            "| cape | tuned | 1,000 | 1.5 | 2.00 | 3.00 | 0.25 | 0.125 | 0.938 |",
        ),
        (study_report.throughput_table, THROUGHPUT, "| 2 | 1 | 4 | 88 | 3 | 4.00 | 1.50 |"),
        (
            study_report.int8_table,
            INT8,
            "| cape | int8 | 4.50 | 4.00 | 3.50 | 0.125 | 4.00 | 3.00 | 1.125 | 0.50 | 2.0 |",
        ),
        (study_report.resolution_table, RESOLUTION, "| 1,000 | 1,012 | 110 | 0.50 | 1.25 | 2.00 | 4.00 | 1.50 |"),
    ],
)
def test_a_table_has_a_line_per_row_and_says_where_it_comes_from(table, rows: list[dict], first: str):
    heads, rule, *lines, empty, source = table({"rows": rows, **WHERE}).split("\n")
    assert len(lines) == len(rows) and lines[0] == first and empty == ""
    assert {line.count("|") for line in (heads, rule, *lines)} == {heads.count("|")}
    assert source == "Measured on a machine, commit abc: `python -m benchmarks.x`."


def test_motion_has_a_table_of_stops_and_one_of_potentials():
    record = {"rows": DYNAMICS, **WHERE}
    stops, potentials = study_report.stop_table(record), study_report.potential_table(record)
    assert stops.split("\n")[2] == "| cape | turn | 2 | - | 1.50 | 12.0 | 4.0 | 6.0 |"
    assert potentials.split("\n")[2:] == ["| cape | turn | 0.5000 | 0.7500 | 0.5000 | 0.2500 |"]
    for table in (stops, potentials):
        assert len({line.count("|") for line in table.split("\n")[:3]}) == 1


def test_ways_out_of_the_body_have_a_line_each():
    row = {"garment": "mean of 6", "set": "trained", "method": "by_parts", "colliding_triangle_pct": 0.025}
    heads, rule, line, *_ = study_report.push_table({"rows": [], "summary": [row], **WHERE}).split("\n")
    assert line == "| mean of 6, trained | by parts | 0.025 | - | - | - | - | - | - |"
    assert heads.count("|") == rule.count("|") == line.count("|")
