"""RIG_POSE, a pose of an avatar's own rig: the local rotation of each of its nodes, where POSE has SMPL's joints.

After the header come four float32 for each node, x, y, z, w, in the order in which ``GET /avatars/{id}`` tells them.
``trans`` is where the node of the pelvis is [m], if the flags say so; at its rest place otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.errors import InputError, MotionError
from drape.wire import messages as wire

FLAG_PLACED = 1  # the message has the place of the pelvis
UNIT_TOLERANCE = 1e-3  # that of ``drape.motion.rig_poses``
_HEADER = wire.record(wire.LAYOUTS["RIG_POSE"])
HEADER_BYTES = _HEADER.size
SHOWN = 3  # nodes that a refusal names


@dataclass(frozen=True, eq=False)
class RigPose:
    """One pose to drape: local ``quaternions`` (N, 4), x, y, z, w, of the rig's nodes; ``place`` (3,) [m], where the
    node of the pelvis is in the world, None for its rest place; time of the client's clock [s]."""

    sequence: int
    client_time_s: float
    place: np.ndarray | None
    quaternions: np.ndarray


def pack_rig_pose(pose: RigPose) -> bytes:
    """Returns the RIG_POSE message of ``pose``; refuses (``MotionError``) quaternions of another shape."""
    turns = np.asarray(pose.quaternions)
    if turns.ndim != 2 or turns.shape[1] != 4:
        cure = "Give one frame: x, y, z, w of each node."
        raise MotionError("quaternions", expected="shape (nodes, 4)", got=f"shape {turns.shape}", cure=cure)
    place = np.zeros(3) if pose.place is None else np.ravel(pose.place)
    flags = 0 if pose.place is None else FLAG_PLACED
    prefix = (wire.MAGIC, wire.WIRE_VERSION, wire.RIG_POSE, flags, pose.sequence, len(turns))
    return _HEADER.pack(*prefix, pose.client_time_s, *place) + np.ascontiguousarray(turns, "<f4").tobytes()


def unpack_rig_pose(message: bytes, nodes: int) -> RigPose:
    """Returns the pose in the RIG_POSE ``message`` for an avatar of so many ``nodes``.

    Refuses (``InputError``) another size, version, kind or number of nodes and numbers that are not finite, and
    (``MotionError``) quaternions that are not of length one.
    """
    name = "rig pose message"
    wire.check_prefix(name, message, wire.RIG_POSE, least=HEADER_BYTES)
    values = _HEADER.unpack_from(message)
    flags, sequence, count, time_s = values[3], values[4], values[5], values[6]
    if count != nodes:
        cure = "GET /avatars/ID tells the nodes in their order."
        raise InputError(name, expected=f"{nodes} quaternions, one a node of the avatar", got=str(count), cure=cure)
    wire.check_length(name, message, HEADER_BYTES + 16 * nodes, f"for {nodes} nodes")
    turns = np.frombuffer(message, "<f4", 4 * nodes, HEADER_BYTES).reshape(nodes, 4).astype(np.float64)
    place = np.array(values[7:10])
    if not (np.isfinite(time_s) and np.isfinite(place).all() and np.isfinite(turns).all()):
        bad = np.argwhere(~np.isfinite(turns))
        where = f"the quaternion of node {bad[0][0]}" if len(bad) else "its time or its place"
        cure = "Send only finite rotations, places and times."
        raise InputError(name, expected="finite numbers", got=f"NaN or infinity in {where}", cure=cure)
    length = np.linalg.norm(turns, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)
    if len(wrong):
        listed = ", ".join(f"{length[node]:.4g} of node {node}" for node in wrong[:SHOWN])
        more = f" and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
        cure = "Send rotations without scale, x, y, z, w."
        raise MotionError(name, expected="unit quaternions", got=f"lengths {listed}{more}", cure=cure)
    return RigPose(sequence, time_s, place if flags & FLAG_PLACED else None, turns)
