"""The binary messages of the stream, defined once; ``scripts/sync_wire.py`` writes the browser's copy.

All numbers are little endian. Every message begins with the same 16 bytes (magic,
version, kind, flags, sequence, count). The client sends POSE and ACK, the service FRAME. A stream on an avatar takes
RIG_POSE in place of POSE (``drape.wire.rig_pose_message``).
Vertices travel as 16-bit steps inside the frame's own bounding box, relative to the
root joint: half a step of a 2 m box is 0.015 mm. A client that asked for jets gets JETS in place of FRAME
(``drape.wire.jets``) and once per garment a LAYOUT (``drape.wire.layout``). A request of REST may send its motion as a
CLIP (``drape.wire.clip_message``); a stream that can move to another process takes STATE along
(``drape.wire.state_pieces``). A client that can take SAME gets it in place of the frame while the body stands still.
With FOLDS (``drape.wire.folds_message``) a client makes folds by itself. Meshes at rest come as MESH and BODY
(``drape.wire.mesh_messages``). The conversation: docs/reference/wire.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np

from drape.errors import InputError
from drape.geometry import jets

WIRE_VERSION = 1
SUBPROTOCOL = f"drape.v{WIRE_VERSION}"
MAGIC = 0x45505244  # "DRPE" in file order
POSE, ACK, FRAME, JETS, LAYOUT, CLIP, STATE, SAME, RIG_POSE, FOLDS, MESH, BODY = range(1, 13)
FLAG_PUSHED = 1  # the vertices were pushed out of the body
FLAG_STEPPED = 2  # the service is under load and has stepped the stream down
FLAG_UNLIKE = 4  # the pose is unlike those that the network was trained on
FLAG_BYTES = 8  # steps of a FRAME are bytes
BYTE_COUNT = 255
NOVELTY_SHIFT, NOVELTY_STEPS = 8, 32  # the upper byte of the flags: steps of 1/32, 255 for all that is more
STEP_COUNT = 65535
FLAT_M = 1e-9  # the least step: a box may be flat
POSE_SIZE = 72

# name, type, count; each layout starts with PREFIX. Types: u8 u16 u32 f32 f64.
Layout = tuple[tuple[str, str, int], ...]
PREFIX: Layout = (
    ("magic", "u32", 1),
    ("version", "u8", 1),
    ("kind", "u8", 1),
    ("flags", "u16", 1),
    ("sequence", "u32", 1),
    ("count", "u32", 1),
)
LAYOUTS: dict[str, Layout] = {
    "POSE": (*PREFIX, ("client_time_s", "f64", 1), ("trans", "f64", 3), ("pose", "f32", POSE_SIZE)),
    "ACK": PREFIX,
    "FRAME": (
        *PREFIX,
        ("client_time_s", "f64", 1),
        ("server_time_s", "f64", 1),
        ("root", "f64", 3),
        ("box_low", "f32", 3),
        ("box_step", "f32", 3),
        ("dropped", "u32", 1),
        ("residence_us", "u32", 1),
        ("pushed_share", "f32", 1),
        ("push_max_m", "f32", 1),
    ),
    "JETS": (
        *PREFIX,
        ("client_time_s", "f64", 1),
        ("server_time_s", "f64", 1),
        ("root", "f64", 3),
        ("dropped", "u32", 1),
        ("residence_us", "u32", 1),
        ("pushed_share", "f32", 1),
        ("push_max_m", "f32", 1),
        ("left_m", "f32", 1),
        ("centre_low", "f32", 3),
        ("centre_step", "f32", 3),
        ("jet_low", "f32", jets.FULL_COUNT),
        ("jet_step", "f32", jets.FULL_COUNT),
    ),
    "SAME": (
        *PREFIX,
        ("client_time_s", "f64", 1),
        ("server_time_s", "f64", 1),
        ("dropped", "u32", 1),
        ("residence_us", "u32", 1),
    ),
    "LAYOUT": (*PREFIX, ("vertices", "u32", 1), ("charts", "u32", 1)),
    "CLIP": (*PREFIX, ("text_bytes", "u32", 1), ("nodes", "u32", 1)),
    "RIG_POSE": (*PREFIX, ("client_time_s", "f64", 1), ("trans", "f64", 3)),
    "MESH": (*PREFIX, ("copies", "u32", 1), ("triangles", "u32", 1), ("uv_step", "f32", 1), ("uv_metres", "f32", 1)),
    "BODY": (
        *PREFIX,
        ("triangles", "u32", 1),
        ("step_m", "f32", 1),
        ("weight_step", "f32", 1),
        ("joints", "f32", POSE_SIZE),
    ),
}
_CODES = {"u8": "B", "u16": "H", "u32": "I", "f32": "f", "f64": "d"}


def record(layout: Layout) -> struct.Struct:
    """Returns the ``Struct`` of the fields of ``layout``, little endian."""
    return struct.Struct("<" + "".join(f"{count}{_CODES[kind]}" for _, kind, count in layout))


_POSE, _ACK, _FRAME, _SAME = (record(LAYOUTS[name]) for name in ("POSE", "ACK", "FRAME", "SAME"))
STAMP_BYTES = record((*PREFIX, ("client_time_s", "f64", 1))).size  # prefix and time of a POSE or RIG_POSE
POSE_BYTES, ACK_BYTES, FRAME_HEADER_BYTES, SAME_BYTES = _POSE.size, _ACK.size, _FRAME.size, _SAME.size


@dataclass(frozen=True, eq=False)
class Pose:
    """One pose to drape: rotation vectors ``pose`` (24, 3) [rad], root translation ``trans`` (3,) [m], time of the
    client's clock [s], and the number of the pose in the stream."""

    sequence: int
    client_time_s: float
    trans: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True, eq=False)
