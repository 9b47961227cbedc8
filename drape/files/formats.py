"""The formats of garment files: the one table that readers, intake, service, clients and page go by.

A new format is a row here and a reader in ``drape.garment.files``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

HEAD_BYTES = 2048  # A file's format is known by so many bytes at its beginning.


@dataclass(frozen=True)
class MeshFormat:
    """One format of garment files.

    ``name`` is also the suffix of its files, and ``content_types`` are its media types. ``reader`` is the function that
    reads it, as ``module.function`` in ``drape.garment.files``. ``fits`` says whether a payload is of this format by
    its bytes. ``names_others``: such a file names files beside it.
    """

    name: str
    content_types: tuple[str, ...]
    reader: str
    fits: Callable[[bytes], bool]
    names_others: bool = False

    @property
    def suffix(self) -> str:
        return f".{self.name}"


def _is_usdz(payload: bytes) -> bool:
    return payload[:4] == b"PK\x03\x04" and b".usd" in payload[30 : 30 + int.from_bytes(payload[26:28], "little")]


def _is_stl(payload: bytes) -> bool:
    binary = len(payload) >= 84 and len(payload) == 84 + 50 * int.from_bytes(payload[80:84], "little")
    return binary or (payload[:512].lstrip()[:6] == b"solid " and b"facet" in payload[:HEAD_BYTES])


def _is_fbx(payload: bytes) -> bool:
    return payload[:18] == b"Kaydara FBX Binary" or (payload[:5] == b"; FBX" and b"FBXHeader" in payload[:HEAD_BYTES])


# OBJ has no mark of its own, so it comes first and is taken where no other fits.
MESH_FORMATS: tuple[MeshFormat, ...] = (
    MeshFormat("obj", ("model/obj",), "obj_mesh.read_obj", lambda payload: False, True),
    MeshFormat("glb", ("model/gltf-binary",), "gltf_mesh.read_glb", lambda payload: payload[:4] == b"glTF"),
    MeshFormat(
        "gltf", ("model/gltf+json",), "gltf_mesh.read_glb", lambda payload: payload[:64].lstrip()[:1] == b"{", True
    ),
    MeshFormat(
        "ply",
        ("model/ply", "application/x-ply"),
        "ply_stl.read_ply",
        lambda payload: payload[:512].lstrip()[:4] in (b"ply\n", b"ply\r"),
        names_others=True,
    ),
    MeshFormat("stl", ("model/stl", "application/sla"), "ply_stl.read_stl", _is_stl),
    MeshFormat("usd", ("model/vnd.usd",), "usd.read_usd", lambda payload: False, True),
    MeshFormat("usda", ("model/vnd.usda",), "usd.read_usd", lambda payload: payload[:5] == b"#usda", True),
    MeshFormat("usdc", ("model/vnd.usdc",), "usd.read_usd", lambda payload: payload[:8] == b"PXR-USDC", True),
    MeshFormat("usdz", ("model/vnd.usdz+zip",), "usd.read_usd", _is_usdz, True),
    MeshFormat("fbx", ("model/fbx", "application/x-fbx"), "fbx_mesh.read_fbx", _is_fbx, True),
    MeshFormat(
        "zip",
        ("application/zip", "application/x-zip-compressed"),
        "archive.read_zip",
        lambda payload: payload[:4] == b"PK\x03\x04",
    ),
)
MESH_NAMES: tuple[str, ...] = tuple(one.name for one in MESH_FORMATS)
AVATAR_SUFFIXES = (".glb", ".vrm")
MESH_SUFFIXES: tuple[str, ...] = tuple(one.suffix for one in MESH_FORMATS)
# Meshes name files with these suffixes.
BESIDE_SUFFIXES = (".mtl", ".bin", ".png", ".jpg", ".jpeg", ".webp", ".tga", ".bmp", ".ktx2")
MESH_CONTENT_TYPES: dict[str, str] = {kind: one.name for one in MESH_FORMATS for kind in one.content_types}


def format_list() -> str:
    """Returns the names of all formats for a sentence: ``OBJ, GLB, GLTF, ..., USDZ or ZIP``."""
    *first, final = (name.upper() for name in MESH_NAMES)
    return f"{', '.join(first)} or {final}"


def sniff(payload: bytes) -> MeshFormat:
    """Returns the format of a mesh by its bytes; OBJ, which has no mark of its own, where nothing else fits."""
    return next((one for one in MESH_FORMATS if one.fits(payload)), MESH_FORMATS[0])
