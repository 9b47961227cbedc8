"""CLIP, the body of a request with a motion: its poses in binary, and in JSON what else it asks for.

After the header come the root translations, frames x 3 float64 [m], where the flags say so; the rotation vectors,
frames x 72 float64 [rad], or where the header has nodes the local quaternions of an avatar's own rig, frames x nodes x
4 float64, x, y, z, w; and the JSON text. The numbers are those that JSON would carry, to the bit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from drape.arrays import check_shape
from drape.errors import InputError, MotionError
from drape.wire import messages as wire

FLAG_PLACED = 1  # the message has translations; without it they are zeros
FRAME_BYTES = 8 * (wire.POSE_SIZE + 3)
_HEADER = wire.record(wire.LAYOUTS["CLIP"])
HEADER_BYTES = _HEADER.size


def of_rig(poses: np.ndarray) -> bool:
    """Returns whether ``poses`` are quaternions (F, N, 4) of a rig; otherwise they are rotation vectors (F, 24, 3)."""
    return poses.ndim == 3 and poses.shape[2] == 4


def frame_bytes(poses: np.ndarray) -> int:
    """Returns how many bytes one frame takes in a CLIP message of ``poses`` (F, 24, 3) or (F, N, 4), its translation
    included."""
    return 8 * (4 * poses.shape[1] + 3) if of_rig(poses) else FRAME_BYTES


def check_motion(poses: np.ndarray, trans: np.ndarray | None) -> None:
    """Refuses (``MotionError``) other shapes than poses (F, 24, 3) or quaternions (F, N, 4), and translations (F, 3) or
    None."""
    if not of_rig(poses):
        check_shape("poses", poses, (None, 24, 3), error=MotionError)
    if trans is not None:
        check_shape("trans", trans, (len(poses), 3), error=MotionError)


def pack_clip(about: Mapping[str, Any], poses: np.ndarray, trans: np.ndarray | None) -> bytes:
    """Returns the CLIP message of ``poses``, rotation vectors (F, 24, 3) [rad] or a rig's local quaternions (F, N, 4),
    x, y, z, w; of the translations ``trans`` (F, 3) [m], None for zeros; and of the JSON fields ``about``.

    Refuses (``MotionError``) other shapes.
    """
    check_motion(poses, trans)
    text = json.dumps(about, separators=(",", ":"), allow_nan=False).encode()
    flags = 0 if trans is None else FLAG_PLACED
    nodes = poses.shape[1] if of_rig(poses) else 0
    header = _HEADER.pack(wire.MAGIC, wire.WIRE_VERSION, wire.CLIP, flags, 0, len(poses), len(text), nodes)
    places = b"" if trans is None else np.asarray(trans, "<f8").tobytes()
    return header + places + np.asarray(poses, "<f8").tobytes() + text


def unpack_clip(message: bytes) -> tuple[bytes, np.ndarray, np.ndarray | None]:
    """Returns the JSON text, the poses (F, 24, 3) [rad] or quaternions (F, N, 4), x, y, z, w, and the translations (F,
    3) [m] or None in the CLIP ``message``, float64, all unchecked.

    Refuses (``InputError``) another size, version or kind.
    """
    wire.check_prefix("clip message", message, wire.CLIP, least=HEADER_BYTES)
    values = _HEADER.unpack_from(message)
    flags, count, text_bytes, nodes = values[3], values[5], values[6], values[7]
    shape = (count, nodes, 4) if nodes else (count, 24, 3)
    placed = bool(flags & FLAG_PLACED)
    start = HEADER_BYTES + (24 * count if placed else 0)
    end = start + 8 * math.prod(shape)
    if len(message) != end + text_bytes:
        of = f" of {nodes} nodes" if nodes else ""
        raise InputError(
            "clip message",
            expected=f"{end + text_bytes} bytes for {count} frames{of} and {text_bytes} bytes of JSON",
            got=f"{len(message)} bytes",
            cure="See docs/reference/wire.md for the layout.",
        )
    trans = np.frombuffer(message, "<f8", 3 * count, HEADER_BYTES).reshape(count, 3) if placed else None
    poses = np.frombuffer(message, "<f8", math.prod(shape), start).reshape(shape)
    return message[end:], poses, trans
