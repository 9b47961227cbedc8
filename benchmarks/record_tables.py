"""The tables of docs/records, each of one committed record.

``TABLES`` has a line for each: the record, the document that speaks of it, the table's name, and the function that
writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from benchmarks.tables import Columns, Record, Row, cells, heads, markdown_table, provenance, rows_table

# --- quality: older records lack detail, and those of the cloth of before fabrics lack fabrics -----------------------
FABRIC = {"fabric": ("fabric", "s")}
DETAIL = {"detail_mm": ("detail [mm]", ".2f"), "dihedral_deg": ("dihedral [deg]", ".1f")}
SHARE = {"detail_share": ("detail share", ".2f")}
GAIN = {"gain": ("gain", ".3f")}
QUALITY = {
    "garment": ("garment", "s"), "method": ("method", "s"), "edge_pct": ("edge %", ".2f"),
    "area_pct": ("area %", ".2f"), "colliding_vertex_pct": ("colliding % (vertex)", ".2f"),
    "colliding_triangle_pct": ("colliding % (triangle)", ".2f"), "self_intersections": ("self-intersections", ".1f"),
    "energy_j": ("energy [J]", ".2f"), "gain": ("gain", ".2f"),
}  # fmt: skip
NETWORK = {
    "gain": ("gain", ".2f"), "edge_over_physics_pp": ("edge over physics [pp]", ".1f"),
    "area_over_physics_pp": ("area over physics [pp]", ".1f"), "chart_gap_p99_mm": ("chart gap p99 [mm]", ".1f"),
    "chart_normal_p99_deg": ("chart normal p99 [deg]", ".1f"), "jitter_ratio": ("jitter", ".2f"),
    "jitter_worst": ("in the worst clip", ".2f"),
}  # fmt: skip
CROSSED, JITTER, AT_REST = {"self_intersections": ".1f"}, {"jitter_ratio": ".2f"}, {"converged_pct": ".0f"}
BESIDE = {"edge_pct": ("edge %", ".2f"), "hang_mm": ("hem lower than skinned [mm]", ".1f"),
          "detail_mm": ("detail [mm]", ".2f")}  # fmt: skip


def _measured(rows: Iterable[Row], *groups: Columns) -> dict[str, str | tuple[str, str]]:
    """Those columns of ``groups`` that any of ``rows`` has."""
    known = {key for row in rows for key in row}
    return {key: column for group in groups for key, column in group.items() if key in known}


def _by_method(rows: Iterable[Row]) -> dict[tuple[str, str, str], dict[str, Row]]:
    """The rows of every garment, set and fabric by method."""
    groups: dict[tuple[str, str, str], dict[str, Row]] = {}
    for row in rows:
        groups.setdefault((row["garment"], row.get("set", ""), row.get("fabric", "")), {})[row["method"]] = row
    return groups


def quality_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``quality``, with a line for every garment, fabric and method, and where
    it was measured."""
    rows = record["rows"]
    first = {"garment": QUALITY["garment"]} | _measured(rows, FABRIC)
    return rows_table(first | QUALITY | _measured(rows, DETAIL), rows, record)


def network_table(record: Record) -> str:
    """Returns a Markdown table of the network in a record of ``quality``, with a line for each garment and fabric and
    one for each mean: gain, strain over physics, charts, jitter and self-intersections."""
    every = [*record["rows"], *record["summary"]]
    own = _measured(every, FABRIC) | NETWORK | _measured(every, SHARE)
    lines = []
    for (garment, kind, _), rows in _by_method(every).items():
        crossings = [cell for method in ("skinning", "network", "physics") for cell in cells(rows[method], CROSSED)]
        name = f"{garment} {kind}".strip() if garment == "all" else garment
        lines.append([name, *cells(rows["network"], own), *cells(rows["network_push"], JITTER), *crossings])
    more = ["with push-out", "self-intersections: skinning", "network", "physics"]
    return markdown_table(["garment", *heads(own), *more], lines)


