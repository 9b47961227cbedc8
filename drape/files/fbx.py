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
    """One visible mesh: ``vertices`` (V, 3) that ``placed`` (3, 4) takes to the world [m]; ``corners`` (C,) of all
    polygons, which are rows (begin, count) of ``polygons`` (P, 2); ``uv`` (C, 2) or None; the numbers of its
    ``materials`` and which of them each polygon has (P,), or none are told."""

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

    ``meshes``; ``materials`` as ``fbx_process`` tells them; ``pictures``, each by its names with its bytes, which may
    be empty; and ``unit_m``, the unit of the file [m].
    """

    meshes: list[FbxMesh]
    materials: list[dict[str, Any]]
    pictures: list[tuple[list[str], bytes]]
    unit_m: float


@dataclass(frozen=True, eq=False)
class FbxMotion:
    """J nodes: ``names``, ``parents`` (-1: none), ``rest`` (J, 3, 4) in the world; ``moves`` (F, J, 10) in the frames,
    relative to the parent: translation, quaternion xyzw, scale; y up."""

    names: list[str]
    parents: list[int]
    rest: np.ndarray
    moves: np.ndarray
    fps: float


def read_scene(payload: bytes, fault: Callable[[str, str, str], DrapeError]) -> FbxScene:
    """The scene of an FBX file, binary or text.

    Raises ``fault(expected, got, cure)`` for damaged bytes, and where ufbx is not installed.
    """
    arrays = _read(payload, fault)
    told = json.loads(arrays["told"].tobytes())
    meshes = [_mesh(arrays, number, one) for number, one in enumerate(told["meshes"])]
    pictures = [(names, arrays[f"picture.{number}"].tobytes()) for number, names in enumerate(told["pictures"])]
    return FbxScene(meshes, told["materials"], pictures, told["unit_m"])


def read_animation(
    payload: bytes, fault: Callable[[str, str, str], DrapeError], *, clip: str | None = None
) -> FbxMotion:
    """The animation called ``clip`` in an FBX file, or its longest. Raises as ``read_scene`` does, and where there is
    none."""
    arrays = _read(payload, fault, "motion", *([] if clip is None else [clip]))
    told = json.loads(arrays["told"].tobytes())
    return FbxMotion(told["names"], told["parents"], arrays["rest"], arrays["moves"], told["fps"])


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
        got = "one that takes too long" if ended.returncode == -signal.SIGXCPU else "one at which its reader ends"
        raise fault("a readable FBX file", got, AGAIN)
    with np.load(io.BytesIO(ended.stdout), allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


def _mesh(arrays: dict[str, np.ndarray], number: int, told: dict[str, Any]) -> FbxMesh:
    names = ("vertices", "corners", "polygons", "face_material", "placed")
    own = {name: arrays[f"{number}.{name}"] for name in names}
    return FbxMesh(name=told["name"], **own, uv=arrays.get(f"{number}.uv"), materials=told["materials"])
