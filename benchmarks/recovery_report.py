"""Tables of ``recovery_targets``, beside table 2 of Yu, Cordier and Seo (2024), and of ``recovery_rivals``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.common import cells, markdown_table, provenance


@dataclass(frozen=True)
class Published:
    """A row of table 2: the paper's own method. Chamfer distance read as cm^2, turning as degrees (decision 0004)."""

    chamfer_cm2: float
    normal: float
    turning_deg: float
    area_err: float


TABLE_2 = {
    "tee": Published(0.112, 0.049, 9.53, 0.09),
    "dress": Published(0.110, 0.075, 10.96, 0.10),
    "shorts": Published(0.126, 0.043, 7.37, 0.04),
    "pants": Published(0.142, 0.049, 7.12, 0.08),
    "skirt": Published(0.106, 0.014, 3.99, 0.04),
}
MEASURES = {"chamfer_cm2": ".3f", "normal": ".3f", "turning_deg": ".2f", "area_err": ".3f"}
MORE = {
    "mean_mm": ".1f",
    "truth_chamfer_cm2": ".3f",
    "graded_turning_deg": ".1f",
    "graded_area_err": ".3f",
    "minutes": ".1f",
}


def ahead(row: dict[str, Any]) -> int:
    """In how many of the four measures ``row`` is at or below the paper."""
    return sum(row[name] <= getattr(TABLE_2[row["garment"]], name) for name in MEASURES)


def table(record: dict[str, Any]) -> str:
    """Every recovery, "ours / theirs", in bold where it is at or ahead of the paper."""
    heads = ["target, base", "Chamfer [cm²]", "normals", "turning [deg]", "areas", "ahead in", "mean distance [mm]"]
    heads += ["true pattern in our simulator [cm²]", "graded: turning", "graded: areas", "minutes"]
    lines = []
    for row in record["rows"]:
        pairs = []
        for name, form in MEASURES.items():
            theirs = getattr(TABLE_2[row["garment"]], name)
            ours = format(row[name], form)
            pairs.append(f"{f'**{ours}**' if row[name] <= theirs else ours} / {theirs:g}")
        lines.append([f"{row['garment']}, {row['seed']}", *pairs, f"{ahead(row)} of 4", *cells(row, MORE)])
    return f"{markdown_table(heads, lines)}\n\n{provenance(record)}"


RIVALS = {
    "controls_mm": ("control points [mm]", ".2f"),
    "controls_max_mm": ("largest", ".2f"),
    "areas_pct": ("areas [%]", ".2f"),
    "border_mm": ("outlines [mm]", ".2f"),
    "turning_deg": ("turning [deg]", ".2f"),
    "surface_mm": ("surfaces apart [mm]", ".2f"),
    "minutes": ("minutes", ".2f"),
    "restarts": ("drapes from flat panels", "d"),
    "drapes": ("drapes from a shape nearby", "d"),
}
RIVAL_NAMES = {
    "lscm": "flattened by LSCM",
    "arap": "flattened by ARAP",
    "base": "base",
    "graded": "graded twice",
    "recovered": "**recovered**",
    "cma": "CMA-ES, our time",
    "cma, 4 times": "CMA-ES, four times our time",
}


def rivals_table(record: dict[str, Any]) -> str:
    """A line for every garment and method, the values of the bases one after the other."""
    lines = []
    for garment, method in dict.fromkeys((row["garment"], row["method"]) for row in record["rows"]):
        rows = [row for row in record["rows"] if (row["garment"], row["method"]) == (garment, method)]
        found = [cells(row, {name: form for name, (_, form) in RIVALS.items()}) for row in rows]
        values = [" / ".join(cell) if set(cell) != {"-"} else "-" for cell in zip(*found, strict=True)]
        lines.append([garment, RIVAL_NAMES[method], *values])
    heads = ["target", "", *(head for head, _ in RIVALS.values())]
    return f"{markdown_table(heads, lines)}\n\n{provenance(record)}"


ROUNDS = {
    "nodes": ("nodes", "d"),
    "mean_mm": ("control points: mean [mm]", ".2f"),
    "max_mm": ("largest [mm]", ".2f"),
    "area_err": ("areas [%]", ".2f"),
    "surface_mm": ("surfaces apart [mm]", ".2f"),
    "steps": ("steps", "d"),
    "drapes": ("drapes", "d"),
    "minutes": ("minutes", ".2f"),
    "processor_minutes": ("of the processor", ".2f"),
}


def rounds_table(record: dict[str, Any]) -> str:
    """A line for every round of every recovery, and one for its whole time."""
    lines = []
    for row in record["rows"]:
        name = f"{row['garment']}, {row['seed']}"
        start = {"mean_mm": row["graded_mm"]}
        lines.append([f"{name}: graded twice", *cells(start, {key: form for key, (_, form) in ROUNDS.items()})])
        for one in record["by_round"]:
            if (one["garment"], one["seed"]) == (row["garment"], row["seed"]):
                own = cells(one, {key: form for key, (_, form) in ROUNDS.items()})
                lines.append([f"{name}: round {one['round']}", *own])
        whole = {"minutes": row["minutes"], "processor_minutes": row["processor_minutes"]}
        lines.append([f"{name}: **whole**", *cells(whole, {key: form for key, (_, form) in ROUNDS.items()})])
    heads = ["target, base", *(head for head, _ in ROUNDS.values())]
    return f"{markdown_table(heads, lines)}\n\n{provenance(record)}"
