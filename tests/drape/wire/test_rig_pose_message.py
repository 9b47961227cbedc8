"""RIG_POSE messages: what goes in comes out, and nothing else gets in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from drape.errors import DrapeError, InputError, MotionError
from drape.wire import messages as wire
from drape.wire.rig_pose_message import HEADER_BYTES, RigPose, pack_rig_pose, unpack_rig_pose

NODES = 5
REST = np.tile(np.array([0.0, 0.0, 0.0, 1.0], np.float32), (NODES, 1))


def turned(seed: int = 0) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=(NODES, 4))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)


def message(**changes: Any) -> bytes:
    values: dict[str, Any] = {"sequence": 7, "client_time_s": 1.5, "place": np.arange(3.0), "quaternions": REST}
    return pack_rig_pose(RigPose(**(values | changes)))


@given(sequence=st.integers(0, 2**32 - 1), time_s=st.floats(0, 1e10), seed=st.integers(0, 99), placed=st.booleans())
def test_a_pose_survives_the_wire_exactly(sequence: int, time_s: float, seed: int, placed: bool):
    place = np.array([1e5, -0.25, seed]) if placed else None
    sent = pack_rig_pose(RigPose(sequence, time_s, place, turned(seed)))
    got = unpack_rig_pose(sent, NODES)
    assert len(sent) == HEADER_BYTES + 16 * NODES == 48 + 16 * NODES
    assert (got.sequence, got.client_time_s) == (sequence, time_s)
    assert_array_equal(got.quaternions, turned(seed))
    assert (got.place is None) == (place is None)
    if got.place is not None:
        assert_array_equal(got.place, place)


def spoilt(value: float, node: int = 3) -> np.ndarray:
    turns = REST.copy()
    turns[node, 1] = value
    return turns


@pytest.mark.parametrize(
    ("sent", "kind", "said"),
    [
        (b"", InputError, "at least 48 bytes"),
        (message()[:-1], InputError, "128 bytes for 5 nodes, got 127"),
        (message() + b"\0", InputError, "128 bytes for 5 nodes, got 129"),
        (message(quaternions=REST[:4]), InputError, "5 quaternions, one a node of the avatar, got 4"),
        (message(quaternions=np.tile(REST, (900, 1))), InputError, "one a node of the avatar, got 4500"),
        (wire.pack_pose(wire.Pose(0, 0.0, np.zeros(3), np.zeros((24, 3)))), InputError, "kind 9"),
        (message(quaternions=spoilt(np.nan)), InputError, "in the quaternion of node 3"),
        (message(quaternions=spoilt(np.inf)), InputError, "in the quaternion of node 3"),
        (message(place=np.array([0.0, np.nan, 0.0])), InputError, "its time or its place"),
        (message(client_time_s=np.inf), InputError, "its time or its place"),
        (message(quaternions=spoilt(3e30)), MotionError, "of node 3"),
        (message(quaternions=0.5 * REST), MotionError, "0.5 of node 0, 0.5 of node 1, 0.5 of node 2 and 2 more"),
        (message(quaternions=np.zeros((NODES, 4))), MotionError, "unit quaternions"),
    ],
)
def test_what_is_no_pose_of_this_rig_is_refused(sent: bytes, kind: type[DrapeError], said: str):
    with pytest.raises(kind, match=f"rig pose message: expected .*{said}"):
        unpack_rig_pose(sent, NODES)


@given(sent=st.binary(max_size=200))
def test_noise_is_refused(sent: bytes):
    with pytest.raises(DrapeError):
        unpack_rig_pose(sent, NODES)


@pytest.mark.parametrize("turns", [np.zeros(4), np.zeros((2, 3)), np.zeros((2, 5, 4))])
def test_arrays_of_other_shapes_are_not_packed(turns: np.ndarray):
    with pytest.raises(MotionError, match=r"shape \(nodes, 4\)"):
        message(quaternions=turns)


def test_still_is_what_neither_turns_nor_goes():
    moved = np.array([1e-3, 1.0, 2.0])
    assert wire.pose_content(message()) == wire.pose_content(message(sequence=8, client_time_s=2.0))
    assert wire.pose_content(message()) != wire.pose_content(message(quaternions=spoilt(1e-3)))
    assert wire.pose_content(message()) != wire.pose_content(message(place=moved))
    ours = [wire.pack_pose(wire.Pose(1, 0.0, place, np.zeros((24, 3)))) for place in (np.arange(3.0), moved)]
    assert wire.pose_content(ours[0]) != wire.pose_content(ours[1])  # along x alone
