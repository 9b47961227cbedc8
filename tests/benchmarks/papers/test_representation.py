"""The table of representations: its rows are ordered as the forms contain each other, and it refuses nonsense."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmarks.papers import representation
from benchmarks.papers.representation import Bench, drape, frame_spaces
from benchmarks.papers.representation_space import REPRESENTATIONS
from drape.body.assets import load_body
from drape.cloth.material import material
from drape.errors import InputError
from drape.garment.cache import save_garment
from tests.benchmarks.papers.representation_setup import bench, bent, found


@pytest.fixture(scope="module")
def rows() -> dict[str, list[dict]]:
    """Rows by method on the tube. It weighs nothing, as it would slide down without end, and keeps 6 cm from the
    body, so that no form can give it all the room it needs for nothing."""
    wide = replace(material(), gravity_m_s2=0.0, contact_gap_m=0.06, contact_j_m4=3e4)
    asked = "--patches 14 --steps 40 --forms paper rigid_1 rigid_2 --no-physics-cache"
    options = representation.main.parse(asked.split())
    wider = Bench.of(bench().judge.cloth.garment, load_body(), bent(), wide)
    found: dict[str, list[dict]] = {}
    for row in representation.measure(wider, options):
        found.setdefault(row["method"], []).append(row)
    return found


def test_rows_are_ordered_as_forms_contain_each_other(rows):
    # The paper's form is measured at the rule's patch count alone.
    assert list(rows) == ["skinning", "skinning_push", "rigid_1", "rigid_2", "physics", "free"]
    energy = {method: own[-1]["energy_j"] for method, own in rows.items()}
    assert rows["skinning_push"][0]["gain"] == 0.0
    assert rows["free"][0]["gain"] == 1.0
    assert energy["free"] <= min(energy.values())
    assert energy["rigid_2"] < energy["rigid_1"] < 0.1 * energy["skinning_push"]
    assert (rows["rigid_1"][0]["numbers"], rows["rigid_2"][0]["numbers"]) == (21, 27)


def test_the_record_is_written(tmp_path):
    path = save_garment(bench().judge.cloth.garment, tmp_path)
    asked = f"--garments {path} --motions turn --frames 1 --patches 14 --forms rigid_1 --steps 15 --threads 1"
    record = representation.main(f"{asked} --no-physics-cache --out {tmp_path / 'out.json'}".split())
    assert json.loads((tmp_path / "out.json").read_text()) == record
    assert [row["method"] for row in record["rows"]][-2:] == ["physics", "free"]


def test_skinned_forms_gain_on_skinning():
    judge = bench().judge
    start = judge.energies(judge.skinned)["energy_j"]
    for name in ("paper", "paper_turning", "skinned_2"):
        spaces = frame_spaces(bench(), REPRESENTATIONS[name], found())
        drapes = drape(bench(), spaces, step_limit=20)
        assert len(drapes.minima) == len(judge.skinned)
        assert judge.energies(drapes.vertices)["energy_j"] < 0.7 * start


def test_shares_of_the_patch_count_are_positive():
    with pytest.raises(InputError, match="above 0"):
        representation.main(["--patches", "0"])
