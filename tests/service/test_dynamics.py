"""Dynamic models in service: what is remembered of a body, and that nobody swings with another's motion."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterator
from itertools import pairwise

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.features import Kinematics
from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.graph.feeds import kinematics
from drape.wire import messages as wire
from service.app import create_app
from service.drapery import Drapery, PoseInput
from service.dynamics import JUMP_M_S, STEP_LIMIT_S, Memory, Moment, advance, nothing
from service.engine import Engine
from service.sessions import Session, Streams
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import serve
from tests.fixtures.tiny_model import STATE_DECAY_S, STATE_SIZE, TINY_DYNAMIC, expected_codes, expected_vertices

TIMES_S = np.arange(12) / 30.0
NO_SHAPE = np.zeros(10)
ROUNDING_M = 2e-6
SIDEWAYS = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def drapery(make_settings: Callable[..., Settings]) -> Iterator[Drapery]:
    made = Drapery(make_settings(model=TINY_DYNAMIC))
    yield made
    made.close()


@pytest.fixture(scope="module")
def moving(make_settings: Callable[..., Settings]) -> Iterator[httpx.Client]:
    """An HTTP client of a service with the dynamic model."""
    settings = make_settings(model=TINY_DYNAMIC)
    with serve(create_app(settings), settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        yield client


def ask(api: httpx.Client, poses: np.ndarray, trans: np.ndarray, **fields: object) -> httpx.Response:
    document = {"garment": "tube", "poses": poses.tolist(), "trans": trans.tolist(), "push_out": False, **fields}
    answer = api.post("/drape", json=document)
    assert answer.status_code == 200, answer.text
    return answer


def vertices_of(answer: httpx.Response) -> np.ndarray:
    return np.frombuffer(answer.content, "<f4").reshape(int(answer.headers["X-Drape-Frames"]), -1, 3)


def clip_input(times_s: np.ndarray = TIMES_S, *, seed: int = 0, motion: float = 1.0) -> PoseInput:
    poses, trans = smooth_motion(times_s, seed=seed)
    return PoseInput(poses, trans, NO_SHAPE, False, motion, times_s)


# --- clips ---


def test_a_clip_swings_as_the_closed_form_says(moving: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = smooth_motion(TIMES_S)
    codes = expected_codes(body, poses, trans, TIMES_S)
    assert np.abs(codes[2:]).max() > 0.02, "the motion must be such that this means something"
    still = expected_vertices(body, tube, poses, trans)
    assert moving.get("/health").json()["dynamic"] is True
    for knob in (1.0, 0.4, 0.0, None):
        answer = ask(moving, poses, trans, fps=30.0, motion=knob)
        share = 1.0 if knob is None else knob
        assert answer.headers["X-Drape-Motion"] == f"{share:g}"
        assert_allclose(vertices_of(answer), still + share * codes[:, None], rtol=0, atol=ROUNDING_M)


def test_the_frame_rate_says_how_fast_it_was(moving: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = smooth_motion(TIMES_S)
    slow = vertices_of(ask(moving, poses, trans, fps=15.0))
    codes = expected_codes(body, poses, trans, 2.0 * TIMES_S)
    assert_allclose(slow, expected_vertices(body, tube, poses, trans) + codes[:, None], rtol=0, atol=ROUNDING_M)


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


class NeverRun(Engine):
    """An engine whose recurrent graph must not be run."""

    def advance(self, features: np.ndarray, state: np.ndarray, dt_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise AssertionError("the recurrent path was run")


def test_knob_zero_and_single_poses_do_not_run_the_recurrence(
    drapery: Drapery, make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
):
    entry = drapery.garments.get("tube")
    static = Drapery(make_settings())
    motion = clip_input()
    want = static.compute(static.garments.get("tube"), [motion]).vertices
    monkeypatch.setattr(drapery.engine, "__class__", NeverRun)
    got = drapery.compute(entry, [dataclasses.replace(motion, motion=0.0)])
    assert_array_equal(got.vertices, want)
    assert got.memories == (None,)
    single = drapery.compute(entry, [motion.part(slice(5, 6), None)])
    assert_array_equal(single.vertices, want[5:6])
    with pytest.raises(AssertionError, match="was run"):
        drapery.compute(entry, [motion])
    static.close()


@pytest.mark.parametrize("chunk", [1, 5, 64])
def test_chunks_hand_the_state_on(make_settings: Callable[..., Settings], drapery: Drapery, chunk: int):
    motion = clip_input()
    whole = drapery.compute(drapery.garments.get("tube"), [motion])
    chunked = Drapery(make_settings(model=TINY_DYNAMIC, chunk_frames=chunk))
    draped = asyncio.run(chunked.drape(chunked.garments.get("tube"), motion))
    assert_array_equal(draped.vertices, whole.vertices)
    last, want = draped.memories[0], whole.memories[0]
    assert last is not None and want is not None
    assert_array_equal(last.state, want.state)
    chunked.close()


def test_clients_of_any_number_and_length_swing_as_if_alone(drapery: Drapery):
    entry = drapery.garments.get("tube")
    inputs = [
        clip_input(TIMES_S, seed=1),
        clip_input(TIMES_S[:1], seed=2),
        clip_input(TIMES_S[:7] * 0.6, seed=3, motion=0.5),
        clip_input(TIMES_S[:9], seed=4, motion=0.0),
        dataclasses.replace(clip_input(TIMES_S[:4], seed=5), betas=np.full(10, 0.5)),
    ]
    # Two begin in the midst of a motion.
    memories = drapery.compute(entry, [clip_input(TIMES_S[:6] - 0.2, seed=i) for i in (1, 3)]).memories
    inputs[0], inputs[2] = (dataclasses.replace(inputs[i], memory=m) for i, m in zip((0, 2), memories, strict=True))
    together = drapery.compute(entry, inputs)
    alone = [drapery.compute(entry, [one]) for one in inputs]
    assert_array_equal(together.vertices, np.concatenate([one.vertices for one in alone]))
    for memory, one in zip(together.memories, alone, strict=True):
        own = one.memories[0]
        assert (memory is None) == (own is None)
        if memory is not None and own is not None:
            assert_array_equal(memory.state, own.state)
            assert_array_equal(memory.code, own.code)
    assert together.memories[3] is None
    shift = together.vertices[0] - drapery.compute(entry, [dataclasses.replace(inputs[0], motion=0.0)]).vertices[0]
    assert np.abs(shift).max() > 0.0, "a motion that goes on counts from its first frame"


# --- memory ---


def at(body: BodyModel, poses: np.ndarray, trans: np.ndarray) -> Kinematics:
    return kinematics(body, poses, trans)


def remembered(drapery: Drapery, times_s: np.ndarray, *, poses: np.ndarray, trans: np.ndarray) -> Memory:
    memory, bodies = nothing(drapery.engine), at(drapery.body, poses, trans)
    for i, time_s in enumerate(times_s):
        (memory,) = advance(drapery.engine, [memory], [Moment(float(time_s), bodies[i])])
    return memory


def test_dropped_frames_only_make_the_step_longer(drapery: Drapery, body: BodyModel):
    times_s = np.delete(TIMES_S, [4, 7, 8])
    poses, trans = smooth_motion(times_s)
    memory = remembered(drapery, times_s, poses=poses, trans=trans)
    assert_allclose(memory.code, expected_codes(body, poses, trans, times_s)[-1], rtol=1e-4, atol=1e-6)
    assert len(memory.moments) == 2


@pytest.mark.parametrize("case", ["pause", "back", "jump"])
def test_what_does_not_follow_begins_anew(drapery: Drapery, case: str):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(drapery, TIMES_S, poses=poses, trans=trans)
    assert np.abs(memory.state).max() > 0.0
    bodies = at(drapery.body, poses, trans)
    later_s = {"pause": STEP_LIMIT_S * 1.01, "back": -1e-3, "jump": 1 / 30}[case]
    body = bodies[-1]
    if case == "jump":
        body = dataclasses.replace(body, joints=body.joints + JUMP_M_S / 30 * 1.01 * SIDEWAYS)
    moment = Moment(float(TIMES_S[-1] + later_s), body)
    (anew,) = advance(drapery.engine, [memory], [moment])
    assert anew.moments == (moment,)
    assert_array_equal(anew.state, np.zeros(STATE_SIZE))
    assert_array_equal(anew.code, np.zeros(STATE_SIZE))


def test_just_within_the_limits_it_goes_on(drapery: Drapery):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(drapery, TIMES_S, poses=poses, trans=trans)
    body = at(drapery.body, poses, trans)[-1]
    fast = dataclasses.replace(body, joints=body.joints + JUMP_M_S / 30 * 0.99 * SIDEWAYS)
    for moment in (Moment(TIMES_S[-1] + 1 / 30, fast), Moment(TIMES_S[-1] + 0.99 * STEP_LIMIT_S, body)):
        (after,) = advance(drapery.engine, [memory], [moment])
        assert len(after.moments) == 2 and np.abs(after.state).max() > 0.0


def test_the_same_time_again_changes_nothing(drapery: Drapery):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(drapery, TIMES_S, poses=poses, trans=trans)
    (same,) = advance(drapery.engine, [memory], [Moment(float(TIMES_S[-1]), at(drapery.body, poses, trans)[0])])
    assert same is memory


def test_a_jittering_clock_makes_no_explosion(drapery: Drapery):
    trans = np.zeros((4, 3))
    trans[:, 0] = 0.01 * np.arange(4)  # one centimetre per frame, two of which come within a microsecond
    times_s = np.array([0.0, 1 / 60, 2 / 60, 2 / 60 + 1e-6])
    memory = remembered(drapery, times_s, poses=np.zeros((4, 24, 3)), trans=trans)
    step_s = 1.0 / 240.0
    speed = 0.01 / step_s - 0.01 * 60
    want = speed / (0.5 * (step_s + 1 / 60)) * step_s
    assert_allclose(memory.state, [want, 0.0, 0.0], rtol=1e-3, atol=1e-5)


def test_a_still_body_forgets(drapery: Drapery):
    poses, trans = smooth_motion(TIMES_S)
    memory = remembered(drapery, TIMES_S, poses=poses, trans=trans)
    body = at(drapery.body, poses, trans)[-1]
    states = []
    for i in range(1, 4):
        (memory,) = advance(drapery.engine, [memory], [Moment(float(TIMES_S[-1] + i / 30), body)])
        states.append(memory.state)
    # The stop itself is a push; after it the state only dies away.
    for before, after in pairwise(states):
        assert_allclose(after, before * np.exp(-1 / 30 / STATE_DECAY_S), rtol=1e-6, atol=0)


# --- streams ---


def put(session: Session, index: int, times_s: np.ndarray, poses: np.ndarray, trans: np.ndarray) -> None:
    session.put(wire.Pose(index, float(times_s[index]), trans[index], poses[index]))


def run_frames(streams: Streams, sessions: list[Session]) -> list[wire.Frame]:
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


def open_sessions(drapery: Drapery, knobs: list[float]) -> tuple[Streams, list[Session]]:
    entry = drapery.garments.get("tube")
    streams = Streams(drapery)
    sessions = [Session(entry, NO_SHAPE, push=False, credit=2, motion=knob) for knob in knobs]
    for session in sessions:
        streams.add(session)
    return streams, sessions


def test_every_stream_has_its_own_motion(drapery: Drapery, body: BodyModel, tube: Garment):
    knobs = [1.0, 0.5, 0.0]
    streams, sessions = open_sessions(drapery, knobs)
    motions = [smooth_motion(TIMES_S, seed=seed) for seed in range(3)]
    for index in range(len(TIMES_S)):
        for session, (poses, trans) in zip(sessions, motions, strict=True):
            put(session, index, TIMES_S, poses, trans)
        frames = run_frames(streams, sessions)
    for frame, knob, (poses, trans) in zip(frames, knobs, motions, strict=True):
        still = expected_vertices(body, tube, poses[-1:], trans[-1:])[0]
        code = knob * expected_codes(body, poses, trans, TIMES_S)[-1]
        assert_allclose(frame.vertices(), still + code, rtol=0, atol=0.5 * frame.box_step.max() + 3e-6)
    assert sessions[2].memory is None


def test_a_pose_that_was_dropped_is_only_time(drapery: Drapery, body: BodyModel, tube: Garment):
    streams, (session,) = open_sessions(drapery, [1.0])
    poses, trans = smooth_motion(TIMES_S)
    dropped = {4, 7, 8}
    for index in range(len(TIMES_S)):
        put(session, index, TIMES_S, poses, trans)
        if index not in dropped:
            (frame,) = run_frames(streams, [session])
    assert frame.dropped == len(dropped)
    kept = [i for i in range(len(TIMES_S)) if i not in dropped]
    code = expected_codes(body, poses[kept], trans[kept], TIMES_S[kept])[-1]
    still = expected_vertices(body, tube, poses[-1:], trans[-1:])[0]
    assert_allclose(frame.vertices(), still + code, rtol=0, atol=0.5 * frame.box_step.max() + 3e-6)


def test_motion_goes_on_over_another_garment_and_ends_with_another_shape(drapery: Drapery):
    streams, (session,) = open_sessions(drapery, [1.0])
    poses, trans = smooth_motion(TIMES_S)
    for index in range(6):
        put(session, index, TIMES_S, poses, trans)
        run_frames(streams, [session])
    memory = session.memory
    assert memory is not None and np.abs(memory.state).max() > 0.0
    other = dataclasses.replace(session.entry, id="other")
    session.reopen(other, NO_SHAPE.copy(), False, 1.0)
    assert session.memory is memory
    session.reopen(other, np.full(10, 0.1), False, 1.0)
    assert session.memory is None
    session.memory = memory
    session.reopen(other, session.betas, False, 0.0)
    assert session.memory is None


def test_a_frame_of_an_earlier_opening_leaves_no_memory(drapery: Drapery):
    _, (session,) = open_sessions(drapery, [1.0])
    session.reopen(session.entry, np.full(10, 0.1), False, 1.0)
    session.deliver(0, b"old", nothing(drapery.engine))
    assert session.memory is None and session.outbox is None


def test_a_batch_mate_that_fails_takes_nobody_along(drapery: Drapery):
    streams, sessions = open_sessions(drapery, [1.0, 1.0])
    motions = [smooth_motion(TIMES_S, seed=seed) for seed in range(2)]
    for index in range(5):
        for session, (poses, trans) in zip(sessions, motions, strict=True):
            put(session, index, TIMES_S, poses, trans)
        run_frames(streams, sessions)
    before = sessions[1].memory
    put(sessions[0], 5, TIMES_S, *motions[0])
    sessions[1].put(wire.Pose(5, float(TIMES_S[5]), np.zeros(3), np.full((24, 3), np.nan)))

    async def once() -> None:
        await streams._compute(streams._next_batch())

    asyncio.run(once())
    assert [session.failure is not None for session in sessions] == [False, True]
    assert sessions[1].memory is before
    alone = drapery.compute(sessions[0].entry, [clip_input(TIMES_S[:6], seed=0)]).memories[0]
    assert sessions[0].memory is not None and alone is not None
    assert_array_equal(sessions[0].memory.state, alone.state)
