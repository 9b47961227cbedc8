"""Folds of a frame: off by default, remembered per stream and garment, told where they began anew."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from dataclasses import replace

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.contact.projection import MOVED_M
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.geometry.closest import signed_distance
from drape.live import fold_step as step
from drape.live import two_level
from drape.stages import folds as folds_stage
from drape.stages.batch import PoseInput
from drape.stages.folds import SETTLE, Folds
from drape.stages.stage import carried
from drape.stages.walk import run, walk
from drape.wire.options import Advanced, DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import serve

TIMES_S = np.arange(6) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)
CLIP = PoseInput(POSES, TRANS, np.zeros(10), TIMES_S)


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(chunk_frames=4)


def test_without_folds_the_stage_is_not_in_the_plan_and_nothing_changes(runtime: DrapeRuntime):
    entry = runtime.garments.get("tube")
    plain, none = (runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=folds))) for folds in (None, 0))
    assert plain == none == runtime.plan(entry, DrapeOptions(advanced=Advanced(settle=3))), (
        "settle alone asks for nothing"
    )
    assert [stage.name for stage in plain.stages] == ["network", "collision"]
    folded = runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=2)))
    assert [stage.name for stage in folded.stages] == ["network", "folds"]
    assert folded.options.advanced.settle == SETTLE
    still = [PoseInput(POSES[:1], TRANS[:1], np.zeros(10), TIMES_S[:1])]
    way = run(folded, still).vertices - run(plain, still).vertices
    assert 1e-5 < np.abs(way).max() < 0.1


def test_folds_lift_the_cloth_off_the_skin_and_nothing_is_projected(
    runtime: DrapeRuntime, body: BodyModel, monkeypatch: pytest.MonkeyPatch
):
    high_m = 0.008  # more than contact keeps, so that there is something to lift
    monkeypatch.setattr(folds_stage, "CLEARANCE_M", high_m)
    entry = runtime.garments.get("tube")
    on, off = (
        runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1, push_out=pushed, coarse=False)))
        for pushed in (True, False)
    )
    assert {stage.name for plan in (on, off) for stage in plan.stages} == {"network", "folds"}
    lifted, left = run(on, [CLIP]), run(off, [CLIP])
    first = np.linalg.norm(lifted.vertices[0] - left.vertices[0], axis=-1)  # later frames begin where these ended
    assert first.max() > 1e-3
    assert_allclose(lifted.quality.push_max_m[0], first.max(), rtol=1e-3, atol=1e-6)
    assert_allclose(lifted.quality.pushed_share[0], (first > MOVED_M).mean(), rtol=0.0, atol=0.01)
    assert not left.quality.push_max_m.any() and not left.quality.pushed_share.any()
    skin = body.posed_vertices(POSES[:1], TRANS[:1])[0]
    above, below = (
        signed_distance(one.world()[0].astype(np.float64), skin, body.faces).min() for one in (lifted, left)
    )
    assert above > high_m - 1.5e-3 > below, "between samples the skin is a little higher than its planes"


def test_layers_that_do_not_feel_each_other_are_pushed_apart(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    scene = runtime.garments.scene(None, ["tube", "coat"])
    for feels, last in ((True, "folds"), (False, "collision")):
        plan = runtime.plan(scene, DrapeOptions(advanced=Advanced(folds=1, cloth_contact=feels)))
        assert plan.stages[-1].name == last and plan.lifted == feels
    told = run(runtime.plan(scene, DrapeOptions(advanced=Advanced(folds=1))), [CLIP]).quality
    hidden = run(runtime.plan(scene, DrapeOptions(advanced=Advanced(folds=1), hidden=("coat",))), [CLIP]).quality
    assert (told.push_max_m >= hidden.push_max_m).all()
    runtime.close()


def test_folds_of_jets_are_refused(runtime: DrapeRuntime):
    with pytest.raises(
        InputError, match=r"^advanced\.folds: expected 0 with geometry jets, whose polynomials are smooth, got 2"
    ):
        runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(folds=2), geometry="jets"))


def test_the_client_folds_one_garment_and_the_network_is_all_that_is_computed(runtime: DrapeRuntime):
    tube = runtime.garments.get("tube")
    asked = DrapeOptions(
        advanced=Advanced(push_out=True, inertia="mesh"), folds_by="client", geometry="jets", tier="accurate"
    )
    plan = runtime.plan(tube, asked)
    assert {stage.name for stage in plan.stages} == {
        stage.name
        for stage in runtime.plan(
            tube, DrapeOptions(advanced=Advanced(folds=0, push_out=False), geometry="jets", motion=0.0)
        ).stages
    }
    numbers = plan.options.advanced
    assert numbers.folds == 4 and numbers.settle == 8 and numbers.cloth_contact
    assert plan.needs == {"jets"} and runtime.tier_of(plan) == "accurate"
    assert numbers.inertia == "mesh" and plan.options.knob == 1.0, "the client swings too"


@pytest.mark.parametrize("tier", ["instant", "fast", "balanced", "accurate"])
def test_the_client_folds_by_the_tier_that_the_service_has(runtime: DrapeRuntime, tier: str):
    here, there = (
        runtime.plan(runtime.garments.get("tube"), DrapeOptions.model_validate({"tier": tier} | other))
        for other in ({}, {"folds_by": "client", "geometry": "jets"})
    )
    assert there.options.advanced == here.options.advanced
    assert there.options.knob == here.options.knob
    assert runtime.tier_of(there) == tier
    assert not {"folds", "swing", "collision"} & {stage.name for stage in there.stages}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"geometry": "vertices"}, "geometry jets, got vertices"),
        ({"colliders": [{"kind": "plane"}]}, "no colliders, got some"),
    ],
)
def test_folds_that_no_client_makes_are_refused(runtime: DrapeRuntime, options: dict, expected: str):
    asked = DrapeOptions.model_validate({"folds_by": "client", "geometry": "jets"} | options)
    with pytest.raises(InputError, match=f"folds_by: expected for client: {expected}"):
        runtime.plan(runtime.garments.get("tube"), asked)


def test_what_bones_carry_is_folded_by_no_client(make_runtime: Callable[..., DrapeRuntime], tube: Garment):
    runtime, hat = make_runtime(), tube.manifest | {"carried_by": ["head"]}
    scene = runtime.garments.add(replace(tube, digest="d" * 64, manifest=hat), "user")
    with pytest.raises(InputError, match="folds_by: expected for client: cloth, got what bones carry"):
        runtime.plan(scene, DrapeOptions(folds_by="client", geometry="jets"))


def test_bits_depend_neither_on_chunks_nor_on_who_else_is_there(runtime: DrapeRuntime):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(folds=1)))
    other = replace(CLIP, poses=POSES[::-1].copy(), betas=np.ones(10))
    alone = run(plan, [CLIP]).vertices
    together = run(plan, [other, CLIP])
    assert_array_equal(together.vertices[len(POSES) :], alone)
    assert_array_equal(asyncio.run(runtime.drape(plan, CLIP)).vertices, alone)
    assert together.memories[0].keys() == together.memories[1].keys() == {("folds", plan.keys[0])}


def test_nobody_presses_a_hidden_garment_below_the_folds_of_what_is_over_it(
    outfit_settings: Settings, monkeypatch: pytest.MonkeyPatch
):
    runtime, pressed = DrapeRuntime(outfit_settings), []
    scene = runtime.garments.scene(None, ["tube", "coat"])
    seen, hidden = (
        runtime.plan(scene, DrapeOptions(advanced=Advanced(folds=1), hidden=one)) for one in (None, ("tube",))
    )
    monkeypatch.setattr(folds_stage, "press", lambda x, *_: pressed.append(len(x)) or x)
    inner = scene.layers[0].vertex_count
    both, outer = run(seen, [CLIP]), run(hidden, [CLIP])
    assert_array_equal(outer.vertices, both.vertices[:, inner:])
    assert pressed == [inner] * 3 * len(POSES), "twice where it is seen, once where it is not"
    runtime.close()


def test_every_layer_has_a_memory_of_its_own(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    apart = DrapeOptions(advanced=Advanced(folds=1, push_out=False, cloth_contact=False))
    plan = runtime.plan(runtime.garments.scene(None, ["tube", "coat"]), apart)
    both = run(plan, [CLIP])
    assert both.memories[0].keys() == {("folds", key) for key in plan.keys}
    inner = runtime.plan(runtime.garments.get("tube"), apart)
    assert_array_equal(run(inner, [CLIP]).vertices, both.layers[0].vertices)
    runtime.close()


def test_cloth_feels_cloth_where_that_is_asked_for(outfit_settings: Settings, monkeypatch: pytest.MonkeyPatch):
    runtime = DrapeRuntime(outfit_settings)
    scene = runtime.garments.scene(None, ["tube", "coat"])
    options = DrapeOptions(advanced=Advanced(folds=1, push_out=False, cloth_contact=True))
    on = runtime.plan(scene, options)
    off, left_out = (runtime.plan(scene, options.updated(cloth_contact=asked)) for asked in (False, None))
    assert on == left_out != off and on.options.advanced.cloth_contact, "scenes have it unless they say otherwise"
    one = runtime.garments.get("tube")
    assert runtime.plan(one, DrapeOptions(advanced=Advanced(folds=1))).options.advanced.cloth_contact, (
        "of one garment as of several"
    )
    apart = DrapeOptions(advanced=Advanced(folds=1, cloth_contact=False))
    assert not runtime.plan(one, apart).options.advanced.cloth_contact
    assert runtime.plan(scene, DrapeOptions(advanced=Advanced(folds=0, cloth_contact=True))) == runtime.plan(
        scene, DrapeOptions(advanced=Advanced(folds=0))
    )
    apart, over = (run(plan, [CLIP]).vertices for plan in (off, on))
    inner = run(runtime.plan(runtime.garments.get("tube"), options), [CLIP]).vertices
    count = inner.shape[1]
    assert np.abs(over - apart)[:, count:].max() > 1e-4, "the outer one feels the inner one"
    assert np.abs(over[:, :count] - inner).max() > 1e-4, "and the inner one gives way"
    hidden = runtime.plan(scene, options.model_copy(update={"hidden": ("coat",)}))
    assert_array_equal(run(hidden, [CLIP]).vertices, over[:, :count])
    other = replace(CLIP, poses=POSES[::-1].copy(), betas=np.ones(10))
    assert_array_equal(run(on, [other, CLIP]).vertices[len(POSES) :], over)
    assert_array_equal(asyncio.run(runtime.drape(on, CLIP)).vertices, over)

    def never(*_: object) -> None:
        raise AssertionError("asked for nothing")

    monkeypatch.setattr(folds_stage, "heights_over", never)
    assert_array_equal(run(off, [CLIP]).vertices, apart)
    runtime.close()


def test_frames_of_streams_go_between_the_layers_of_an_outfit(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    plan = runtime.plan(runtime.garments.scene(None, ["tube", "coat"]), DrapeOptions(advanced=Advanced(folds=1)))
    steps = list(walk(plan, [CLIP]))
    assert len(steps) == len(plan.stages) + 1, "a step for each of two layers"
    assert_array_equal(steps[-1].vertices, run(plan, [CLIP]).vertices)
    assert_array_equal(asyncio.run(runtime.drape(plan, CLIP)).vertices, steps[-1].vertices)
    runtime.close()


def test_memories_hold_for_a_fabric(runtime: DrapeRuntime):
    entry = runtime.garments.get("tube")
    plan = runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1)))
    memories = run(plan, [CLIP]).memories[0]
    (folds,) = plan.keys
    assert ("folds", folds) in carried(
        memories, plan, runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=4, push_out=False)))
    )
    assert not carried(memories, plan, runtime.plan(entry, DrapeOptions()))
    assert plan.stages[1].depends_on(plan) != plan.stages[1].depends_on(replace(plan, fabrics=(fabric("denim"),)))


def test_constants_are_made_when_a_plan_is_prepared_and_once(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(folds=1)))
    asyncio.run(runtime.prepare(plan))

    def never(*_: object) -> None:
        raise AssertionError("constants made in a frame")

    monkeypatch.setattr("drape.live.two_level.two_level", never)
    run(plan, [CLIP])


def test_constants_of_two_garments_are_made_beside_each_other(
    outfit_settings: Settings, monkeypatch: pytest.MonkeyPatch
):
    runtime = DrapeRuntime(outfit_settings)
    plan = runtime.plan(runtime.garments.scene(None, ["tube", "coat"]), DrapeOptions(advanced=Advanced(folds=1)))
    both, made = threading.Barrier(2, timeout=60.0), two_level.one_level
    monkeypatch.setattr(two_level, "one_level", lambda *of: (both.wait(), made(*of))[1])
    asyncio.run(runtime.prepare(plan))
    runtime.close()


def test_frames_do_not_wait_for_constants_of_others(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    entry = runtime.garments.get("tube")
    plan, other = (
        runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1), fabric=name)) for name in (None, "chiffon")
    )
    stage = next(one for one in plan.stages if one.name == "folds")
    stage.prepare(plan)
    made, begun, through = two_level.two_level, threading.Event(), threading.Event()
    monkeypatch.setattr(two_level, "two_level", lambda *of: begun.set() or (through.wait() and made(*of)))
    making = threading.Thread(target=stage.prepare, args=(other,))
    making.start()
    begun.wait()
    run(plan, [CLIP])
    assert making.is_alive()
    through.set()
    making.join()


def test_constants_are_kept_up_to_a_size_those_in_use_always(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    entry, made = runtime.garments.get("tube"), []
    counted = two_level.two_level
    monkeypatch.setattr(two_level, "two_level", lambda *of: made.append(of) or counted(*of))
    stage = next(
        one for one in runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1))).stages if one.name == "folds"
    )
    assert isinstance(stage, Folds)
    for named, kept_bytes, wanted in (("swim", 1 << 30, 1), ("rib", 0, 2), ("rib", 0, 2), ("swim", 0, 3)):
        monkeypatch.setattr(folds_stage, "KEPT_BYTES", kept_bytes)
        stage.prepare(runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1), fabric=named)))
        assert len(made) == wanted


def test_resets_are_counted_and_told(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    with serve(create_app(runtime.settings, runtime=runtime), runtime.settings) as url:
        document = {"garment": "tube", "poses": POSES.tolist(), "folds": 2, "settle": 1}
        headers = httpx.post(url + "/drape", json=document).headers
        assert headers["X-Drape-Folds"] == "2" and headers["X-Drape-Folds-Resets"] == "0"
        assert httpx.post(url + "/drape", json=document | {"folds": 0}).headers["X-Drape-Folds"] == "0"
        whole = step.memory_of
        for levels in (step, two_level):
            torn = lambda *of: replace(whole(*of), residual=np.full_like(of[1].residual, np.nan))  # noqa: E731
            monkeypatch.setattr(levels, "memory_of", torn)
        headers = httpx.post(url + "/drape", json=document).headers
        assert headers["X-Drape-Folds-Resets"] == str(len(POSES) - 1), "no frame leads to a fold"
        for folds in (-1, 17, 1.5):
            assert httpx.post(url + "/drape", json=document | {"folds": folds}).json()["name"] == "folds"


def test_what_is_removed_is_forgotten(runtime: DrapeRuntime):
    (stage,) = (one for one in runtime.stages if isinstance(one, Folds))
    entry = runtime.garments.get("tube")
    plan = runtime.plan(entry, DrapeOptions(advanced=Advanced(folds=1)))
    stage.prepare(plan)
    held = {name for name in stage._constants if name[0] == entry.garment.digest}
    assert held
    stage.remove(entry.garment)
    assert not held & set(stage._constants) and entry.garment.digest not in stage._garments
    stage.add(entry.garment, {})
    stage.prepare(plan)
