"""Reads a mesh file as its maker left it: vertex order, uv and materials kept, nothing trusted.

OBJ and GLB are parsed here: a refused OBJ names its line, and a GLB of 360 bytes can make a library allocate a
gigabyte. PLY and ASCII STL go through trimesh, after their declared counts were compared with the bytes that came.
``drape.garment.mesh_checks`` decides on the meaning of a mesh: its unit, its up axis and its faults.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from drape.errors import MeshError, NotFound, legible
from drape.files.beside import file_beside
from drape.files.formats import MESH_FORMATS, format_list, sniff
from drape.files.looks import NO_LOOKS, Looks
from drape.files.notes import warning
from drape.files.pictures import remake_pictures

BYTES_LIMIT = 96 * 2**20
VERTEX_LIMIT = 400_000
AVATAR_VERTEX_LIMIT = 400_000
Beside = Callable[[str], bytes | None]
"""The bytes of a file that a mesh file names, None where it is not there."""
NOTHING_M = 0.05  # nothing is worn so near the origin: a ring lies on no finger there, and no garment on a body
MATERIAL_CHARACTERS = 200  # a longer name is cut


@dataclass(frozen=True, eq=False)
class GarmentMesh:
    """A triangle mesh: ``vertices`` (V, 3), ``faces`` (F, 3), ``uv`` (T, 2) and ``uv_faces`` (F, 3), both empty without
    texture coordinates. They are in the unit and the axes of the file until intake converts them to metres, y up.
    ``material_names``, and ``face_material`` (F,), the number of each face's material. ``notes`` say what was done to
    the mesh on the way. Texture coordinates have their origin at the lower left. ``looks``: those of the materials."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    material_names: tuple[str, ...]
    face_material: np.ndarray
    notes: tuple[str, ...] = ()
    looks: Looks = NO_LOOKS

    def noted(self, *notes: str) -> GarmentMesh:
        return replace(self, notes=self.notes + notes)

    def take_faces(self, keep: np.ndarray) -> GarmentMesh:
        """Returns the mesh with the same vertices and only the faces ``keep``, a mask (F,) or indices."""
        uv_faces = self.uv_faces[keep] if len(self.uv_faces) else self.uv_faces
        return replace(self, faces=self.faces[keep], uv_faces=uv_faces, face_material=self.face_material[keep])


def plain_mesh(name: str, vertices: np.ndarray, faces: np.ndarray | list[list[int]]) -> GarmentMesh:
    """Returns a mesh of ``vertices`` (V, 3) and ``faces`` (F, 3), without texture coordinates and with one material,
    "default"."""
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    return GarmentMesh(
        name=name,
        vertices=np.asarray(vertices, dtype=np.float64).reshape(-1, 3),
        faces=faces,
        uv=np.zeros((0, 2)),
        uv_faces=np.zeros((0, 3), dtype=np.int64),
        material_names=("default",),
        face_material=np.zeros(len(faces), dtype=np.int64),
    )


@dataclass(frozen=True, eq=False)
class MeshPart:
    """One of the meshes of a scene, in world axes: ``points`` (V, 3), triangles ``faces`` (F, 3), texture coordinates
    ``uv`` (3 F, 2) of their corners or None, and the number of ``polygons`` that were cut into triangles."""

    points: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    polygons: int


def join_parts(name: str, parts: Sequence[MeshPart]) -> GarmentMesh:
    """Returns the mesh of ``parts``, one after the other, in their axes and with one material. Corners of parts without
    texture coordinates have (0, 0), if others have some. Raises ``MeshError`` where there are no parts."""
    if not parts:
        raise mesh_fault(name, "a mesh that is drawn", "none", "Export the garment's surface.")
    starts = np.cumsum([0] + [len(part.points) for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)])
    mesh = plain_mesh(name, np.concatenate([part.points for part in parts]), faces)
    if polygons := sum(part.polygons for part in parts):
        mesh = mesh.noted(f"{polygons} polygons triangulated")
    if all(part.uv is None for part in parts):
        return mesh
    uv = np.concatenate([np.zeros((3 * len(part.faces), 2)) if part.uv is None else part.uv for part in parts])
    return replace(mesh, uv=uv, uv_faces=np.arange(len(uv)).reshape(-1, 3))


