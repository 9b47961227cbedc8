"""Tables of PolyFit: every row in its table, with its numbers and the paper's."""

from __future__ import annotations

from benchmarks import polyfit_report

FIT = {"height_rmse": 0.0055, "height_rmse_p99": 0.05, "normal_deg": 2.0, "folded_patch_pct": 3.5}
ERRORS = {
    "chart_rmse_mm": 2.0, "worst_patch_mm": 10.0, "point_rmse_mm": 1.5, "normal_deg": 6.0, "folded_triangles": 12.0,
    "folded_charts": 3.0, "worst_ratio": 0.5, "patch_count": 105.0,
}  # fmt: skip
RECORD = {
    "rows": [
        {"table": "3", "model": "gaussian", **FIT, "paper_height": 0.0248, "paper_normal_deg": 5.485},
        {"table": "6", "model": "mean normal", **FIT},
        {"table": "8", "model": "dgcnn", **FIT, "ms": 1.75, "paper_height": 0.029, "paper_ms": 0.0625},
        *({"table": "figure 9", "model": "pca", "order": order, **FIT} for order in range(1, 7)),
        {"table": "7", "garment": "cape", "point_rmse_m": 0.00025, "normal_deg": 1.0, "product_rmse_m": 0.0005,
         "product_normal_deg": 2.0, "paper_point_rmse": 0.000125, "paper_normal_deg": 1.834},
        {"table": "frames", "garment": "cape", "charts": "projected", "frame": "pca", **ERRORS},
        {"table": "frames", "garment": "all", "charts": "laid flat", "frame": "qstn", **ERRORS},
        {"table": "density", "garment": "cape", "patches": "even", "charts": "projected", **ERRORS},
        {"table": "density", "garment": "shawl", "patches": "adaptive", "charts": "projected", **ERRORS},
    ],
    "most_curved": {"garment": "shawl"}, "machine": "a machine", "commit": "abc", "command": "python -m benchmarks.x",
}  # fmt: skip


def test_fits_stand_beside_the_papers():
    text = polyfit_report.fits_table(RECORD)
    assert "| Gaussians alone | 0.0055 | 0.050 | 2.00 | 3.5 | 0.0248 | 5.49 |" in text
    assert "| mean normal, no network | 0.0055 | 0.050 | 2.00 | 3.5 | - | - |" in text
    assert "| DGCNN, regresses the jet | 0.0055 | 0.050 | 2.00 | 3.5 | 0.0290 | - | 1.75 | 0.062 |" in text
    assert "| principal axes, no network |" + " 0.0055 |" * 6 in text
    assert text.endswith("Measured on a machine, commit abc: `python -m benchmarks.x`.")


def test_whole_garments_are_in_millimetres():
    assert "| cape | 0.25 | 1.00 | 0.50 | 2.00 | 0.12 | 1.83 |" in polyfit_report.garments_table(RECORD)


def test_frames_are_means_and_densities_are_those_of_the_most_curved_garment():
    frames, density = polyfit_report.frames_table(RECORD), polyfit_report.density_table(RECORD)
    assert "| laid flat | qstn | 2.00 | 10.0 | 1.50 | 6.00 | 12 | 3 |" in frames and "projected" not in frames
    assert density.startswith("`shawl`, 105 patches:")
    assert "| adaptive | projected | 2.00 | 10.0 | 1.50 | 6.00 | 12 | 3 | 0.50 |" in density and "even |" not in density
