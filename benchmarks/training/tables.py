"""The table of the record of ``benchmarks.training``."""

from __future__ import annotations

from benchmarks.shared.markdown import Record, rows_table

THROUGHPUT = {
    "processes": ("processes", "d"), "threads": ("threads each", "d"), "batch": ("frames a step", "d"),
    "frames_per_s": ("frames/s", ".0f"), "spread": ("spread", ".0f"),
}  # fmt: skip


def throughput_table(record: Record) -> str:
    """One line per way to share a training step among cores, and where its time goes."""
    stages = [key for key in record["rows"][0] if key.endswith("_ms")]
    columns = {key: (f"{key.removesuffix('_ms')} [ms/frame]", ".2f") for key in stages}
    return rows_table(THROUGHPUT | columns, record["rows"], record)


TABLES = (("training", "docs/guide/training.md", "throughput", throughput_table),)
