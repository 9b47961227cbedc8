"""A second simulator beside the optimum: how far every drape is from where recovery.sim comes to rest [mm].

The garment's triangles are laid flat, each in its own plane, and simulated by linearised implicit steps with damping
and friction until nothing moves. From the energy of docs/reference/quality.md it differs in its hinges, which
resist most where they are folded over; in contact, by the body's signed distance in place of tangent planes; in
friction; and in the method, which is motion in time. Membrane, weight and the layer of contact are the same.

With friction a garment has many shapes at rest. So every pose is simulated twice: from the physics optimum, which gives
the reference, and from the network's drape. The distance between these two ends is the floor, below which a distance to
the reference says nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.judge.physics_cache import cached, key_of
from benchmarks.shared import common
from drape.cloth import orthotropic
from drape.cloth.material import Material
from drape.errors import InputError
from drape.geometry import closest, meshes
from recovery.sim import assembly, contact, elastic, implicit, linearised, model, sdf, solver
from recovery.sim.contact import SkinContact, tangential
from recovery.sim.linearised import linearised_step
from recovery.sim.model import ClothModel, ClothState, Parameters, Rest
from recovery.sim.sdf import GridDistance, SignedDistance

STARTS = ("physics", "network")  # the first is the reference, the second says how much the start decides
FRICTION = 0.3
GRID_M = 0.015  # of the body's signed distance
STEP_S = 0.05
KEPT_SPEED = 0.8  # of every step's velocity: the shape at rest is sought, not the way there
LONGEST_MOVE_M = 0.01  # of a node in one step; a fold that snaps open would throw its triangles
AT_REST_MM_S = 2.0  # mean speed of the nodes, what friction's own creep comes to
STEP_LIMIT = 40
BALANCED_SHARE = 0.1  # of its own weight: the force left at a node that counts as balanced
CACHE_DIR = common.ROOT / "runs" / "reference_cache"  # ignored by git
SOURCES: tuple[ModuleType, ...] = (
    assembly, contact, elastic, implicit, linearised, model, sdf, solver, orthotropic, closest, meshes,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Reference:
    """Where the simulator ended, per frame.

    ``vertices`` [m] (F, V, 3); ``speed_mm_s`` (F,) mean speed of the nodes in the last step; ``residual_n`` (F,) the
    norm of the force that is left after friction took what it can, ``balanced_pct`` (F,) the share of nodes left with
    less than a tenth of their weight; ``steps`` (F,), ``seconds`` for all frames.
    """

    vertices: np.ndarray
    speed_mm_s: np.ndarray
    residual_n: np.ndarray
    balanced_pct: np.ndarray
    steps: np.ndarray
    seconds: float

    @property
    def at_rest(self) -> np.ndarray:
        """Which frames (F,) came to rest before the last step allowed."""
        return self.speed_mm_s <= AT_REST_MM_S


class Bodies:
    """The posed bodies (F, Vb, 3) as signed distances, each made when it is first asked for."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self._made: dict[int, SignedDistance] = {}

    def __getitem__(self, frame: int) -> SignedDistance:
        if frame not in self._made:
            self._made[frame] = GridDistance.from_mesh(self.vertices[frame], self.faces, spacing_m=GRID_M)
        return self._made[frame]


