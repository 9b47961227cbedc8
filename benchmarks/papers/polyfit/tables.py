"""Tables of ``benchmarks.papers.polyfit`` for the documents, each beside the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.shared.markdown import Record, provenance, rows_table, table

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
TIMES = {"ms": ("ms", ".2f"), "paper_ms": ("paper: ms", ".3f")}
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
        parts.append(f"{title}:\n\n{rows_table(FIT | (TIMES if number == '8' else {}), named)}")
    rows = {(row["model"], row["order"]): row for row in _of(record, "figure 9")}
    lines = [
        [MODELS[model], *(f"{rows[model, order]['height_rmse']:.4f}" for order in ORDERS)]
        for model in dict.fromkeys(model for model, _ in rows)
    ]
    titles = ["height RMSE by order of the jet", *(str(order) for order in ORDERS)]
    return "\n\n".join([*parts, f"Figure 9:\n\n{table(titles, lines)}", provenance(record)])


def garments_table(record: Record) -> str:
    """Table 7 of the paper: whole garments, in clusters as there and as intake fits them."""
    scaled = ({key: 1e3 * value if "rmse" in key else value for key, value in row.items()} for row in _of(record, "7"))
    return rows_table(GARMENTS, scaled, record)


def _of(record: Record, number: str) -> Sequence[Record]:
    return [row for row in record["rows"] if row["table"] == number]


TABLES = (
    ("polyfit", "docs/studies/polyfit.md", "polyfit_fits", fits_table),
    ("polyfit", "docs/studies/polyfit.md", "polyfit_garments", garments_table),
)
