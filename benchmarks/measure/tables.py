"""Tables of the records of ``benchmarks.quality`` and of the other measurements of its package."""

from __future__ import annotations

from benchmarks.shared.markdown import Columns, Record, cells, heads, rows_table, table

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
PUSHED = {"jitter_ratio": ("with push-out", ".2f")}
CROSSINGS = {"self_intersections": ("", ".1f")}
# Records of before detail was measured, and of the one cloth of before fabrics, lack these columns.
FABRIC = {"fabric": ("fabric", "s")}
DETAIL = {"detail_mm": ("detail [mm]", ".2f"), "dihedral_deg": ("dihedral [deg]", ".1f")}
SHARE = {"detail_share": ("detail share", ".2f")}
GAIN = {"gain": ("gain", ".3f")}
FOLDS = {
    "energy_j": ("energy [J]", ".3f"), "edge_pct": ("edge %", ".2f"), "detail_mm": ("detail [mm]", ".2f"),
    "colliding_pct": ("colliding %", ".2f"), "jitter_ratio": ("jitter", ".1f"), "ms": ("ms", ".1f"),
}  # fmt: skip
AFTER = ("jitter_ratio", "ms")  # what only folds have
BESIDE = {"edge_pct": ".2f", "hang_mm": ".1f", "detail_mm": ".2f"}
SHARES = {"skin_pixels_pct": ("mean", ".3f"), "worst_pct": ("worst", ".2f")}
SKIN = {
    "skinning": "skinning", "network": "network, pushed out", "folds": "folds on delivered triangles",
    "wrapped": "folds on finer ones, delivered wrapped", "fine": "folds on the finest mesh",
}  # fmt: skip
STOP = {
    "garment": ("garment", "s"), "clip": ("clip", "s"), "swings": ("swings through", "d"),
    "millimetre_s": ("within 1 mm after [s]", ".2f"), "rest_s": ("every bit still after [s]", ".2f"),
    "peak_mm": ("hem: largest [mm]", ".1f"),
}  # fmt: skip
POTENTIAL = {
    "garment": ("garment", "s"), "clip": ("clip", "s"),
    "given_dynamic_j": ("after the same frames: moving [J]", ".4f"), "given_static_j": ("static", ".4f"),
    "own_dynamic_j": ("each after its own: moving", ".4f"), "own_static_j": ("static", ".4f"),
}  # fmt: skip
TRADE = {
    "tier": ("tier", "s"), "knobs": ("what runs", "s"), "time_ratio": ("time, rival = 1", ".2f"),
    "cpu_ms": ("processor [ms]", ".1f"), "p95_ms": ("p95 [ms]", ".1f"), "gain": ("gain", ".3f"),
    "gain_p05": ("of the worst twentieth", ".3f"), "error_mm": ("to physics [mm]", ".1f"),
    "edge_pct": ("edge %", ".2f"), "detail_share": ("detail share", ".2f"), "jitter_ratio": ("jitter", ".2f"),
    "colliding_pct": ("colliding %", ".2f"), "skin_pixels_pct": ("skin, pixels %", ".3f"),
    "self_intersections": ("self-intersections", ".0f"),
}  # fmt: skip


def quality_table(record: Record) -> str:
    """Every garment and method of ``benchmarks.quality``."""
    rows = record["rows"]
    first = {"garment": QUALITY["garment"]} | _measured(rows, FABRIC)
    return rows_table(first | QUALITY | _measured(rows, DETAIL), rows, record)


def _measured(rows: list[Record], *groups: Columns) -> dict[str, tuple[str, str]]:
    """Those columns of ``groups`` that any of ``rows`` has."""
    return {key: column for group in groups for key, column in group.items() if any(key in row for row in rows)}


def _by_method(rows: list[Record]) -> dict[tuple[str, str, str], dict[str, Record]]:
    """The rows of every garment, set and fabric by method."""
    groups: dict[tuple[str, str, str], dict[str, Record]] = {}
    for row in rows:
        groups.setdefault((row["garment"], row.get("set", ""), row.get("fabric", "")), {})[row["method"]] = row
    return groups


def network_table(record: Record) -> str:
    """The network beside its bounds: one line per garment, and their means; the figures that have targets."""
    every = [*record["rows"], *record["summary"]]
    fabric, share = _measured(every, FABRIC), _measured(every, SHARE)
    lines = []
    for (garment, kind, _), rows in _by_method(every).items():
        crossings = [cell for method in ("skinning", "network", "physics") for cell in cells(rows[method], CROSSINGS)]
        name = f"{garment} {kind}".strip() if garment == "all" else garment
        own = cells(rows["network"], fabric | NETWORK | share)
        lines.append([name, *own, *cells(rows["network_push"], PUSHED), *crossings])
    counted = ["self-intersections: skinning", "network", "physics"]
    return table(["garment", *heads(fabric | NETWORK | share), *heads(PUSHED), *counted], lines)


def gain_table(record: Record) -> str:
    """The short form for the README: one line per garment."""
    fabric = _measured(record["rows"], FABRIC)
    groups = _by_method(record["rows"])
    folds = {"folds": "two steps of folds"} if any("folds" in rows for rows in groups.values()) else {}
    methods = {"network_push": "network + push-out", **folds}
    lines = []
    for (garment, _, _), rows in groups.items():
        strains = [f"{rows[method]['edge_pct']:.2f}" for method in ("skinning_push", *methods, "physics")]
        gains = [f"{rows[method]['gain']:.2f}" for method in methods]
        lines.append([garment, *cells(rows["physics"], fabric), *strains, *gains])
    titles = ["edge strain %: skinning + nearest-vertex push", *methods.values(), "physics"]
    gained = [f"gain: {name}" for name in methods.values()] if folds else ["gain"]
    return table(["garment", *heads(fabric), *titles, *gained], lines, record)


