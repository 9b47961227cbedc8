"""What is in an FBX file: meshes in metres, y up, materials and pictures, read in a process of its own."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from drape.errors import DrapeError

WAIT_S = 120.0
INSTALL = "Install it (pip install 'patchdrape[fbx]'), or export the mesh as GLB."
AGAIN = "Export it again, or as GLB."


@dataclass(frozen=True, eq=False)
class FbxMesh:
    """One visible mesh of an FBX file.

    ``placed`` (3, 4) takes its ``vertices`` (V, 3) to the world [m]. ``corners`` (C,) are the vertices of all polygons,
    one polygon after the other, and ``polygons`` (P, 2) the first corner and the number of corners of each. ``uv``
    (C, 2) are the corners' texture coordinates with the origin at the lower left, or None. ``materials`` are indices of
    the file's materials, and ``face_material`` (P,) is the index of each polygon's in ``materials``, empty where the
    file has none.
    """

    name: str
    vertices: np.ndarray
    corners: np.ndarray
    polygons: np.ndarray
    face_material: np.ndarray
    placed: np.ndarray
    uv: np.ndarray | None
    materials: list[int]


@dataclass(frozen=True, eq=False)
class FbxScene:
    """The visible contents of an FBX file.

    ``materials`` have "name", "base_color" (red, green, blue) and the ``NUMBERS`` of ``fbx_process``, None where the
    file has none. Their "pictures" have, by names of the ``MAPS`` of ``fbx_process``, the index in ``pictures`` of what
    a map shows. ``pictures`` have the names by which the file calls each one, and its bytes, which may be empty.
    ``unit_m`` is the file's unit [m].
    """

    meshes: list[FbxMesh]
    materials: list[dict[str, Any]]
    pictures: list[tuple[list[str], bytes]]
    unit_m: float


@dataclass(frozen=True, eq=False)
class FbxMotion:
    """J nodes of an FBX file in F frames, y up, in metres.

    ``parents`` are indices, -1 for none. ``rest`` (J, 3, 4) are the world transforms at rest. ``moves`` (F, J, 10) are
    the transforms relative to the parent: translation, quaternion xyzw, scale.
    """

    names: list[str]
    parents: list[int]
    rest: np.ndarray
    moves: np.ndarray
    fps: float


def read_scene(payload: bytes, fault: Callable[[str, str, str], DrapeError]) -> FbxScene:
    """Returns the visible contents of the FBX file ``payload``, binary or text.

    Raises ``fault(expected, got, cure)`` for damaged bytes, and where ufbx is not installed.
    """
    arrays = _read(payload, fault)
    description = json.loads(arrays["description"].tobytes())
    meshes = [_mesh(arrays, number, one) for number, one in enumerate(description["meshes"])]
    pictures = [(names, arrays[f"picture.{number}"].tobytes()) for number, names in enumerate(description["pictures"])]
    return FbxScene(meshes, description["materials"], pictures, description["unit_m"])


def read_animation(
    payload: bytes, fault: Callable[[str, str, str], DrapeError], *, clip: str | None = None
) -> FbxMotion:
    """Returns the nodes of the FBX file ``payload`` in the animation called ``clip``, or in the longest. Raises as
    ``read_scene`` does, and where there is none."""
    arrays = _read(payload, fault, "motion", *([] if clip is None else [clip]))
    description = json.loads(arrays["description"].tobytes())
    return FbxMotion(**description, rest=arrays["rest"], moves=arrays["moves"])


def _read(payload: bytes, fault: Callable[[str, str, str], DrapeError], *asked: str) -> dict[str, np.ndarray]:
    """The arrays that the process writes."""
    if find_spec("ufbx") is None:
        raise fault("the package ufbx, which reads FBX", "none", INSTALL)
    command = [sys.executable, "-m", "drape.files.fbx_process", *asked]
    try:
        ended = subprocess.run(command, input=payload, capture_output=True, timeout=WAIT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise fault(f"an FBX file that is read within {WAIT_S:g} s", "no end by then", AGAIN) from error
    if ended.returncode == 3:
        raise fault("a readable FBX file", ended.stdout.decode(errors="replace")[:100], AGAIN)
    if ended.returncode:
        late = sys.platform != "win32" and ended.returncode == -signal.SIGXCPU
        got = "one that takes too long" if late else "one at which its reader ends"
        raise fault("a readable FBX file", got, AGAIN)
    with np.load(io.BytesIO(ended.stdout), allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


def _mesh(arrays: dict[str, np.ndarray], number: int, named: dict[str, Any]) -> FbxMesh:
    names = ("vertices", "corners", "polygons", "face_material", "placed")
    own = {name: arrays[f"{number}.{name}"] for name in names}
    return FbxMesh(name=named["name"], **own, uv=arrays.get(f"{number}.uv"), materials=named["materials"])