def fabrics_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``quality`` with a line for each garment and fabric: the gain of the
    network, and its strain, hang and detail beside those of physics."""
    lines = []
    for names, rows in _by_method(record["rows"]).items():
        network, physics = (cells(rows[method], BESIDE) for method in ("network", "physics"))
        gains = [*cells(rows["network"], GAIN), *cells(rows["network_push"], GAIN)]
        pairs = [f"{ours} / {best}" for ours, best in zip(network, physics, strict=True)]
        lines.append([*names, *gains, *pairs, *cells(rows["physics"], AT_REST)])
    beside = [f"{name}: network / physics" for name in heads(BESIDE)]
    return markdown_table(["garment", "set", "fabric", "gain", "pushed out", *beside, "poses at rest %"], lines, record)


def four_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``quality`` with a line for each fabric and set of garments: the gain of
    the network alone, pushed out, and with folds; the edge strain of folds minus that of physics [percentage points]
    and the detail share of folds; and the share [%] of poses in which physics came to rest."""
    left, lines = {"edge_over_physics_pp": ".2f", "detail_share": ".2f"}, []
    for (_, kind, fabric), rows in _by_method(record["summary"]).items():
        gains = [value for method in ("network", "network_push", "folds") for value in cells(rows[method], GAIN)]
        lines.append([fabric, kind, *gains, *cells(rows["folds"], left), *cells(rows["physics"], AT_REST)])
    titles = ["fabric", "garments", "network", "pushed out", "two steps of folds", "edge over physics [points]"]
    return markdown_table([*titles, "detail share", "poses at rest %"], lines, record)


# --- the trade, motion -----------------------------------------------------------------------------------------------
TRADE = {
    "tier": ("tier", "s"), "knobs": ("what runs", "s"), "time_ratio": ("time, rival = 1", ".2f"),
    "cpu_ms": ("processor [ms]", ".1f"), "p95_ms": ("p95 [ms]", ".1f"), "gain": ("gain", ".3f"),
    "gain_p05": ("5th percentile", ".3f"), "curvature": ("curvature over physics'", ".2f"),
    "error_mm": ("to physics [mm]", ".1f"),
    "edge_pct": ("edge %", ".2f"), "detail_share": ("detail share", ".2f"), "jitter_ratio": ("jitter", ".2f"),
    "colliding_pct": ("colliding %", ".2f"), "skin_pixels_pct": ("skin, pixels %", ".3f"),
    "self_intersections": ("self-intersections", ".0f"),
}  # fmt: skip
MOVING = {
    "garment": ("garment", "s"), "clip": ("clip", "s"), "tier": ("tier", "s"),
    "curvature": ("curvature over the still's", ".2f"), "dihedral": ("dihedral", ".2f"), "fine": ("fine", ".2f"),
    "middle": ("middle", ".2f"), "hem": ("hem", ".2f"), "area": ("area", ".3f"),
    "curvature_last": ("curvature over that of the last pose", ".2f"), "pop": ("pop", ".2f"),
    "crossings": ("crossings", ".1f"), "crossings_worst": ("worst frame", ".0f"), "depth_mm": ("in skin [mm]", ".1f"),
    "inside": ("vertices 10 mm in it", ".1f"), "inside_worst": ("worst frame", ".0f"),
    "strain_pct": ("strain [%]", ".0f"), "jitter": ("jitter", ".2f"), "resets": ("resets", ".0f"),
}  # fmt: skip
SWING = {
    "garment": ("garment", "s"), "clip": ("clip", "s"), "method": ("method", "s"), "rise_mm": ("hem rises [mm]", ".0f"),
    "share": ("of the simulator's", ".2f"), "error_mm": ("hem off the simulator's [mm]", ".0f"),
    "hem_mm": ("hem off the still drape's [mm]", ".0f"), "ms": ("ms", ".1f"),
}  # fmt: skip


