"""The binary messages: what goes in comes out, and nothing else gets in."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import DrapeError, InputError
from drape.wire import messages as wire

finite32 = st.floats(-100.0, 100.0, width=32)


def pose_message(**changes: Any) -> bytes:
    values: dict[str, Any] = {
        "sequence": 7,
        "client_time_s": 1.5,
        "trans": np.arange(3.0),
        "pose": np.linspace(-1, 1, 72).reshape(24, 3),
    }
    return wire.pack_pose(wire.Pose(**(values | changes)))


def frame(vertices: np.ndarray) -> wire.Frame:
    return wire.Frame(3, 0.25, 1e9, np.array([1e4, 0.5, -2.0]), vertices, 5, 1234, True, 0.25, 0.007)


@given(
    sequence=st.integers(0, 2**32 - 1),
    time_s=st.floats(0, 1e10),
    trans=hnp.arrays(float, 3, elements=st.floats(-1e5, 1e5)),
    pose=hnp.arrays(np.float32, (24, 3), elements=finite32),
)
def test_pose_survives_the_wire_exactly(sequence, time_s, trans, pose):
    got = wire.unpack_pose(wire.pack_pose(wire.Pose(sequence, time_s, trans, pose)))
    assert (got.sequence, got.client_time_s) == (sequence, time_s)
    assert_array_equal(got.trans, trans)
    assert_array_equal(got.pose, pose)


@pytest.mark.parametrize("pushed", [False, True])
@pytest.mark.parametrize("stepped", [False, True])
def test_header_survives_the_wire_and_each_flag_is_its_own(pushed: bool, stepped: bool):
    sent = dataclasses.replace(frame(np.zeros((5, 3), np.float32)), pushed=pushed, stepped=stepped)
    got = wire.unpack_frame(wire.pack_frame(sent))
    kept = ("sequence", "client_time_s", "server_time_s", "dropped", "residence_us", "pushed_share")
    assert [getattr(got, name) for name in kept] == [getattr(sent, name) for name in kept]
    assert (got.pushed, got.stepped) == (pushed, stepped)
    assert_array_equal(got.root, sent.root)
    assert_allclose(got.push_max_m, sent.push_max_m, rtol=1e-6, atol=0)
    assert_allclose(got.vertices(), sent.root + sent.positions, rtol=0, atol=1e-8)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_payload_begins_and_ends_on_four_bytes(count: int):
    assert wire.FRAME_HEADER_BYTES % 4 == 0
    assert len(wire.pack_frame(frame(np.ones((count, 3), np.float32)))) % 4 == 0


@given(message=st.binary(max_size=400))
def test_noise_is_refused(message):
    for read in (wire.unpack_pose, wire.unpack_ack, wire.unpack_frame):
        with pytest.raises(DrapeError):
            read(message)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused_by_name(value: float):
    pose = np.zeros((24, 3))
    pose[3, 1] = value
    with pytest.raises(InputError, match=r"pose\[10\]"):
        wire.unpack_pose(pose_message(pose=pose))
    with pytest.raises(InputError, match=r"trans\[2\]"):
        wire.unpack_pose(pose_message(trans=np.array([0, 0, value])))
    with pytest.raises(InputError, match="client_time_s"):
        wire.unpack_pose(pose_message(client_time_s=value))


@pytest.mark.parametrize(("offset", "word"), [(0, "magic"), (4, "version"), (5, "kind")])
def test_a_message_of_another_origin_version_or_kind_is_refused(offset: int, word: str):
    message = bytearray(pose_message())
    message[offset] ^= 0x55
    with pytest.raises(InputError, match=word):
        wire.unpack_pose(bytes(message))


def test_a_message_of_another_size_is_refused():
    for message in (pose_message()[:-1], pose_message() + b"\0"):
        with pytest.raises(InputError, match="336 bytes"):
            wire.unpack_pose(message)
    with pytest.raises(InputError, match="for 5 vertices"):
        wire.unpack_frame(wire.pack_frame(frame(np.zeros((5, 3), np.float32))) + b"\0\0\0\0")
    with pytest.raises(InputError, match="at least 16"):
        wire.message_kind(b"DRPE")


def test_ack_carries_its_sequence():
    message = wire.pack_ack(4_000_000_000)
    assert wire.message_kind(message) == wire.ACK
    assert wire.unpack_ack(message) == 4_000_000_000


def test_a_frame_that_holds_is_told_by_its_numbers_alone():
    answer = wire.Answer(4_000_000_000, 1.25, 2.5, dropped=3, residence_us=2**33)
    message = wire.pack_same(answer)
    assert len(message) == wire.SAME_BYTES == 40 and wire.message_kind(message) == wire.SAME
    assert wire.unpack_same(message) == dataclasses.replace(answer, residence_us=2**32 - 1)
    frame = wire.Frame(1, 0.5, 0.75, np.ones(3), np.zeros((4, 3), np.float32), 1, 7, pushed=True, novelty=0.5)
    told = dataclasses.replace(frame, **dataclasses.asdict(wire.unpack_same(message)))
    assert wire.pack_frame(told) == wire.resent(wire.pack_frame(frame), answer)
    with pytest.raises(InputError, match="same message: expected 40 bytes, got 39"):
        wire.unpack_same(message[:-1])
