"""Tables in the documents come from the committed records."""

from __future__ import annotations

from benchmarks import report

ROW = {
    "edge_pct": 1.0,
    "area_pct": 2.0,
    "colliding_vertex_pct": 0.125,
    "colliding_triangle_pct": 0.0,
    "energy_j": 0.5,
}
RECORD = {
    "rows": [
        {**ROW, "garment": "sash", "method": method, "gain": gain}
        for method, gain in (("skinning_push", 0.0), ("network_push", 0.731), ("physics", 1.0))
    ],
    "machine": "a machine",
    "commit": "abc",
    "command": "python -m benchmarks.quality",
}


def test_a_table_takes_the_place_between_its_markers(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- gain:begin -->\nold\n<!-- gain:end -->\nafter\n")
    assert report.insert(page, "gain", report.gain_table(RECORD))
    text = page.read_text()
    assert "| sash | 1.00 | 1.00 | 1.00 | 0.73 |" in text
    assert "old" not in text
    assert text.startswith("before\n<!-- gain:begin -->")
    assert text.endswith("<!-- gain:end -->\nafter\n")
    assert not report.insert(page, "quality", "x")


def test_the_networks_table_has_a_line_per_garment_and_set_with_dashes_for_what_was_not_measured():
    network = {"gain": 0.7, "edge_over_physics_pp": 1.84, "chart_gap_p99_mm": 2.5, "jitter_ratio": None}
    crossings = {"skinning": 7.0, "network": 3.0, "physics": 0.5}

    def rows(garment: str, kind: str) -> list[dict]:
        return [
            {"garment": garment, "set": kind, "method": method, **(network if method == "network" else {})}
            | ({"self_intersections": crossings[method]} if method in crossings else {"jitter_ratio": 1.25})
            for method in ("skinning", "network", "network_push", "physics")
        ]

    record = {"rows": rows("sash", "unseen"), "summary": [*rows("all", "trained"), *rows("all", "unseen")]}
    heads, rule, *lines = report.network_table(record).split("\n")
    assert heads.count("|") == rule.count("|")
    assert lines[0] == "| sash | 0.70 | 1.8 | - | 2.5 | - | - | - | 1.25 | 7.0 | 3.0 | 0.5 |"
    assert [line.split(" | ")[0] for line in lines] == ["| sash", "| all trained", "| all unseen"]


def test_the_long_table_has_a_line_per_row_and_says_where_it_comes_from():
    table = report.quality_table(RECORD)
    assert table.count("| sash |") == 3
    assert "a machine, commit abc: `python -m benchmarks.quality`" in table
