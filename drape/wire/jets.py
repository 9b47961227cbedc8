"""JETS, the frame of a client that evaluates the garment on its own mesh: per patch a frame and a jet.

A row has 77 bytes whatever the mesh. The centre is counted in 16-bit steps of the frame's own box, the rotation's
quaternion in 16-bit steps of [-1, 1]. Coefficients up to order 2 have 16 bits, those of orders 3 and 4, which add
little, have 8. Each coefficient has its own box over the patches of the frame. ``drape.wire.layout`` makes vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drape.arrays import check_shape
from drape.errors import InputError
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_quaternion, quaternion_to_matrix
from drape.wire import messages as wire

FINE = np.flatnonzero(np.tile(np.arange(jets.HEIGHT_COUNT) < jets.IN_PLANE_COUNT, 3))  # coefficients of 16 bits
COARSE = np.setdiff1d(np.arange(jets.FULL_COUNT), FINE)  # coefficients of 8 bits
FINE_COLUMNS = 3 + 4 + len(FINE)  # centre, quaternion, coefficients
ROW_BYTES = 2 * FINE_COLUMNS + len(COARSE)
COARSE_COUNT = 255
UNIT = 32767  # steps of a quaternion's component from 0 to 1

_HEADER = wire.record(wire.LAYOUTS["JETS"])
HEADER_BYTES = _HEADER.size


@dataclass(frozen=True, eq=False)
class JetFrame:
    """One draped frame as posed patches. ``sequence`` and ``client_time_s`` are those of its pose.

    ``jet`` (K, 45) [patch scales] is the change of each patch's rest surface in the patch's frame, the push-out
    included. ``rotation`` (K, 3, 3) and ``centre`` (K, 3) [m], relative to ``root`` (3,) float64 [m], are the patches'
    posed frames. Vertices that a client makes of the jets are short of clear by ``left_m`` [m] at most.
    Other numbers are those of ``drape.wire.messages.Frame``.
    """

    sequence: int
    client_time_s: float
    server_time_s: float
    root: np.ndarray
    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    dropped: int = 0
    residence_us: int = 0
    pushed: bool = False
    pushed_share: float = 0.0
    push_max_m: float = 0.0
    left_m: float = 0.0
    stepped: bool = False
    novelty: float = 0.0

    def layers(self, counts: Sequence[int]) -> list[JetFrame]:
        """Returns the frame of each garment of an outfit; ``counts`` are their numbers of patches, in order.

        Refuses (``InputError``) counts that do not add up to the patches of this frame.
        """
        if sum(counts) != len(self.jet):
            raise InputError(
                "patches",
                expected=f"{len(self.jet)}, as in the frame",
                got=" + ".join(map(str, counts)) or "none",
                cure="Use the layouts of the garments that were asked for, in their order.",
            )
        ends = np.cumsum(counts, dtype=int)[:-1]
        parts = zip(*(np.split(rows, ends) for rows in (self.jet, self.rotation, self.centre)), strict=True)
        return [replace(self, jet=jet, rotation=rotation, centre=centre) for jet, rotation, centre in parts]


def message_bytes(patches: int) -> int:
    """Returns the length [bytes] of a JETS message of so many ``patches``, a multiple of 4."""
    return HEADER_BYTES + ROW_BYTES * patches + (-ROW_BYTES * patches) % 4


def pack_jets(frame: JetFrame) -> bytes:
    """Returns the JETS message of ``frame``: the header, then for each patch a row of 16-bit steps (centre, quaternion
    and the coefficients ``FINE``), then for each patch a row of 8-bit steps (the coefficients ``COARSE``)."""
    count = len(frame.jet)
    check_shape("jet", frame.jet, (None, jets.FULL_COUNT))
    low, step = np.empty(jets.FULL_COUNT, np.float32), np.empty(jets.FULL_COUNT, np.float32)
    fine, low[FINE], step[FINE] = wire.quantise(frame.jet[:, FINE])
    coarse, low[COARSE], step[COARSE] = wire.quantise(frame.jet[:, COARSE], COARSE_COUNT)
    centre, centre_low, centre_step = wire.quantise(frame.centre)
    turn = np.rint((matrix_to_quaternion(frame.rotation) + 1.0) * UNIT).astype(np.uint16)
    header = _HEADER.pack(
        wire.MAGIC, wire.WIRE_VERSION, wire.JETS, wire.frame_flags(frame.pushed, frame.stepped, frame.novelty),
        frame.sequence, count,
        frame.client_time_s, frame.server_time_s, *frame.root,
        frame.dropped, min(frame.residence_us, 0xFFFFFFFF), frame.pushed_share, frame.push_max_m, frame.left_m,
        *centre_low, *centre_step, *low, *step,
    )  # fmt: skip
    payload = np.concatenate([centre, turn, fine], axis=1).astype("<u2").tobytes() + coarse.astype(np.uint8).tobytes()
    return header + payload + b"\0" * (-len(payload) % 4)


def unpack_jets(message: bytes) -> JetFrame:
    """Returns the frame in the JETS ``message``; refuses (``InputError``) another size, magic, version or kind, and
    rotations that are no unit quaternions."""
    wire.check_prefix("jets message", message, wire.JETS, least=HEADER_BYTES)
    values = _HEADER.unpack_from(message)
    count = values[5]
    wire.check_length("jets message", message, message_bytes(count), f"for {count} patches")
    boxes = np.array(values[-6 - 2 * jets.FULL_COUNT :], np.float32)
    centre_low, centre_step, low, step = np.split(boxes, [3, 6, 6 + jets.FULL_COUNT])
    fine = np.frombuffer(message, "<u2", count * FINE_COLUMNS, HEADER_BYTES).reshape(count, FINE_COLUMNS)
    start = HEADER_BYTES + 2 * count * FINE_COLUMNS
    coarse = np.frombuffer(message, np.uint8, count * len(COARSE), start).reshape(count, len(COARSE))
    jet = np.empty((count, jets.FULL_COUNT), np.float32)
    jet[:, FINE] = wire.dequantise(fine[:, 7:], low[FINE], step[FINE])
    jet[:, COARSE] = wire.dequantise(coarse, low[COARSE], step[COARSE])
    turn = fine[:, 3:7].astype(np.float64) / UNIT - 1.0
    norm = np.linalg.norm(turn, axis=1, keepdims=True)
    if (norm < 0.5).any():
        raise InputError(
            "jets message",
            expected="unit quaternions",
            got=f"one of length {norm.min():.3f}",
            cure="See docs/reference/wire.md for the layout.",
        )
    return JetFrame(
        sequence=values[4],
        client_time_s=values[6],
        server_time_s=values[7],
        root=np.array(values[8:11]),
        jet=jet,
        rotation=quaternion_to_matrix(turn / norm).astype(np.float32),
        centre=wire.dequantise(fine[:, :3], centre_low, centre_step),
        dropped=values[11],
        residence_us=values[12],
        pushed=bool(values[3] & wire.FLAG_PUSHED),
        stepped=bool(values[3] & wire.FLAG_STEPPED),
        novelty=wire.flagged_novelty(values[3]),
        pushed_share=values[13],
        push_max_m=values[14],
        left_m=values[15],
    )


def split_jets(content: bytes) -> list[JetFrame]:
    """Returns the frames of the JETS messages that follow each other in ``content``.

    Refuses (``InputError``) bytes that are no whole message.
    """
    frames, start = [], 0
    while start < len(content):
        wire.check_prefix("jets message", content[start:], wire.JETS, least=HEADER_BYTES)
        size = message_bytes(_HEADER.unpack_from(content, start)[5])
        frames.append(unpack_jets(content[start : start + size]))
        start += size
    return frames
