"""Tables of the studies of the network: variety of the garments trained on, fine-tuning, resolution of the mesh."""

from __future__ import annotations

from typing import Any

from benchmarks.common import provenance

Record = dict[str, Any]


def generality_table(record: Record) -> str:
    """One line per run: what it was trained on, and the gain on every garment; those it saw and those it did not."""
    rows = record["rows"]
    means = [key for key in ("mean_seen", "mean_unseen") if key in rows[0]]
    names = [key.removeprefix("gain_") for key in rows[0] if key.startswith("gain_")]
    heads = ["trained on", "garments", "partitions", "steps", *(key.replace("_", ", ") for key in means), *names]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for row in rows:
        values = [*(row[key] for key in means), *(row[f"gain_{name}"] for name in names)]
        cells = [row["run"], *(f"{row[key]:,}" for key in ("garments", "partitions", "steps"))]
        lines.append("| " + " | ".join([*cells, *(_number(value, ".2f") for value in values)]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def finetuning_table(record: Record) -> str:
    """One line per garment and network, in the form of the paper's table 2."""
    lines = [
        "| garment | network | steps | minutes | edge % | area % | colliding % | energy [J] | gain |",
        "|---" * 9 + "|",
    ]
    forms = {"edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".2f", "energy_j": ".3f", "gain": ".3f"}
    for row in record["rows"]:
        cells = [row["garment"], row["network"], f"{row['steps']:,}", f"{row['train_s'] / 60.0:.1f}"]
        lines.append("| " + " | ".join([*cells, *(_number(row[key], form) for key, form in forms.items())]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def resolution_table(record: Record) -> str:
    """One line per mesh of one garment: how far its drape is from that of the finest, and what it costs."""
    lines = [
        "| mesh | vertices | patches | at rest [mm] | draped, mean [mm] | p95 [mm] | edge % | one frame, p50 [ms] |",
        "|---" * 8 + "|",
    ]
    forms = {"rest_mm": ".2f", "mean_mm": ".2f", "p95_mm": ".2f", "edge_pct": ".2f", "p50_ms": ".2f"}
    for row in record["rows"]:
        cells = [row["mesh"], f"{row['vertices']:,}", str(row["patches"])]
        lines.append("| " + " | ".join([*cells, *(_number(row.get(key), form) for key, form in forms.items())]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
