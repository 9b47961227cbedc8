"""Tables of the records of this package's repeats of the papers' tables."""

from __future__ import annotations

from benchmarks.shared.markdown import Record, rows_table

FORM_NAMES = {
    "skinning": "skinning", "skinning_push": "skinning + nearest-vertex push",
    "paper": "paper: height jet, translation, scale; vertices skinned", "paper_turning": "+ free rotation",
    "skinned_2": "in-plane order 2, vertices skinned", "rigid_1": "in-plane order 1, frames skinned rigidly",
    "rigid_2": "in-plane order 2, frames skinned rigidly", "rigid_3": "in-plane order 3, frames skinned rigidly",
    "physics": "physics optimum of benchmarks.quality", "free": "every vertex free",
}  # fmt: skip
LOSS_NAMES = {
    "skinning": "skinning", "skinning_push": "skinning + nearest-vertex push", "paper": "equation 10, all terms",
    "no_collision": "without collision (L_col)", "no_metric": "without metric (L_inext)",
    "no_edges": "without edges (L_mesh_inext)", "no_boundary": "without boundary", "no_gravity": "without gravity",
    "house": "energy of training.run", "house_metric": "energy + metric",
    "house_jet_bending": "energy, bending from jets",
}  # fmt: skip
FORMS = {
    "garment": ("garment", "s"), "patches": ("patches", "d"), "numbers": ("numbers each", "d"), "form": ("form", "s"),
    "energies": ("membrane / total [J]", "s"), "edge_pct": ("edge %", ".2f"), "area_pct": ("area %", ".2f"),
    "colliding_vertex_pct": ("colliding %", ".2f"), "gain": ("gain", ".3f"),
}  # fmt: skip
LOSSES = {
    "name": ("loss", "s"), "edge_pct": ("edge %", ".2f"), "area_pct": ("area %", ".2f"),
    "colliding_vertex_pct": ("colliding %", ".3f"), "published_edge_pct": ("OneFit: edge %", ".1f"),
    "published_area_pct": ("area %", ".1f"), "published_colliding_pct": ("colliding %", ".3f"),
    "membrane_j": ("membrane [J]", ".3f"), "bending_j": ("bending [J]", ".4f"), "contact_j": ("contact [J]", ".4f"),
    "chart_gap_p99_mm": ("gap p99 [mm]", ".1f"), "chart_normal_p99_deg": ("normals p99 [deg]", ".0f"),
}  # fmt: skip
VARIETY = {
    "run": ("trained on", "s"), "garments": ("garments", ","), "partitions": ("partitions", ","),
    "steps": ("steps", ","), "mean_seen": ("mean, seen", ".2f"), "mean_unseen": ("mean, unseen", ".2f"),
}  # fmt: skip
FINETUNING = {
    "garment": ("garment", "s"), "network": ("network", "s"), "steps": ("steps", ","), "minutes": ("minutes", ".1f"),
    "edge_pct": ("edge %", ".2f"), "area_pct": ("area %", ".2f"), "colliding_vertex_pct": ("colliding %", ".2f"),
    "energy_j": ("energy [J]", ".3f"), "gain": ("gain", ".3f"),
}  # fmt: skip


def form_table(record: Record) -> str:
    """Every form of patch, one line per garment and patch count."""
    rows = [row for row in record["rows"] if row["method"] in FORM_NAMES]
    named = (
        row | {"form": FORM_NAMES[row["method"]], "energies": f"{row['membrane_j']:.3f} / {row['energy_j']:.3f}"}
        for row in rows
    )
    return rows_table(FORMS, named, record)


def loss_table(record: Record) -> str:
    """OneFit's table 4: one line per set of losses, the published figures beside."""
    return rows_table(LOSSES, (row | {"name": LOSS_NAMES[row["loss"]]} for row in record["rows"]), record)


def generality_table(record: Record) -> str:
    """OneFit's table 1 and figures 5 and 6: what a run was trained on, and its gain on every garment."""
    rows = record["rows"]
    columns = {key: column for key, column in VARIETY.items() if key in rows[0]}
    gains = {key: (key.removeprefix("gain_"), ".2f") for key in rows[0] if key.startswith("gain_")}
    return rows_table(columns | gains, rows, record)


def finetuning_table(record: Record) -> str:
    """OneFit's table 2: one line per garment and network."""
    return rows_table(FINETUNING, (row | {"minutes": row["train_s"] / 60.0} for row in record["rows"]), record)


TABLES = (
    ("representation", "docs/decisions/0008-representation.md", "forms", form_table),
    ("loss_ablation", "docs/studies/losses.md", "loss_ablation", loss_table),
    ("generality", "docs/guide/training.md", "generality", generality_table),
    ("finetuning", "docs/guide/training.md", "finetuning", finetuning_table),
)
