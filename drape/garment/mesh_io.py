"""Reads a mesh file as its maker left it: vertex order, uv and materials kept, nothing trusted.

OBJ and GLB are parsed here: no library keeps OBJ's vertex order, and a GLB of 360 bytes can
make one allocate a gigabyte. PLY and ASCII STL go through trimesh after their declared counts
were compared with the bytes that came. What the mesh means (unit, up axis, faults) is decided
in ``drape.garment.mesh_checks``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.errors import MeshError, NotFound

BYTES_LIMIT = 96 * 2**20
VERTEX_LIMIT = 200_000
AVATAR_VERTEX_LIMIT = 400_000
KINDS = ("obj", "glb", "ply", "stl")
_SILENT = frozenset(
    {
        "vn",
        "o",
        "g",
        "s",
        "mtllib",
        "l",
        "p",
        "vp",
        "cstype",
        "deg",
        "curv",
        "curv2",
        "surf",
        "parm",
        "end",
        "bevel",
        "lod",
    }
)
_INTEGER = re.compile(r"[+-]?\d{1,18}\Z")  # more digits are no index, and no int64


@dataclass(frozen=True, eq=False)
class GarmentMesh:
    """A triangle mesh: ``vertices`` (V, 3), ``faces`` (F, 3), ``uv`` (T, 2) and ``uv_faces`` (F, 3) or both empty.

    ``material_names`` and ``face_material`` (F,) are the file's; ``notes`` say what was
    done to it on the way. Texture coordinates have their origin at the lower left.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    material_names: tuple[str, ...]
    face_material: np.ndarray
    notes: tuple[str, ...] = ()

    def noted(self, *notes: str) -> GarmentMesh:
        return replace(self, notes=self.notes + notes)

    def take_faces(self, keep: np.ndarray) -> GarmentMesh:
        """The same mesh with only the faces of ``keep``."""
        uv_faces = self.uv_faces[keep] if len(self.uv_faces) else self.uv_faces
        return replace(self, faces=self.faces[keep], uv_faces=uv_faces, face_material=self.face_material[keep])


def plain_mesh(
    name: str, vertices: np.ndarray, faces: np.ndarray | list[list[int]], *, notes: tuple[str, ...] = ()
) -> GarmentMesh:
    """A mesh without uv and with one material."""
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    return GarmentMesh(
        name=name,
        vertices=np.asarray(vertices, dtype=np.float64).reshape(-1, 3),
        faces=faces,
        uv=np.zeros((0, 2)),
        uv_faces=np.zeros((0, 3), dtype=np.int64),
        material_names=("default",),
        face_material=np.zeros(len(faces), dtype=np.int64),
        notes=notes,
    )


