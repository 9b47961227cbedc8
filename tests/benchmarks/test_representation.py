"""The table of representations: its rows are ordered as the forms contain each other, and it refuses nonsense."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmarks import representation
from benchmarks.representation_agree import gain_at_gap
from benchmarks.representation_drape import drape, frame_spaces, total_j
from benchmarks.representation_plot import plot
from benchmarks.representation_space import REPRESENTATIONS
from drape.body.assets import load_body
from drape.cloth.material import material
from drape.errors import InputError
from drape.garment.cache import save_garment
from tests.benchmarks.representation_setup import bench, bent, found


@pytest.fixture(scope="module")
def rows() -> dict[str, list[dict]]:
    """Rows by method on the tube. It weighs nothing, as it would slide down without end, and keeps 6 cm from the
    body, so that no form can give it all the room it needs for nothing."""
    wide = replace(material(), gravity_m_s2=0.0, contact_gap_m=0.06, contact_j_m4=3e4)
    asked = "--patches 14 --agree-at 14 --agree 4e5 4e3 --steps 40 --forms paper rigid_1 rigid_2"
    options = representation.parse(asked.split())
    options.body, options.poses, options.physics_folder, options.network = load_body(), bent(), None, None
    found: dict[str, list[dict]] = {}
    for row in representation.measure(replace(bench(), material=wide), options):
        found.setdefault(row["method"], []).append(row)
    return found


def test_rows_are_ordered_as_forms_contain_each_other(rows):
    # The paper's form is measured at the rule's patch count alone.
    by_agreement = ["refit", "agreeing", "agreeing_refit", "through"]
    assert list(rows) == ["skinning", "skinning_push", "rigid_1", "rigid_2", *by_agreement, "physics", "free"]
    energy = {method: own[-1]["energy_j"] for method, own in rows.items()}
    assert rows["skinning_push"][0]["gain"] == 0.0
    assert rows["free"][0]["gain"] == 1.0
    assert energy["free"] <= min(energy.values())
    assert energy["rigid_2"] < energy["rigid_1"] < 0.1 * energy["skinning_push"]
    assert (rows["rigid_1"][0]["numbers"], rows["rigid_2"][0]["numbers"]) == (21, 27)


def test_a_heavier_penalty_closes_gaps_and_costs_energy(rows):
    (freely,), (light, heavy) = rows["rigid_2"], rows["agreeing"]
    assert (light["disagreement_weight"], heavy["disagreement_weight"]) == (4e3, 4e5)
    assert heavy["chart_gap_p99_mm"] < light["chart_gap_p99_mm"] < freely["chart_gap_p99_mm"]
    assert heavy["chart_gap_rms_mm"] < light["chart_gap_rms_mm"] < freely["chart_gap_rms_mm"]
    assert light["energy_j"] < heavy["energy_j"]


def test_consensus_has_its_rows(rows):
    (freely,), (flat, full, more) = rows["rigid_2"], rows["refit"]
    assert [(row["numbers"], row["refits"]) for row in (flat, full, more)] == [(27, 1), (45, 1), (45, 3)]
    gaps = [row["chart_gap_rms_mm"] for row in (more, full, flat, freely)]
    assert gaps == sorted(gaps)
    assert [row["disagreement_weight"] for row in rows["through"]] == [0.0, 0.0, 4e3, 4e5]
    assert [row["numbers"] for row in rows["through"]] == [27, 45, 45, 45]
    assert rows["through"][-1]["chart_gap_rms_mm"] < rows["through"][1]["chart_gap_rms_mm"]
    assert [row["disagreement_weight"] for row in rows["agreeing_refit"]] == 3 * [4e3]


def test_record_and_picture_are_written(tmp_path):
    path = save_garment(bench().garment, tmp_path)
    asked = f"--garments {path} --motions turn --frames 1 --patches 14 --agree-at 14 --forms rigid_1 --agree 4e3"
    written = f"--no-physics-cache --model none --out {tmp_path / 'out.json'} --plot {tmp_path / 'plot.png'}"
    record = representation.main(f"{asked} --steps 15 --threads 1 {written}".split())
    stored = json.loads((tmp_path / "out.json").read_text())
    assert stored == record
    assert [row["method"] for row in record["rows"]][-2:] == ["physics", "free"]
    assert {entry["means"] for entry in record["agreement"]} == {"consensus"}  # one penalty alone is no curve
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"


def test_agreement_is_read_off_for_every_garment_and_patch_count():
    rows = [
        {"garment": "a", "percent": 100, "method": method, "chart_gap_p99_mm": gap, "gain": gain}
        for method, gap, gain in (("rigid_2", 32.0, 0.9), ("agreeing", 8.0, 0.7), ("agreeing", 3.5, 0.5))
    ] + [{"garment": "a", "method": "free", "gain": 1.0}]
    rows += [
        {"garment": "a", "percent": 100, "method": "through", "numbers": n, "chart_gap_p99_mm": gap, "gain": gain}
        for n, gap, gain in ((27, 2.0, 0.0), (45, 9.0, 0.95), (45, 1.0, 0.85))
    ]
    by_gap = {(entry["means"], entry["gap_mm"]): entry["gain"] for entry in representation.agreement(rows)}
    assert by_gap["penalty", 2.0] is None
    assert 0.5 < by_gap["penalty", 4.0] < 0.7 < by_gap["penalty", 10.0] < 0.9
    assert by_gap["consensus", 3.0] == pytest.approx(0.9)
    assert by_gap["consensus", 10.0] is None


def test_skinned_forms_gain_on_skinning():
    start = total_j(bench(), bench().skinned)
    for name in ("paper", "paper_turning", "skinned_2"):
        spaces = frame_spaces(bench(), REPRESENTATIONS[name], found())
        drapes = drape(bench(), spaces, step_limit=20)
        assert len(drapes.minima) == bench().frame_count
        assert total_j(bench(), drapes.vertices) < 0.7 * start


def test_gain_at_a_gap_is_read_off_the_curve():
    curve = [(1.0, 0.2), (16.0, 1.0), (4.0, 0.6)]
    assert gain_at_gap(curve, 2.0) == pytest.approx(0.4)
    assert gain_at_gap(curve, 16.0) == pytest.approx(1.0)
    assert gain_at_gap(curve, 0.5) is None
    assert gain_at_gap([], 1.0) is None


def test_shares_of_the_patch_count_are_positive():
    with pytest.raises(InputError, match="above 0"):
        representation.parse(["--patches", "0"])


def test_rounds_of_consensus_are_positive():
    with pytest.raises(InputError, match="1 or more"):
        representation.parse(["--rounds", "0"])


def test_the_sharpness_of_the_blend_is_positive():
    with pytest.raises(InputError, match="above 0"):
        representation.parse(["--sharpness", "0"])


def test_the_quick_form_is_small_and_yields_to_options():
    quick = representation.parse(["--quick"])
    assert (quick.garments, quick.frames, quick.patches, quick.agree) == (["tshirt"], 1, [100], [])
    full = representation.parse([])
    assert (full.garments, full.frames, full.forms) == (list(representation.GARMENTS), 2, list(REPRESENTATIONS))
    assert representation.parse(["--quick", "--steps", "7"]).steps == 7


def test_a_picture_without_some_forms_is_drawn(tmp_path):
    rows = [{"garment": "a", "method": "rigid_2", "patches": 10, "numbers": 27, "gain": 1.0}]
    plot(rows, tmp_path / "new" / "plot.png")
    assert (tmp_path / "new" / "plot.png").stat().st_size > 1000
