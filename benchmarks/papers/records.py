"""The tables that documents show of the papers' repeats; ``TABLES`` as of ``benchmarks.records``."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.tables import Record, markdown_table, provenance, rows_table

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
    named = (
        row | {"form": FORM_NAMES[row["method"]], "energies": f"{row['membrane_j']:.3f} / {row['energy_j']:.3f}"}
        for row in record["rows"]
        if row["method"] in FORM_NAMES
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


MODELS = {
    "gaussian": "Gaussians alone", "families": "the four families", "finetuned": "fine-tuned on garment patches",
    "pca": "principal axes, no network", "adapted": "fine-tuned on the patches measured, as in the paper",
    "mean normal": "mean normal, no network", "best by search": "best frame by search, a bound",
    "pointnet": "PointNet, regresses the jet", "dgcnn": "DGCNN, regresses the jet",
}  # fmt: skip
FIT = {
    "name": ("model", "s"), "height_rmse": ("height RMSE", ".4f"), "height_rmse_p99": ("its p99", ".3f"),
    "normal_deg": ("normals [deg]", ".2f"), "folded_patch_pct": ("fold over %", ".1f"),
    "paper_height": ("paper: height", ".4f"), "paper_normal_deg": ("paper: normals", ".2f"),
}  # fmt: skip
FIT_TIMES = {"ms": ("ms", ".2f"), "paper_ms": ("paper: ms", ".3f")}
GARMENTS = {
    "garment": ("garment", "s"), "point_rmse_m": ("points, RMSE [mm]", ".2f"), "normal_deg": ("normals [deg]", ".2f"),
    "product_rmse_m": ("intake: points [mm]", ".2f"), "product_normal_deg": ("intake: normals [deg]", ".2f"),
    "paper_point_rmse": ("paper: points [mm]", ".2f"), "paper_normal_deg": ("paper: normals [deg]", ".2f"),
}  # fmt: skip
ORDERS = range(1, 7)


def fits_table(record: Record) -> str:
    """Tables 3, 6 and 8 of the paper, and figure 9: how well a jet fits in each frame, in patch radii."""
    parts = []
    for number, title in (
        ("3", "Table 3, what it is trained on"),
        ("6", "Table 6, who chooses the frame"),
        ("8", "Table 8, other encoders; milliseconds of one patch"),
    ):
        named = (row | {"name": MODELS[row["model"]]} for row in _of(record, number))
        parts.append(f"{title}:\n\n{rows_table(FIT | (FIT_TIMES if number == '8' else {}), named)}")
    rows = {(row["model"], row["order"]): row for row in _of(record, "figure 9")}
    lines = [
        [MODELS[model], *(f"{rows[model, order]['height_rmse']:.4f}" for order in ORDERS)]
        for model in dict.fromkeys(model for model, _ in rows)
    ]
    titles = ["height RMSE by order of the jet", *(str(order) for order in ORDERS)]
    return "\n\n".join([*parts, f"Figure 9:\n\n{markdown_table(titles, lines)}", provenance(record)])


def garments_table(record: Record) -> str:
    """Table 7 of the paper: whole garments, in clusters as there and as intake fits them."""
    scaled = ({key: 1e3 * value if "rmse" in key else value for key, value in row.items()} for row in _of(record, "7"))
    return rows_table(GARMENTS, scaled, record)


def _of(record: Record, number: str) -> Sequence[Record]:
    return [row for row in record["rows"] if row["table"] == number]


TABLES = (
    ("representation", "docs/decisions/0008-representation.md", "forms", form_table),
    ("loss_ablation", "docs/studies/losses.md", "loss_ablation", loss_table),
    ("generality", "docs/guide/training.md", "generality", generality_table),
    ("finetuning", "docs/guide/training.md", "finetuning", finetuning_table),
    ("polyfit", "docs/studies/polyfit.md", "polyfit_fits", fits_table),
    ("polyfit", "docs/studies/polyfit.md", "polyfit_garments", garments_table),
)