def weld(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` with vertices at exactly the same place made one; order of first appearance."""
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(mesh.vertices):
        return mesh
    rank = np.argsort(np.argsort(first))
    welded = replace(mesh, vertices=mesh.vertices[np.sort(first)], faces=rank[inverse.reshape(-1)][mesh.faces])
    return welded.noted(f"{len(mesh.vertices)} vertices welded into {len(first)}")


def read_mesh(
    source: Path | bytes, *, name: str | None = None, kind: str | None = None, vertex_limit: int = VERTEX_LIMIT
) -> GarmentMesh:
    """The mesh in a file or in its bytes; ``kind`` (obj, glb, ply, stl) is taken from the suffix or the first bytes.

    Raises ``MeshError`` (or ``NotFound`` for an absent file) with what was expected and what cures it.
    """
    if isinstance(source, (bytes, bytearray, memoryview)):
        payload, name = bytes(source), name or "garment"
    else:
        path = Path(source)
        if not path.is_file():
            raise NotFound("garment", expected="an existing file", got=path.name, cure="Check the path.")
        if path.stat().st_size > BYTES_LIMIT:
            raise _too_large(path.name, path.stat().st_size)
        payload, name = path.read_bytes(), name or path.stem
        kind = kind or path.suffix.lower().lstrip(".")
    if len(payload) > BYTES_LIMIT:
        raise _too_large(name, len(payload))
    kind = sniff(payload) if kind is None else kind.lower().lstrip(".")
    if kind not in KINDS:
        raise MeshError(
            f"mesh {name}", expected="OBJ, GLB, PLY or STL", got=f".{kind}", cure="Export the mesh as one of these."
        )
    if not payload.strip():
        raise MeshError(f"mesh {name}", expected="a mesh", got="an empty file", cure="Export it again.")
    if kind == "obj":
        return read_obj(payload, name=name, vertex_limit=vertex_limit)
    if kind == "glb":
        from drape.garment.glb_reader import read_glb

        return read_glb(payload, name=name, vertex_limit=vertex_limit)
    from drape.garment.ply_stl_reader import read_ply, read_stl

    return (read_ply if kind == "ply" else read_stl)(payload, name=name, vertex_limit=vertex_limit)


def sniff(payload: bytes) -> str:
    """The kind of a mesh by its first bytes; OBJ where nothing else fits."""
    head = payload[:512].lstrip()
    if payload[:4] == b"glTF":
        return "glb"
    if head[:4] in (b"ply\n", b"ply\r"):
        return "ply"
    binary_stl = len(payload) >= 84 and len(payload) == 84 + 50 * int.from_bytes(payload[80:84], "little")
    return "stl" if binary_stl or (head[:6] == b"solid " and b"facet" in payload[:2048]) else "obj"


def _too_large(name: str, size: int) -> MeshError:
    return MeshError(
        f"mesh {name}",
        expected=f"at most {BYTES_LIMIT >> 20} MiB",
        got=f"{size / 2**20:.0f} MiB",
        cure="Decimate the mesh.",
    )


def check_count(name: str, count: int, limit: int) -> None:
    """Refuses a mesh that declares more vertices than ``limit``."""
    if count > limit:
        raise MeshError(
            f"mesh {name}", expected=f"at most {limit:,} vertices", got=f"{count:,}", cure="Decimate the mesh."
        )


# --- OBJ -------------------------------------------------------------------------------------------------------------


def read_obj(payload: bytes, *, name: str, vertex_limit: int = VERTEX_LIMIT) -> GarmentMesh:
    """The mesh of a Wavefront OBJ; vertices and texture coordinates in the file's order, polygons as triangle fans."""
    return _ObjReader(name, vertex_limit).read(payload)


class _ObjReader:
    """The state of one pass over an OBJ file."""

    def __init__(self, name: str, vertex_limit: int) -> None:
        self.name, self.vertex_limit = name, vertex_limit
        self.vertices: list[tuple[float, ...]] = []
        self.uv: list[tuple[float, ...]] = []
        self.normal_count = 0
        self.faces: list[tuple[int, int, int]] = []
        self.uv_faces: list[tuple[int, int, int]] = []
        self.lines: list[int] = []
        self.materials: dict[str, int] = {}
        self.face_material: list[int] = []
        self.material = -1
        self.polygon_count = 0
        self.skipped: set[str] = set()

    def fault(self, line: int, expected: str, got: str, cure: str = "Export the mesh again.") -> MeshError:
        return MeshError(f"mesh {self.name} line {line}", expected=expected, got=got[:80], cure=cure)

    def read(self, payload: bytes) -> GarmentMesh:
        if b"\0" in payload:
            raise MeshError(
                f"mesh {self.name}",
                expected="a text file (OBJ)",
                got="binary data",
                cure="Name the file by its format.",
            )
        pending = ""
        for number, raw in enumerate(payload.decode("utf-8", errors="replace").splitlines(), start=1):
            text = pending + raw.split("#", 1)[0].strip()
            pending = ""
            if text.endswith("\\"):
                pending = text[:-1] + " "
                continue
            words = text.split()
            if words:
                self.statement(number, words, text)
        return self.finish()

    def statement(self, number: int, words: list[str], text: str) -> None:
        keyword, rest = words[0], words[1:]
        if keyword == "v":
            self.vertices.append(self.floats(number, rest, 3))
            check_count(self.name, len(self.vertices), self.vertex_limit)
        elif keyword == "vt":
            values = self.floats(number, rest, 1)
            self.uv.append((values[0], values[1] if len(values) > 1 else 0.0))
            check_count(self.name, len(self.uv), 3 * self.vertex_limit)
        elif keyword == "vn":
            self.normal_count += 1
        elif keyword == "f":
            self.polygon(number, rest)
        elif keyword == "usemtl":
            label = text[len("usemtl") :].strip() or "default"
            self.material = self.materials.setdefault(label, len(self.materials))
        elif keyword in _SILENT:
            self.skipped.add(keyword)
        else:
            raise self.fault(
                number, "an OBJ statement (v, vt, vn, f, usemtl, ...)", repr(keyword), "Is this an OBJ file?"
            )

    def floats(self, number: int, words: list[str], count: int) -> tuple[float, ...]:
        try:
            # float() takes 1_000; OBJ does not.
            values = tuple(float(word) if "_" not in word else float("x") for word in words[: max(count, 3)])
        except ValueError:
            values = ()
        if len(values) < count or not np.isfinite(values).all():
            raise self.fault(
                number, f"{count} finite numbers", " ".join(words) or "nothing", "Repair or remove the line."
            )
        return values

    def polygon(self, number: int, words: list[str]) -> None:
        if len(words) < 3:
            raise self.fault(number, "at least 3 corners", str(len(words)), "Remove the face.")
        if len(words) > 256:
            raise self.fault(number, "at most 256 corners", str(len(words)), "Triangulate the face.")
        corners = [self.corner(number, word) for word in words]
        if self.material < 0:
            self.material = self.materials.setdefault("default", len(self.materials))
        self.polygon_count += len(corners) > 3
        for i in range(1, len(corners) - 1):
            a, b, c = corners[0], corners[i], corners[i + 1]
            self.faces.append((a[0], b[0], c[0]))
            self.uv_faces.append((a[1], b[1], c[1]))
            self.face_material.append(self.material)
            self.lines.append(number)
        check_count(self.name, len(self.faces) // 4, self.vertex_limit)

    def corner(self, number: int, word: str) -> tuple[int, int]:
        """Zero-based vertex and texture index of ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; -1 for no texture."""
        parts = word.split("/")
        if len(parts) > 3 or any(part and not _INTEGER.match(part) for part in parts) or not parts[0]:
            raise self.fault(number, "corners like 1, 1/2, 1//3 or 1/2/3", repr(word))
        counts = (len(self.vertices), len(self.uv), self.normal_count)
        found = []
        for part, count, what in zip(parts, counts, ("vertex", "texture coordinate", "normal"), strict=False):
            index = int(part) if part else None
            if index == 0 or (index is not None and index < -count):
                raise self.fault(
                    number, f"a {what} index from 1, or from -{count} to -1", str(index), "Repair the face."
                )
            # Positive indices may point ahead: they are checked when all vertices are known.
            found.append(-1 if index is None else index - 1 if index > 0 else count + index)
        return found[0], found[1] if len(found) > 1 else -1

    def finish(self) -> GarmentMesh:
        if not self.vertices or not self.faces:
            missing = "faces" if self.vertices else "vertices"
            raise MeshError(
                f"mesh {self.name}",
                expected="vertices and faces",
                got=f"no {missing}",
                cure="Export the garment's surface.",
            )
        faces, uv_faces = np.array(self.faces, dtype=np.int64), np.array(self.uv_faces, dtype=np.int64)
        for table, count, what in (
            (faces, len(self.vertices), "vertex"),
            (uv_faces, len(self.uv), "texture coordinate"),
        ):
            beyond = np.flatnonzero((table >= count).any(axis=1))
            if len(beyond):
                row = int(beyond[0])
                raise self.fault(
                    self.lines[row], f"a {what} index up to {count}", str(int(table[row].max()) + 1), "Repair the face."
                )
        notes = []
        if self.polygon_count:
            notes.append(f"{self.polygon_count} polygons triangulated")
        uv = np.array(self.uv, dtype=np.float64).reshape(-1, 2)
        bare = (uv_faces < 0).any(axis=1)
        if bare.all():
            uv, uv_faces = np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)
        elif bare.any():
            uv_faces[bare] = len(uv)
            uv = np.vstack([uv, [[0.0, 0.0]]])
            notes.append(f"{int(bare.sum())} faces without texture coordinates take (0, 0)")
        if self.skipped & {"l", "p", "curv", "surf"}:
            notes.append("lines, points and curves left out")
        return GarmentMesh(
            name=self.name,
            vertices=np.array(self.vertices, dtype=np.float64)[:, :3],
            faces=faces,
            uv=uv,
            uv_faces=uv_faces,
            material_names=tuple(self.materials),
            face_material=np.array(self.face_material, dtype=np.int64),
            notes=tuple(notes),
        )
