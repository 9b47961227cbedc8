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


def test_the_long_table_has_a_line_per_row_and_says_where_it_comes_from():
    table = report.quality_table(RECORD)
    assert table.count("| sash |") == 3
    assert "a machine, commit abc: `python -m benchmarks.quality`" in table