def stop_table(record: Record) -> str:
    """One line per garment and clip: the hem after an abrupt stop."""
    rows = [row for row in record["rows"] if row["kind"] == "stop"]
    times = {key: (f"after {key}", ".1f") for key in rows[0] if key[0].isdigit()}
    return rows_table(STOP | times, rows, record)


def potential_table(record: Record) -> str:
    """One line per garment and clip: the incremental potential of the moving and of the static drape."""
    return rows_table(POTENTIAL, [row for row in record["rows"] if row["kind"] == "potential"])


def folds_table(record: Record) -> str:
    """One line per garment, fabric, clip and start: it alone, and with two and eight steps; then physics, if known."""
    folds = _measured(record["rows"], GAIN) | FOLDS | _measured(record["rows"], SHARE)
    start = {key: column for key, column in folds.items() if key not in AFTER}
    named: dict[tuple[str, ...], dict[int, Record]] = {}
    for row in record["rows"]:
        apart = ", cloth feels cloth" if row.get("cloth_contact") else ""
        key = row["garment"], row["fabric"], row["clip"], row["method"].replace("_", " ") + apart
        named.setdefault(key, {})[row["sweeps"]] = row
    lines = []
    for key, rows in named.items():
        alone = " / ".join(cells(rows[0], start)) if 0 in rows else ""
        lines.append([*key, alone, *(" / ".join(cells(rows[n], folds)) if n in rows else "" for n in (2, 8))])
    titles = ["garment", "fabric", "clip", "start", " / ".join(heads(start)), f"2 steps: {' / '.join(heads(folds))}"]
    return table([*titles, "8 steps"], lines, record)


def trade_table(record: Record) -> str:
    """One line per choice of knobs on the front, and the ends of the axis, the cheapest first."""
    kept = [row for row in record["means"] if row["pareto"] or row["tier"]]
    ordered = sorted(kept, key=lambda row: row["time_ratio"])
    return rows_table(TRADE, ({**row, "tier": row["tier"].replace("_", " ")} for row in ordered), record)


def skin_table(record: Record) -> str:
    """One line per garment: the skin that shows on average and in the worst view, by how it was draped."""
    lines = []
    for (garment, _, _), rows in _by_method(record["rows"]).items():
        meshes = dict.fromkeys(str(rows[name]["vertices"]) for name in ("network", "fine"))
        shares = (cells(rows[name], SHARES) if name in rows else [] for name in SKIN)
        lines.append([garment, " to ".join(meshes), *map(" / ".join, shares)])
    return table(["garment", "vertices", *SKIN.values()], lines, record)


def fabrics_table(record: Record) -> str:
    """One line per garment and fabric: the gain of the network, its strain and hang beside those of physics."""
    lines = []
    for (garment, kind, fabric), rows in _by_method(record["rows"]).items():
        apart = [f"{rows['network'][key]:{form}} / {rows['physics'][key]:{form}}" for key, form in BESIDE.items()]
        line = [garment, kind, fabric, *cells(rows["network"], GAIN), *cells(rows["network_push"], GAIN), *apart]
        lines.append([*line, *cells(rows["physics"], {"converged_pct": ("", ".0f")})])
    beside = [f"{name}: network / physics" for name in ("edge %", "hem lower than skinned [mm]", "detail [mm]")]
    return table(["garment", "set", "fabric", "gain", "pushed out", *beside, "poses at rest %"], lines, record)


FOUR = {"edge_over_physics_pp": ("", ".2f"), "detail_share": ("", ".2f")}


def four_table(record: Record) -> str:
    """One line per fabric and set of all garments: gains of the network alone and of folds on it."""
    lines = []
    for (_, kind, fabric), rows in _by_method(record["summary"]).items():
        gains = [value for method in ("network", "network_push", "folds") for value in cells(rows[method], GAIN)]
        rest = cells(rows["physics"], {"converged_pct": ("", ".0f")})
        lines.append([fabric, kind, *gains, *cells(rows["folds"], FOUR), *rest])
    heads = ["fabric", "garments", "network", "pushed out", "two steps of folds", "edge over physics [points]"]
    return table([*heads, "detail share", "poses at rest %"], lines, record)


SWING = {
    "garment": ("garment", "s"), "clip": ("clip", "s"), "method": ("method", "s"), "rise_mm": ("hem rises [mm]", ".0f"),
    "share": ("of the simulator's", ".2f"), "error_mm": ("hem off the simulator's [mm]", ".0f"),
    "hem_mm": ("hem off the still drape's [mm]", ".0f"), "ms": ("ms", ".1f"),
}  # fmt: skip


def swing_table(record: Record) -> str:
    """One line per method: how far the hem flies, beside a simulator."""
    return rows_table(SWING, record["rows"])


TABLES = (
    ("quality", "docs/reference/quality.md", "quality", quality_table),
    ("quality", "docs/reference/quality.md", "gain", gain_table),
    ("quality", "docs/reference/quality.md", "quality_network", network_table),
    ("quality_fine", "docs/reference/quality.md", "quality_fine", network_table),
    ("quality_fabrics", "docs/reference/quality.md", "quality_fabrics", fabrics_table),
    ("quality_four", "docs/reference/quality.md", "quality_four", four_table),
    ("swing", "docs/explanation/swing.md", "swing", swing_table),
    ("dynamics", "docs/guide/training.md", "dynamics_stop", stop_table),
    ("dynamics", "docs/guide/training.md", "dynamics_potential", potential_table),
    ("folds", "docs/explanation/folds.md", "folds", folds_table),
    ("tradeoff", "docs/reference/tradeoff.md", "tradeoff", trade_table),
    ("skin_pixels", "docs/explanation/folds.md", "skin", skin_table),
)
