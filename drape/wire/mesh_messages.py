"""Meshes at rest, sent once: the MESH of a garment as graphics cards take it, and the BODY with its skin.

After the header come arrays of whole numbers, each as the differences from the number ``lag`` places before, zigzagged
(0, -1, 1, -2, ...) into 32 bits: the first bytes of all, then the second ones, and so on, which compresses to a tenth
of JSON. What is no whole number is told in steps: places are off by 0.01 mm at most.

MESH: ``copies`` (lag 1), the corners of ``triangles`` (1), and texture coordinates where ``uv_step`` is not 0 (2).
Where texture coordinates have a seam, vertices come again behind all others; ``copies`` says which. BODY: corners (1),
places (3), and of each vertex its four heaviest bones (4) and the weights of the last three (3), of which the first one
is the rest to 1.
"""

from __future__ import annotations

import numpy as np

from drape.wire import messages as wire

STEP_M = 2e-5
WEIGHT_STEP = 2.0**-18
MOST_STEPS = 2.0**30  # of texture coordinates, however far apart they lie
_MESH, _BODY = wire.record(wire.LAYOUTS["MESH"]), wire.record(wire.LAYOUTS["BODY"])
MESH_HEADER_BYTES, BODY_HEADER_BYTES = _MESH.size, _BODY.size


def pack_mesh(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, uv_faces: np.ndarray) -> bytes:
    """Returns the MESH message of a garment of V vertices: its triangles ``faces`` (F, 3), and a texture coordinate for
    each vertex. ``uv_faces`` (F, 3) are the rows of ``uv`` (T, 2) that the corners of ``faces`` have, both empty
    without texture coordinates. A vertex with several rows, as at a seam, is copied for each further one.

    The message tells how many metres a unit of ``uv`` is, which follows from ``vertices`` (V, 3) [m] at rest. These are
    not in the message, since frames bring them.
    """
    prefix = (wire.MAGIC, wire.WIRE_VERSION, wire.MESH, 0, 0, len(vertices))
    if not len(uv):
        return _MESH.pack(*prefix, 0, len(faces), 0.0, 0.0) + _whole(faces, 1)
    metres = _uv_metres(vertices, faces, uv, uv_faces)
    copies, index, rows = _with_seams(len(vertices), faces, uv_faces)
    step = np.float32(max(STEP_M / metres, np.abs(uv).max() / MOST_STEPS) if metres else 1.0 / MOST_STEPS)
    coordinates = np.where(rows[:, None] < 0, 0.0, uv[rows])
    header = _MESH.pack(*prefix, len(copies), len(faces), step, metres)
    return b"".join([header, _whole(copies, 1), _whole(index, 1), _whole(np.round(coordinates / step), 2)])


def _with_seams(count: int, faces: np.ndarray, uv_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The vertices that come again (C,), the corners (3 F,) with those, and of all ``count`` + C the row of ``uv``,
    -1 where a vertex has no triangle."""
    corners, own = faces.reshape(-1).astype(np.int64), uv_faces.reshape(-1).astype(np.int64)
    rows = np.full(count, -1)
    rows[corners[::-1]] = own[::-1]  # the first one counts
    again = np.flatnonzero(rows[corners] != own)
    pairs, which = np.unique(np.stack([corners[again], own[again]], axis=1), axis=0, return_inverse=True)
    index = corners.copy()
    index[again] = count + which.reshape(-1)
    return pairs[:, 0], index, np.concatenate([rows, pairs[:, 1]])


def _uv_metres(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, uv_faces: np.ndarray) -> float:
    """Metres of a unit of texture coordinates: the median over edges at rest, 0 where all coordinates are the same.
    Panels that are laid out flat give 1."""
    across = np.linalg.norm(uv[uv_faces[:, 0]] - uv[uv_faces[:, 1]], axis=1)
    known = across > 1e-9
    if not known.any():
        return 0.0
    lengths = np.linalg.norm(vertices[faces[known, 0]] - vertices[faces[known, 1]], axis=1)
    return float(np.median(lengths / across[known]))


def pack_body_mesh(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, bones: np.ndarray, weights: np.ndarray
) -> bytes:
    """Returns the BODY message of a body at rest: ``vertices`` (V, 3) [m], ``faces`` (F, 3), ``joints`` (24, 3) [m],
    and for each vertex four ``bones`` (V, 4) and their skinning ``weights`` (V, 4), rows summing to one."""
    header = _BODY.pack(
        wire.MAGIC, wire.WIRE_VERSION, wire.BODY, 0, 0, len(vertices), len(faces), STEP_M, WEIGHT_STEP, *joints.ravel()
    )
    steps = np.round(vertices / STEP_M), np.round(weights[:, 1:] / WEIGHT_STEP)
    return b"".join([header, _whole(faces, 1), _whole(steps[0], 3), _whole(bones, 4), _whole(steps[1], 3)])


def _whole(numbers: np.ndarray, lag: int) -> bytes:
    flat = np.asarray(numbers).reshape(-1).astype(np.int64)
    steps = flat.copy()
    steps[lag:] -= flat[:-lag]
    zigzag = ((steps << 1) ^ (steps >> 63)).astype("<u4")
    return zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()