def trade_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``tradeoff``, the cheapest first, with a line for each choice of knobs
    that nothing beats in both time and gain, for each tier, and for the rival and physics."""
    front = [row for row in record["means"] if row["pareto"] or row["tier"]]
    ordered = sorted(front, key=lambda row: row["time_ratio"])
    return rows_table(TRADE, ({**row, "tier": row["tier"].replace("_", " ")} for row in ordered), record)


# --- speed -----------------------------------------------------------------------------------------------------------
NAMES = {
    "onnx": "packed graph: vertices", "onnx_pushed": "packed graph and push-out",
    "onnx_jets": "packed graph: posed jets", "torch_eager": "torch, eager, same precomputation",
    "skinning_push": "skinning and nearest-vertex push (SciPy)", "floor": "floor",
}  # fmt: skip
TIMES = {"p50_ms": "p50 [ms]", "p95_ms": "p95", "p99_ms": "p99", "min_ms": "least"}
KERNELS = {
    "garment": ("garment", "s"), "tier": ("tier", "s"), "stage": ("stage", "s"), "kernel": ("kernel", "s"),
    "calls": ("calls", ".0f"), "cpu_ms": ("processor [ms]", ".3f"), "wall_ms": ("wall [ms]", ".3f"),
    "share": ("of the frame", ".2f"), "floor_ms": ("floor [ms]", ".3f"), "bare_ms": ("not traced [ms]", ".3f"),
}  # fmt: skip
THREADS = {
    "garment": ("garment", "s"), "what": ("what", "s"), "threads": ("threads", "d"),
    "cpu_ms": ("processor a frame [ms]", ".2f"), "wall_ms": ("wall a frame [ms]", ".2f"),
    "frames_per_s": ("frames/s", ".0f"),
}  # fmt: skip
VIEWS = {
    "garment": ("garment", "s"), "case": ("case", "s"), "what": ("what", "s"), "full_ms": ("in full [ms]", ".2f"),
    "cpu_ms": ("so [ms]", ".2f"), "saving": ("saved", ".2f"),
}  # fmt: skip
BATCHES = {"batch": ("frames in a call", "d"), "p50_ms": ("p50 [ms]", ".2f"), "frames_per_s": ("frames/s", ".0f")}
SERVING = {
    "case": ("case", "s"), "server": ("server", "s"), "tier": ("tier", "s"), "clients": ("clients", "d"),
    "goodput_pct": ("goodput %", ".0f"), "stepped_pct": ("with less than asked %", ".0f"),
    "frame_age_p50_ms": ("age p50 [ms]", ".0f"), "frame_age_p99_ms": ("p99", ".0f"),
    "overhead_p50_ms": ("beside the model p50 [ms]", ".1f"), "overhead_p99_ms": ("p99 [ms]", ".1f"),
    "gap_max_ms": ("longest gap [ms]", ".0f"), "cpu_ms": ("processor a pose [ms]", ".1f"),
}  # fmt: skip
INTAKES = {
    "garment": ("file", "s"), "faces": ("faces", "d"), "garments": ("garments", "d"),
    "read_s": ("read, wearer [s]", ".1f"), "rest_s": ("at rest [s]", ".1f"), "fit_s": ("patches, cloth [s]", ".1f"),
    "all_s": ("all [s]", ".1f"), "drawn": ("vertices drawn", "d"), "cloth": ("of cloth", "d"),
    "hang_ms": ("hanging [ms]", ".3f"), "frame_ms": ("frame [ms]", ".1f"), "over_dress": ("over the dress's", ".2f"),
    "sent_s": ("from upload to worn [s]", ".1f"),
}  # fmt: skip


def single_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``latency``: the times [ms] of one frame of each single garment, of ours,
    of rivals and of the floor."""
    lines = []
    for row in record["rows"]:
        if row["batch"] != 1 or row["garment"] == "mixed" or "," in row["garment"] or "store" in row["garment"]:
            continue
        name = NAMES[row["name"]] + (f", {row['passes']} passes" if "passes" in row else "")
        lines.append([row["garment"], name, *cells(row, dict.fromkeys(TIMES, ".2f"), missing="")])
    return markdown_table(["garment", "what", *TIMES.values()], lines, record)


