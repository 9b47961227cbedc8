"""Tables of the studies: variety of the garments trained on, fine-tuning, resolution, throughput, motion, push-out."""

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


def throughput_table(record: Record) -> str:
    """One line per way to share a training step among cores, and where its time goes."""
    stages = [key.removesuffix("_ms") for key in record["rows"][0] if key.endswith("_ms")]
    heads = (
        "processes",
        "threads each",
        "frames a step",
        "frames/s",
        "spread",
        *(f"{name} [ms/frame]" for name in stages),
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in record["rows"]:
        cells = [str(row[key]) for key in ("processes", "threads", "batch")]
        cells += [f"{row[key]:.0f}" for key in ("frames_per_s", "spread")]
        lines.append("| " + " | ".join([*cells, *(f"{row[f'{name}_ms']:.2f}" for name in stages)]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def stop_table(record: Record) -> str:
    """One line per garment and clip: the hem after an abrupt stop."""
    rows = [row for row in record["rows"] if row["kind"] == "stop"]
    times = [key for key in rows[0] if key[0].isdigit()]
    heads = (
        "garment",
        "clip",
        "swings through",
        "within 1 mm after [s]",
        "every bit still after [s]",
        "hem: largest [mm]",
    )
    lines = [
        "| " + " | ".join([*heads, *(f"after {key}" for key in times)]) + " |",
        "|---" * (len(heads) + len(times)) + "|",
    ]
    for row in rows:
        cells = [row["garment"], row["clip"], str(row["swings"])]
        cells += [
            _number(row[key], form) for key, form in {"millimetre_s": ".2f", "rest_s": ".2f", "peak_mm": ".1f"}.items()
        ]
        lines.append("| " + " | ".join([*cells, *(_number(row[key], ".1f") for key in times)]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def potential_table(record: Record) -> str:
    """One line per garment and clip: the incremental potential of the moving and of the static drape."""
    lines = [
        "| garment | clip | after the same frames: moving [J] | static | each after its own: moving | static |",
        "|---" * 6 + "|",
    ]
    for row in (row for row in record["rows"] if row["kind"] == "potential"):
        values = [row[f"{kind}_{motion}_j"] for kind in ("given", "own") for motion in ("dynamic", "static")]
        lines.append(
            "| " + " | ".join([row["garment"], row["clip"], *(_number(value, ".4f") for value in values)]) + " |"
        )
    return "\n".join(lines)


def push_table(record: Record) -> str:
    """One line per set of garments and way out of the body."""
    forms = {
        "colliding_triangle_pct": ".3f", "edge_pct": ".2f", "edge_added_pp": ".2f", "energy_j": ".3f",
        "jitter_ratio": ".2f", "p50_ms": ".2f", "processor_ms": ".2f",
    }  # fmt: skip
    heads = ("garments", "way", "colliding triangles %", "edge %", "added [pp]", "energy [J]", "jitter", "p50 [ms]")
    lines = [f"| {' | '.join([*heads, 'processor [ms]'])} |", "|---" * (len(heads) + 1) + "|"]
    for row in record["summary"]:
        cells = [f"{row['garment']}, {row['set']}", row["method"].replace("_", " ")]
        lines.append("| " + " | ".join([*cells, *(_number(row.get(key), form) for key, form in forms.items())]) + " |")
    return "\n".join([*lines, "", provenance(record)])


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
