"""One call a frame has the bits of stage by stage: messages, vertices, figures, memories. And which frames take it."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

from drape.errors import ArtifactError
from drape.stages import frame as frame_stage
from drape.stages.batch import Batch, Memories, PoseInput
from drape.stages.network import Network
from drape.stages.plan import Plan
from drape.stages.stage import Stage, carried
from drape.stages.walk import by_stages, run, walk
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.replicas.memory_codec import decode_value, encode_value
from service.settings import Settings
from tests.fixtures.poses import smooth_motion

CLOCK = slice(24, 32)  # of a FRAME message: when it was sent
TIMES_S = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 3.1, 33.0, 34.0]) / 30.0  # twice the same, and a pause
POSES, TRANS = smooth_motion(np.arange(len(TIMES_S)) / 30.0)
BENT = POSES.copy()
BENT[3:, 0] += [2.5, 0.0, 0.0]  # all at once bent over: a cut
PLANE = {"kind": "plane", "normal": [0.2, 1.0, 0.0], "offset_m": -0.2}


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(inertia="mesh")


def plan_of(runtime: DrapeRuntime, *, messages: bool = True, **options: Any) -> Plan:
    asked = DrapeOptions.model_validate(options)
    return runtime.plan(runtime.garments.get("tube"), asked, messages=messages)


def bits(value: Any) -> Any:
    """``value`` so that it is equal to what has the same classes and bits."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if is_dataclass(value):
        return type(value), [bits(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, dict):
        return {key: bits(one) for key, one in value.items()}
    return [bits(one) for one in value] if isinstance(value, tuple) else value


def frames(number: int, memories: Sequence[Memories]) -> list[PoseInput]:
    """The frame ``number`` of two streams, one of which bends over at once, on bodies of two shapes."""
    one = slice(number, number + 1)
    times_s, shapes = TIMES_S[one], (np.zeros(10), np.linspace(-1.0, 1.0, 10))
    both = zip((POSES, BENT), shapes, memories, strict=True)
    return [PoseInput(poses[one], TRANS[one], betas, times_s, told, number) for poses, betas, told in both]


def told(batch: Batch) -> Any:
    messages = [message[: CLOCK.start] + message[CLOCK.stop :] for message in batch.messages]
    return messages, bits(batch.quality), bits(batch.root), bits(batch.vertices), bits(batch.memories)


@pytest.mark.parametrize(
    "options",
    [
        *({"tier": tier, **more} for tier in ("instant", "fast", "accurate") for more in ({}, {"colliders": [PLANE]})),
        {"tier": "balanced", "motion": 0.0, "pixels_per_m": 50.0},
    ],
)
def test_a_walk_has_the_bits_of_stage_by_stage(runtime: DrapeRuntime, options: dict):
    plan = plan_of(runtime, settle=1, **options)
    assert frame_stage.at_once(plan) is not None
    memories: tuple[tuple[Memories, ...], ...] = (({}, {}), ({}, {}))
    for number in range(len(TIMES_S)):
        at_once, staged = run(plan, frames(number, memories[0])), list(by_stages(plan, frames(number, memories[1])))[-1]
        assert told(at_once) == told(staged), number
        memories = (at_once.memories, staged.memories)


@pytest.fixture(scope="module")
def dressed(outfit_settings: Settings) -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(outfit_settings)
    yield made
    made.close()


@pytest.mark.parametrize(
    "options",
    [
        {"tier": "fast"},
        {"tier": "instant", "hidden": ("coat",), "colliders": [PLANE]},
        {"tier": "accurate", "hidden": ("tube",)},
    ],
)
def test_layers_do_so_too(dressed: DrapeRuntime, options: dict):
    """Their first frames, and those after a cut, are drawn stage by stage."""
    scene = dressed.garments.scene(None, ["tube", "coat"])
    plan = dressed.plan(scene, DrapeOptions.model_validate(options | {"settle": 1}), messages=True)
    first, memories, ways = frame_stage.at_once(plan), [({}, {}), ({}, {})], []
    assert first is not None
    for number in range(len(TIMES_S)):
        ways.append(frame_stage.drawn(Batch.of(plan, frames(number, memories[0])), first) is not None)
        at_once, staged = run(plan, frames(number, memories[0])), list(by_stages(plan, frames(number, memories[1])))[-1]
        assert told(at_once) == told(staged), number
        memories = [at_once.memories, staged.memories]
    assert ways == [False, *[True] * (len(TIMES_S) - 1)]


@pytest.mark.parametrize("options", [{"folds": 0, "push_out": False}, {"folds": 1, "safe_folds": 4, "settle": 1}])
def test_a_clip_does_too_and_others_may_come_between_its_frames(runtime: DrapeRuntime, options: dict):
    plan = plan_of(runtime, messages=False, **options)
    clips = [PoseInput(POSES, TRANS, np.zeros(10), TIMES_S), PoseInput(BENT[:4], TRANS[:4], np.ones(10), TIMES_S[:4])]
    steps = list(walk(plan, clips))
    assert told(steps[-1]) == told(list(by_stages(plan, clips))[-1])
    assert len(steps) == len(POSES) + 4 + 1


@pytest.mark.parametrize(
    "options", [{"tier": "fast", "settle": 1}, {"tier": "accurate", "settle": 1}, {"tier": "instant"}]
)
def test_memories_go_on_at_another_process(runtime: DrapeRuntime, options: dict):
    plan = plan_of(runtime, **options)
    left = run(plan, frames(1, run(plan, frames(0, ({}, {}))).memories)).memories
    classes = runtime.memory_classes
    here = told(run(plan, frames(2, left)))
    moved = [
        {key: decode_value(encode_value(one, classes), classes) for key, one in memories.items()} for memories in left
    ]
    assert told(run(plan, frames(2, moved))) == here
    copied = pickle.loads(pickle.dumps(left))
    kept = {
        name for memories in copied for memory in memories.values() for name in vars(getattr(memory, "coarse", memory))
    }
    assert not kept & {"left", "record"}, "addresses stay here"
    assert told(run(plan, frames(2, copied))) == here


def test_cloth_that_was_lifted_alone_begins_to_fold_stage_by_stage(runtime: DrapeRuntime):
    instant, fast = (plan_of(runtime, tier=tier) for tier in ("instant", "fast"))
    left = tuple(carried(memories, instant, fast) for memories in run(instant, frames(0, ({}, {}))).memories)
    assert [stage for stage, _ in left[0]] == ["swing", "folds"]
    first = frame_stage.at_once(fast)
    assert first is not None and frame_stage.drawn(Batch.of(fast, frames(1, left)), first) is None
    after = run(fast, frames(1, left))
    assert told(after) == told(list(by_stages(fast, frames(1, left)))[-1])
    assert frame_stage.drawn(Batch.of(fast, frames(2, after.memories)), first) is not None


@pytest.mark.parametrize("way", [walk, by_stages])
def test_numbers_that_are_not_finite_are_refused(runtime: DrapeRuntime, way: Callable[..., Iterator[Batch]]):
    plan = plan_of(runtime, tier="fast")
    (network,) = (stage for stage in plan.stages if isinstance(stage, Network))
    first = network.rows(plan)[0].patches.first
    kept = first.copy()
    first[:] = np.nan
    with pytest.raises(ArtifactError, match="expected finite numbers, got NaN or infinity"):
        list(way(plan, frames(0, ({}, {}))))
    first[:] = kept


def test_what_the_engine_has_not_goes_stage_by_stage(runtime: DrapeRuntime, make_runtime: Callable[..., DrapeRuntime]):
    class Own(Stage):
        """A stage of somebody else, which reads the skin."""

        name = "own"

        def needs(self, plan: Plan) -> frozenset[str]:
            return frozenset({"skin"})

    others: list[dict[str, Any]] = [{"geometry": "jets"}, {"folds": 0, "push_out": True}]
    for options in others:
        assert frame_stage.at_once(plan_of(runtime, **options)) is None
    plan = plan_of(runtime, tier="fast")
    own = Plan(plan.scene, plan.options, True, (*plan.stages, object.__new__(Own)), plan.needs, draped=plan.draped)
    assert frame_stage.at_once(own) is None
    clip = PoseInput(POSES, TRANS, np.zeros(10), TIMES_S)
    several = plan_of(make_runtime(inertia="mesh", threads=2), tier="fast")
    first = frame_stage.at_once(several)
    assert first is not None and frame_stage.drawn(Batch.of(several, [clip]), first) is None
    assert frame_stage.drawn(Batch.of(several, [clip.part(slice(0, 1), {})]), first) is not None


def test_each_stage_is_told_its_share_of_the_time(runtime: DrapeRuntime):
    spent: dict[str, float] = {}
    plan = plan_of(runtime, tier="fast")
    begun_s = time.perf_counter()
    run(plan, frames(0, ({}, {})), spent.__setitem__)
    whole_s = time.perf_counter() - begun_s
    assert list(spent) == [stage.name for stage in plan.stages] and all(took_s > 0.0 for took_s in spent.values())
    assert sum(spent.values()) <= whole_s
