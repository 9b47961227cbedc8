"""Writes the committed results into the documents, between ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``.

python -m benchmarks.report
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import latency_report, polyfit_report, recovery_report, representation_report, study_report
from benchmarks.common import RESULTS_DIR, ROOT, cells, markdown_table, provenance

QUALITY_COLUMNS = {
    "edge_pct": ".2f",
    "area_pct": ".2f",
    "colliding_vertex_pct": ".2f",
    "colliding_triangle_pct": ".2f",
    "self_intersections": ".1f",
    "energy_j": ".2f",
    "gain": ".2f",
}
NETWORK_COLUMNS = {
    "gain": ".2f",
    "edge_over_physics_pp": ".1f",
    "area_over_physics_pp": ".1f",
    "chart_gap_p99_mm": ".1f",
    "chart_normal_p99_deg": ".1f",
    "jitter_ratio": ".2f",
    "jitter_worst": ".2f",
}
# Of benchmarks.quality --reference; the long table has them where they were measured.
REFERENCE_COLUMNS = {"reference_mm": ".1f", "reference_p95_mm": ".1f", "reference_surface_mm": ".1f"}
REFERENCE_HEADS = ("to the reference, mean [mm]", "p95 [mm]", "to its surface [mm]")
END_COLUMNS = {
    "reference_start_mm": ".1f",
    "reference_start_surface_mm": ".1f",
    "reference_steps": ".0f",
    "reference_at_rest_pct": ".0f",
    "reference_speed_mm_s": ".1f",
    "reference_balanced_pct": ".0f",
    "reference_residual_n": ".2f",
}
CROSSING_METHODS = ("skinning", "network", "physics")


def quality_table(record: dict[str, Any]) -> str:
    """Every garment and method of ``benchmarks.quality``."""
    heads = [
        *("garment", "method", "edge %", "area %", "colliding % (vertex)", "colliding % (triangle)"),
        *("self-intersections", "energy [J]", "gain"),
    ]
    columns = QUALITY_COLUMNS
    if any("reference_mm" in row for row in record["rows"]):
        heads, columns = [*heads, *REFERENCE_HEADS], columns | REFERENCE_COLUMNS
    lines = [[row["garment"], row["method"], *cells(row, columns)] for row in record["rows"]]
    return f"{markdown_table(heads, lines)}\n\n{provenance(record)}"


def reference_table(record: dict[str, Any]) -> str:
    """How far every method is from the second simulator's drape, and the floor: its two ends from each other."""
    lines = []
    for row in record["rows"]:
        lines.append([row["garment"], row["method"], *cells(row, REFERENCE_COLUMNS)])
        if "reference_floor_mm" in row:
            floor = {key.replace("reference", "reference_floor"): form for key, form in REFERENCE_COLUMNS.items()}
            lines.append([row["garment"], f"simulated from {row['method']}: the floor", *cells(row, floor)])
    return f"{markdown_table(['garment', 'drape', *REFERENCE_HEADS], lines)}\n\n{provenance(record)}"


def reference_end_table(record: dict[str, Any]) -> str:
    """How the second simulator came to rest from each of its starts."""
    heads = (
        *("garment", "from", "ends at, mean [mm]", "at, to the surface [mm]", "steps", "poses at rest %"),
        *("fastest pose [mm/s]", "vertices balanced %", "force left [N]", "weight [N]"),
    )
    weights = {row["garment"]: cells(row, {"weight_n": ".2f"}) for row in record["rows"] if row.get("weight_n")}
    lines = [
        [row["garment"], row["method"], *cells(row, END_COLUMNS), *weights[row["garment"]]]
        for row in record["rows"]
        if "reference_start_mm" in row
    ]
    return markdown_table(heads, lines)


