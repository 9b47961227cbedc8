"""A garment in a GLB: static, or a clip as morph targets.

glTF's axes are ours (right-handed, y up, facing +z) and its unit is the metre. A draped clip has no skeleton that could
reproduce it, so frame i is the morph target i - 1 of frame 0 and its weight is one at its time; between frames players
interpolate linearly.

Quantised (KHR_mesh_quantization) a node takes over the motion of the body's root, and what is left is counted in steps
of 16 bits of one box around all frames; normals have 8 bits. Players scale and place the steps by the node.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from drape.errors import InputError
from drape.export.glb_file import INDEX_BUFFER, VERTEX_BUFFER, GlbFile
from drape.export.root_motion import RootMotion, keys
from drape.export.surface import Surface
from drape.geometry import meshes
from drape.wanted import go_on

GARMENT_COLOURS = ((0.18, 0.42, 0.72, 1.0), (0.62, 0.17, 0.19, 1.0), (0.16, 0.38, 0.26, 1.0), (0.40, 0.28, 0.55, 1.0))
STEPS = 32767  # So many steps go from 0 to the box's end.
NORMAL_STEPS = 127
# A normal is shortened at most to this length, so that its difference from the first frame's fits into [-1, 1].
SHORTEST = 0.05


@dataclass(frozen=True, eq=False)
class Corners:
    """A mesh whose vertices are split where texture coordinates have a seam.

    ``source`` (N,) is the delivered vertex of each of the N rows, and ``faces`` (F, 3) are indices of rows. ``uv``
    (N, 2) are texture coordinates with the origin at the upper left, None where there are none.
    """

    source: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None


def split_seams(garment: Surface) -> Corners:
    """Returns the mesh of ``garment`` with each pair of vertex and texture coordinate in a row. The first rows are the
    vertices in the delivered order."""
    if not garment.uv_faces.size:
        return Corners(np.arange(garment.vertex_count), garment.faces.astype(np.int64), None)
    pairs = np.stack([garment.faces.reshape(-1), garment.uv_faces.reshape(-1)], axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    first = np.ones(len(unique), dtype=bool)
    first[1:] = unique[1:, 0] != unique[:-1, 0]
    place = np.empty(len(unique), dtype=np.int64)
    place[first] = unique[first, 0]
    place[~first] = garment.vertex_count + np.arange((~first).sum())
    source = np.concatenate([np.arange(garment.vertex_count), unique[~first, 0]])
    uv = np.zeros((len(source), 2))
    uv[place] = garment.uv[unique[:, 1]]
    uv[:, 1] = 1.0 - uv[:, 1]  # glTF counts v from the top.
    return Corners(source, place[inverse.reshape(-1)].reshape(-1, 3), uv)


def vertex_normals(frames: np.ndarray, faces: np.ndarray, *, table: np.ndarray | None = None) -> np.ndarray:
    """Returns the unit normals (..., V, 3), float32, of vertices ``frames`` (..., V, 3) with ``faces`` (F, 3);
    (0, 1, 0) where a vertex has no face. ``table`` is ``meshes.face_table`` of the faces, where it is made already."""
    normals = meshes.vertex_normals(frames, faces, table=table)
    normals[np.linalg.norm(normals, axis=-1) < 0.5] = (0.0, 1.0, 0.0)
    return normals.astype(np.float32)


def add_garment(
    file: GlbFile,
    garment: Surface,
    frames: np.ndarray,
    fps: float,
    colour: tuple[float, float, float, float] = GARMENT_COLOURS[0],
    *,
    root_motion: RootMotion | None = None,
) -> None:
    """Adds the garment at ``frames`` [m] (F, V, 3) to ``file``, animated at ``fps`` frames a second if there are
    several.

    With a ``root_motion`` it is quantised: no coordinate is off by more than half a step, 1/65534 of the box's longer
    half. Without one it is in float32. ``colour`` is linear red, green, blue and opacity. Raises ``InputError`` for a
    motion of another number of frames.
    """
    corners = split_seams(garment)
    if root_motion is not None and len(root_motion) != len(frames):
        cure = "Give the root's motion of these frames."
        raise InputError("root motion", expected=f"{len(frames)} frames", got=str(len(root_motion)), cure=cure)
    made = _in_floats if root_motion is None else partial(_in_steps, root_motion=root_motion)
    add_shape(file, garment, corners, made(file, garment, corners, frames), len(frames), fps, colour)


def add_shape(
    file: GlbFile,
    garment: Surface,
    corners: Corners,
    shape: Shape,
    frames: int,
    fps: float,
    colour: tuple[float, float, float, float],
) -> None:
    """Adds mesh, materials and node of ``garment`` to ``file``, and an animation where ``shape`` has morph targets. Of
    n targets target i is shown in frame ``frames`` - n + i, at ``fps`` frames a second; before these the mesh itself is
    shown.

    ``corners`` is ``split_seams`` of the garment. ``colour``, linear red, green, blue and opacity, is for materials
    that have no look.
    """
    base, moves = shape.parts[0], shape.parts[1:]
    if corners.uv is not None:
        base["TEXCOORD_0"] = file.array(corners.uv.astype(np.float32), target=VERTEX_BUFFER)
    primitives = []
    names = garment.material_names or (garment.name,)
    for index, name in enumerate(names):
        chosen = corners.faces[garment.face_material == index] if garment.material_names else corners.faces
        if len(chosen) == 0:
            continue
        primitive: dict[str, Any] = {
            "attributes": base,
            "indices": file.array(flat_indices(chosen, len(corners.source)), target=INDEX_BUFFER),
            "material": file.material(name, colour, garment.looks, index, with_pictures=corners.uv is not None),
        }
        if moves:
            primitive["targets"] = moves
        primitives.append(primitive)
    mesh: dict[str, Any] = {"name": garment.name, "primitives": primitives}
    if moves:
        mesh["weights"] = [0.0] * len(moves)
    node = {path: values[0].tolist() for path, values in shape.motion.items()} | shape.node
    placed = file.node({"name": garment.name, "mesh": file.add("meshes", mesh), **node})
    if moves:
        motion = {"weights": np.eye(frames, dtype=np.float32)[:, frames - len(moves) :].reshape(-1)} | shape.motion
        file.animate(frames, fps, [(placed, path, values) for path, values in motion.items()])


@dataclass(frozen=True, eq=False)
class Shape:
    """A garment's mesh as it lies in a GLB file.

    ``parts`` are the accessors of attributes (POSITION, NORMAL, ...), of the mesh and then of each morph target.
    ``node`` has further fields of its node, and ``motion`` the values (F, n) of the node's animated paths (translation,
    rotation).
    """

    parts: list[dict[str, int]]
    node: dict[str, Any] = field(default_factory=dict)
    motion: dict[str, np.ndarray] = field(default_factory=dict)


def _in_floats(file: GlbFile, garment: Surface, corners: Corners, frames: np.ndarray) -> Shape:
    """The clip in float32."""
    table, first = meshes.face_table(garment.faces, frames.shape[1]), np.zeros((), np.float32)
    parts: list[dict[str, int]] = []
    for points in frames.astype(np.float32):
        go_on()
        rows = np.stack([points, vertex_normals(points, garment.faces, table=table)])[:, corners.source]
        places, normals = rows - first
        first = first if parts else rows
        position = file.array(places, target=VERTEX_BUFFER, bounds=True)
        parts.append({"POSITION": position, "NORMAL": file.array(normals, target=VERTEX_BUFFER)})
    return Shape(parts)


def _in_steps(
    file: GlbFile, garment: Surface, corners: Corners, frames: np.ndarray, *, root_motion: RootMotion
) -> Shape:
    """The clip in steps, and the node that scales them to places and moves with the root."""
    file.quantised()
    centre, scale = _box(frames, root_motion)
    places, turned = [], []
    for steps, normal in _steps(frames, garment.faces, root_motion, centre, scale):
        # A way is between what two frames were rounded to: their errors do not add up.
        places.append((steps[corners.source] - places[0]) if places else steps[corners.source])
        turned.append(normal[corners.source])
    positions = file.quantised_rows(np.stack(places).astype(np.int16), bounds=True)
    normals = file.quantised_rows(np.stack(turned).astype(np.int8))
    parts = [{"POSITION": p, "NORMAL": n} for p, n in zip(positions, normals, strict=True)]
    motion = {"translation": root_motion.places_of(centre).astype(np.float32), "rotation": keys(root_motion.turn)}
    return Shape(parts, {"scale": [scale] * 3}, motion)


def _box(frames: np.ndarray, root_motion: RootMotion) -> tuple[np.ndarray, float]:
    """The centre (3,) [m] of the first frame in the root's frame, and the length [m] of ``STEPS`` steps.

    That is the longest of the first frame's half edges and of all displacements from it along an axis.
    """
    first = root_motion.towards_root(frames[0], 0)
    centre = 0.5 * (first.min(axis=0) + first.max(axis=0))
    reach = np.abs(first - centre).max()
    for frame in range(1, len(frames)):
        go_on()
        reach = max(reach, np.abs(root_motion.towards_root(frames[frame], frame) - first).max())
    return centre, float(max(reach, 1e-6)) * (1.0 + 1.0 / STEPS)  # Rounding may make a way longer by a step.


def _steps(
    frames: np.ndarray, faces: np.ndarray, root_motion: RootMotion, centre: np.ndarray, scale: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Each frame's places in steps from the centre (V, 3), and the first one's normals or the differences from them."""
    first, table = np.zeros(0), meshes.face_table(faces, frames.shape[1])
    for frame, points in enumerate(frames):
        go_on()
        local = root_motion.towards_root(points, frame)
        normals = normal_steps(vertex_normals(local, faces, table=table).astype(np.float64), first if frame else None)
        if not frame:
            first = normals / NORMAL_STEPS
        yield np.rint((local - centre) * (STEPS / scale)).astype(np.int32), normals


