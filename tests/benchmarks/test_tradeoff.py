"""The benchmark of the trade: a small garment on the real road, the front, and the rule that chooses tiers."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks import tradeoff
from benchmarks.cases import CaseClip, CaseScene
from benchmarks.model_drape import ModelDrape
from benchmarks.served import Stream
from benchmarks.stopwatch import Clock
from benchmarks.tradeoff import Case, Knobs, manifest_tiers, means, tiers_of, times, write_tiers
from drape.artifacts import load_manifest
from drape.catalog import find_motions
from drape.cloth.fabric_table import fabric
from drape.errors import ArtifactError, InputError
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
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
    folder = tiny_folder / "models" / TINY
    networks = {name: ModelDrape(folder, body, threads=1, passes=passes) for name, passes in tradeoff.STARTS.items()}
    scene = CaseScene(tube, fabric("jersey"), CaseClip.read(find_motions(["walk"])[0], 30.0, FRAMES, body))
    return Case.of(scene, networks, keeps_apart=False)  # which takes minutes: tests/benchmarks/judge has it


@pytest.fixture(scope="module")
def rows(case, drapery):
    knobs = [Knobs(0, 0, coarse=True), *(Knobs(0, n, coarse) for coarse in (True, False) for n in (2, 8))]
    return tradeoff.measure_knobs(case, drapery, knobs)


@pytest.mark.long
def test_every_combination_is_measured_beside_the_rival_and_physics(rows):
    assert [row["tier"] for row in rows] == [*[""] * 5, "skinning_push", "physics"]
    assert [row["knobs"] for row in rows[:2]] == ["passes 0, folds 0", "passes 0, folds 2 coarse"]
    rival, physics = rows[-2:]
    assert rival["time_ratio"] == 1.0 and rival["gain"] < 1.0 == physics["gain"]
    by_knobs = {row["knobs"]: row for row in rows}
    for level in (" coarse", ""):
        none, *more = "passes 0, folds 0", f"passes 0, folds 2{level}", f"passes 0, folds 8{level}"
        none, two, eight = (by_knobs[name] for name in (none, *more))
        assert none["gain"] < two["gain"] <= 1.0, "steps are nearer to physics"
        assert two["gain"] - 0.005 < eight["gain"] <= 1.0, "more of them are as near"
        assert two["error_mm"] > 0.0 and two["curvature"] > 0.5
    assert by_knobs["passes 0, folds 0"]["jitter_ratio"] == 1.0


def test_a_stream_goes_the_services_own_road(drapery, body, tube):
    pose, scene = np.zeros((24, 3)), drapery.garments.get("tube")
    stream = Stream(
        drapery.plan(scene, DrapeOptions(advanced=Advanced(folds=2, push_out=False), motion=0.0)), body.shape_count
    )
    first = stream.pose(pose, 0.0)
    assert list(stream.memories) == [("folds", stream.plan.keys[0])]
    assert np.isfinite(stream.pose(pose, 1.0 / 30.0).world()).all() and min(stream.clock.cpu_ms) > 0.0
    stream.forget()
    assert_array_equal(stream.pose(pose, 0.0).world(), first.world())
    every = drapery.plan(scene, Knobs(None, 0, coarse=True).options(drapery.engine.pass_count))
    assert every.options.advanced.passes is None and every.lifted and not every.projected


def test_the_first_frame_is_not_timed():
    assert times(Clock([100.0, 1.0, 2.0, 3.0], [50.0, 1.0, 1.0, 4.0])) == {
        "p50_ms": 2.0, "p95_ms": pytest.approx(2.9), "cpu_ms": 1.0,
    }  # fmt: skip


def row(n: int, ratio: float, gain: float, *, passes: int | None = 0, coarse: bool = False) -> dict:
    knobs = Knobs(passes, n, coarse)
    found = {"tier": "", "knobs": str(knobs), **asdict(knobs), "time_ratio": ratio, "gain": gain, "jitter_ratio": 1.0}
    found |= {"cpu_ms": 10.0 * ratio, "gain_p05": gain - 0.1, "error_mm": 1.0, "edge_pct": 1.0, "detail_share": 1.0}
    return found | {"curvature": 2.0 - gain}


def test_means_are_over_all_that_was_measured_and_mark_the_front():
    low, high = row(1, 0.4, 0.8), row(1, 0.6, 0.9)
    worse = row(2, 0.7, 0.7)
    first, second = means([low, high, worse])
    assert (first["time_ratio"], first["gain"], first["pareto"]) == (0.5, pytest.approx(0.85), True)
    assert first["gain_p05"] == pytest.approx(0.805) and not second["pareto"], "dearer and worse"


def test_tiers_are_the_cheapest_the_nearest_and_one_between():
    lift = row(0, 0.1, 0.99, coarse=True)
    rows = [lift, row(1, 0.4, 0.90), row(2, 0.6, 0.93), row(3, 0.74, 0.962), row(8, 1.5, 0.98), row(16, 1.9, 0.9805)]
    assert [found["folds"] for found in tiers_of(rows)] == [0, 1, 3, 16]
    assert [found["folds"] for found in tiers_of(rows[::-1])] == [0, 1, 3, 16], "in any order"
    assert [found["folds"] for found in tiers_of(rows[:2])] == [0, 1, 1, 1], "there is but one"
    more = [lift, row(2, 0.4, 0.9, passes=None), row(4, 0.6, 0.95, passes=0), row(4, 0.7, 0.94, passes=None)]
    assert [found["passes"] for found in tiers_of(more)] == [0, None, None, None], "never less than below"
    cheap = [lift, row(4, 0.4, 0.9), row(2, 0.5, 0.99, passes=None), row(4, 0.8, 0.95, passes=None)]
    assert [(found["passes"], found["folds"]) for found in tiers_of(cheap)][1:] == [(0, 4), (None, 4), (None, 4)]
    levels = [lift, row(1, 0.3, 0.9), row(2, 0.4, 0.99, coarse=True), row(2, 0.5, 0.98)]
    assert [found["time_ratio"] for found in tiers_of(levels)][1:] == [0.3, 0.5, 0.5], "not coarse over fine"
    levels = [lift, row(1, 0.3, 0.9, coarse=True), row(2, 0.4, 0.99, coarse=True), row(2, 0.5, 0.98)]
    assert [found["time_ratio"] for found in tiers_of(levels)][1:] == [0.3, 0.4, 0.5], "the last one is fine"
    rough = [lift, row(1, 0.3, 0.9, coarse=True), row(2, 0.4, 0.99) | {"detail_share": 1.3}, row(2, 0.5, 0.98)]
    assert [found["time_ratio"] for found in tiers_of(rough)][1:] == [0.3, 0.4, 0.5], "the last one is not too rough"
    paper = [lift, row(1, 0.3, 0.9), row(2, 0.4, 0.95) | {"curvature": 3.0}, row(2, 0.5, 0.96), row(4, 0.6, 0.97)]
    assert [found["time_ratio"] for found in tiers_of(paper)][1:] == [0.3, 0.5, 0.6], "what crumples is not cloth"
    near = [lift, row(1, 0.3, 0.9), row(2, 0.40, 0.96), row(2, 0.41, 0.955) | {"curvature": 1.0}, row(4, 0.6, 0.97)]
    assert [found["time_ratio"] for found in tiers_of(near)][1:] == [0.3, 0.41, 0.6], "as cheap, and less crumpled"
    lifts = [row(0, 0.1, 0.6), row(0, 0.2, 0.75, passes=1), row(0, 0.3, 0.8, passes=None), *rows[1:]]
    assert tiers_of(lifts)[0]["passes"] == 1, "two fifths of what all corrections gain"
    for few in ([lift], rows[1:]):
        with pytest.raises(InputError, match="combinations with"):
            tiers_of(few)


def test_what_is_served_is_measured():
    found = [str(knobs) for knobs in tradeoff.combinations((1, 2))]
    assert found[:3] == ["passes 0, folds 0", "passes 1, folds 0", "passes all, folds 0"]
    assert found[3] == "passes 0, folds 1 coarse" and found[-1] == "passes all, folds 2"
    assert len(found) == len(set(found)) == 15


def test_tiers_are_written_into_the_manifest_and_refused_where_the_service_would(tmp_path, body):
    folder = write_tiny_model(tmp_path, body)
    chosen = [
        row(0, 0.1, 0.5, passes=1, coarse=True),
        row(1, 0.4, 0.9, coarse=True),
        row(2, 0.6, 0.95),
        row(8, 1.5, 0.98),
    ]
    tiers = manifest_tiers(chosen, {"machine": "here"})
    write_tiers(folder, tiers)
    read = load_manifest(folder).tiers
    assert [(tier["name"], tier["folds"], tier["alone"]) for tier in read] == [
        ("instant", 0, 1), ("fast", 1, 1), ("balanced", 2, None), ("accurate", 8, None),
    ]  # fmt: skip
    assert read[2]["figures"]["gain"] == 0.95 and read[2]["figures"]["machine"] == "here"
    json.dumps(read)
    with pytest.raises(ArtifactError, match="tiers of the manifest"):
        write_tiers(folder, [{**tier, "folds": 0} for tier in tiers])
    assert load_manifest(folder).tiers == read
