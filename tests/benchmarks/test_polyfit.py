"""The tables of benchmarks.polyfit: what is measured means what its column says."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks import polyfit, polyfit_tables
from drape.garment.charts import pca_orient
from drape.garment.fitting import patch_fields, rest_garment
from tests.training.training_setup import tube
from training.polyfit.config import suite
from training.polyfit.families import FAMILIES, Patches, draw_patches
from training.polyfit.fit import turned
from training.polyfit.garment_patches import NamedGarment
from training.polyfit.network import Qstn

TUBE = NamedGarment("tube", tube())
WIDE = NamedGarment("wide", rest_garment(tube().vertices * [2.0, 1.0, 2.0], tube().faces, tube().body))


def patches(count: int = 40) -> Patches:
    return draw_patches(count, 60, families=FAMILIES, seed=(5, 5))


def test_an_untrained_transformer_is_the_canonical_frame():
    first, second = polyfit_tables.evaluate(Qstn().eval(), patches()), polyfit_tables.evaluate(None, patches())
    for key, value in second.items():
        assert_allclose(first[key], value, rtol=1e-3, atol=1e-6)


def test_searching_the_frame_lowers_the_error_and_a_higher_order_does_too():
    base = polyfit_tables.evaluate(None, patches())["height_rmse"]
    assert polyfit_tables.search(patches())["height_rmse"] < base
    assert polyfit_tables.evaluate(None, patches(), order=6)["height_rmse"] < base
    assert polyfit_tables.evaluate(None, patches(), order=2)["height_rmse"] > base


def test_mean_normal_frames_look_along_the_mean_normal():
    own = polyfit_tables.mean_normal_frames(patches())
    mean = own.normals.mean(dim=1)
    assert_allclose((mean / mean.norm(dim=-1, keepdim=True))[:, 2].abs(), 1.0, rtol=0, atol=1e-5)
    lengths = turned(own.points, torch.tensor([[1.0, 0.0, 0.0, 0.0]])).norm(dim=-1)
    assert float(lengths.max()) <= 1.0 + 1e-5


def test_clusters_of_a_smooth_tube_fit_to_a_fraction_of_a_millimetre():
    found = polyfit_tables.cluster_fit(None, TUBE)
    assert 0.0 < found["point_rmse_m"] < 5e-4
    assert 0.0 < found["normal_deg"] < 5.0


def test_chart_figures_see_a_fold():
    fields = patch_fields(tube(), count=12)
    plain = polyfit_tables.chart_figures(tube(), fields)
    mirrored = {**fields, "chart_uv": fields["chart_uv"] * np.array([-1.0, 1.0], dtype=np.float32)}
    assert polyfit_tables.chart_figures(tube(), mirrored)["folded_triangles"] > plain["folded_triangles"]
    assert plain["worst_patch_mm"] >= plain["chart_rmse_mm"]


def test_rows_per_frame_and_density_are_complete():
    rows = polyfit.frames_with_mean(
        polyfit_tables.frame_rows([TUBE], {"mean normal": None, "pca": pca_orient}, seeds=1)
    )
    assert [(row["garment"], row["charts"], row["frame"]) for row in rows] == [
        (garment, charts, frame)
        for garment in ("tube", "all")
        for charts in ("projected", "laid flat")
        for frame in ("mean normal", "pca")
    ]
    assert {k: v for k, v in rows[0].items() if isinstance(v, float)}.items() <= rows[4].items()
    assert all(row["folded_charts"] == 0 for row in rows if row["charts"] == "laid flat")
    rows = polyfit_tables.density_rows([TUBE, WIDE], seeds=1)
    assert [(row["patches"], row["charts"]) for row in rows[:5]] == [
        ("even", "projected"), ("even", "laid flat"), ("by curvature", "projected"),
        ("adaptive", "projected"), ("adaptive", "laid flat"),
    ]  # fmt: skip
    assert rows[0]["worst_ratio"] == rows[1]["worst_ratio_alike"] == 1.0
    assert len({row["patch_count"] for row in rows[:5]}) == 1
    found = polyfit_tables.most_curved(rows)
    assert found["garment"] == "tube"
    assert found["ratio"] == pytest.approx(rows[3]["worst_patch_mm"] / rows[0]["worst_patch_mm"])
    assert found["ratio"] <= 1.0 + 1e-9 or found["adaptive_mm"] < 0.1


def test_curvature_of_a_tube_is_that_of_its_cross_section():
    # An ellipse of half-axes 0.20 and 0.16 m: the root mean square of its curvature, by arc length.
    angle = np.linspace(0.0, 2.0 * np.pi, 4001)
    speed = np.sqrt((0.20 * np.cos(angle)) ** 2 + (0.16 * np.sin(angle)) ** 2)
    wanted = np.sqrt(np.trapezoid((0.20 * 0.16 / speed**3) ** 2 * speed, angle) / np.trapezoid(speed, angle))
    assert_allclose(polyfit_tables.curvature_rms(tube()), wanted, rtol=0.05, atol=0)


def test_every_row_of_the_paper_has_a_network_or_a_garment():
    assert set(PAPER_MODELS) <= {*suite(), "pca"}
    assert set(polyfit.PAPER["7"]) <= {"tshirt", "longsleeve", "tank", "trousers", "shorts", "dress"}


PAPER_MODELS = [name for table in ("3", "6", "8") for name in polyfit.PAPER[table]]


@pytest.mark.slow
def test_picture_and_tables_come_out(tmp_path, capsys):
    rows = polyfit.order_rows(Qstn().eval(), patches(8))
    polyfit.plot_orders(rows, tmp_path / "orders.png", where="nowhere")
    assert (tmp_path / "orders.png").stat().st_size > 1000
    polyfit.print_tables([*rows, *polyfit_tables.density_rows([TUBE], seeds=1)], where="nowhere")
    assert "Figure 9" in capsys.readouterr().out
    json.dumps(rows)
