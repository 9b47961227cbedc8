"""Meshes of garments out of the service's JSON, and the GLB of a clip that came in pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clients.calls import Call
from drape.errors import InputError
from drape.export.glb import GARMENT_COLOURS, add_garment
from drape.export.glb_file import GlbFile
from drape.export.root_motion import RootMotion
from drape.export.surface import MeshSurface, Surface


def surface_of(document: Mapping[str, Any]) -> MeshSurface:
    """Returns the mesh in the JSON ``document`` of ``GET /garments/{id}/mesh``."""
    return MeshSurface(
        document["id"],
        len(document["vertices"]),
        np.array(document["faces"], dtype=np.int64).reshape(-1, 3),
        np.array(document["uv"], dtype=float).reshape(-1, 2),
        np.array(document["uv_faces"], dtype=np.int64).reshape(-1, 3),
        tuple(document["materials"]),
        np.array(document["face_material"], dtype=np.int64),
    )


def layers(meshes: Sequence[Surface], vertices: np.ndarray) -> list[np.ndarray]:
    """Returns ``vertices`` (F, V, 3) split into those of each of ``meshes``, in their order."""
    return np.split(vertices, np.cumsum([mesh.vertex_count for mesh in meshes])[:-1], axis=1)


def check_at_once(call: Call[bytes], most: int) -> None:
    """Refuses (``InputError``) a ``call`` whose GLB has a body or is on a rig, since only the service can write that.
    The clip of ``call`` has more than ``most`` frames, the most of one request."""
    assert call.clip is not None
    for name in ("body", "rig"):
        if call.json.get(name):
            frames = len(call.clip.poses)
            cure = "Leave it out, or ask for less at once."
            raise InputError(name, expected=f"at most {most} frames with it", got=str(frames), cure=cure)


def glb_of(call: Call[bytes], meshes: Sequence[Surface], vertices: np.ndarray, roots: np.ndarray) -> bytes:
    """Returns the bytes of the GLB that ``call`` asks for. ``vertices`` [m] (F, V, 3) are those of all ``meshes``, one
    mesh after the other, relative to the ``roots`` [m] (F, 3) of the frames."""
    assert call.clip is not None
    file = GlbFile()
    root_motion = RootMotion(call.clip.poses[:, 0], roots) if call.json["quantised"] else None
    for number, (mesh, own) in enumerate(zip(meshes, layers(meshes, vertices), strict=True)):
        colour = GARMENT_COLOURS[number % len(GARMENT_COLOURS)]
        places = (own + roots[:, None]).astype(np.float32)
        add_garment(file, mesh, places, call.json["fps"], colour, root_motion=root_motion)
    return file.to_bytes()
