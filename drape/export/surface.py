"""The mesh of a garment as writers of files take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drape.files.looks import NO_LOOKS, Looks


class Surface(Protocol):
    """The mesh of a garment as writers of files take it.

    ``faces`` (F, 3) are indices of its ``vertex_count`` vertices. ``uv`` (T, 2) are texture coordinates with the origin
    at the lower left, and ``uv_faces`` (F, 3) indices of these; both are empty where there are none. ``face_material``
    (F,) is the index of each face's material in ``material_names`` and ``looks``.
    """

    @property
    def name(self) -> str: ...
    @property
    def vertex_count(self) -> int: ...
    @property
    def faces(self) -> np.ndarray: ...
    @property
    def uv(self) -> np.ndarray: ...
    @property
    def uv_faces(self) -> np.ndarray: ...
    @property
    def material_names(self) -> tuple[str, ...]: ...
    @property
    def face_material(self) -> np.ndarray: ...
    @property
    def looks(self) -> Looks: ...


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """A ``Surface`` that does not come from a ``Garment``, such as a mesh that a service has sent."""

    name: str
    vertex_count: int
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    material_names: tuple[str, ...]
    face_material: np.ndarray
    looks: Looks = NO_LOOKS


@dataclass(frozen=True, eq=False)
class MovingGarment:
    """A garment over F frames: its mesh, ``vertices`` [m] (F, V, 3) in the world, and a ``colour``, linear red, green,
    blue and opacity."""

    surface: Surface
    vertices: np.ndarray
    colour: tuple[float, float, float, float]


class Counted(Protocol):
    """Something with a number of vertices: a ``Surface``, or a garment in service."""

    @property
    def vertex_count(self) -> int: ...


def by_layer(layers: Sequence[Counted], vertices: np.ndarray) -> list[np.ndarray]:
    """Returns the parts of ``vertices`` (F, V, 3) that belong to each of ``layers``, which lie there one after the
    other."""
    return np.split(vertices, np.cumsum([layer.vertex_count for layer in layers])[:-1], axis=1)
