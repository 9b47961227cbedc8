"""The benchmark of the knobs beside the tiers: what lies between two frames, and every way on the real road."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks import folds
from benchmarks.measure.tables import other_knobs_table
from benchmarks.other_knobs import WAYS, Way, between, draped_frames, measure, with_patches
from benchmarks.shared.network import Network
from benchmarks.tradeoff import Case
from drape.body.model import BodyModel
from drape.catalog import find_motions
from drape.cloth.fabric_table import fabric
from drape.garment.fine import fine_garment
from service.compute.drape_runtime import Drapery
from tests.drape.garment.garment_files import obj_text, shirt
from tests.fixtures.serving import make_settings, tiny_folder
from tests.fixtures.tiny_model import TINY, tube_garment

__all__ = ["make_settings", "tiny_folder"]  # fixtures
FRAMES = 5


def test_frames_between_are_on_lines_and_draped_ones_are_kept():
    assert_array_equal(draped_frames(6, 2), [0, 2, 4, 5])
    assert_array_equal(draped_frames(5, 4), [0, 4])
    assert_array_equal(draped_frames(3, 1), [0, 1, 2])
    vertices = np.array([0.0, 99.0, 4.0, 99.0, 2.0, 7.0])[:, None, None] * np.ones((2, 3))
    got = between(vertices.astype(np.float32), draped_frames(6, 2))
    assert got.dtype == np.float32
    assert_allclose(got[:, 0, 0], [0.0, 2.0, 4.0, 3.0, 2.0, 7.0])
    assert_array_equal(between(vertices, np.arange(6)), vertices)


@pytest.fixture(scope="module")
def rows(body: BodyModel, tiny_folder: Path, make_settings) -> dict[str, dict[str, Any]]:
    """Of a garment that is delivered coarse; a second one stands for it with twice its patches."""
    coarse, other = (tube_garment(body, name=name, subdivided=True) for name in ("coarse", "again"))
    networks = {
        name: Network(tiny_folder / "models" / TINY, body, threads=1, passes=passes)
        for name, passes in (("network_0", 0), ("network_all", None))
    }
    clip = folds.Clip.read(find_motions(["walk"])[0], 30.0, FRAMES, body)
    case = Case.of(fine_garment(coarse), fabric("jersey"), clip, body, networks)
    drapery = Drapery(make_settings(folds=None))
    found = measure(case, {1.0: coarse, 2.0: other}, {"int8": drapery, "float32": drapery, "float16": drapery})
    drapery.close()
    return {row["way"]: row for row in found}


def test_every_way_is_measured_beside_what_is_served(rows: dict[str, dict[str, Any]]):
    served, *others = (way.name for way in WAYS if way.patches != 0.75)
    assert list(rows) == [served, *others], "a number of patches that there is not is left out"
    assert rows[served]["cost"] == 1.0 and rows[served]["jitter_ratio"] == 1.0 and rows[served]["gain"] > 0.0
    for row in rows.values():
        assert row["ms"] > 0.0 and row["error_mm"] > 0.0
    same = {key: value for key, value in rows[served].items() if key not in ("way", "ms", "cost")}
    for name in ("network in float32", "twice the patches"):  # of the tiny network the same
        assert {key: rows[name][key] for key in same} == pytest.approx(same, nan_ok=True), name


def test_bytes_and_places_are_those_of_the_message(rows: dict[str, dict[str, Any]]):
    served, delivered = rows[WAYS[0].name], rows["sent as delivered"]
    for name, share in (
        ("coordinates of 8 bits", 0.5),
        ("15 a second, lines between", 0.5),
        ("sent as delivered", 0.3),
    ):
        assert rows[name]["kbytes"] < (share + 0.05) * served["kbytes"], name
    assert rows["7.5 a second, lines between"]["kbytes"] == pytest.approx(0.25 * served["kbytes"])
    assert abs(rows["coordinates of 8 bits"]["error_mm"] - served["error_mm"]) > 1e-4, "they are rounded"
    assert "gain" not in delivered and delivered["error_mm"] == pytest.approx(served["error_mm"], rel=0.5)
    table = other_knobs_table({"rows": list(rows.values()), "machine": "here", "commit": "c", "command": "x"})
    assert "| sent as delivered |" in table and "| - |" in table


def test_a_mesh_is_taken_in_with_other_numbers_of_patches_and_a_cached_garment_is_not(
    body: BodyModel, tiny_folder: Path, tmp_path: Path
):
    (cached,) = (tiny_folder / "shipped").glob("*.npz")
    assert list(with_patches(cached, body)) == [1.0]
    (tmp_path / "shirt.obj").write_bytes(obj_text(*shirt(body, body.v_template)))
    found = with_patches(tmp_path / "shirt.obj", body, [WAYS[0], Way("more", patches=2.0)])
    assert found[2.0].patch_count > 1.5 * found[1.0].patch_count
    assert_array_equal(found[1.0].vertices, found[2.0].vertices)
