"""Tables and the plot of a record of ``benchmarks.latency``.

python -m benchmarks.speed.tables   (writes docs/images/latency_growth.png; the tables come with benchmarks.report)
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.shared.common import RESULTS_DIR, ROOT
from benchmarks.shared.markdown import Record, rows_table, table

PLOT = ROOT / "docs" / "images" / "latency_growth.png"
NAMES = {
    "onnx": "packed graph: vertices", "onnx_pushed": "packed graph and push-out",
    "onnx_subnormals": "packed graph and push-out, subnormal numbers kept",
    "onnx_normals": "packed graph: vertices and normals", "onnx_steps": "packed graph: 16-bit steps",
    "onnx_jets": "packed graph: posed jets", "onnx_fp16": "packed graph, matrices in float16",
    "onnx_readable": "graph that is not packed", "torch_eager": "torch, eager, same precomputation",
    "torch_compile": "torch.compile, same precomputation", "skinning_push": "skinning and nearest-vertex push (SciPy)",
    "newton_vbd": "Newton VBD", "floor": "floor",
}  # fmt: skip
SERVING = {
    "case": ("case", "s"), "server": ("server", "s"), "tier": ("tier", "s"), "clients": ("clients", "d"),
    "goodput_pct": ("goodput %", ".0f"), "stepped_pct": ("with less than asked %", ".0f"),
    "frame_age_p50_ms": ("age p50 [ms]", ".0f"), "frame_age_p99_ms": ("p99", ".0f"),
    "overhead_p50_ms": ("beside the model p50 [ms]", ".1f"), "overhead_p99_ms": ("p99 [ms]", ".1f"),
    "gap_max_ms": ("longest gap [ms]", ".0f"),
    "cpu_ms": ("processor a pose [ms]", ".1f"),
}  # fmt: skip
TIMES = {"p50_ms": "p50 [ms]", "p95_ms": "p95", "p99_ms": "p99", "min_ms": "least"}


def single_table(record: Record) -> str:
    """One frame of one garment: ours, the rivals, the floor."""
    lines = []
    for row in record["rows"]:
        if row["batch"] != 1 or row["garment"] == "mixed" or "," in row["garment"] or "store" in row["garment"]:
            continue
        name = NAMES[row["name"]] + (f", {row['passes']} passes" if "passes" in row else "")
        if "ratio" in row:
            name += f" ({row['ratio']['both']:.2f} times as long)"
        if "iterations" in row:
            reached = "" if row["reached"] else ", strain not reached"
            name += f", {row['iterations']} iterations{reached}"
        times = ["" if row.get(key) is None else f"{row[key]:.2f}" for key in TIMES]
        lines.append([row["garment"], name, *(times if "p50_ms" in row else [row["skipped"], "", "", ""])])
    return f"{table(['garment', 'what', *TIMES.values()], lines)}\n\n{_provenance(record)}"


def stage_table(record: Record) -> str:
    """Where the milliseconds of a frame go, and the push-out that comes on top."""
    rows = [row for row in record["rows"] if row["name"] == "onnx" and "stage_ms" in row]
    stages = list(rows[0]["stage_ms"])
    lines = (
        [row["garment"], str(row["vertices"]), *(f"{ms:.2f}" for ms in (*row["stage_ms"].values(), row["push_out_ms"]))]
        for row in rows
    )
    return table(["garment", "vertices", *stages, "push-out"], lines)


def batch_table(record: Record) -> str:
    """Frames of all shipped garments in turn."""
    columns = {"batch": ("frames in a call", "d"), "p50_ms": ("p50 [ms]", ".2f"), "frames_per_s": ("frames/s", ".0f")}
    return rows_table(columns, (row for row in record["rows"] if row["garment"] == "mixed"))


def growth_table(record: Record) -> str:
    """More vertices, patches and garments."""
    columns = {
        "garment": ("what", "s"), "vertices": ("vertices", "d"), "patches": ("patches", "d"),
        "p50_ms": ("p50 [ms]", ".2f"), "memory_mb": ("memory [MB]", ".1f"),
    }  # fmt: skip
    stored = (row | {"memory_mb": 1e-6 * row["store_bytes"]} for row in record["rows"] if "store_bytes" in row)
    return rows_table(columns, stored)


def serving_table(record: Record) -> str:
    """Streams under load: one line per case, and how many clients each server carries."""
    carried = ", ".join(f"{name} {count}" for name, count in record["max_clients"].items())
    alone = ", ".join(f"{tier} {ms:.1f} ms" for tier, ms in record["model_ms"].items())
    rows = rows_table(SERVING, record["rows"])
    return f"{rows}\n\nClients carried: {carried}. A frame alone: {alone}.\n\n{_provenance(record)}"


def _provenance(record: Record) -> str:
    return (
        f"Measured on {record['machine']}, {record['threads']} threads, load {record['load_before']:.1f} before it, "
        f"commit {record['commit']}: `{record['command']}`."
    )


def plot(record: Record, path: Path) -> None:
    """Milliseconds of one frame over vertices and over patches, and frames per second over the batch."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(11.0, 3.4), constrained_layout=True)
    series = (
        ("vertices", "vertices", "ms per frame", lambda r: ", vertices" in r["garment"], "p50_ms"),
        ("patches", "patches", "ms per frame", lambda r: ", patches" in r["garment"], "p50_ms"),
        ("batch", "frames in a call", "frames per second", lambda r: r["garment"] == "mixed", "frames_per_s"),
    )
    for axis, (key, across, up, chosen, value) in zip(axes, series, strict=True):
        rows = [row for row in record["rows"] if row["name"] == "onnx" and chosen(row)]
        axis.plot([row[key] for row in rows], [row[value] for row in rows], "o-", color="#1f5f8b")
        axis.set_xlabel(across)
        axis.set_ylabel(up)
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
        if key != "patches":
            axis.set_xscale("log")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


CHURN = {
    "clients": ("clients", "d"), "minutes": ("minutes", ".0f"), "streams": ("streams", "d"), "frames": ("frames", "d"),
    "requests": ("requests", "d"), "uploads": ("uploads", "d"), "refused": ("refused", "d"), "failed": ("failed", "d"),
    "memory_mb": ("memory [MB]", ".0f"), "last_mb": ("at the end", ".0f"), "slope_mb_h": ("slope [MB/h]", ".1f"),
    "slope_error_mb_h": ("its error", ".1f"), "descriptors": ("descriptors", "d"),
    "last_descriptors": ("at the end ", "d"), "threads": ("threads", "d"), "last_threads": ("at the end  ", "d"),
}  # fmt: skip


def churn_table(record: Record) -> str:
    """What a service held while clients came and went."""
    return rows_table(CHURN, record["rows"], record)


TABLES = (
    ("latency", "docs/reference/performance.md", "latency_single", single_table),
    ("latency", "docs/reference/performance.md", "latency_stages", stage_table),
    ("latency", "docs/reference/performance.md", "latency_batches", batch_table),
    ("latency", "docs/reference/performance.md", "latency_growth", growth_table),
    ("serving", "docs/reference/performance.md", "serving", serving_table),
    ("churn", "docs/reference/performance.md", "churn", churn_table),
)


def main() -> None:
    """Command line entry."""
    plot(json.loads((RESULTS_DIR / "latency.json").read_text(encoding="utf-8")), PLOT)
    print(PLOT.relative_to(ROOT))


if __name__ == "__main__":
    main()
