"""The physics optimum of a drape: every vertex is free, and each frame's energy is minimised by itself.

``drape.exact.newton`` goes down from the lowest of the starts, with the garment's charts as coarse level. The
optimum never lies above its starts. It says of every frame whether it came to rest; a garment that ends far from rest
is refused by its name. docs/reference/quality.md tells what its figures mean.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.cloth.waistband import STIFFNESS_N_M2, band_energy, waistband
from drape.errors import MeshError
from drape.exact.blended_planes import blended_distance
from drape.exact.linear import Charts
from drape.exact.newton import TOLERANCE, Band, Cloth, minimum
from drape.exact.settling import State
from drape.garment.cache import Garment
from drape.geometry import meshes

STEPS = 250  # of Newton's method, at most
LEFT_LIMIT_J_M2 = 0.05  # skinning costs 1 to 5 J per m^2 of cloth


PartsOf = Callable[..., dict[str, np.ndarray]]
Descend = Callable[[Cloth, np.ndarray, list[np.ndarray], Band | None], State]


@dataclass(frozen=True, eq=False)
class Waistband:
    """A waistband over F posed bodies: springs hold its n vertices ``vertex`` (n,) at ``anchor`` [m] (F, n, 3);
    ``length_m`` (n,) is the length of the band that each stands for."""

    vertex: np.ndarray
    length_m: np.ndarray
    anchor: np.ndarray

    def over(self, frame: int, vertex_count: int) -> Band:
        """Returns the springs of one ``frame``, of all vertices of a mesh with ``vertex_count``."""
        band = Band(np.zeros((vertex_count, 3)), np.zeros(vertex_count))
        band.anchor[self.vertex] = self.anchor[frame]
        band.n_per_m[self.vertex] = STIFFNESS_N_M2 * self.length_m
        return band


@dataclass(frozen=True, eq=False)
class OptimumTask:
    """What is to be minimised: a ``cloth`` of ``material`` over the posed bodies ``body_vertices`` [m] (F, Vb, 3), from
    each of ``starts`` [m] (F, V, 3).

    ``charts`` are the garment's patches, if it has any. ``waistband`` holds it, if it has one: without friction
    trousers would slide off the hips. Errors name the garment ``name``.
    """

    cloth: ClothMesh
    material: Material
    contact: BodyContact
    body_vertices: np.ndarray
    starts: tuple[np.ndarray, ...]
    charts: Charts | None = None
    waistband: Waistband | None = None
    name: str = "garment"

    @classmethod
    def of_garment(
        cls,
        garment: Garment,
        body: BodyModel,
        cloth: ClothMesh,
        material: Material,
        *,
        contact: BodyContact,
        body_vertices: np.ndarray,
        skinned: np.ndarray,
        starts: tuple[np.ndarray, ...],
    ) -> OptimumTask:
        """Returns the task of ``garment`` with its patches, its waistband held at its places in ``skinned`` [m]
        (F, V, 3)."""
        charts = Charts(garment.chart_patch, garment.chart_weight)
        band = anchored_waistband(garment, body, skinned)
        return cls(cloth, material, contact, body_vertices, starts, charts, band, garment.name)


@dataclass(frozen=True, eq=False)
class Optimum:
    """The drapes that a minimiser reached over F bodies, ``vertices`` [m] (F, V, 3), and how.

    ``start_j`` and ``energy_j`` (F,) [J] are the energies (``total_j``) of the lowest start and of ``vertices``.
    ``nearest_j`` (F,) [J] is that of ``vertices`` with contact over the planes of the nearest body vertices.
    ``residual_n`` (F,) [N] is the norm of the force that is left, and ``converged`` (F,) says whether it is at most the
    tolerance times the weight. ``steps`` (F,) counts steps of Newton's method, ``processor_s`` (F,) is their processor
    time, and ``seconds`` the wall time of all frames.
    """

    vertices: np.ndarray
    start_j: np.ndarray
    energy_j: np.ndarray
    nearest_j: np.ndarray
    residual_n: np.ndarray
    converged: np.ndarray
    steps: np.ndarray
    processor_s: np.ndarray
    seconds: float


def anchored_waistband(garment: Garment, body: BodyModel, skinned: np.ndarray) -> Waistband | None:
    """Returns the waistband of ``garment``, held at its places in ``skinned`` [m] (F, V, 3); None if shoulders hold the
    garment."""
    band = waistband(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), body)
    return None if band is None else Waistband(band.vertex, band.length_m, skinned[:, band.vertex])


# Energies [J] (F,) by part. Contact is over the blended planes: those of the nearest body vertices, which training
# uses, also cut through free space far from the body.
energy_parts = partial(metrics.static_parts, distance=blended_distance)


def corner_slopes(cloth: ClothMesh) -> np.ndarray:
    """Returns 1 / altitude [1/m] (3, F) at the three corners of every triangle at rest: the lengths of the gradients of
    their barycentric coordinates."""
    a, b, c, d = cloth.inverse_shape
    return np.stack([np.hypot(a + b, c + d), np.hypot(a, c), np.hypot(b, d)])


def vertex_stiffness(cloth: ClothMesh, material: Material) -> np.ndarray:
    """Returns for each vertex a bound [N/m] (V,) of the diagonal of the energy's Hessian, in which membrane and hinges
    count in full and contact by half."""
    membrane = max(material.warp_n_per_m, material.weft_n_per_m) * cloth.face_area * corner_slopes(cloth) ** 2
    total = np.bincount(cloth.face_index, weights=membrane.reshape(-1), minlength=cloth.vertex_count)
    # Per metre a wing turns its hinge by 1 / altitude of its triangle, an end of the edge by about the mean of both.
    area = cloth.face_area[meshes.hinge_faces(cloth.faces)].T
    slope = np.sqrt(cloth.hinge_weight * area.sum(axis=0)) / (2.0 * area)
    turn = np.stack([slope.mean(axis=0), slope.mean(axis=0), *slope])
    hinge = sum(abs(b) for b in material.bending) * cloth.hinge_weight * turn**2
    total += np.bincount(cloth.hinge_index, weights=hinge.reshape(-1), minlength=cloth.vertex_count)
    return total + material.contact_j_m4 * cloth.vertex_area


def minimise(task: OptimumTask, *, step_limit: int = STEPS, tolerance: float = TOLERANCE) -> Optimum:
    """Returns the drapes of least energy near the starts of ``task``.

    A frame ends when the force left is at most ``tolerance`` of the weight, after ``step_limit`` steps, or where no
    step lowers the energy. Raises ``MeshError``, naming the garment, where no start has a finite energy, or where the
    force left is worth more than ``LEFT_LIMIT_J_M2``.
    """
    forces: list[np.ndarray] = []

    def descend(cloth: Cloth, posed: np.ndarray, starts: list[np.ndarray], band: Band | None) -> State:
        end = minimum(cloth, task.contact, posed, starts, step_limit=step_limit, tolerance=tolerance, band=band)
        forces.append(end.gradient)
        return end

    optimum = never_above(descend_from_starts(task, descend), task)
    _refuse_unrest(optimum, np.stack(forces), task)
    return optimum


def descend_from_starts(task: OptimumTask, descend: Descend) -> Optimum:
    """Returns the drapes in which ``descend`` ends. It is called for each frame of ``task``, with the cloth, the posed
    body, the starts of the frame, and the springs of the waistband or None."""
    began = time.perf_counter()
    starts = [np.asarray(start, dtype=np.float64) for start in task.starts]
    cloth = Cloth.of(task.cloth, task.material, task.charts)
    ends: list[State] = []
    processor_s = []
    for frame, posed in enumerate(task.body_vertices):
        before_s = time.process_time()
        band = task.waistband.over(frame, task.cloth.vertex_count) if task.waistband else None
        ends.append(descend(cloth, posed, [np.ascontiguousarray(start[frame]) for start in starts], band))
        processor_s.append(time.process_time() - before_s)
    vertices = np.stack([end.x for end in ends])
    return Optimum(
        vertices=vertices,
        start_j=np.stack([total_j(start, task) for start in starts]).min(axis=0),
        energy_j=total_j(vertices, task),
        nearest_j=total_j(vertices, task, metrics.static_parts),
        residual_n=np.array([np.linalg.norm(end.gradient) for end in ends]),
        converged=np.array([end.at_rest for end in ends]),
        steps=np.array([end.steps for end in ends]),
        processor_s=np.array(processor_s),
        seconds=time.perf_counter() - began,
    )


def total_j(vertices: np.ndarray, task: OptimumTask, parts_of: PartsOf = energy_parts) -> np.ndarray:
    """Returns the energy [J] (F,) of the drapes ``vertices`` [m] (F, V, 3) of ``task``, with the waistband's. Gravity's
    counts from the mean height of the first start; ``parts_of`` gives the parts of the cloth's energy."""
    height_m = metrics.mean_height(np.asarray(task.starts[0], dtype=np.float64), task.cloth)
    parts = parts_of(vertices, task.cloth, task.material, task.contact, task.body_vertices, height_m=height_m)
    total = np.stack([*parts.values()]).sum(axis=0)
    if (band := task.waistband) is None:
        return total
    return total + band_energy(vertices[:, band.vertex] - band.anchor, band.length_m)


