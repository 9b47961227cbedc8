"""CLIP, the body of a request with a motion: its poses in binary, and in JSON what else it asks for.

After the header come the root translations, frames x 3 float64 [m], where the flags say so; the rotation vectors,
frames x 72 float64 [rad]; and the JSON text. The numbers are those that JSON would carry, to the bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from drape.arrays import check_shape
from drape.errors import InputError, MotionError
from drape.wire import messages as wire

FLAG_PLACED = 1  # translations are there; zeros otherwise
FRAME_BYTES = 8 * (wire.POSE_SIZE + 3)
_HEADER = wire.record(wire.LAYOUTS["CLIP"])
HEADER_BYTES = _HEADER.size


def check_motion(poses: np.ndarray, trans: np.ndarray | None) -> None:
    """Refuses (``MotionError``) other shapes than poses (F, 24, 3) and translations (F, 3) or None."""
    check_shape("poses", poses, (None, 24, 3), error=MotionError)
    if trans is not None:
        check_shape("trans", trans, (len(poses), 3), error=MotionError)


def pack_clip(about: Mapping[str, Any], poses: np.ndarray, trans: np.ndarray | None) -> bytes:
    """The CLIP message of ``poses`` (F, 24, 3) [rad], ``trans`` (F, 3) [m] or None, and the JSON fields ``about``.

    Refuses (``MotionError``) other shapes.
    """
    check_motion(poses, trans)
    text = json.dumps(about, separators=(",", ":"), allow_nan=False).encode()
    flags = 0 if trans is None else FLAG_PLACED
    header = _HEADER.pack(wire.MAGIC, wire.WIRE_VERSION, wire.CLIP, flags, 0, len(poses), len(text), 0)
    places = b"" if trans is None else np.asarray(trans, "<f8").tobytes()
    return header + places + np.asarray(poses, "<f8").tobytes() + text


def unpack_clip(message: bytes) -> tuple[bytes, np.ndarray, np.ndarray | None]:
    """The JSON text, poses (F, 24, 3) and translations (F, 3) or None of ``message``, all unchecked; refuses another
    size, version or kind."""
    wire.check_prefix("clip message", message, wire.CLIP, least=HEADER_BYTES)
    values = _HEADER.unpack_from(message)
    flags, count, text_bytes = values[3], values[5], values[6]
    placed = bool(flags & FLAG_PLACED)
    start = HEADER_BYTES + (24 * count if placed else 0)
    end = start + 8 * wire.POSE_SIZE * count
    if len(message) != end + text_bytes:
        raise InputError(
            "clip message",
            expected=f"{end + text_bytes} bytes for {count} frames and {text_bytes} bytes of JSON",
            got=f"{len(message)} bytes",
            cure="See docs/reference/wire.md for the layout.",
        )
    trans = np.frombuffer(message, "<f8", 3 * count, HEADER_BYTES).reshape(count, 3) if placed else None
    poses = np.frombuffer(message, "<f8", wire.POSE_SIZE * count, start).reshape(count, 24, 3)
    return message[end:], poses, trans