def normal_steps(normals: np.ndarray, first: np.ndarray | None) -> np.ndarray:
    """Returns unit ``normals`` (V, 3) in steps of 1/127: floats that are whole numbers in [-127, 127]. With ``first``
    (V, 3), other unit normals, these are the differences from ``first``, as morph targets have them; a normal too far
    from ``first`` is shortened before."""
    return np.rint((normals if first is None else _way_of_normals(first, normals)) * NORMAL_STEPS)


def _way_of_normals(first: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The difference between ``first`` (V, 3) and the direction of ``normals``, each part within [-1, 1].

    Players make normals unit vectors again, so a normal that lies too far away is shortened.
    """
    room = 1.0 + np.sign(normals) * first
    share = (room / np.maximum(np.abs(normals), 1e-9)).min(axis=1, keepdims=True)
    return np.clip(np.clip(share, SHORTEST, 1.0) * normals - first, -1.0, 1.0)


def flat_indices(faces: np.ndarray, count: int) -> np.ndarray:
    """Returns the vertices (3 F,) of ``faces`` (F, 3), corner by corner, of a mesh of ``count`` vertices: uint16 where
    that suffices, otherwise uint32. 65535 is reserved."""
    return faces.reshape(-1).astype(np.uint16 if count < 65535 else np.uint32)
