"""Frames of jets: what goes in comes out within half a step, and nothing else gets in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import DrapeError, InputError
from drape.geometry.rotations import quaternion_to_matrix, rotvec_to_matrix
from drape.wire import messages as wire
from drape.wire.jets import (
    COARSE,
    COARSE_COUNT,
    FINE,
    HEADER_BYTES,
    ROW_BYTES,
    UNIT,
    JetFrame,
    message_bytes,
    pack_jets,
    split_jets,
    unpack_jets,
)


def frame(count: int, *, seed: int = 0, **changes: Any) -> JetFrame:
    generator = np.random.default_rng(seed)
    values: dict[str, Any] = {
        "sequence": 7,
        "client_time_s": 1.5,
        "server_time_s": 1e9,
        "root": np.array([1e4, 0.5, -2.0]),
        "jet": generator.normal(size=(count, 45)).astype(np.float32),
        "rotation": rotvec_to_matrix(generator.normal(size=(count, 3))).astype(np.float32),
        "centre": generator.uniform(-1.0, 1.0, size=(count, 3)).astype(np.float32),
        "dropped": 3,
        "residence_us": 1234,
        "pushed": True,
        "pushed_share": 0.25,
        "push_max_m": 0.007,
        "left_m": 0.002,
    }
    return JetFrame(**(values | changes))


@given(count=st.integers(1, 40), seed=st.integers(0, 2**16))
def test_numbers_are_within_half_a_step_of_their_own_boxes(count: int, seed: int):
    sent = frame(count, seed=seed)
    got = unpack_jets(pack_jets(sent))
    for columns, steps in ((FINE, wire.STEP_COUNT), (COARSE, COARSE_COUNT)):
        values = sent.jet[:, columns]
        step = (values.max(axis=0) - values.min(axis=0)) / steps
        assert (np.abs(got.jet[:, columns] - values) <= 0.501 * step + 1e-6).all()
    extent = sent.centre.max(axis=0) - sent.centre.min(axis=0)
    assert (np.abs(got.centre - sent.centre) <= 0.501 * extent / wire.STEP_COUNT + 1e-6).all()
    # Four components, each off by half a step, turn a rotation by at most twice their length.
    assert np.abs(got.rotation - sent.rotation).max() <= 2.0 * 2.0 * 0.5 / UNIT + 1e-6
    assert_allclose(got.rotation @ np.swapaxes(got.rotation, 1, 2), np.tile(np.eye(3), (count, 1, 1)), atol=1e-5)


def test_half_turns_survive():
    turns = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, -0.8, 0], [1, 0, 0, 0]], dtype=float)
    sent = frame(5, rotation=quaternion_to_matrix(turns))
    assert_allclose(unpack_jets(pack_jets(sent)).rotation, sent.rotation, rtol=0, atol=1e-4)


def test_header_survives_the_wire():
    sent = frame(4)
    got = unpack_jets(pack_jets(sent))
    for name in ("sequence", "client_time_s", "server_time_s", "dropped", "residence_us", "pushed", "pushed_share"):
        assert getattr(got, name) == getattr(sent, name)
    assert_array_equal(got.root, sent.root)
    assert_allclose([got.push_max_m, got.left_m], [sent.push_max_m, sent.left_m], rtol=1e-6, atol=0)
    assert not unpack_jets(pack_jets(frame(1, pushed=False))).pushed
    assert unpack_jets(pack_jets(frame(1, pushed=False, stepped=True))).stepped


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 110])
def test_messages_have_the_stated_length_and_end_on_four_bytes(count: int):
    assert HEADER_BYTES % 4 == 0 and ROW_BYTES == 77
    if count:
        assert len(pack_jets(frame(count))) == message_bytes(count)
    assert message_bytes(count) % 4 == 0
    assert 0 <= message_bytes(count) - HEADER_BYTES - 77 * count < 4


@given(message=st.binary(max_size=1000))
def test_noise_is_refused(message: bytes):
    with pytest.raises(DrapeError):
        unpack_jets(message)
    if message:
        with pytest.raises(DrapeError):
            split_jets(message)


def test_messages_of_another_size_kind_or_content_are_refused():
    message = pack_jets(frame(5))
    with pytest.raises(InputError, match="bytes for 5 patches"):
        unpack_jets(message + b"\0\0\0\0")
    other = wire.pack_frame(wire.Frame(1, 0.0, 0.0, np.zeros(3), np.zeros((200, 3), np.float32)))
    with pytest.raises(InputError, match="expected kind 4, got kind 3"):
        unpack_jets(other)
    with pytest.raises(InputError, match="at least 460 bytes"):
        unpack_jets(message[:100])
    nothing = bytearray(message)
    nothing[HEADER_BYTES + 6 : HEADER_BYTES + 14] = (UNIT.to_bytes(2, "little")) * 4
    with pytest.raises(InputError, match="unit quaternions, got one of length 0"):
        unpack_jets(bytes(nothing))
    with pytest.raises(InputError, match=r"jet: expected shape \(any, 45\)"):
        pack_jets(frame(5, jet=np.zeros((5, 27), np.float32)))


def test_a_clip_is_one_message_after_the_other():
    clip = [frame(3, sequence=i, seed=i) for i in range(4)]
    content = b"".join(pack_jets(one) for one in clip)
    assert [got.sequence for got in split_jets(content)] == [0, 1, 2, 3]
    with pytest.raises(InputError):
        split_jets(content[:-4])
    assert split_jets(b"") == []


def test_a_frame_parts_into_garments():
    whole = frame(7)
    inner, outer = whole.layers([3, 4])
    assert_array_equal(inner.jet, whole.jet[:3])
    assert_array_equal(outer.centre, whole.centre[3:])
    assert inner.sequence == whole.sequence and inner.left_m == whole.left_m
    for counts in ([3, 3], [], [8]):
        with pytest.raises(InputError, match="expected 7, as in the frame"):
            whole.layers(counts)
