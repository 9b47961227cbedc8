"""Judging a drape: its energy, strain, collisions and relief, beside physics of the same cloth.

``MEASURES`` maps the name of a column to the function that computes it; ``Judged.figures`` gives a row of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import stored_minimum
from benchmarks.measure.detail import LowPass, dihedral_deg
from benchmarks.measure.hem import hang_mm
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.skin_pixels import PosedBody, covered_faces, skin_pixels_pct
from benchmarks.scenes import skinned
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import modelled
from drape.exact.blended_planes import blended_distance
from drape.garment.cache import Garment

FEW = 3  # frames, about, of measures that take long
Distance = Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class Cloth:
    """A garment's subdivided mesh in one cloth, and the body that it lies on.

    ``fabric`` None stands for ``material``, the cloth of before fabrics, whose rest is the mesh as modelled. Contact
    counts by ``distance``: blended planes as physics has them, or the nearest vertex's plane as training has it.
    """

    garment: Garment
    body: BodyModel
    material: Material
    fabric: Fabric | None = None
    distance: Distance = blended_distance

    @classmethod
    def of(cls, garment: Garment, body: BodyModel, fabric: Fabric) -> Cloth:
        """``garment`` made of ``fabric``, in its own rest state."""
        return cls(garment, body, Material.of(fabric), fabric)

    @property
    def rest(self) -> np.ndarray:
        """Rest vertices [m] (V, 3)."""
        return self.garment.vertices.astype(np.float64)

    @property
    def faces(self) -> np.ndarray:
        """Triangles (F, 3)."""
        return self.garment.fine_faces.astype(np.int64)

    @cached_property
    def mesh(self) -> ClothMesh:
        """The constants of the cloth's energy."""
        return ClothMesh.of(self._state, self.faces, len(self.rest))

    @cached_property
    def low_pass(self) -> LowPass:
        """The filter that relief is measured against."""
        return LowPass.of(self._state, self.faces, len(self.rest))

    @cached_property
    def contact(self) -> BodyContact:
        """The body's surface as contact takes it."""
        return BodyContact(self.body.faces, self.body.vertex_count)

    @cached_property
    def covered(self) -> np.ndarray:
        """Which faces (Fb,) of the body the garment covers at rest."""
        return covered_faces(self.body.v_template, self.body.faces, self.rest, self.faces)

    @cached_property
    def _state(self):
        return modelled(self.rest, self.faces) if self.fabric is None else self.garment.rest_state()