def flat_triangles(rest: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every rest triangle in its own plane: panel vertices [m] (3F, 2) and panel triangles (F, 3)."""
    first, second = meshes.corner_edges(rest, faces)
    length = np.linalg.norm(first, axis=1)
    along = (first * second).sum(axis=1) / length
    height = 2.0 * meshes.face_areas(rest, faces) / length
    zero = np.zeros_like(length)
    corners = np.stack([zero, zero, length, zero, along, height], axis=1)
    return corners.reshape(-1, 2), np.arange(3 * len(faces)).reshape(-1, 3)


class Simulated:
    """One garment, ready to be simulated over any of its bodies."""

    def __init__(self, rest: np.ndarray, faces: np.ndarray, material: Material) -> None:
        panels, panel_faces = flat_triangles(rest, faces)
        self.model = ClothModel(faces, panel_faces=panel_faces, gravity_m_s2=material.gravity_m_s2, rest_shape=rest)
        self.parameters: Parameters = self.model.parameters(panels, material.woven)
        self.rest: Rest = self.model.rest(self.parameters.panels)
        self.material = material
        self.node_weight_n = material.gravity_m_s2 * material.density_kg_m2 * self.rest.node_area

    def contact(self, body: SignedDistance) -> SkinContact:
        """The layer of contact of ``material``, with friction."""
        return SkinContact(
            body,
            stiffness_j_m4=self.material.contact_j_m4,
            gap_m=self.material.contact_gap_m,
            friction=FRICTION,
        )

    def force_left(self, x: Tensor, skin: SkinContact) -> Tensor:
        """Force [N] (V, 3) at nodes ``x`` that friction at rest cannot hold: what lies outside Coulomb's cone."""
        mass = self.parameters.density_kg_m2 * self.rest.node_area
        force = elastic.forces(self.model, self.rest, self.parameters, x) + mass[:, None] * self.model.gravity
        force = force + skin.force(x, self.rest.node_area)
        limit, normal = skin.grip(x, self.rest.node_area)
        pull = tangential(force, normal)
        size = pull.norm(dim=1).clamp(min=1e-15)
        return force - torch.clamp(limit / size, max=1.0)[:, None] * pull

    def come_to_rest(self, start: np.ndarray, body: SignedDistance, step_limit: int) -> tuple[Tensor, float, int]:
        """Nodes [m] (V, 3) from ``start``, the mean speed [mm/s] of the last step, and the steps taken."""
        skin, state = self.contact(body), self.model.state(start)
        speed = np.inf
        for step in range(1, step_limit + 1):
            with torch.no_grad():
                after = linearised_step(self.model, state, self.parameters, dt_s=STEP_S, contact=skin).x
                move = after - state.x
                size = move.norm(dim=1, keepdim=True)
                move = move * torch.clamp(LONGEST_MOVE_M / size.clamp(min=1e-12), max=1.0)
                speed = 1e3 * float(move.norm(dim=1).mean()) / STEP_S
                state = ClothState(state.x + move, (KEPT_SPEED / STEP_S) * move)
            if speed <= AT_REST_MM_S:
                return state.x, speed, step
        return state.x, speed, step_limit


def simulate(
    rest: np.ndarray,
    faces: np.ndarray,
    material: Material,
    start: np.ndarray,
    bodies: Bodies | Sequence[SignedDistance],
    *,
    step_limit: int = STEP_LIMIT,
) -> Reference:
    """The drape at rest from each frame of ``start`` [m] (F, V, 3) over the frame's body.

    Ends for each frame when the mean speed is at most 2 mm/s, or after ``step_limit`` steps of one sparse
    factor each.
    """
    began = time.perf_counter()
    garment = Simulated(rest, faces, material)
    found, speeds, residuals, balanced, steps = [], [], [], [], []
    for frame, positions in enumerate(start):
        x, speed, count = garment.come_to_rest(positions, bodies[frame], step_limit)
        left = garment.force_left(x, garment.contact(bodies[frame])).norm(dim=1)
        found.append(x.numpy())
        speeds.append(speed)
        residuals.append(float(left.norm()))
        balanced.append(100.0 * float((left < BALANCED_SHARE * garment.node_weight_n).double().mean()))
        steps.append(count)
    return Reference(
        np.stack(found),
        np.array(speeds),
        np.array(residuals),
        np.array(balanced),
        np.array(steps),
        time.perf_counter() - began,
    )


def reference_key(
    rest: np.ndarray, faces: np.ndarray, material: Material, start: np.ndarray, bodies: Bodies, step_limit: int
) -> str:
    """Hash of what a reference depends on, hexadecimal."""
    return key_of(
        [asdict(material), step_limit],
        (rest, faces, start, bodies.vertices[: len(start)], bodies.faces),
        (*SOURCES, sys.modules[__name__]),
    )


def stored(
    rest: np.ndarray,
    faces: np.ndarray,
    material: Material,
    start: np.ndarray,
    bodies: Bodies,
    *,
    folder: Path | None,
    step_limit: int = STEP_LIMIT,
) -> tuple[Reference, bool]:
    """``simulate``, or what an earlier run kept in ``folder`` of the same, and whether it was kept."""
    key = reference_key(rest, faces, material, start, bodies, step_limit)
    return cached(
        key,
        lambda: simulate(rest, faces, material, start, bodies, step_limit=step_limit),
        folder,
        kind=Reference,
    )


def distances_mm(vertices: np.ndarray, reference: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """How far ``vertices`` [m] (F, V, 3) are from ``reference`` (F, V, 3).

    ``mm`` the mean over the vertices, ``p95_mm`` their 95th percentile, each a mean over the frames; ``surface_mm``
    the mean distance to the nearest point of the reference's triangles, which leaves out what slid along the cloth.
    """
    if vertices.shape != reference.shape:
        raise InputError(
            "reference",
            expected=f"the shape {vertices.shape}",
            got=str(reference.shape),
            cure="Compare the same frames.",
        )
    apart = 1e3 * np.linalg.norm(vertices - reference, axis=-1)
    near = [closest.closest_point(a, b, faces).distance.mean() for a, b in zip(vertices, reference, strict=True)]
    return {
        "mm": float(apart.mean()),
        "p95_mm": float(np.percentile(apart, 95.0, axis=1).mean()),
        "surface_mm": 1e3 * float(np.mean(near)),
    }


def reference_figures(
    positions: Mapping[str, np.ndarray],
    rest: np.ndarray,
    faces: np.ndarray,
    material: Material,
    bodies: Bodies,
    *,
    frames: int,
    folder: Path | None,
) -> dict[str, dict[str, Any]]:
    """Columns by method, over the first ``frames`` frames of its ``positions`` [m] (F, V, 3).

    Every method has ``reference_mm``, ``_p95_mm`` and ``_surface_mm``, from the simulator's drape that began at the
    physics optimum. The methods of ``STARTS`` say how the simulation that began at them ended, and by
    ``reference_start_mm`` how far from there. The second has the floor: the distances between the two ends.
    """
    ends: dict[str, Reference] = {}
    columns: dict[str, dict[str, Any]] = {method: {} for method in positions}
    for name in STARTS:
        start = positions[name][:frames]
        ends[name], was_stored = stored(rest, faces, material, start, bodies, folder=folder)
        end = ends[name]
        columns[name] |= {
            "reference_start_mm": distances_mm(start, end.vertices, faces)["mm"],
            "reference_start_surface_mm": distances_mm(start, end.vertices, faces)["surface_mm"],
            "reference_at_rest_pct": 100.0 * float(end.at_rest.mean()),
            "reference_speed_mm_s": float(end.speed_mm_s.max()),
            "reference_residual_n": float(end.residual_n.mean()),
            "reference_balanced_pct": float(end.balanced_pct.mean()),
            "reference_steps": float(end.steps.mean()),
            "reference_seconds": end.seconds,
            "reference_cached": was_stored,
        }
    goal = ends[STARTS[0]].vertices
    for method, vertices in positions.items():
        found = distances_mm(vertices[:frames], goal, faces)
        columns[method] |= {f"reference_{key}": value for key, value in found.items()}
    floor = distances_mm(ends[STARTS[1]].vertices, goal, faces)
    columns[STARTS[1]] |= {f"reference_floor_{key}": value for key, value in floor.items()}
    return columns
