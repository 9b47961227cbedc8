"""Judging a drape: its energy, strain, collisions and relief, beside physics of the same cloth.

``MEASURES`` maps the name of a column to the function that computes it; ``Judged.figures`` gives a row of them.

Skin that shows through cloth is counted in pictures, as a viewer sees it. A body and a garment are drawn from four
sides. A pixel shows skin where the body is nearest, on a face that the rest pose covers, and cloth lies less than 3 cm
behind it. Pictures of the rest pose from eight sides tell which faces it covers: those that always have cloth before
them, and lie 3 cm from bare ones, because a hem may move so far.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from benchmarks.cases import skinned
from benchmarks.judge import physics
from benchmarks.judge.physics_cache import stored_minimum
from benchmarks.measure.detail import LowPass, dihedral_deg
from benchmarks.measure.hem import hang_mm
from benchmarks.measure.intersections import intersection_count
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import modelled_rest
from drape.exact.blended_planes import blended_distance
from drape.garment.cache import Garment
from drape.geometry.raster import ZBuffer, z_buffer

FEW = 3  # measures that take long are taken on about so many bodies


@dataclass(frozen=True, eq=False)
class JudgedCloth:
    """The subdivided mesh of a garment made of one cloth, and the body that it lies on.

    With None for ``fabric`` the cloth is ``material`` and rests as the mesh is modelled; otherwise ``material`` is that
    of the fabric, and the garment's own rest state counts.
    """

    garment: Garment
    body: BodyModel
    material: Material
    fabric: Fabric | None = None

    @classmethod
    def of(cls, garment: Garment, body: BodyModel, fabric: Fabric) -> JudgedCloth:
        """Returns ``garment`` made of ``fabric`` on ``body``."""
        return cls(garment, body, Material.of(fabric), fabric)

    @property
    def rest(self) -> np.ndarray:
        """The vertices of the subdivided mesh at rest [m] (V, 3), float64."""
        return self.garment.vertices.astype(np.float64)

    @property
    def faces(self) -> np.ndarray:
        """The triangles (F, 3) of the subdivided mesh, int64."""
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
        """The whole surface of the body, for contact."""
        return BodyContact(self.body.faces, self.body.vertex_count)

    @cached_property
    def covered(self) -> np.ndarray:
        """Which faces of the body (Fb,) the garment covers at rest (``covered_skin``)."""
        return covered_skin(self.body.v_template, self.body.faces, self.rest, self.faces)

    @cached_property
    def _state(self):
        return modelled_rest(self.rest, self.faces) if self.fabric is None else self.garment.rest_state()


@dataclass(frozen=True, eq=False)
class Judged:
    """What judges drapes of a ``cloth`` over n posed bodies, ``body_vertices`` [m] (n, Vb, 3).

    ``skinned`` [m] (n, V, 3) is the cloth after linear blend skinning. Its mean heights are those at which the energy
    of gravity is 0. Physics holds a waistband where these vertices have it.
    """

    cloth: JudgedCloth
    body_vertices: np.ndarray
    skinned: np.ndarray

    @classmethod
    def of(cls, cloth: JudgedCloth, poses: np.ndarray) -> Judged:
        """Returns ``cloth`` over its body at ``poses`` (n, 24, 3) [rad]."""
        return cls(cloth, cloth.body.posed_vertices(poses), skinned(cloth.garment, cloth.body, poses))

    @property
    def spread(self) -> slice:
        """Which of the n bodies slow measures are taken on: about ``FEW``, evenly spread."""
        return slice(None, None, max(1, len(self.body_vertices) // FEW))

    @cached_property
    def few(self) -> Judged:
        """The same cloth over the bodies of ``spread`` alone."""
        return Judged(self.cloth, self.body_vertices[self.spread], self.skinned[self.spread])

    @cached_property
    def height_m(self) -> np.ndarray:
        """The heights [m] (n,) that the energy of gravity counts from."""
        return metrics.mean_height(self.skinned, self.cloth.mesh)

    @cached_property
    def body_normals(self) -> np.ndarray:
        """The unit vertex normals (n, Vb, 3) of the bodies."""
        return np.asarray(self.cloth.contact.normals(self.body_vertices))

    @cached_property
    def pushed(self) -> np.ndarray:
        """The drapes [m] (n, V, 3) whose gain is 0: ``skinned`` after the nearest-vertex push."""
        return nearest_vertex_push(self.skinned, self.body_vertices, self.body_normals)

    @cached_property
    def pictured(self) -> tuple[JudgedBody, ...]:
        """The n bodies with their pictures, which all drapes share."""
        return tuple(JudgedBody.of(posed, self.cloth.body.faces) for posed in self.body_vertices)

    def parts_j(self, vertices: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the energies [J] (n,) of the drapes ``vertices`` [m] (n, V, 3) by part: "membrane", "bending",
        "gravity" and "contact"."""
        cloth = self.cloth
        return metrics.static_parts(
            vertices, cloth.mesh, cloth.material, cloth.contact, self.body_vertices,
            height_m=self.height_m, distance=blended_distance,
        )  # fmt: skip

    def energies(self, vertices: np.ndarray) -> dict[str, float]:
        """Returns mean energies [J] of the drapes ``vertices`` [m] (n, V, 3): the whole as "energy_j", and each part of
        ``parts_j`` as "PART_j"."""
        parts = self.parts_j(vertices)
        whole = {"energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean())}
        return whole | {f"{part}_j": float(value.mean()) for part, value in parts.items()}

    def figures(self, vertices: np.ndarray, names: Sequence[str]) -> dict[str, float]:
        """Returns the measures ``names`` of ``MEASURES``, as means over the drapes ``vertices`` [m] (n, V, 3)."""
        return {name: float(np.mean(MEASURES[name](self, vertices))) for name in names}

    def task(self, starts: tuple[np.ndarray, ...]) -> physics.OptimumTask:
        """Returns the task to find physics of the cloth on these bodies, from each of ``starts`` [m] (n, V, 3)."""
        cloth = self.cloth
        return physics.OptimumTask.of_garment(
            cloth.garment, cloth.body, cloth.mesh, cloth.material,
            contact=cloth.contact, body_vertices=self.body_vertices, skinned=self.skinned, starts=starts,
        )  # fmt: skip

    def optimum(
        self, starts: tuple[np.ndarray, ...], folder: Path | None, steps: int | None = None
    ) -> tuple[physics.Optimum, bool]:
        """Returns the physics optimum from ``starts`` in at most ``steps`` (by default ``physics.STEPS``), and whether
        it was in ``folder`` already."""
        return stored_minimum(self.task(starts), steps or physics.STEPS, folder)

    def skin_pct(self, vertices: np.ndarray) -> np.ndarray:
        """Returns ``skin_pixels_pct`` (n, 4) [%] of the drapes ``vertices`` [m] (n, V, 3)."""
        covered, faces = self.cloth.covered, self.cloth.faces
        pairs = zip(self.pictured, vertices, strict=True)
        return np.stack([skin_pixels_pct(body, covered, cloth, faces) for body, cloth in pairs])


# Each gives a value for every drape, but the share of skin gives one, the mean over the views that show cloth.
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
    """Returns the root mean square third difference in time of ``vertices`` (F, V, 3) over that of ``start`` (F, V, 3);
    NaN where that stands still."""
    still = metrics.third_difference_square(start)
    return float(np.sqrt(metrics.third_difference_square(vertices) / still)) if still > 0.0 else float("nan")


PIXEL_M = 0.003
VIEWS_DEG, REST_VIEWS_DEG = (0.0, 90.0, 180.0, 270.0), tuple(45.0 * view for view in range(8))
HEM_M, BEHIND_M = 0.03, 0.03
MARGIN_M = 0.1  # added around the body, since cloth stands off it


@dataclass(frozen=True, eq=False)
class Camera:
    """The frame of pictures that show a whole body: their ``size`` (height, width) in pixels, and the ``centre`` [m]
    (3,) that they look at."""

    size: tuple[int, int]
    centre: np.ndarray

    @classmethod
    def around(cls, vertices: np.ndarray) -> Camera:
        """Returns the camera whose pictures show all of ``vertices`` [m] (V, 3) from any side."""
        low, high = vertices.min(axis=0) - MARGIN_M, vertices.max(axis=0) + MARGIN_M
        side = float(np.linalg.norm((high - low)[[0, 2]]))
        height = float(high[1] - low[1]) + 0.15 * side  # the view looks down a little
        return cls((int(np.ceil(height / PIXEL_M)), int(np.ceil(side / PIXEL_M))), 0.5 * (low + high))

    def see(self, vertices: np.ndarray, faces: np.ndarray, azimuth_deg: float) -> ZBuffer:
        """Returns the picture of a mesh, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), from the side ``azimuth_deg``:
        the nearest face in every pixel and its depth."""
        extent_m = self.size[0] * PIXEL_M
        return z_buffer(vertices, faces, size=self.size, azimuth_deg=azimuth_deg, centre=self.centre, extent_m=extent_m)


def covered_skin(
    body_vertices: np.ndarray, body_faces: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Returns which (Fb,) of ``body_faces`` a garment, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), covers at rest:
    faces that never show in pictures from ``REST_VIEWS_DEG``, because cloth is before them, and are at least ``HEM_M``
    from those that show."""
    camera = Camera.around(body_vertices)
    hidden, bare = np.zeros(len(body_faces), bool), np.zeros(len(body_faces), bool)
    for azimuth_deg in REST_VIEWS_DEG:
        skin, cloth = (camera.see(*mesh, azimuth_deg) for mesh in ((body_vertices, body_faces), (vertices, faces)))
        behind = cloth.depth > skin.depth
        hidden[skin.face[behind & (skin.face >= 0)]] = True
        bare[skin.face[~behind & (skin.face >= 0)]] = True
    centre = body_vertices[body_faces].mean(axis=1)
    near_bare = KDTree(centre[bare]).query(centre)[0] < HEM_M if bare.any() else np.zeros(len(centre), bool)
    return hidden & ~bare & ~near_bare


@dataclass(frozen=True, eq=False)
class JudgedBody:
    """A body on which garments are looked at: ``vertices`` [m] (Vb, 3), ``faces`` (Fb, 3), and its pictures ``views``
    from the four sides ``VIEWS_DEG`` by ``camera``."""

    vertices: np.ndarray
    faces: np.ndarray
    camera: Camera
    views: tuple[ZBuffer, ...]

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> JudgedBody:
        """Returns the body with its pictures."""
        camera = Camera.around(vertices)
        return cls(vertices, faces, camera, tuple(camera.see(vertices, faces, azimuth) for azimuth in VIEWS_DEG))


def skin_pixels_pct(body: JudgedBody, covered: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns how much skin shows through cloth, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), on ``body``: the share
    [%] (4,) of pixels, from four sides.

    Of the pixels that show cloth or a face of the body that is ``covered`` (Fb,) at rest, those count that show such a
    face with cloth less than 3 cm behind it. NaN where a picture shows neither.
    """
    shares = []
    for skin, azimuth_deg in zip(body.views, VIEWS_DEG, strict=True):
        cloth = body.camera.see(vertices, faces, azimuth_deg)
        in_front = skin.depth > cloth.depth
        bare = in_front & (skin.face >= 0) & covered[np.maximum(skin.face, 0)]
        shown = bare & (cloth.depth > skin.depth - BEHIND_M)
        count = np.count_nonzero(bare) + np.count_nonzero(~in_front & (cloth.face >= 0))
        shares.append(100.0 * np.count_nonzero(shown) / count if count else np.nan)
    return np.array(shares)
