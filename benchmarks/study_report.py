"""Tables of the studies: variety of the garments trained on, fine-tuning, resolution, throughput, motion, push-out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from benchmarks.common import cells, markdown_table, provenance

Record = dict[str, Any]


def generality_table(record: Record) -> str:
    """One line per run: what it was trained on, and the gain on every garment; those it saw and those it did not."""
    rows = record["rows"]
    means = [key for key in ("mean_seen", "mean_unseen") if key in rows[0]]
    gains = [key for key in rows[0] if key.startswith("gain_")]
    heads = ["trained on", "garments", "partitions", "steps", *(key.replace("_", ", ") for key in means)]
    heads += [key.removeprefix("gain_") for key in gains]
    forms = {"garments": ",", "partitions": ",", "steps": ","} | dict.fromkeys([*means, *gains], ".2f")
    return _with_source(record, heads, ([row["run"], *cells(row, forms)] for row in rows))


def finetuning_table(record: Record) -> str:
    """One line per garment and network, in the form of the paper's table 2."""
    heads = ["garment", "network", "steps", "minutes", "edge %", "area %", "colliding %", "energy [J]", "gain"]
    forms = {"edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".2f", "energy_j": ".3f", "gain": ".3f"}
    lines = (
        [row["garment"], row["network"], f"{row['steps']:,}", f"{row['train_s'] / 60.0:.1f}", *cells(row, forms)]
        for row in record["rows"]
    )
    return _with_source(record, heads, lines)


def resolution_table(record: Record) -> str:
    """One line per mesh of one garment: how far its drape is from that of the finest, and what it costs."""
    heads = ["mesh", "vertices", "patches", "at rest [mm]", "draped, mean [mm]", "p95 [mm]", "edge %"]
    heads.append("one frame, p50 [ms]")
    forms = {"mesh": "s", "vertices": ",", "patches": "d"}
    forms |= dict.fromkeys(("rest_mm", "mean_mm", "p95_mm", "edge_pct", "p50_ms"), ".2f")
    return _with_source(record, heads, (cells(row, forms) for row in record["rows"]))


def throughput_table(record: Record) -> str:
    """One line per way to share a training step among cores, and where its time goes."""
    stages = [key for key in record["rows"][0] if key.endswith("_ms")]
    heads = ["processes", "threads each", "frames a step", "frames/s", "spread"]
    heads += [f"{key.removesuffix('_ms')} [ms/frame]" for key in stages]
    forms = {"processes": "d", "threads": "d", "batch": "d", "frames_per_s": ".0f", "spread": ".0f"}
    forms |= dict.fromkeys(stages, ".2f")
    return _with_source(record, heads, (cells(row, forms) for row in record["rows"]))


def int8_table(record: Record) -> str:
    """One line per garment and form of the packed graph."""
    heads = ["garment", "packed graph", "one frame, p50 [ms]", "least", "of ten in a call [ms]", "energy [J]", "edge %"]
    heads += ["area %", "jitter", "apart, mean [mm]", "p99 [mm]"]
    forms = {"garment": "s", "form": "s", "p50_ms": ".2f", "min_ms": ".2f", "batch_ms": ".2f", "energy_j": ".3f"}
    forms |= {"edge_pct": ".2f", "area_pct": ".2f", "jitter": ".3f", "apart_mm": ".2f", "apart_p99_mm": ".1f"}
    return _with_source(record, heads, (cells(row, forms) for row in record["rows"]))


def stop_table(record: Record) -> str:
    """One line per garment and clip: the hem after an abrupt stop."""
    rows = [row for row in record["rows"] if row["kind"] == "stop"]
    times = [key for key in rows[0] if key[0].isdigit()]
    heads = ["garment", "clip", "swings through", "within 1 mm after [s]", "every bit still after [s]"]
    heads += ["hem: largest [mm]", *(f"after {key}" for key in times)]
    forms = {"garment": "s", "clip": "s", "swings": "d", "millimetre_s": ".2f", "rest_s": ".2f", "peak_mm": ".1f"}
    forms |= dict.fromkeys(times, ".1f")
    return _with_source(record, heads, (cells(row, forms) for row in rows))


def potential_table(record: Record) -> str:
    """One line per garment and clip: the incremental potential of the moving and of the static drape."""
    heads = ["garment", "clip", "after the same frames: moving [J]", "static", "each after its own: moving", "static"]
    forms = {"garment": "s", "clip": "s"}
    forms |= {f"{kind}_{motion}_j": ".4f" for kind in ("given", "own") for motion in ("dynamic", "static")}
    return markdown_table(heads, (cells(row, forms) for row in record["rows"] if row["kind"] == "potential"))


def push_table(record: Record) -> str:
    """One line per set of garments and way out of the body."""
    heads = ["garments", "way", "colliding triangles %", "edge %", "added [pp]", "energy [J]", "jitter", "p50 [ms]"]
    heads.append("processor [ms]")
    forms = {
        "colliding_triangle_pct": ".3f", "edge_pct": ".2f", "edge_added_pp": ".2f", "energy_j": ".3f",
        "jitter_ratio": ".2f", "p50_ms": ".2f", "processor_ms": ".2f",
    }  # fmt: skip
    lines = (
        [f"{row['garment']}, {row['set']}", row["method"].replace("_", " "), *cells(row, forms)]
        for row in record["summary"]
    )
    return _with_source(record, heads, lines)


def _with_source(record: Record, heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    return "\n".join([markdown_table(heads, lines), "", provenance(record)])
