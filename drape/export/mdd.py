"""MDD point caches (LightWave's motion designer): for Maya, Cinema 4D, Houdini, Blender and others.

Big endian: the number of frames and of points, the time [s] of each frame, then float32 x y z of every point of every
frame. The mesh that the points belong to is another file, with the same vertices in the same order:
``drape.export.obj``.
"""

from __future__ import annotations

import struct

import numpy as np

_HEAD = struct.Struct(">ii")


def mdd_head(points: int, frames: int, fps: float) -> bytes:
    """Returns the bytes that an MDD file of ``frames`` frames of ``points`` points begins with. The first frame is at 0
    s."""
    return _HEAD.pack(frames, points) + (np.arange(frames) / fps).astype(">f4").tobytes()


def mdd_frames(vertices: np.ndarray) -> bytes:
    """Returns the bytes of the frames of ``vertices`` [m] (F, V, 3) in an MDD file."""
    return np.asarray(vertices, ">f4").tobytes()