def fans(sides: np.ndarray) -> np.ndarray:
    """Returns the triangles (F, 3) of polygons cut into fans from their first corners, as indices of corners. Polygon p
    has ``sides[p]`` corners (P,); the corners of all polygons are numbered one after the other."""
    start = np.cumsum(sides) - sides
    first = np.repeat(start, sides - 2)
    step = np.arange(len(first)) - np.repeat(np.cumsum(sides - 2) - (sides - 2), sides - 2)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def weld(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with vertices at exactly the same place made one, in the order of their first appearance, with a
    note. A mesh without such vertices is returned itself."""
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(mesh.vertices):
        return mesh
    rank = np.argsort(np.argsort(first))
    welded = replace(mesh, vertices=mesh.vertices[np.sort(first)], faces=rank[inverse.reshape(-1)][mesh.faces])
    return welded.noted(f"{len(mesh.vertices)} vertices welded into {len(first)}")


def read_mesh(
    source: Path | bytes, *, name: str | None = None, kind: str | None = None, vertex_limit: int = VERTEX_LIMIT
) -> GarmentMesh:
    """Returns the mesh in a file or in its bytes, in the file's unit and axes. ``kind`` ("obj", ...) is by default that
    of the suffix, or of the first bytes. Raises ``MeshError``, or ``NotFound`` for an absent file, which say what was
    expected and what cures it."""
    folder = None
    if isinstance(source, (bytes, bytearray, memoryview)):
        payload, name = bytes(source), name or "garment"
    else:
        path = Path(source)
        if not path.is_file():
            raise NotFound("garment", expected="an existing file", got=path.name, cure="Check the path.")
        if path.stat().st_size > BYTES_LIMIT:
            raise mesh_fault(path.name, *_too_large(path.stat().st_size))
        payload, name = path.read_bytes(), name or path.stem
        kind = kind or path.suffix.lower().lstrip(".")
        folder = path.absolute().parent
    if len(payload) > BYTES_LIMIT:
        raise mesh_fault(name, *_too_large(len(payload)))
    kind = sniff(payload).name if kind is None else kind.lower().lstrip(".")
    beside = partial(file_beside, folder, most_bytes=BYTES_LIMIT)
    mesh = read_payload(payload, name=name, kind=kind, vertex_limit=vertex_limit, beside=beside)
    names = tuple(legible(one)[:MATERIAL_CHARACTERS] for one in mesh.material_names)
    looks, notes = remake_pictures(mesh.looks)
    return replace(mesh, material_names=names, looks=looks).noted(*notes)


def read_payload(payload: bytes, *, name: str, kind: str, vertex_limit: int, beside: Beside) -> GarmentMesh:
    """Returns the mesh in ``payload``, a file of the format ``kind``, with its pictures as they are in the file.
    ``beside`` returns the bytes of a file that the mesh file names. Raises ``MeshError``."""
    kind = "glb" if kind == "vrm" else kind
    form = next((one for one in MESH_FORMATS if one.name == kind), None)
    if form is None:
        raise mesh_fault(name, format_list(), f".{kind}", "Export the mesh as one of these.")
    if not payload.strip():
        raise mesh_fault(name, "a mesh", "an empty file")
    module, _, function = form.reader.partition(".")
    read = getattr(import_module(f"{__package__}.{module}"), function)
    more = {"beside": beside} if form.names_others else {}
    return read(payload, name=name, vertex_limit=vertex_limit, **more)


def in_stated_unit(points: np.ndarray, unit_m: float) -> tuple[np.ndarray, str]:
    """Returns ``points`` [m] (N, 3) of a file that states its unit, and a note of that.

    Where they lie so near to the origin that nothing is worn there, the file's own numbers are returned and the note is
    a warning: programs write metres and state centimetres.
    """
    farthest_m = float(np.abs(points).max(initial=0.0))
    if 0.0 < unit_m < 1.0 and farthest_m < NOTHING_M:
        within = f"in which it all lies within {100.0 * farthest_m:.2g} cm of its origin"
        return points / unit_m, warning(f"the file states its unit, {unit_m:g} m, {within}: that is not counted")
    return points, f"the file states its unit: {unit_m:g} m"


def _too_large(size: int) -> tuple[str, str, str]:
    return f"at most {BYTES_LIMIT >> 20} MiB", f"{size / 2**20:.0f} MiB", "Decimate the mesh."


def check_count(name: str, count: int, limit: int) -> None:
    """Raises ``MeshError`` if the mesh ``name`` declares ``count`` vertices and that is more than ``limit``."""
    if count > limit:
        raise mesh_fault(name, f"at most {limit:,} vertices", f"{count:,}", "Decimate the mesh.")


def mesh_fault(name: str, expected: str, got: str, cure: str = "Export it again.") -> MeshError:
    """Returns the error about the mesh ``name``, for its reader to raise; ``got`` is cut to 120 characters."""
    return MeshError(f"mesh {name}", expected=expected, got=got[:120], cure=cure)
