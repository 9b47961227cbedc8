"""The quality table: what it takes, what it refuses, and that its columns mean what they say."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import quality
from benchmarks.judge import physics
from benchmarks.quality import METHODS
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.errors import InputError, NotFound
from tests.benchmarks.quality_setup import bench


def test_unusable_garments_are_named(tmp_path, monkeypatch):
    (tmp_path / "shirt.obj").write_text("v 0 0 0\n")
    monkeypatch.setattr(quality, "measure", lambda garment, bench, **_: pytest.fail("measured a broken garment"))
    with pytest.raises(InputError, match="at least one usable"):
        quality.main(["--quick", "--garments", str(tmp_path)])


def test_a_garment_without_an_optimum_is_named(monkeypatch):
    monkeypatch.setattr(physics, "LEFT_LIMIT_J_M2", 0.0)  # a good network is nearer to rest than the limit
    asked = "--quick --garments shorts --frames 1 --steps 1 --threads 1 --no-physics-cache"
    with pytest.raises(InputError, match="shorts: expected a physics optimum at rest"):
        quality.main(asked.split())


@pytest.mark.long
def test_the_quick_table_is_ordered_as_physics_demands(tmp_path):
    stored = tmp_path / "quality.json"
    asked = "--quick --garments shorts --threads 1 --no-physics-cache"
    record = quality.main(f"{asked} --out {stored}".split())
    assert json.loads(stored.read_text()) == record
    rows = {row["method"]: row for row in record["rows"]}
    assert tuple(rows) == METHODS
    assert {row["set"] for row in record["rows"]} == {"trained"}
    assert rows["network"]["chart_gap_p99_mm"] > 0.0
    assert record["graph"] == "compiled"  # what is served
    assert record["windows"][0].startswith("reach:")
    assert (record["fabric"], record["passes"]) == (["jersey"] if record["knows_fabrics"] else [], 4)
    assert rows["skinning"]["detail_mm"] > 0.0
    assert rows["physics"]["gain"] == 1.0
    assert rows["skinning_push"]["gain"] == 0.0
    assert rows["physics"]["energy_j"] < rows["skinning_push"]["energy_j"]
    assert rows["physics"]["edge_pct"] < rows["skinning"]["edge_pct"]
    assert rows["skinning_push"]["colliding_vertex_pct"] < 0.1


def test_a_garment_can_be_measured_with_more_patches():
    body = load_body()
    tank = open_garment(find_garments(["tank"])[0], body)
    finer = quality.covered(tank, body, 1.5)
    assert finer.patch_count == pytest.approx(1.5 * tank.patch_count, abs=1)
    assert np.array_equal(finer.vertices, tank.vertices)


def options(*words: str):
    return quality.main.parse(["--quick", *words])


def test_without_fabrics_a_network_that_knows_them_is_measured_in_jersey(tmp_path):
    knowing = bench(tmp_path)
    assert knowing.network.engine.knows_fabrics
    (made,) = quality.in_fabrics(knowing, options())
    assert made.fabric == fabric("jersey")
    assert made.material == Material.of(fabric("jersey"))
    assert quality.in_fabrics(knowing, options("--material", "soft")) == [knowing]


def test_every_fabric_is_measured_once_under_its_own_name(tmp_path):
    with pytest.warns(DeprecationWarning, match="chiffon"):
        made = quality.in_fabrics(bench(tmp_path), options("--fabrics", "rib", "limp", "rib"))
    assert [one.fabric.name for one in made if one.fabric] == ["rib", "chiffon"]


def test_fabrics_that_cannot_be_measured_are_refused(tmp_path):
    with pytest.raises(NotFound, match="fabric: expected one of"):
        quality.in_fabrics(bench(tmp_path), options("--fabrics", "tin"))
    with pytest.raises(InputError, match="--material: expected no --fabrics beside it"):
        quality.in_fabrics(bench(tmp_path), options("--fabrics", "rib", "--material", "soft"))