class Frame:
    """One draped frame. ``sequence`` and ``client_time_s`` are those of its pose.

    ``positions`` (V, 3) float32 [m] count from ``root`` (3,) float64 [m] in the world's axes. ``dropped``: poses of the
    stream that a newer one replaced, so far. ``residence_us``: time from the arrival of the pose to the sending of the
    frame. ``pushed``: whether push-out was on; it moved ``pushed_share`` (0 to 1) of the vertices, the furthest by
    ``push_max_m``. ``stepped``: less was computed than the client asked for. ``novelty``: how unlike training the pose
    is; above 1 it is novel. A coordinate has ``bits`` on the wire, 8 or 16, and steps of ``box_step`` (3,) [m].
    """

    sequence: int
    client_time_s: float
    server_time_s: float
    root: np.ndarray
    positions: np.ndarray
    dropped: int = 0
    residence_us: int = 0
    pushed: bool = False
    pushed_share: float = 0.0
    push_max_m: float = 0.0
    box_step: np.ndarray = field(default_factory=lambda: np.zeros(3, np.float32))
    stepped: bool = False
    novelty: float = 0.0
    bits: int = 16

    def vertices(self) -> np.ndarray:
        """Returns the vertices [m] (V, 3) in the world, float64."""
        return self.positions + self.root


@dataclass(frozen=True)
class Answer:
    """The fields of a ``Frame`` that belong to the pose which it answers."""

    sequence: int
    client_time_s: float
    server_time_s: float
    dropped: int = 0
    residence_us: int = 0


def frame_flags(pushed: bool, stepped: bool, novelty: float) -> int:
    """Returns the field ``flags`` of a FRAME or JETS message: the bits ``FLAG_PUSHED``, ``FLAG_STEPPED`` and
    ``FLAG_UNLIKE``, and from bit ``NOVELTY_SHIFT`` on ``novelty`` in steps of 1/32. ``FLAG_BYTES`` is left 0."""
    steps = min(255, round(NOVELTY_STEPS * min(novelty, 255.0)))
    return FLAG_PUSHED * pushed | FLAG_STEPPED * stepped | FLAG_UNLIKE * (novelty > 1.0) | steps << NOVELTY_SHIFT


def flagged_novelty(flags: int) -> float:
    """Returns the novelty in the ``flags`` of a FRAME or JETS message, exact to 1/64 and at most 8: above 1 the pose is
    novel."""
    return (flags >> NOVELTY_SHIFT) / NOVELTY_STEPS


def pack_pose(pose: Pose) -> bytes:
    """Returns the POSE message of ``pose``."""
    prefix = (MAGIC, WIRE_VERSION, POSE, 0, pose.sequence, 1)
    return _POSE.pack(*prefix, pose.client_time_s, *np.ravel(pose.trans), *np.ravel(pose.pose))


