"""The referee's table: its rows, what another method's record adds, and that stored optima say so."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks import referee
from benchmarks.judge import physics
from benchmarks.shared.render import PLAIN_CLOTH
from drape.cloth.fabric_table import fabric
from tests.benchmarks.quality_setup import bench, tube


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    made = bench(tmp_path_factory.mktemp("optima"))
    return referee.Scene(
        made.body, made.poses, made.contact, made.body_vertices, made.network, physics.STEPS, made.physics_folder
    )


def test_a_row_says_how_near_to_rest_a_pose_came_and_what_it_took(scene):
    one, vertices = referee.measure(tube(), None, scene)
    rows = [*one, *referee.measure(tube(), fabric("rib"), scene)[0]]
    assert [(row["fabric"], row["pose"]) for row in rows] == [(n, p) for n in ("", "rib") for p in ("bend:1", "bend:2")]
    for row in rows:
        assert row["energy_j"] <= row["start_j"]
        assert row["at_rest"] == (row["force_left_share"] <= physics.TOLERANCE)
        assert 0 <= row["steps"] <= physics.STEPS  # none where it settled to rest
        assert row["processor_s"] > 0.0
        assert not row["cached"]
    again, stored = referee.measure(tube(), None, scene)
    assert again == [row | {"cached": True} for row in rows[:2]]
    assert_array_equal(stored, vertices)
    drawn = referee.picture(tube(), vertices, scene)
    assert drawn.shape == (*referee.SIZE, 3)
    assert (np.abs(drawn - PLAIN_CLOTH) < 0.3).all(axis=2).mean() > 0.02


def row(garment: str, made_of: str, pose: str, energy_j: float, **others) -> dict:
    numbers = {"start_j": 1.0, "nearest_j": energy_j + 0.004, "force_left_share": 0.005, "steps": 20}
    more = {"at_rest": True, "held": False, "processor_s": 1.0, "seconds": 2.0}
    return {"garment": garment, "fabric": made_of, "pose": pose, "energy_j": energy_j} | numbers | more | others


def test_another_methods_record_is_compared_pose_by_pose_in_the_one_cloth(tmp_path):
    before = [
        {"garment": "sash", "pose": "a:1", "energy_j": 0.3, "processor_s": 5.0},
        {"garment": "sash", "pose": "a:2", "energy_j": 0.1, "processor_s": 7.0},
    ]
    path = tmp_path / "before.json"
    path.write_text(json.dumps({"rows": before}))
    rows = [
        row("sash", "", "a:1", 0.2),
        row("sash", "", "a:2", 0.2, at_rest=False, force_left_share=0.02),
        row("sash", "rib", "a:1", 0.1),
    ]
    referee.add_before(rows, path)
    one, rib = referee.summary(rows)
    assert (one["poses"], one["at_rest"], one["not_above_start"], one["not_above_old"]) == (2, 1, 2, 1)
    assert (one["old_energy_j"], one["old_processor_s"], one["force_left_share"]) == (0.2, 6.0, 0.02)
    assert one["planes_apart_pct"] == pytest.approx(100.0 * 0.004 / 0.8)
    assert "old_energy_j" not in rib
    assert rib["fabric"] == "rib"
