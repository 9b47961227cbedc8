"""Dynamic models in service: what is remembered of a body, and that nobody swings with another's motion."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterator

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.body.features import Kinematics
from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.graph.feeds import kinematics
from drape.graph.packing import pack_body
from drape.inference.engine import Engine
from drape.inference.packing import Packer, ScenePlan
from drape.live.clock import SHORTEST_STEP_S
from drape.stages.batch import Memories, PoseInput
from drape.stages.encode import KEY
from drape.stages.motion import JUMP_M_S, STEP_LIMIT_S, Memory, Moment, Motion, advance
from drape.stages.plan import Plan
from drape.stages.walk import run
from drape.wire import messages as wire
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.compute.threads import SlicedThread
from service.settings import Settings
from service.stream.session import Opening, StreamSession
from service.stream.workers import Streams
from tests.fixtures.packed import MOVING
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import served
from tests.fixtures.tiny_model import (
    ROUNDING_M,
    STATE_SIZE,
    TINY_DYNAMIC,
    expected_codes,
    expected_vertices,
    tiny_folder,
)

TIMES_S = np.arange(12) / 30.0
NO_SHAPE = np.zeros(10)
SIDEWAYS = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(model=TINY_DYNAMIC, stream_threads=1)  # all that wait go together


@pytest.fixture(scope="module")
def moving(make_settings: Callable[..., Settings]) -> Iterator[httpx.Client]:
    """An HTTP client of a service with the dynamic model."""
    with served(make_settings(model=TINY_DYNAMIC)) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        yield client


def ask(api: httpx.Client, poses: np.ndarray, trans: np.ndarray, **fields: object) -> httpx.Response:
    document = {"garment": "tube", "poses": poses.tolist(), "trans": trans.tolist(), "push_out": False, **fields}
    answer = api.post("/drape", json=document)
    assert answer.status_code == 200, answer.text
    return answer


def vertices_of(answer: httpx.Response) -> np.ndarray:
    return np.frombuffer(answer.content, "<f4").reshape(int(answer.headers["X-Drape-Frames"]), -1, 3)


def clip_of(times_s: np.ndarray = TIMES_S, *, seed: int = 0, bent: float = 0.0) -> PoseInput:
    poses, trans = smooth_motion(times_s, seed=seed)
    return PoseInput(poses, trans, NO_SHAPE + bent, times_s)


def plan_of(runtime: DrapeRuntime, knob: float = 1.0, *, messages: bool = False) -> Plan:
    return runtime.plan(
        runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False), motion=knob), messages=messages
    )


def moved(memories: Memories) -> Memory | None:
    """What is remembered of a body's motion."""
    return memories.get(Motion.key)


# --- clips ---