def network_table(record: dict[str, Any]) -> str:
    """The network beside its bounds: one line per garment, and their means; the figures that have targets."""
    lines = [
        "| garment | gain | edge over physics [pp] | area over physics [pp] | chart gap p99 [mm] "
        "| chart normal p99 [deg] | jitter | in the worst clip | with push-out "
        "| self-intersections: skinning | network | physics |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    every = [*record["rows"], *record["summary"]]
    for garment, kind in dict.fromkeys((row["garment"], row.get("set", "")) for row in every):
        rows = {row["method"]: row for row in every if (row["garment"], row.get("set", "")) == (garment, kind)}
        pushed = cells(rows["network_push"], {"jitter_ratio": ".2f"})
        crossings = [cell for method in CROSSING_METHODS for cell in cells(rows[method], {"self_intersections": ".1f"})]
        name = f"{garment} {kind}".strip() if garment == "all" else garment
        lines.append(f"| {name} | {' | '.join([*cells(rows['network'], NETWORK_COLUMNS), *pushed, *crossings])} |")
    return "\n".join(lines)


def gain_table(record: dict[str, Any]) -> str:
    """The short form for the README: one line per garment."""
    methods = ("skinning_push", "network_push", "physics")
    lines = [
        "| garment | edge strain %: skinning + push-out | network + push-out | physics | gain |",
        "|---|---|---|---|---|",
    ]
    for garment in dict.fromkeys(row["garment"] for row in record["rows"]):
        rows = {row["method"]: row for row in record["rows"] if row["garment"] == garment}
        strains = " | ".join(f"{rows[m]['edge_pct']:.2f}" for m in methods)
        lines.append(f"| {garment} | {strains} | {rows['network_push']['gain']:.2f} |")
    return "\n".join([*lines, "", provenance(record)])


def insert(path: Path, name: str, text: str) -> bool:
    """Puts ``text`` between the markers called ``name`` in ``path``; False where the file has none."""
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    content = path.read_text(encoding="utf-8")
    if begin not in content or end not in content:
        return False
    head, rest = content.split(begin, 1)
    path.write_text(f"{head}{begin}\n{text}\n{end}{rest.split(end, 1)[1]}", encoding="utf-8")
    return True


TABLES: tuple[tuple[str, str, str, Callable[[dict[str, Any]], str]], ...] = (
    ("quality", "docs/quality.md", "quality", quality_table),
    ("quality", "README.md", "gain", gain_table),
    ("quality", "docs/quality.md", "quality_network", network_table),
    ("quality_unseen", "docs/quality.md", "quality_unseen", quality_table),
    ("quality_unseen", "docs/quality.md", "quality_unseen_network", network_table),
    ("quality_reference", "docs/quality.md", "quality_reference", reference_table),
    ("quality_reference", "docs/quality.md", "quality_reference_ends", reference_end_table),
    ("latency", "docs/performance.md", "latency_single", latency_report.single_table),
    ("latency", "docs/performance.md", "latency_stages", latency_report.stage_table),
    ("latency", "docs/performance.md", "latency_batches", latency_report.batch_table),
    ("latency", "docs/performance.md", "latency_growth", latency_report.growth_table),
    ("representation", "docs/decisions/0008-representation.md", "forms", representation_report.form_table),
    ("representation", "docs/decisions/0008-representation.md", "agreement", representation_report.agreement_table),
    ("representation_agreeing", "docs/decisions/0008-representation.md", "bound", representation_report.bound_table),
    (
        "representation_agreeing_fine",
        "docs/decisions/0008-representation.md",
        "bound_fine",
        representation_report.bound_table,
    ),
    ("quality_fine", "docs/quality.md", "quality_fine", network_table),
    ("int8", "docs/performance.md", "int8", study_report.int8_table),
    ("generality", "docs/training.md", "generality", study_report.generality_table),
    ("finetuning", "docs/training.md", "finetuning", study_report.finetuning_table),
    ("training", "docs/training.md", "throughput", study_report.throughput_table),
    ("dynamics", "docs/training.md", "dynamics_stop", study_report.stop_table),
    ("dynamics", "docs/training.md", "dynamics_potential", study_report.potential_table),
    ("push_out", "docs/push_out.md", "push_out", study_report.push_table),
    ("resolution", "docs/quality.md", "resolution", study_report.resolution_table),
    ("recovery_targets", "docs/recovery_fit.md", "recovery_targets", recovery_report.table),
    ("recovery_rounds", "docs/recovery_fit.md", "recovery_rounds", recovery_report.rounds_table),
    ("recovery_rivals", "docs/recovery_fit.md", "recovery_rivals", recovery_report.rivals_table),
    ("polyfit", "docs/polyfit.md", "polyfit_fits", polyfit_report.fits_table),
    ("polyfit", "docs/polyfit.md", "polyfit_garments", polyfit_report.garments_table),
    ("polyfit", "docs/decisions/0005-polyfit.md", "polyfit_frames", polyfit_report.frames_table),
    ("polyfit", "docs/decisions/0005-polyfit.md", "polyfit_density", polyfit_report.density_table),
    ("loss_ablation", "docs/losses.md", "loss_ablation", representation_report.loss_table),
)


def main() -> None:
    """Command line entry."""
    for bench, document, name, table in TABLES:
        result = RESULTS_DIR / f"{bench}.json"
        if not result.is_file():
            print(f"{document} {name}: no {result.name} yet")
            continue
        done = insert(ROOT / document, name, table(json.loads(result.read_text(encoding="utf-8"))))
        print(f"{document} {name}: {'written' if done else 'no markers'}")


if __name__ == "__main__":
    main()
