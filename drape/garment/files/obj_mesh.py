"""Reads Wavefront OBJ: faults are named by their line, and limits hold while the file is read."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from json import detect_encoding
from math import isfinite

import numpy as np

from drape.errors import MeshError
from drape.garment.files.mesh import Beside, GarmentMesh, check_count, mesh_fault
from drape.garment.files.mtl import mtl_looks

# Statements that say nothing about the surface, and are not noted as left out.
_SILENT = frozenset("o g s".split())  # noqa: SIM905
_KEYWORD_LIMIT = 100
_INTEGER = re.compile(r"[+-]?\d{1,18}\Z")  # more digits are no index, and no int64
_USUAL = re.compile(r"([1-9]\d{,17})(?:/([1-9]\d{,17})?(?:/(?:[1-9]\d{,17})?)?)?\Z")  # a corner that counts from 1


def read_obj(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """Returns the mesh of a Wavefront OBJ, in the file's unit and axes. Vertices and texture coordinates keep the
    file's order; polygons become fans of triangles. ``beside`` reads MTL files and pictures. Raises ``MeshError``,
    which names the line."""
    reader = _ObjReader(name, vertex_limit)
    mesh = reader.read(payload)
    looks, notes = mtl_looks(reader.libraries, beside, mesh.material_names)
    return replace(mesh, looks=looks).noted(*notes)


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
        self.libraries: list[str] = []
        self.face_material: list[int] = []
        self.material = -1
        self.polygon_count = 0
        self.skipped: Counter[str] = Counter()
        self.first_skipped = 0

    def fault(self, line: int, expected: str, got: str, cure: str = "Export the mesh again.") -> MeshError:
        return mesh_fault(f"{self.name} line {line}", expected, got[:80], cure)

    def read(self, payload: bytes) -> GarmentMesh:
        rows = re.split(r"\r\n?|\n", payload.decode(detect_encoding(payload), errors="replace").replace("\0", " "))
        pending = ""
        for number, raw in enumerate(rows, start=1):
            # A material's name may hold a #; after a number it begins a comment.
            data = re.split(r"\s#", raw, maxsplit=1) if raw.lstrip().startswith("usemtl") else raw.split("#", 1)
            text = pending + data[0].strip()
            pending = ""
            if text.endswith("\\") and number < len(rows):
                pending = text[:-1] + " "
                continue
            words = text.rstrip("\\").split()
            if words:
                self.statement(number, words, text)
        return self.finish(is_binary=b"\0" in payload)

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
        elif keyword == "mtllib":
            self.libraries.append(text[len("mtllib") :].strip())
        elif keyword not in _SILENT:
            # A hostile file must not choose how many keywords are kept.
            self.skipped[keyword[:16] if len(self.skipped) < _KEYWORD_LIMIT else "others"] += 1
            self.first_skipped = self.first_skipped or number

    def floats(self, number: int, words: list[str], count: int) -> tuple[float, ...]:
        try:
            # float() takes 1_000; OBJ does not.
            values = tuple(float(word) if "_" not in word else float("x") for word in words[: max(count, 3)])
        except ValueError:
            values = ()
        if len(values) < count or not all(map(isfinite, values)):
            commas = any("," in word for word in words)
            cure = "Write decimals with points, not commas." if commas else "Repair or remove the line."
            raise self.fault(number, f"{count} finite numbers", " ".join(words) or "nothing", cure)
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
        if (usual := _USUAL.match(word)) is not None:
            return int(usual[1]) - 1, int(usual[2] or 0) - 1
        parts = word.split("/")
        if len(parts) > 3 or any(part and not _INTEGER.match(part) for part in parts) or not parts[0]:
            raise self.fault(number, "corners like 1, 1/2, 1//3 or 1/2/3", repr(word))
        counts = (len(self.vertices), len(self.uv), self.normal_count)
        indices = []
        for part, count, what in zip(parts, counts, ("vertex", "texture coordinate", "normal"), strict=False):
            index = int(part) if part else None
            if index == 0 or (index is not None and index < -count):
                raise self.fault(
                    number, f"a {what} index from 1, or from -{count} to -1", str(index), "Repair the face."
                )
            # Positive indices may point ahead: they are checked when all vertices are known.
            indices.append(-1 if index is None else index - 1 if index > 0 else count + index)
        return indices[0], indices[1] if len(indices) > 1 else -1

    def finish(self, *, is_binary: bool) -> GarmentMesh:
        if not self.vertices and not self.faces and is_binary:
            raise mesh_fault(self.name, "a text file (OBJ)", "binary data", "Name the file by its format.")
        if not self.vertices and not self.faces and self.skipped:
            expected, got = "an OBJ statement (v, vt, vn, f, usemtl, ...)", repr(next(iter(self.skipped)))
            raise self.fault(self.first_skipped, expected, got, "Is this an OBJ file?")
        if not self.vertices or not self.faces:
            missing = "faces" if self.vertices else "vertices"
            raise mesh_fault(self.name, "vertices and faces", f"no {missing}", "Export the garment's surface.")
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
        if self.skipped:
            most = ", ".join(f"{count} {keyword!a}" for keyword, count in self.skipped.most_common(5))
            rest = ", ..." if len(self.skipped) > 5 else ""
            notes.append(f"statements left out that say nothing of the surface, {self.skipped.total()}: {most}{rest}")
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