def pose_content(message: bytes) -> bytes:
    """Returns the bytes of translation and pose in a POSE or RIG_POSE ``message``. Messages of one pose have the
    same."""
    return message[STAMP_BYTES:]


def unpack_pose(message: bytes) -> Pose:
    """Returns the pose in the POSE ``message``.

    Refuses (``InputError``) another size, version or kind, and numbers that are not finite.
    """
    check_prefix("pose message", message, POSE, POSE_BYTES)
    values = _POSE.unpack(message)
    numbers = np.array(values[6:])
    if not math.isfinite(sum(values[6:])) and not np.isfinite(numbers).all():
        index = int(np.argmin(np.isfinite(numbers)))
        raise InputError(
            "pose message",
            expected="finite numbers",
            got=f"{numbers[index]} in {_name_of('POSE', index)}",
            cure="Send only finite rotations, translations and times.",
        )
    return Pose(sequence=values[4], client_time_s=values[6], trans=numbers[1:4], pose=numbers[4:].reshape(24, 3))


def pack_ack(sequence: int) -> bytes:
    """Returns the ACK message, which says that the client has taken the frame ``sequence``."""
    return _ACK.pack(MAGIC, WIRE_VERSION, ACK, 0, sequence, 0)


def unpack_ack(message: bytes) -> int:
    """Returns the sequence number of the frame that the ACK ``message`` says was taken."""
    check_prefix("ack message", message, ACK, ACK_BYTES)
    return _ACK.unpack(message)[4]


def message_kind(message: bytes) -> int:
    """Returns the kind of a message, such as ``POSE``, unchecked; refuses (``InputError``) fewer than 16 bytes."""
    if len(message) < ACK_BYTES:
        raise InputError(
            "message",
            expected=f"at least {ACK_BYTES} bytes",
            got=f"{len(message)} bytes",
            cure="See docs/reference/wire.md.",
        )
    return message[5]