def never_above(optimum: Optimum, task: OptimumTask) -> Optimum:
    """Returns ``optimum`` with the lowest start in place of every drape whose energy ended above that of its start.

    That happens by rounding alone: while descending, the energy of gravity is summed from another height than here.
    """
    risen = np.flatnonzero(optimum.energy_j > optimum.start_j)
    starts = np.stack(task.starts).astype(np.float64)
    lowest = np.stack([total_j(start, task) for start in starts]).argmin(axis=0)
    vertices, converged = optimum.vertices.copy(), optimum.converged.copy()
    vertices[risen], converged[risen] = starts[lowest, np.arange(len(vertices))][risen], False
    return replace(
        optimum,
        vertices=vertices,
        energy_j=np.fmin(optimum.energy_j, optimum.start_j),
        nearest_j=total_j(vertices, task, metrics.static_parts),
        converged=converged,
    )


def _refuse_unrest(optimum: Optimum, force_n: np.ndarray, task: OptimumTask) -> None:
    """Raises ``MeshError`` if a step along the force that is left could still gain a good part of the energy."""
    cloth, material = task.cloth, task.material
    left_j = ((force_n**2).sum(axis=-1) / (2.0 * vertex_stiffness(cloth, material))).sum(axis=-1)
    left_j = np.where(np.isfinite(optimum.start_j), np.nan_to_num(left_j, nan=np.inf), np.inf)
    limit_j = LEFT_LIMIT_J_M2 * cloth.vertex_area.sum()
    worst = int(left_j.argmax())
    if left_j[worst] <= limit_j:
        return
    weight_n = material.gravity_m_s2 * cloth.vertex_mass(material).sum()
    lowest_mm = 1e3 / corner_slopes(cloth).max()
    raise MeshError(
        task.name,
        expected=f"a physics optimum at rest, the force that is left worth at most {limit_j:.2g} J",
        got=f"{optimum.residual_n[worst]:.3g} N ({weight_n:.2g} N weight) worth {left_j[worst]:.2g} J in pose {worst}, "
        f"energy {optimum.start_j[worst]:.4g} to {optimum.energy_j[worst]:.4g} J in {optimum.steps[worst]} steps",
        cure=f"Take more steps, or mesh it anew: its lowest triangle is {lowest_mm:.2g} mm high.",
    )