@dataclass(frozen=True, eq=False)
class Judged:
    """A cloth over the posed bodies ``body_vertices`` [m] (n, Vb, 3).

    Heights count from those of ``skinned`` [m] (n, V, 3), which also carries the waistbands that physics holds.
    """

    cloth: Cloth
    body_vertices: np.ndarray
    skinned: np.ndarray

    @classmethod
    def of(cls, cloth: Cloth, poses: np.ndarray) -> Judged:
        """``cloth`` over its body at ``poses`` (n, 24, 3) [rad]."""
        return cls(cloth, cloth.body.posed_vertices(poses), skinned(cloth.garment, cloth.body, poses))

    def at(self, frames: slice | np.ndarray) -> Judged:
        """The same over some of the bodies."""
        return Judged(self.cloth, self.body_vertices[frames], self.skinned[frames])

    @property
    def spread(self) -> slice:
        """Which of the frames measures that take long look at."""
        return slice(None, None, max(1, len(self.body_vertices) // FEW))

    @cached_property
    def few(self) -> Judged:
        """The same over the frames of ``spread``."""
        return self.at(self.spread)

    @cached_property
    def height_m(self) -> np.ndarray:
        """Height [m] (n,) that gravity's energy counts from."""
        return metrics.mean_height(self.skinned, self.cloth.mesh)

    @cached_property
    def body_normals(self) -> np.ndarray:
        """Unit vertex normals (n, Vb, 3) of the bodies."""
        return np.asarray(self.cloth.contact.normals(self.body_vertices))

    @cached_property
    def pushed(self) -> np.ndarray:
        """``skinned`` with the nearest-vertex push: the baseline of a gain."""
        return nearest_vertex_push(self.skinned, self.body_vertices, self.body_normals)

    @cached_property
    def pictured(self) -> tuple[PosedBody, ...]:
        """The bodies in pictures, which all drapes share."""
        return tuple(PosedBody.of(posed, self.cloth.body.faces) for posed in self.body_vertices)

    def parts_j(self, vertices: np.ndarray) -> dict[str, np.ndarray]:
        """Energies [J] (n,) by part of ``vertices`` [m] (n, V, 3)."""
        cloth = self.cloth
        return metrics.static_parts(
            vertices, cloth.mesh, cloth.material, cloth.contact, self.body_vertices,
            height_m=self.height_m, distance=cloth.distance,
        )  # fmt: skip

    def energies(self, vertices: np.ndarray) -> dict[str, float]:
        """Mean energies [J] of ``vertices`` [m] (n, V, 3): the whole as ``energy_j``, and each part."""
        parts = self.parts_j(vertices)
        whole = {"energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean())}
        return whole | {f"{part}_j": float(value.mean()) for part, value in parts.items()}

    def figures(self, vertices: np.ndarray, names: Sequence[str]) -> dict[str, float]:
        """Those of ``MEASURES`` called ``names``, means over the frames of ``vertices`` [m] (n, V, 3)."""
        return {name: float(np.mean(MEASURES[name](self, vertices))) for name in names}

    def task(self, starts: tuple[np.ndarray, ...]) -> physics.Task:
        """The task of physics, from ``starts`` [m] (n, V, 3)."""
        cloth = self.cloth
        return physics.Task.of_garment(
            cloth.garment, cloth.body, cloth.mesh, cloth.material,
            contact=cloth.contact, body_vertices=self.body_vertices, skinned=self.skinned, starts=starts,
        )  # fmt: skip

    def optimum(
        self, starts: tuple[np.ndarray, ...], folder: Path | None, steps: int | None = None
    ) -> tuple[physics.Optimum, bool]:
        """The physics optimum from ``starts`` in at most ``steps``, and whether it was kept in ``folder``."""
        return stored_minimum(self.task(starts), steps or physics.STEPS, folder)

    def skin_pct(self, vertices: np.ndarray) -> np.ndarray:
        """Share [%] (n, 4) of skin in the pixels of ``vertices`` [m] (n, V, 3), from four sides."""
        covered, faces = self.cloth.covered, self.cloth.faces
        pairs = zip(self.pictured, vertices, strict=True)
        return np.stack([skin_pixels_pct(body, covered, cloth, faces) for body, cloth in pairs])


# Each gives a value for every frame, but skin, which is the mean over the views that show cloth.
MEASURES: dict[str, Callable[[Judged, np.ndarray], Any]] = {
    "edge_pct": lambda j, x: metrics.edge_strain_pct(x, j.cloth.rest, j.cloth.faces),
    "area_pct": lambda j, x: metrics.area_strain_pct(x, j.cloth.rest, j.cloth.faces),
    "colliding_vertex_pct": lambda j, x: metrics.colliding_vertex_pct(x, j.body_vertices, j.body_normals),
    "colliding_triangle_pct": lambda j, x: metrics.colliding_triangle_pct(x, j.body_vertices, j.cloth.body.faces),
    "self_intersections": lambda j, x: intersection_count(x, j.cloth.faces),
    "skin_pixels_pct": lambda j, x: np.nanmean(j.skin_pct(x), keepdims=True),
    "hang_mm": lambda j, x: hang_mm(x, j.skinned, j.cloth.rest, j.cloth.faces),
    "detail_mm": lambda j, x: j.cloth.low_pass.detail_mm(x),
    "dihedral_deg": lambda j, x: dihedral_deg(x, j.cloth.faces),
}


def jitter_ratio(vertices: np.ndarray, start: np.ndarray) -> float:
    """Root mean square third difference of ``vertices`` (F, V, 3) over that of ``start``; NaN where that is still."""
    still = metrics.third_difference_square(start)
    return float(np.sqrt(metrics.third_difference_square(vertices) / still)) if still > 0.0 else float("nan")
