"""The mesh of a garment as writers of files take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drape.files.looks import NO_LOOKS, Looks


class Surface(Protocol):
    """A mesh of triangles: ``faces`` (F, 3) of ``vertex_count`` vertices, texture coordinates ``uv`` (T, 2) with
    ``uv_faces`` (F, 3), both empty where there are none, the material ``face_material`` (F,) of each face, and
    ``looks`` of the materials."""

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
    """A garment at ``vertices`` [m] (F, V, 3), in a ``colour`` of linear red, green, blue and opacity."""

    surface: Surface
    vertices: np.ndarray
    colour: tuple[float, float, float, float]


class Counted(Protocol):
    """Something with a number of vertices: a ``Surface``, or a garment in service."""

    @property
    def vertex_count(self) -> int: ...


def by_layer(layers: Sequence[Counted], vertices: np.ndarray) -> list[np.ndarray]:
    """Splits ``vertices`` (F, V, 3), which has those of all ``layers`` one after the other, into an array for each
    layer.
    """
    return np.split(vertices, np.cumsum([layer.vertex_count for layer in layers])[:-1], axis=1)
