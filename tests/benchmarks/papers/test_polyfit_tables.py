"""The tables of benchmarks.papers.polyfit: what is measured means what its column says."""

from __future__ import annotations

import json

import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.papers.polyfit import __main__ as polyfit
from benchmarks.papers.polyfit import measures as polyfit_tables
from benchmarks.papers.polyfit.families import FAMILIES, Patches, draw_patches
from benchmarks.papers.polyfit.fit import turned
from benchmarks.papers.polyfit.garment_patches import NamedGarment
from benchmarks.papers.polyfit.network import Qstn
from benchmarks.papers.polyfit.train import suite
from tests.training.training_setup import tube

TUBE = NamedGarment("tube", tube())


def patches(count: int = 40) -> Patches:
    return draw_patches(count, 60, families=FAMILIES, seed=(5, 5))


def test_a_higher_order_lowers_the_error():
    low, base, high = (polyfit_tables.evaluate(None, patches(), order=n)["height_rmse"] for n in (2, 4, 6))
    assert low > base > high


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


def test_every_row_of_the_paper_has_a_network_or_a_garment():
    assert set(PAPER_MODELS) <= {*suite(), "pca"}
    assert set(polyfit.PAPER["7"]) <= {"tshirt", "longsleeve", "tank", "trousers", "shorts", "dress"}


PAPER_MODELS = [name for table in ("3", "6", "8") for name in polyfit.PAPER[table]]


@pytest.mark.slow
def test_tables_come_out():
    rows = polyfit.order_rows(Qstn().eval(), patches(8))
    assert any("Figure 9" in text and "finetuned" in text for text in polyfit.table_texts(rows, where="nowhere"))
    json.dumps(rows)
