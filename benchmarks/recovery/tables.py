"""Tables of recoveries: from an independent simulator, beside table 2 of Yu, Cordier and Seo (2024), and by round."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.shared.markdown import Record, cells, heads, table


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
    "mean_mm": ("mean distance [mm]", ".1f"),
    "truth_chamfer_cm2": ("true pattern in our simulator [cm²]", ".3f"),
    "graded_turning_deg": ("graded: turning", ".1f"),
    "graded_area_err": ("graded: areas", ".3f"),
    "minutes": ("minutes", ".1f"),
}


def ahead(row: Record) -> int:
    """In how many of the four measures ``row`` is at or below the paper."""
    return sum(row[name] <= getattr(TABLE_2[row["garment"]], name) for name in MEASURES)


def targets_table(record: Record) -> str:
    """Every recovery, "ours / theirs", in bold where it is at or ahead of the paper."""
    lines = []
    for row in record["rows"]:
        pairs = []
        for name, form in MEASURES.items():
            theirs = getattr(TABLE_2[row["garment"]], name)
            ours = format(row[name], form)
            pairs.append(f"{f'**{ours}**' if row[name] <= theirs else ours} / {theirs:g}")
        lines.append([f"{row['garment']}, {row['seed']}", *pairs, f"{ahead(row)} of 4", *cells(row, MORE)])
    titles = ["target, base", "Chamfer [cm²]", "normals", "turning [deg]", "areas", "ahead in", *heads(MORE)]
    return table(titles, lines, record)


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


def rounds_table(record: Record) -> str:
    """A line for every round of every recovery, and one for its whole time."""
    lines = []
    for row in record["rows"]:
        name = f"{row['garment']}, {row['seed']}"
        lines.append([f"{name}: graded twice", *cells({"mean_mm": row["graded_mm"]}, ROUNDS)])
        for one in record["by_round"]:
            if (one["garment"], one["seed"]) == (row["garment"], row["seed"]):
                lines.append([f"{name}: round {one['round']}", *cells(one, ROUNDS)])
        whole = {key: row[key] for key in ("minutes", "processor_minutes")}
        lines.append([f"{name}: **whole**", *cells(whole, ROUNDS)])
    return table(["target, base", *heads(ROUNDS)], lines, record)


TABLES = (
    ("recovery_targets", "docs/explanation/recovery_fit.md", "recovery_targets", targets_table),
    ("recovery_rounds", "docs/explanation/recovery_fit.md", "recovery_rounds", rounds_table),
)
