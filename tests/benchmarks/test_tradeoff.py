"""The benchmark of the trade: a small garment on the real road, the front, and the rule that chooses tiers."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks import folds, tradeoff
from benchmarks.shared.network import Network
from benchmarks.speed.rivals import NewtonClip
from benchmarks.tradeoff import Case, Knobs, Runner, manifest_tiers, means, plot, tiers_of, times, write_tiers
from drape.artifacts import load_manifest
from drape.catalog import find_motions
from drape.cloth.fabric_table import fabric
from drape.errors import ArtifactError, InputError
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.compute.tiers import NAMES
from tests.fixtures.serving import make_settings, tiny_folder
from tests.fixtures.tiny_model import TINY, write_tiny_model

__all__ = ["make_settings", "tiny_folder"]  # fixtures
FRAMES = 4


@pytest.fixture(scope="module")
def drapery(make_settings):
    made = DrapeRuntime(make_settings())
    yield made
    made.close()


@pytest.fixture(scope="module")
def case(body, tube, tiny_folder):
    networks = {
        name: Network(tiny_folder / "models" / TINY, body, threads=1, passes=passes)
        for name, passes in (("network_0", 0), ("network_all", None))
    }
    clip = folds.Clip.read(find_motions(["walk"])[0], 30.0, FRAMES, body)
    return Case.of(tube, fabric("jersey"), clip, body, networks)


@pytest.fixture(scope="module")
def rows(case, drapery):
    return tradeoff.measure(case, drapery, [Knobs(0, n, push) for push in (False, True) for n in (0, 2, 8)])


def test_every_combination_is_measured_beside_the_rival_and_physics(rows):
    assert [row["tier"] for row in rows] == [*[""] * 6, "skinning_push", "physics"]
    assert [row["knobs"] for row in rows[:2]] == ["passes 0, folds 0", "passes 0, folds 2"]
    rival, physics = rows[-2:]
    assert rival["time_ratio"] == 1.0 and rival["gain"] < 1.0 == physics["gain"]
    by_knobs = {row["knobs"]: row for row in rows}
    for push in ("", ", push-out"):
        none, two, eight = (by_knobs[f"passes 0, folds {n}{push}"] for n in (0, 2, 8))
        assert none["gain"] < two["gain"] < eight["gain"] <= 1.0, "more steps are nearer to physics"
        assert two["error_mm"] > 0.0
    assert by_knobs["passes 0, folds 0"]["jitter_ratio"] == 1.0


def test_a_simulator_is_left_out_with_a_reason_where_there_is_none(case, body, capsys):
    assert tradeoff.newton_rows(case, body, case.skinned, None) == []
    assert "newton_vbd is left out: no interpreter with newton: give --newton PYTHON" in capsys.readouterr().out
    assert tradeoff.newton_rows(case, body, case.skinned, "/nowhere/python") == []
    assert "newton_vbd is left out: FileNotFoundError" in capsys.readouterr().out


def test_a_simulator_has_a_row_for_each_pace_that_it_comes_through(case, body, capsys, monkeypatch):
    def run(clip: NewtonClip, python: str | None, paces: tuple) -> dict:
        assert python == "python" and clip.fps == 30.0 and (clip.start == case.skinned[0]).all()
        assert clip.body_vertices.shape == (FRAMES, body.vertex_count, 3)
        flown = np.where(np.arange(FRAMES) == 2, np.nan, 0.0)[:, None, None] + case.skinned
        ms = np.arange(2.0 * FRAMES).reshape(2, FRAMES)
        return {"vertices": np.stack([case.skinned, flown]), "wall_ms": ms, "cpu_ms": ms}

    monkeypatch.setattr(NewtonClip, "run", run)
    (row,) = tradeoff.newton_rows(case, body, case.skinned, "python")
    assert (row["tier"], row["knobs"], row["cpu_ms"]) == ("newton_vbd", "8 steps, 10 iterations", 2.0)
    assert row["gain"] == pytest.approx(0.0) and row["jitter_ratio"] == 1.0, "it is where skinning is"
    assert "newton_vbd, 32 steps, 3 iterations, is left out" in capsys.readouterr().out


def test_a_runner_goes_the_services_own_road(drapery, body, tube):
    clip = folds.Clip.read(find_motions(["walk"])[0], 30.0, 2, body)
    plan = drapery.plan(drapery.garments.get("tube"), DrapeOptions(folds=2, motion=0.0, push_out=False))
    runner = Runner.of(plan, clip, body.shape_count)
    runner.step(0)
    assert list(runner.memories) == [("folds", plan.keys[0])]
    runner.step(1)
    assert np.isfinite(runner.vertices).all() and (runner.cpu_ms > 0.0).all()
    every = Knobs(None, 0, True).options(drapery.engine.pass_count)
    assert drapery.plan(drapery.garments.get("tube"), every).options.passes is None


def test_the_first_frame_is_not_timed():
    assert times(np.array([100.0, 1.0, 2.0, 3.0]), np.array([50.0, 1.0, 1.0, 4.0])) == {
        "p50_ms": 2.0, "p95_ms": pytest.approx(2.9), "cpu_ms": 1.0,
    }  # fmt: skip


def row(n: int, ratio: float, gain: float, *, passes: int | None = 0, push: bool = True, contact: bool = True) -> dict:
    knobs = Knobs(passes, n, push, contact)
    found = {"tier": "", "knobs": str(knobs), **asdict(knobs), "time_ratio": ratio, "gain": gain, "jitter_ratio": 1.0}
    found |= {"cpu_ms": 10.0 * ratio, "gain_p05": gain - 0.1, "error_mm": 1.0, "edge_pct": 1.0, "detail_share": 1.0}
    return found


def test_means_are_over_all_that_was_measured_and_mark_the_front():
    low, high = row(1, 0.4, 0.8), row(1, 0.6, 0.9)
    worse = row(2, 0.7, 0.7)
    first, second = means([low, high, worse])
    assert (first["time_ratio"], first["gain"], first["pareto"]) == (0.5, pytest.approx(0.85), True)
    assert first["gain_p05"] == pytest.approx(0.805) and not second["pareto"], "dearer and worse"


def test_tiers_are_the_cheapest_the_nearest_and_half_way_between():
    rows = [row(0, 0.1, 0.99), row(1, 0.4, 0.90), row(2, 0.6, 0.93), row(3, 0.74, 0.951), row(8, 1.5, 0.98)]
    rows += [row(16, 1.9, 0.9815), row(4, 0.7, 0.999, push=False), row(5, 0.5, 0.999, contact=False)]
    assert [found["folds"] for found in tiers_of(rows)] == [1, 3, 8]
    assert [found["folds"] for found in tiers_of(rows[::-1])] == [1, 3, 8], "in any order"
    assert [found["folds"] for found in tiers_of(rows[:2])] == [1, 1, 1], "there is but one"
    more = [row(2, 0.4, 0.9, passes=None), row(4, 0.6, 0.95, passes=0), row(4, 0.7, 0.94, passes=None)]
    assert [found["passes"] for found in tiers_of(more)] == [None] * 3, "never less than below"
    cheap = [row(4, 0.4, 0.9), row(2, 0.5, 0.99, passes=None), row(4, 0.8, 0.95, passes=None)]
    assert [(found["passes"], found["folds"]) for found in tiers_of(cheap)] == [(0, 4), (None, 4), (None, 4)]
    with pytest.raises(InputError, match="combinations with folds"):
        tiers_of([row(0, 0.1, 0.9)])


def test_what_is_served_and_what_may_pass_through_itself_are_measured():
    found = [str(knobs) for knobs in tradeoff.combinations((0, 2))]
    assert found[:2] == ["passes 0, folds 0", "passes 0, folds 2"] and len(found) == len(set(found)) == 10
    assert found[-1] == "passes all, folds 2, through itself" and "passes all, folds 2, push-out" in found


def test_a_simulator_is_an_end_of_the_axis_and_no_tier(tmp_path):
    served = [row(1, 0.4, 0.9), row(2, 0.6, 0.95)]
    figures = {"time_ratio": 4.0, "gain": 0.99, "error_mm": 9.0}
    simulated = [{"tier": "newton_vbd", "knobs": f"{n} steps, 10 iterations"} | figures for n in (2, 8)]
    mean = means([*served, *simulated, simulated[0]])
    assert [found["knobs"] for found in mean[2:]] == ["2 steps, 10 iterations", "8 steps, 10 iterations"]
    assert [found["folds"] for found in tiers_of(mean)] == [1, 2, 2]
    assert [found["pareto"] for found in means([row(9, 5.0, 0.98), *simulated])] == [True] * 3
    plot(mean, tiers_of(mean), tmp_path / "with.png")
    plot(mean[:2], tiers_of(mean), tmp_path / "without.png")
    assert (tmp_path / "with.png").read_bytes() != (tmp_path / "without.png").read_bytes()


def test_tiers_are_written_into_the_manifest_and_refused_where_the_service_would(tmp_path, body):
    folder = write_tiny_model(tmp_path, body)
    chosen = [row(1, 0.4, 0.9), row(2, 0.6, 0.95), row(8, 1.5, 0.98)]
    tiers = manifest_tiers(chosen, {"machine": "here"})
    write_tiers(folder, tiers)
    read = load_manifest(folder).tiers
    assert [(tier["name"], tier["folds"], tier["alone"]) for tier in read] == [
        ("fast", 1, 0), ("balanced", 2, None), ("accurate", 8, None),
    ]  # fmt: skip
    assert read[1]["figures"]["gain"] == 0.95 and read[1]["figures"]["machine"] == "here"
    json.dumps(read)
    with pytest.raises(ArtifactError, match="tiers of the manifest"):
        write_tiers(folder, [{**tier, "folds": 0} for tier in tiers])
    assert load_manifest(folder).tiers == read


def test_the_front_is_drawn(tmp_path):
    rows = means([row(1, 0.4, 0.9), row(2, 0.6, 0.95), row(8, 1.5, 0.98), row(0, 0.3, 0.5, passes=None, push=False)])
    plot(rows, tiers_of(rows), tmp_path / "deep" / "front.png")
    assert (tmp_path / "deep" / "front.png").stat().st_size > 5_000
    assert len(NAMES) == len(tiers_of(rows)) and replace(Knobs(0, 1, True), folds=2) == Knobs(0, 2, True)
