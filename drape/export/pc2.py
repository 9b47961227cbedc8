"""PC2 point caches: the vertices of every frame, for Blender's Mesh Cache, 3ds Max, Houdini and others.

A head of 32 bytes, then float32 x y z of every point of every sample, little endian; a sample is a frame. The mesh that
the points belong to is another file, with the same vertices in the same order: ``drape.export.obj``.
"""

from __future__ import annotations

import struct

import numpy as np

_HEAD = struct.Struct("<12siiffi")
HEAD_BYTES = _HEAD.size
MAGIC, VERSION = b"POINTCACHE2\0", 1
FRAMES_A_SAMPLE = 1.0


def pc2_head(points: int, frames: int) -> bytes:
    """Returns the bytes that a PC2 file of ``frames`` samples of ``points`` points begins with. The first sample is of
    frame 0."""
    return _HEAD.pack(MAGIC, VERSION, points, 0.0, FRAMES_A_SAMPLE, frames)


def pc2_samples(vertices: np.ndarray) -> bytes:
    """Returns the bytes of the samples of ``vertices`` [m] (F, V, 3) in a PC2 file."""
    return np.asarray(vertices, "<f4").tobytes()
