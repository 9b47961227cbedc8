"""Tables of ``benchmarks.polyfit`` for the documents, each beside the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.common import cells, markdown_table, provenance

Record = dict[str, Any]

MODELS = {
    "gaussian": "Gaussians alone",
    "families": "the four families",
    "finetuned": "fine-tuned on garment patches",
    "pca": "principal axes, no network",
    "adapted": "fine-tuned on the patches measured, as in the paper",
    "mean normal": "mean normal, no network",
    "best by search": "best frame by search, a bound",
    "pointnet": "PointNet, regresses the jet",
    "dgcnn": "DGCNN, regresses the jet",
}
FIT = {"height_rmse": ".4f", "height_rmse_p99": ".3f", "normal_deg": ".2f", "folded_patch_pct": ".1f"}
PAPER = {"paper_height": ".4f", "paper_normal_deg": ".2f"}
FIT_HEADS = ("height RMSE", "its p99", "normals [deg]", "fold over %", "paper: height", "paper: normals")
ERRORS = {
    "chart_rmse_mm": ".2f", "worst_patch_mm": ".1f", "point_rmse_mm": ".2f", "normal_deg": ".2f",
    "folded_triangles": ".0f", "folded_charts": ".0f",
}  # fmt: skip
ERROR_HEADS = (
    *("charts, RMSE [mm]", "worst patch [mm]", "blended, RMSE [mm]", "normals [deg]"),
    *("triangles folded", "charts folded"),
)
ORDERS = range(1, 7)


def fits_table(record: Record) -> str:
    """Tables 3, 6 and 8 of the paper, and figure 9: how well a jet fits in each frame, in patch radii."""
    parts = []
    for table, title in (
        ("3", "Table 3, what it is trained on"),
        ("6", "Table 6, who chooses the frame"),
        ("8", "Table 8, other encoders; milliseconds of one patch"),
    ):
        timed = table == "8"
        heads = ("model", *FIT_HEADS, *(("ms", "paper: ms") if timed else ()))
        forms = FIT | PAPER | ({"ms": ".2f", "paper_ms": ".3f"} if timed else {})
        lines = [[MODELS[row["model"]], *cells(row, forms)] for row in _of(record, table)]
        parts.append(f"{title}:\n\n{markdown_table(heads, lines)}")
    rows = {(row["model"], row["order"]): row for row in _of(record, "figure 9")}
    lines = [
        [MODELS[model], *(f"{rows[model, order]['height_rmse']:.4f}" for order in ORDERS)]
        for model in dict.fromkeys(model for model, _ in rows)
    ]
    heads = ("height RMSE by order of the jet", *(str(order) for order in ORDERS))
    parts.append(f"Figure 9:\n\n{markdown_table(heads, lines)}")
    return "\n\n".join([*parts, provenance(record)])


def garments_table(record: Record) -> str:
    """Table 7 of the paper: whole garments, in clusters as there and as intake fits them."""
    heads = (
        *("garment", "points, RMSE [mm]", "normals [deg]", "intake: points [mm]", "intake: normals [deg]"),
        *("paper: points [mm]", "paper: normals [deg]"),
    )
    keys = (
        "point_rmse_m",
        "normal_deg",
        "product_rmse_m",
        "product_normal_deg",
        "paper_point_rmse",
        "paper_normal_deg",
    )
    lines = []
    for row in _of(record, "7"):
        shown = {key: 1e3 * row[key] if "rmse" in key else row[key] for key in keys}
        lines.append([row["garment"], *cells(shown, dict.fromkeys(keys, ".2f"))])
    return f"{markdown_table(heads, lines)}\n\n{provenance(record)}"


def frames_table(record: Record) -> str:
    """The product's charts on garments never seen, by who chooses the frame; means of all."""
    rows = [row for row in _of(record, "frames") if row["garment"] == "all"]
    lines = [[row["charts"], row["frame"], *cells(row, ERRORS)] for row in rows]
    return markdown_table(("charts", "frame", *ERROR_HEADS), lines)


def density_table(record: Record) -> str:
    """The garment of most curvature by where its patches are small, at equal count."""
    garment = record["most_curved"]["garment"]
    forms = ERRORS | {"worst_ratio": ".2f"}
    rows = [row for row in _of(record, "density") if row["garment"] == garment]
    lines = [[row["patches"], row["charts"], *cells(row, forms)] for row in rows]
    heads = ("patches", "charts", *ERROR_HEADS, "worst patch over that of even ones, projected")
    return (
        f"`{garment}`, {rows[0]['patch_count']:.0f} patches:\n\n{markdown_table(heads, lines)}\n\n{provenance(record)}"
    )


def _of(record: Record, table: str) -> Sequence[Record]:
    return [row for row in record["rows"] if row["table"] == table]