def quantise(positions: np.ndarray, count: int = STEP_COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns ``positions`` (V, n) in whole steps between the least and the greatest number of each column: the steps
    (V, n) uint16 from 0 to ``count``, the least numbers (n,), and the size of a step in each column (n,), both float32
    in the unit of ``positions``."""
    # By columns, a copy: along rows of three NumPy takes eight times as long.
    columns = np.array(positions.T, dtype=np.float32, order="C")
    low = columns.min(axis=1)
    step = np.maximum((columns.max(axis=1) - low) / np.float32(count), np.float32(FLAT_M))
    columns -= low[:, None]
    columns /= step[:, None]
    np.rint(columns, out=columns)  # within 0 and count: the division is off by two roundings at most
    steps = np.empty(positions.shape, np.uint16)
    steps.T[...] = columns
    return steps, low, step


Quantise = Callable[[np.ndarray, int], tuple[np.ndarray, np.ndarray, np.ndarray]]


def dequantise(steps: np.ndarray, low: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Returns the numbers (V, n) float32 that ``steps`` (V, n) stand for: ``low`` (n,) + ``steps`` * ``step`` (n,)."""
    return low + step * steps.astype(np.float32)


def pack_frame(frame: Frame, quantise: Quantise = quantise) -> bytes:
    """Returns the FRAME message of ``frame``: header, then 3 uint16 or bytes a vertex, padded to a multiple of 4 bytes.

    ``quantise`` may be another function with the same results.
    """
    bytes_each = frame.bits == 8
    steps, low, step = quantise(frame.positions, BYTE_COUNT if bytes_each else STEP_COUNT)
    flags = frame_flags(frame.pushed, frame.stepped, frame.novelty) | FLAG_BYTES * bytes_each
    header = _FRAME.pack(
        MAGIC, WIRE_VERSION, FRAME, flags,
        frame.sequence, len(steps),
        frame.client_time_s, frame.server_time_s, *frame.root, *low, *step,
        frame.dropped, min(frame.residence_us, 0xFFFFFFFF), frame.pushed_share, frame.push_max_m,
    )  # fmt: skip
    payload = np.ascontiguousarray(steps, "u1" if bytes_each else "<u2")
    return b"".join((header, payload.data, b"\0" * (-payload.nbytes % 4)))


def pack_same(answer: Answer) -> bytes:
    """Returns the SAME message, which says that the last FRAME or JETS answers the pose of ``answer`` too."""
    residence_us = min(answer.residence_us, 0xFFFFFFFF)
    prefix = (MAGIC, WIRE_VERSION, SAME, 0, answer.sequence, 0)
    return _SAME.pack(*prefix, answer.client_time_s, answer.server_time_s, answer.dropped, residence_us)


def unpack_same(message: bytes) -> Answer:
    """Returns the answer in the SAME ``message``; refuses (``InputError``) another size, version or kind."""
    check_prefix("same message", message, SAME, SAME_BYTES)
    values = _SAME.unpack(message)
    return Answer(values[4], *values[6:])


def resent(message: bytes, answer: Answer) -> bytes:
    """Returns the FRAME or JETS ``message`` with the fields of ``answer`` in its header: the same frame as the answer
    to another pose."""
    kind = {FRAME: "FRAME", JETS: "JETS"}[message_kind(message)]
    values = asdict(answer) | {"residence_us": min(answer.residence_us, 0xFFFFFFFF)}
    again, offset = bytearray(message), 0
    for name, number, count in LAYOUTS[kind]:
        form = struct.Struct(f"<{count}{_CODES[number]}")
        if name in values:
            form.pack_into(again, offset, values[name])
        offset += form.size
    return bytes(again)


def unpack_frame(message: bytes) -> Frame:
    """Returns the frame in the FRAME ``message``; refuses (``InputError``) another size, version or kind."""
    check_prefix("frame message", message, FRAME, least=FRAME_HEADER_BYTES)
    values = _FRAME.unpack_from(message)
    count = values[5]
    bits = 8 if values[3] & FLAG_BYTES else 16
    payload = count * 3 * bits // 8
    size = FRAME_HEADER_BYTES + payload + -payload % 4
    check_length("frame message", message, size, f"for {count} vertices")
    kind = "u1" if bits == 8 else "<u2"
    steps = np.frombuffer(message, dtype=kind, count=count * 3, offset=FRAME_HEADER_BYTES).reshape(count, 3)
    low, step = np.array(values[11:14], np.float32), np.array(values[14:17], np.float32)
    return Frame(
        sequence=values[4],
        client_time_s=values[6],
        server_time_s=values[7],
        root=np.array(values[8:11]),
        positions=dequantise(steps, low, step),
        dropped=values[17],
        residence_us=values[18],
        pushed=bool(values[3] & FLAG_PUSHED),
        stepped=bool(values[3] & FLAG_STEPPED),
        novelty=flagged_novelty(values[3]),
        bits=bits,
        pushed_share=values[19],
        push_max_m=values[20],
        box_step=step,
    )


def check_prefix(name: str, message: bytes, kind: int, size: int | None = None, *, least: int = ACK_BYTES) -> None:
    """Refuses (``InputError``) a ``message`` of fewer than ``least`` bytes, of not ``size`` bytes where that is given,
    or of another magic, version or ``kind``. ``name`` is what the refusal calls it."""
    if (size is not None and len(message) != size) or len(message) < least:
        wanted = f"{size} bytes" if size is not None else f"at least {least} bytes"
        raise InputError(
            name, expected=wanted, got=f"{len(message)} bytes", cure="See docs/reference/wire.md for the layout."
        )
    magic, version, got_kind, *_ = _ACK.unpack_from(message)
    if magic != MAGIC or version != WIRE_VERSION:
        raise InputError(
            name,
            expected=f"magic {MAGIC:#x} and version {WIRE_VERSION}",
            got=f"magic {magic:#x} and version {version}",
            cure="Use a client of the same release as the service.",
        )
    if got_kind != kind:
        raise InputError(
            name, expected=f"kind {kind}", got=f"kind {got_kind}", cure="See docs/reference/wire.md for the kinds."
        )


def check_length(name: str, message: bytes, size: int, what: str) -> None:
    """Refuses (``InputError``) a ``message`` that has not ``size`` bytes. ``name`` is what the refusal calls it, and
    ``what`` says what the bytes are for."""
    if len(message) != size:
        got = f"{len(message)} bytes"
        raise InputError(name, expected=f"{size} bytes {what}", got=got, cure="See docs/reference/wire.md.")


def _name_of(layout: str, index: int) -> str:
    """The field that holds the number ``index`` after the prefix."""
    for name, _, count in LAYOUTS[layout][len(PREFIX) :]:
        if index < count:
            return f"{name}[{index}]" if count > 1 else name
        index -= count
    raise AssertionError("the index lies outside the layout")