def intakes_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``intakes`` with a line for each file: the seconds of its intake and the
    time of its frames, with the time from its upload to a service without streams until it was worn."""
    worn = {row["garment"]: row["sent_s"] for row in record["rows"] if row.get("streams") == 0}
    rows = [row | {"sent_s": worn.get(row["garment"])} for row in record["rows"] if "faces" in row]
    return rows_table(INTAKES, rows, record)


def serving_table(record: Record) -> str:
    """Returns a Markdown table of a record of ``serving`` with a line for each case, and below it how many clients are
    carried and how long a frame takes alone."""
    carried = ", ".join(f"{name} {count}" for name, count in record["max_clients"].items())
    alone = ", ".join(f"{tier} {ms:.1f} ms" for tier, ms in record["model_ms"].items())
    rows = rows_table(SERVING, record["rows"])
    return f"{rows}\n\nClients carried: {carried}. A frame alone: {alone}.\n\n{provenance(record)}"


# --- recovery --------------------------------------------------------------------------------------------------------
CUTS = {
    "target": ("target", "s"), "from": ("from", "s"), "base": ("base", "s"), "told": ("cut told", "s"),
    "panels": ("panels", "d"), "mean_mm": ("mean distance [mm]", ".1f"), "chamfer_cm2": ("Chamfer [cm²]", ".2f"),
    "seam_max_pct": ("seams differ by [%]", ".2f"), "anew_mm": ("sewn anew [mm]", ".1f"),
    "sewn_mm": ("sewn, from the target [mm]", ".1f"), "minutes": ("minutes", ".1f"),
    "processor_min": ("of the processor [min]", ".1f"),
}  # fmt: skip
PAGE = {
    "device": ("device", "s"), "slowed": ("slowed", "s"), "webgl": ("WebGL", "s"),
    "performance": ("performance", "d"), "accessibility": ("accessibility", "d"),
    "best_practices": ("best practices", "d"), "seo": ("SEO", "d"),
    "first_paint_s": ("first paint [s]", ".2f"), "largest_paint_s": ("largest [s]", ".2f"),
    "blocking_s": ("blocked [s]", ".2f"), "shift": ("shift", ".3f"), "loaded_kb": ("loaded [kB]", ".0f"),
    "moves_s": ("cloth moves [s]", ".2f"), "moving_kb": ("until then [kB]", ".0f"),
}  # fmt: skip


def rows_where(columns: Columns, record: Record, *, sourced: bool = True, **values: str) -> str:
    """Returns a Markdown table with a line for each row of ``record`` that has these ``values`` by key; if ``sourced``
    is true, with where it was measured."""
    rows = [row for row in record["rows"] if all(row[key] == value for key, value in values.items())]
    return rows_table(columns, rows, record if sourced else None)


QUALITY_PAGE, FOLDS_PAGE, SPEED_PAGE = (
    "docs/reference/quality.md", "docs/explanation/folds.md", "docs/reference/performance.md",
)  # fmt: skip
TABLES: tuple[tuple[str, str, str, Callable[[Record], str]], ...] = (
    ("quality", QUALITY_PAGE, "quality", quality_table),
    ("quality", QUALITY_PAGE, "quality_network", network_table),
    ("quality_fine", QUALITY_PAGE, "quality_fine", network_table),
    ("quality_fabrics", QUALITY_PAGE, "quality_fabrics", fabrics_table),
    ("quality_four", QUALITY_PAGE, "quality_four", four_table),
    ("swing", "docs/explanation/swing.md", "swing", partial(rows_where, SWING, sourced=False)),
    ("moving", FOLDS_PAGE, "moving", partial(rows_where, MOVING)),
    ("tradeoff", "docs/reference/tradeoff.md", "tradeoff", trade_table),
    ("yardsticks", "docs/reference/tradeoff.md", "yardsticks", trade_table),
    ("frame", SPEED_PAGE, "frame_kernels", partial(rows_where, KERNELS, sourced=False, kind="kernel")),
    ("frame_views", SPEED_PAGE, "frame_threads", partial(rows_where, THREADS, sourced=False, kind="threads")),
    ("frame_views", SPEED_PAGE, "frame_views", partial(rows_where, VIEWS, kind="view")),
    ("latency", SPEED_PAGE, "latency_single", single_table),
    ("latency", SPEED_PAGE, "latency_batches", partial(rows_where, BATCHES, sourced=False, garment="mixed")),
    ("latency_gpu", SPEED_PAGE, "latency_gpu_single", single_table),
    ("latency_gpu", SPEED_PAGE, "latency_gpu_batches", partial(rows_where, BATCHES, sourced=False, garment="mixed")),
    ("serving", SPEED_PAGE, "serving", serving_table),
    ("intakes", "docs/guide/garments.md", "intakes", intakes_table),
    ("page_lighthouse", "docs/guide/web.md", "page_lighthouse", partial(rows_where, PAGE)),
    ("recovery_cuts", "docs/guide/recovery_run.md", "recovery_cuts", partial(rows_where, CUTS)),
)
