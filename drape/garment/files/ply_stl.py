"""Reads PLY and STL, through trimesh where it must be, after comparing declared counts with the bytes."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np

from drape.files.looks import Looks, Material
from drape.files.notes import absent_file
from drape.garment.files.mesh import Beside, GarmentMesh, check_count, mesh_fault, plain_mesh, weld

_PLY_SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip


def read_ply(payload: bytes, *, name: str, vertex_limit: int, beside: Beside = lambda wanted: None) -> GarmentMesh:
    """Returns the mesh of a PLY file, in the file's unit and axes. The picture that its header calls TextureFile, read
    by ``beside``, is its base colour. Raises ``MeshError``, also where the header's counts do not fit the bytes."""
    end = payload[:65536].find(b"end_header")
    if end < 0 or payload[:3] != b"ply":
        raise mesh_fault(name, "a PLY header", "none in the first 64 KiB")
    header = payload[:end].decode("ascii", errors="replace").splitlines()
    ascii_file = any(line.split()[:2] == ["format", "ascii"] for line in header if line.strip())
    needed, count, names = 0, 0, set()
    for words in (line.split() for line in header):
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdigit():
                raise mesh_fault(name, "element NAME COUNT", " ".join(words)[:60])
            count = int(words[2])
            names.add(words[1])
            check_count(f"{name} ({words[1]})", count // (1 if words[1] == "vertex" else 4), vertex_limit)
        elif words[:1] == ["property"] and len(words) >= 3:
            # A list costs at least its own count; text at least two characters per value.
            needed += count * (2 if ascii_file else _PLY_SIZES.get(words[2] if words[1] == "list" else words[1], 1))
    if not {"vertex", "face"} <= names:
        raise mesh_fault(name, "elements vertex and face", ", ".join(sorted(names)) or "none", "Export a mesh.")
    held = len(payload) - end
    if needed > held:
        cure = "The file is cut off: export it again."
        raise mesh_fault(name, f"at least {needed:,} bytes of data", f"{held:,}", cure)
    mesh = _by_trimesh(payload, "ply", name)
    named = [line.split(maxsplit=2)[2] for line in header if line.startswith("comment TextureFile ")]
    if not named or not len(mesh.uv):
        return mesh
    if (picture := beside(named[0])) is None:
        return mesh.noted(absent_file(named[0]))
    return replace(mesh, looks=Looks((Material(pictures={"base_colour": 0}),), (picture,)))


def read_stl(payload: bytes, *, name: str, vertex_limit: int) -> GarmentMesh:
    """Returns the mesh of an STL file, in the file's unit and axes. Corners at the same place become one vertex, in the
    order of their first appearance. Raises ``MeshError``."""
    declared = int.from_bytes(payload[80:84], "little") if len(payload) >= 84 else -1
    if declared >= 0 and len(payload) == 84 + 50 * declared:
        check_count(name, declared // 2, vertex_limit)
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(payload, dtype=record, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    elif payload.lstrip()[:5] == b"solid" and b"facet" in payload:
        check_count(name, payload.count(b"vertex") // 6, vertex_limit)
        mesh = _by_trimesh(payload, "stl_ascii", name)
        corners = mesh.vertices[mesh.faces.reshape(-1)]
    else:
        got = f"{len(payload):,} bytes for {declared:,}"
        raise mesh_fault(name, "an STL whose size fits its count of triangles", got)
    return weld(plain_mesh(name, corners, np.arange(len(corners))))


def _by_trimesh(payload: bytes, kind: str, name: str) -> GarmentMesh:
    import trimesh

    try:
        loaded = trimesh.load_mesh(io.BytesIO(payload), file_type=kind, process=False, maintain_order=True)
        vertices, faces = np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces, dtype=np.int64)
    except Exception as error:
        # A broken file can raise anything inside the library.
        raise mesh_fault(name, f"a readable {kind[:3].upper()}", f"{type(error).__name__}: {error}") from error
    mesh, uv = plain_mesh(name, vertices, faces), getattr(loaded.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(vertices), 2) or not np.isfinite(uv).all():
        return mesh
    return replace(mesh, uv=np.asarray(uv, dtype=np.float64), uv_faces=faces)
