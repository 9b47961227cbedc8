"""CLIP messages: what goes in comes out, and nothing else gets in."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from drape.errors import InputError, MotionError
from drape.wire import messages as wire
from drape.wire.clip_message import FRAME_BYTES, HEADER_BYTES, frame_bytes, of_rig, pack_clip, unpack_clip

POSES, TRANS = np.linspace(-1.0, 1.0, 144).reshape(2, 24, 3), np.arange(6.0).reshape(2, 3)


@given(
    poses=hnp.arrays(float, st.tuples(st.integers(0, 4), st.just(24), st.just(3))), placed=st.booleans(), name=st.text()
)
def test_a_clip_survives_the_wire_exactly(poses, placed, name):
    trans = poses[:, 0] if placed else None
    text, got, places = unpack_clip(pack_clip({"garment": name}, poses, trans))
    assert json.loads(text) == {"garment": name}
    assert_array_equal(got, poses)
    assert (places is None) == (trans is None)
    if trans is not None:
        assert_array_equal(places, trans)


@given(count=st.integers(0, 4), nodes=st.integers(1, 7), placed=st.booleans())
def test_a_clip_of_a_rig_survives_the_wire_exactly(count, nodes, placed):
    turns = np.random.default_rng(count).normal(size=(count, nodes, 4))
    trans = turns[:, 0, :3] if placed else None
    message = pack_clip({"avatar": "me"}, turns, trans)
    text, got, places = unpack_clip(message)
    assert json.loads(text) == {"avatar": "me"} and of_rig(got)
    assert_array_equal(got, turns)
    assert (places is None) == (trans is None)
    assert len(message) <= HEADER_BYTES + count * frame_bytes(turns) + len(text)


def test_a_frame_has_six_hundred_bytes():
    message = pack_clip({}, POSES, TRANS)
    assert len(message) == HEADER_BYTES + 2 * FRAME_BYTES + len("{}") and FRAME_BYTES == 600


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b"", "at least 24 bytes"),
        (pack_clip({}, POSES, TRANS)[:-1], "for 2 frames and 2 bytes of JSON"),
        (pack_clip({}, np.zeros((2, 5, 4)), TRANS)[:-1], "for 2 frames of 5 nodes and 2 bytes of JSON"),
        (pack_clip({}, POSES, None) + b" ", "for 2 frames and 2 bytes of JSON"),
        (wire.pack_pose(wire.Pose(0, 0.0, TRANS[0], POSES[0])), "kind 6"),
    ],
)
def test_what_is_no_clip_is_refused(message: bytes, said: str):
    with pytest.raises(InputError, match=f"clip message: expected .*{said}"):
        unpack_clip(message)


def test_arrays_of_other_shapes_are_not_packed():
    with pytest.raises(MotionError, match=r"poses: expected shape \(any, 24, 3\), got shape \(2, 23, 3\)"):
        pack_clip({}, POSES[:, :23], None)
    with pytest.raises(MotionError, match=r"trans: expected shape \(2, 3\), got shape \(1, 3\)"):
        pack_clip({}, POSES, TRANS[:1])