def test_a_clip_swings_as_the_readable_graphs_say(moving: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = smooth_motion(TIMES_S)
    codes = expected_codes(body, poses, trans, TIMES_S)
    still = expected_vertices(body, tube, poses, trans, codes=0.0 * codes)
    assert moving.get("/health").json()["dynamic"] is True
    for knob in (1.0, 0.4, 0.0, None):
        answer = ask(moving, poses, trans, fps=30.0, motion=knob)
        share = 1.0 if knob is None else knob
        expected = expected_vertices(body, tube, poses, trans, codes=share * codes)
        swing_m = np.abs(expected - still)[3:].max(axis=(1, 2))
        assert share == 0.0 or swing_m.min() > 1e-4, "the motion must be such that this means something"
        assert answer.headers["X-Drape-Motion"] == f"{share:g}"
        assert_allclose(vertices_of(answer), expected, rtol=0, atol=ROUNDING_M)


def test_the_frame_rate_says_how_fast_it_was(moving: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = smooth_motion(TIMES_S)
    codes = expected_codes(body, poses, trans, 2.0 * TIMES_S)
    expected = expected_vertices(body, tube, poses, trans, codes=codes)
    assert_allclose(vertices_of(ask(moving, poses, trans, fps=15.0)), expected, rtol=0, atol=ROUNDING_M)


def test_a_static_model_has_no_motion_and_says_so(api: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = smooth_motion(TIMES_S)
    answer = ask(api, poses, trans, motion=1.0)
    assert answer.headers["X-Drape-Motion"] == "0"
    assert_allclose(vertices_of(answer), expected_vertices(body, tube, poses, trans), rtol=0, atol=ROUNDING_M)
    assert api.get("/health").json()["dynamic"] is False


@pytest.mark.parametrize("motion", [-0.1, 1.5, "full"])
def test_a_knob_out_of_range_is_refused(moving: httpx.Client, motion: object):
    answer = moving.post("/drape", json={"garment": "tube", "poses": np.zeros((1, 24, 3)).tolist(), "motion": motion})
    assert answer.status_code == 400 and answer.json()["name"] == "motion"


def test_a_still_scene_is_the_static_models_and_runs_no_recurrence(
    runtime: DrapeRuntime, make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
):
    static, clip = DrapeRuntime(make_settings()), clip_of()
    want = run(plan_of(static), [clip]).vertices
    ran: list[int] = []
    advance_all = Engine.advance

    def counted(engine: Engine, features: np.ndarray, *rest: np.ndarray):
        ran.append(len(features))
        return advance_all(engine, features, *rest)

    def refused(*_: object) -> None:
        raise AssertionError("kinematics were computed")

    monkeypatch.setattr(Engine, "advance", counted)
    with monkeypatch.context() as patched:
        patched.setattr("drape.stages.motion.moments", refused)
        got = run(plan_of(runtime, 0.0), [clip])
    assert_array_equal(got.vertices, want)
    assert ran == [] and got.memories == ({},)
    single = run(plan_of(runtime), [clip.part(slice(5, 6), {})])
    assert_array_equal(single.vertices, want[5:6])
    run(plan_of(runtime), [clip, clip_of(TIMES_S[:5], seed=1)])
    assert ran == [2, 2, 2, *[1] * (len(TIMES_S) - 5)], "the first two frames have no motion yet"
    static.close()


def test_chunks_hand_the_state_on(make_runtime: Callable[..., DrapeRuntime], runtime: DrapeRuntime):
    whole = run(plan_of(runtime), [clip_of()])
    chunked = make_runtime(model=TINY_DYNAMIC, chunk_frames=5)
    draped = asyncio.run(chunked.drape(plan_of(chunked), clip_of()))
    assert_array_equal(draped.vertices, whole.vertices)
    last, want = moved(draped.memories[0]), moved(whole.memories[0])
    assert last is not None and want is not None
    assert_array_equal(last.state, want.state)


def test_clients_of_any_number_and_length_swing_as_if_alone(runtime: DrapeRuntime):
    plan = plan_of(runtime)
    inputs = [
        clip_of(TIMES_S, seed=1),
        clip_of(TIMES_S[:1], seed=2),
        clip_of(TIMES_S[:7] * 0.6, seed=3, bent=-0.4),
        clip_of(TIMES_S[:4], seed=5, bent=0.5),
    ]
    # Two begin in the midst of a motion.
    memories = run(plan, [clip_of(TIMES_S[:6] - 0.2, seed=i) for i in (1, 3)]).memories
    inputs[0], inputs[2] = (dataclasses.replace(inputs[i], memories=m) for i, m in zip((0, 2), memories, strict=True))
    together = run(plan, inputs)
    alone = [run(plan, [one]) for one in inputs]
    assert_array_equal(together.vertices, np.concatenate([one.vertices for one in alone]))
    for memory, one in zip(together.memories, alone, strict=True):
        got, own = moved(memory), moved(one.memories[0])
        assert got is not None and own is not None
        assert_array_equal(got.state, own.state)
        assert_array_equal(got.code, own.code)
    still = run(plan_of(runtime, 0.0), [inputs[0]])
    assert np.abs(together.vertices[0] - still.vertices[0]).max() > 0.0, "a motion counts from its first frame"


def test_bodies_without_a_code_hang_at_rest(tube: Garment):
    packer = Packer(Engine(tiny_folder(dynamic=True)), load_body())
    packer.add("tube", tube)
    rows = pack_body(load_body()).rows(smooth_motion(TIMES_S[:2])[0])
    code = np.zeros((2, MOVING.body_code_size), np.float32)
    items = [("tube", 0), ("tube", 1)]
    still = packer.run(ScenePlan(), rows, items)
    for given, none in zip(packer.run(ScenePlan(), rows | {"dynamic_code": code}, items), still, strict=True):
        assert_array_equal(given.arrays["vertices"], none.arrays["vertices"])
    code[1] = 1.0
    first, second = packer.run(ScenePlan(), rows | {"dynamic_code": code}, items)
    assert_array_equal(first.arrays["vertices"], still[0].arrays["vertices"])
    assert np.abs(second.arrays["vertices"] - still[1].arrays["vertices"]).max() > 1e-4


# --- memory ---


def at(body: BodyModel, poses: np.ndarray, trans: np.ndarray) -> Kinematics:
    return kinematics(body, poses, trans)


def remembered(runtime: DrapeRuntime, times_s: np.ndarray, *, poses: np.ndarray, trans: np.ndarray) -> Memory:
    memory, bodies = Memory.empty(runtime.engine), at(runtime.body, poses, trans)
    for i, time_s in enumerate(times_s):
        (memory,) = advance(runtime.engine, [memory], [Moment(float(time_s), bodies[i])])
    return memory


def test_dropped_frames_only_make_the_step_longer(runtime: DrapeRuntime, body: BodyModel):
    times_s = np.delete(TIMES_S, [4, 7, 8])
    poses, trans = smooth_motion(times_s)
    memory = remembered(runtime, times_s, poses=poses, trans=trans)
    expected = expected_codes(body, poses, trans, times_s)[-1]
    assert_allclose(memory.code, expected, rtol=0, atol=5e-5)  # sums of hundreds of numbers up to 2, step after step
    assert len(memory.moments) == 2


@pytest.mark.parametrize("case", ["pause", "back", "jump"])
def test_what_does_not_follow_begins_anew(runtime: DrapeRuntime, case: str):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(runtime, TIMES_S, poses=poses, trans=trans)
    assert np.abs(memory.state).max() > 0.0
    bodies = at(runtime.body, poses, trans)
    later_s = {"pause": STEP_LIMIT_S * 1.01, "back": -1e-3, "jump": 1 / 30}[case]
    body = bodies[-1]
    if case == "jump":
        body = dataclasses.replace(body, joints=body.joints + JUMP_M_S / 30 * 1.01 * SIDEWAYS)
    moment = Moment(float(TIMES_S[-1] + later_s), body)
    (anew,) = advance(runtime.engine, [memory], [moment])
    assert anew.moments == (moment,)
    assert_array_equal(anew.state, np.zeros(STATE_SIZE))
    assert_array_equal(anew.code, np.zeros(MOVING.body_code_size))


def test_just_within_the_limits_it_goes_on(runtime: DrapeRuntime):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(runtime, TIMES_S, poses=poses, trans=trans)
    body = at(runtime.body, poses, trans)[-1]
    fast = dataclasses.replace(body, joints=body.joints + JUMP_M_S / 30 * 0.99 * SIDEWAYS)
    for moment in (Moment(TIMES_S[-1] + 1 / 30, fast), Moment(TIMES_S[-1] + 0.99 * STEP_LIMIT_S, body)):
        (after,) = advance(runtime.engine, [memory], [moment])
        assert len(after.moments) == 2 and np.abs(after.state).max() > 0.0


def test_the_same_time_again_changes_nothing(runtime: DrapeRuntime):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(runtime, TIMES_S, poses=poses, trans=trans)
    (same,) = advance(runtime.engine, [memory], [Moment(float(TIMES_S[-1]), at(runtime.body, poses, trans)[0])])
    assert same is memory


def test_a_jittering_clock_makes_no_explosion(runtime: DrapeRuntime):
    """Frames a microsecond apart count as if they were the shortest step apart."""
    trans = np.zeros((4, 3))
    trans[:, 0] = 0.01 * np.arange(4)
    times_s = np.array([0.0, 1 / 60, 2 / 60, 2 / 60 + 1e-6])
    states = []
    for last_s in (2 / 60 + 1e-6, 2 / 60 + SHORTEST_STEP_S):
        times_s[-1] = last_s
        states.append(remembered(runtime, times_s, poses=np.zeros((4, 24, 3)), trans=trans).state)
    assert_allclose(states[0], states[1], rtol=1e-4, atol=1e-6)
    assert np.abs(states[0]).max() > 0.0


# --- streams ---


def put(session: StreamSession, index: int, times_s: np.ndarray, poses: np.ndarray, trans: np.ndarray) -> None:
    session.put(wire.Pose(index, float(times_s[index]), trans[index], poses[index]))


def run_frames(streams: Streams, sessions: list[StreamSession]) -> list[wire.Frame]:
    """Lets all that wait be computed in one batch; their frames."""

    async def once() -> None:
        assert streams._next_batch() == sessions
        await streams._compute(sessions)

    asyncio.run(once())
    frames = []
    for session in sessions:
        assert session.outbox is not None, session.failure
        frame = wire.unpack_frame(session.outbox)
        session.outbox = None
        session.acknowledge(frame.sequence)
        frames.append(frame)
    return frames


def open_sessions(runtime: DrapeRuntime, knobs: list[float]) -> tuple[Streams, list[StreamSession]]:
    streams = Streams(runtime, SlicedThread())
    sessions = [StreamSession(plan_of(runtime, knob, messages=True), NO_SHAPE, credit=2) for knob in knobs]
    for session in sessions:
        streams.add(session)
    return streams, sessions


def test_every_stream_has_its_own_motion(runtime: DrapeRuntime, body: BodyModel, tube: Garment):
    streams, sessions = open_sessions(runtime, [1.0, 1.0])
    _, (still,) = open_sessions(runtime, [0.0])
    streams.add(still)
    motions = [smooth_motion(TIMES_S, seed=seed) for seed in range(3)]
    for index in range(len(TIMES_S)):
        for session, (poses, trans) in zip((*sessions, still), motions, strict=True):
            put(session, index, TIMES_S, poses, trans)
        frames = run_frames(streams, sessions) + run_frames(streams, [still])
    for frame, knob, (poses, trans) in zip(frames, (1.0, 1.0, 0.0), motions, strict=True):
        codes = knob * expected_codes(body, poses, trans, TIMES_S)[-1:]
        expected = expected_vertices(body, tube, poses[-1:], trans[-1:], codes=codes)[0]
        assert_allclose(frame.vertices(), expected, rtol=0, atol=0.5 * frame.box_step.max() + ROUNDING_M)
    assert still.memories.keys() == {KEY}, "no motion"


def test_motion_goes_on_over_another_garment_and_ends_with_another_shape(runtime: DrapeRuntime):
    streams, (session,) = open_sessions(runtime, [1.0])
    poses, trans = smooth_motion(TIMES_S)
    for index in range(6):
        put(session, index, TIMES_S, poses, trans)
        run_frames(streams, [session])
    memory, plan = moved(session.memories), session.plan
    assert memory is not None and np.abs(memory.state).max() > 0.0
    entry = runtime.garments.get("tube")
    other = dataclasses.replace(entry, id="other", garment=dataclasses.replace(entry.garment, digest="other"))
    session.reopen(Opening(dataclasses.replace(plan, scene=other), NO_SHAPE.copy()))
    assert moved(session.memories) is memory
    session.reopen(Opening(plan, np.full(10, 0.1)))
    assert session.memories == {}
    session.memories = {Motion.key: memory}
    session.reopen(Opening(plan_of(runtime, 0.0, messages=True), session.betas))
    assert session.memories == {}


def test_a_frame_of_an_earlier_opening_leaves_no_memory(runtime: DrapeRuntime):
    _, (session,) = open_sessions(runtime, [1.0])
    session.reopen(Opening(session.plan, np.full(10, 0.1)))
    session.deliver(0, b"old", {Motion.key: Memory.empty(runtime.engine)})
    assert session.memories == {} and session.outbox is None
