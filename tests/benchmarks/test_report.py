"""Tables in the documents come from the committed records."""

from __future__ import annotations

from benchmarks import loss_ablation, report, representation, representation_report
from benchmarks.common import ROOT
from benchmarks.representation_space import REPRESENTATIONS

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


def test_distances_to_the_reference_stand_where_they_were_measured():
    assert "reference" not in report.quality_table(RECORD)
    found = {"reference_mm": 15.25, "reference_p95_mm": 31.7, "reference_surface_mm": 9.12}
    ends = {"reference_start_mm": 12.6, "reference_at_rest_pct": 50.0, "reference_residual_n": 0.25}
    floor = {"reference_floor_mm": 11.8, "reference_floor_p95_mm": 21.2, "reference_floor_surface_mm": 4.1}
    extra = {"network_push": ends | floor, "physics": ends | {"weight_n": 1.5}}
    rows = [row | found | extra.get(row["method"], {}) for row in RECORD["rows"]]
    record = RECORD | {"rows": rows}
    heads, rule, first, *_ = report.quality_table(record).split("\n")
    assert heads.count("|") == rule.count("|") == first.count("|")
    assert first.endswith("| 15.2 | 31.7 | 9.1 |")
    _, _, *lines, _, source = report.reference_table(record).split("\n")
    assert lines[0] == "| sash | skinning_push | 15.2 | 31.7 | 9.1 |"
    assert lines[2] == "| sash | simulated from network_push: the floor | 11.8 | 21.2 | 4.1 |"
    assert len(lines) == 4
    assert source.startswith("Measured on a machine")
    heads, rule, *lines = report.reference_end_table(record).split("\n")
    assert heads.count("|") == rule.count("|") == lines[0].count("|")
    assert lines == [
        "| sash | network_push | 12.6 | - | - | 50 | - | - | 0.25 | 1.50 |",
        "| sash | physics | 12.6 | - | - | 50 | - | - | 0.25 | 1.50 |",
    ]


def test_every_form_and_every_loss_has_a_name_in_the_documents():
    assert set(REPRESENTATIONS) < set(representation_report.FORM_NAMES)
    assert representation.AGREEING in representation_report.AGREEMENT_NAMES
    assert {*loss_ablation.LOSS_SETS, "skinning", "skinning_push"} == set(representation_report.LOSS_NAMES)


def test_the_table_of_forms_leaves_agreement_out_and_that_of_agreement_the_forms():
    energies = {"membrane_j": 0.1, "energy_j": 0.25, "colliding_vertex_pct": 0.0, "edge_pct": 3.0, "area_pct": 2.0}
    charts = {"chart_gap_p99_mm": 3.25, "chart_normal_p99_deg": 12.0, "percent": 100, "patches": 110, "gain": 0.91}
    rows = [
        {"garment": "sash", "method": "skinning", **energies, "gain": -0.3},
        {"garment": "sash", "method": "rigid_2", "numbers": 27, **energies, **charts},
        {"garment": "sash", "method": "rigid_2", "numbers": 27, **energies, **charts, "percent": 50},
        {"garment": "sash", "method": "through", "numbers": 45, "refits": 2, "disagreement_weight": 4e3, **energies}
        | charts,
    ]
    record = {**RECORD, "rows": rows}
    _, _, *lines, _, source = representation_report.form_table(record).split("\n")
    assert lines[0] == "| sash | - | - | skinning | 0.100 / 0.250 | 3.00 | 2.00 | 0.00 | -0.300 |"
    assert [line.split(" | ")[2] for line in lines] == ["-", "27", "27"]
    assert source.startswith("Measured on a machine")
    physics = {"garment": "sash", "method": "physics", **energies, "edge_pct": 1.5, "area_pct": 1.0, "gain": 1.0}
    bound = representation_report.bound_table({**RECORD, "rows": [*rows, physics]})
    _, _, *lines, _, source = bound.split("\n")
    assert lines[0] == "| sash | 110 | blended | - | 3.2 | 12 | 1.50 | 1.00 | 0.910 |"
    assert lines[2] == "| sash | 110 | blended, fitted to the blend, blended | 4e3 | 3.2 | 12 | 1.50 | 1.00 | 0.910 |"
    assert source.startswith("Measured on a machine")
    _, _, *lines = representation_report.agreement_table(record).split("\n")
    assert lines == [
        "| sash | energy alone | - | - | 3.2 | 12.0 | 0.910 |",
        "| sash | the same through consensus | 4e3 | 2 x 45 numbers | 3.2 | 12.0 | 0.910 |",
    ]


def test_the_table_of_losses_has_dashes_for_what_is_not_published():
    energies = {"membrane_j": 0.1, "bending_j": 0.01, "contact_j": 0.0}
    figures = {"edge_pct": 3.0, "area_pct": 2.0, "colliding_vertex_pct": 0.5, **energies}
    published = dict(zip(("published_edge_pct", "published_area_pct"), (None, 12.76), strict=True))
    rows = [{"loss": "skinning", **figures}, {"loss": "no_metric", **figures, **published, "chart_gap_p99_mm": 4.0}]
    table = representation_report.loss_table({**RECORD, "rows": rows})
    heads, rule, *lines = table.split("\n")[:4]
    assert heads.count("|") == rule.count("|") == lines[0].count("|")
    assert lines[1].startswith("| without metric (L_inext) | 3.00 | 2.00 | 0.500 | - | 12.8 | - | 0.100 | 0.0100 |")


def test_every_table_has_its_place_in_its_document():
    for _, document, name, _ in report.TABLES:
        text = (ROOT / document).read_text(encoding="utf-8")
        assert text.count(f"<!-- {name}:begin -->") == text.count(f"<!-- {name}:end -->") == 1, f"{document} {name}"
