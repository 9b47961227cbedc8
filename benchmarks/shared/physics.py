"""The physics optimum: every vertex free, each frame's energy minimised directly.

Adam first, which forgets the large strains of the start quickly; then heavy-ball
descent scaled by each vertex's stiffness, whose steps do not shrink, so that a small
change of energy means an optimum and not a small step. Contact planes follow the
nearest body vertices every few steps. No step takes a vertex farther than a part of its lowest
triangle, a frame whose energy rises goes back to its best state, and what does not come to rest is
refused. How the method was chosen: docs/reference/quality.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.errors import MeshError
from drape.geometry import meshes

ADAM_STEPS = 500
ADAM_RATES_M = (3e-3, 5e-4)
ADAM_DECAYS = (0.9, 0.97)
STEP, MOMENTUM = 0.2, 0.98
MOVE_LIMIT_M = 0.004
MOVE_SHARE = 0.5  # of the lowest altitude at a vertex: a larger move turns its triangles over
REFRESH_STEPS = 10
RISE_SHARE = 0.3  # of what a frame has gained, that its energy may lie above the lowest: momentum climbs, planes jump
SHRINK, GROWTH = 0.5, 1.1  # of a frame's steps, where it rose farther and where it is the lowest yet
CHECK_STEPS = 100
TOLERANCE = 1e-4
LEFT_LIMIT_J_M2 = 0.05  # skinning costs 1 to 5 J per m^2 of cloth


@dataclass(frozen=True, eq=False)
class Optimum:
    """What the minimiser reached, per frame: the state of least energy that it met.

    ``vertices`` [m] (F, V, 3); ``start_j``, ``energy_j`` (F,) the energy of the start and of ``vertices`` [J], never
    above the start's; ``residual_n`` (F,) the norm of the force that is left [N], ``left_j`` (F,) what it could still
    gain [J], the sum of |force|^2 / (2 stiffness) over the vertices; ``change`` (F,) of the energy over 100
    steps, the larger of the last two, as a share of all that was gained; ``steps`` (F,), ``seconds`` for all frames.
    """

    vertices: np.ndarray
    start_j: np.ndarray
    energy_j: np.ndarray
    residual_n: np.ndarray
    left_j: np.ndarray
    change: np.ndarray
    steps: np.ndarray
    seconds: float


def corner_slopes(cloth: ClothMesh) -> np.ndarray:
    """1 / altitude [1/m] (3, F) of every triangle's corners at rest: the gradients of their barycentric coordinates."""
    a, b, c, d = cloth.inverse_shape
    return np.stack([np.hypot(a + b, c + d), np.hypot(a, c), np.hypot(b, d)])


def vertex_stiffness(cloth: ClothMesh, material: Material) -> np.ndarray:
    """A bound [N/m] (V,) of the diagonal of the Hessian: membrane, hinges and half of the vertices' contact."""
    membrane = max(material.warp_n_per_m, material.weft_n_per_m) * cloth.face_area * corner_slopes(cloth) ** 2
    total = np.bincount(cloth.face_index, weights=membrane.reshape(-1), minlength=cloth.vertex_count)
    # Per metre a wing turns its hinge by 1 / altitude of its triangle, an end of the edge by about the mean of both.
    area = cloth.face_area[meshes.hinge_faces(cloth.faces)].T
    slope = np.sqrt(cloth.hinge_weight * area.sum(axis=0)) / (2.0 * area)
    turn = np.stack([slope.mean(axis=0), slope.mean(axis=0), *slope])
    hinge = sum(abs(b) for b in material.bending) * cloth.hinge_weight * turn**2
    total += np.bincount(cloth.hinge_index, weights=hinge.reshape(-1), minlength=cloth.vertex_count)
    return total + material.contact_j_m4 * cloth.vertex_area


def move_limits(cloth: ClothMesh) -> np.ndarray:
    """How far [m] (V,) one step may take a vertex: ``MOVE_SHARE`` of the lowest altitude at rest of its triangles."""
    steepest = np.zeros(cloth.vertex_count)
    np.maximum.at(steepest, cloth.face_index, np.tile(corner_slopes(cloth).max(axis=0), 3))
    return MOVE_SHARE / np.maximum(steepest, MOVE_SHARE / MOVE_LIMIT_M)


class _State(NamedTuple):
    """Where frames are over planes just looked up: energy [J] (F,), positions and gradient (F, V, 3), Adam's moment."""

    energy: torch.Tensor
    positions: torch.Tensor
    gradient: torch.Tensor
    second: torch.Tensor

    def where(self, chosen: torch.Tensor, other: _State) -> _State:
        """These frames where ``chosen`` (F,), those of ``other`` elsewhere."""
        return _State(
            *(torch.where(chosen.view(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(self, other, strict=True))
        )


class _Frames:
    """The frames still running: how they move, their contact planes, and the best state that each has met."""

    def __init__(
        self, cloth: ClothMesh, material: Material, contact: BodyContact, start: np.ndarray, body_vertices: np.ndarray
    ) -> None:
        self.contact, self.material = contact, material
        self.bodies, self.normals = body_vertices, np.asarray(contact.normals(body_vertices))
        self.positions = torch.tensor(start, dtype=torch.float32)
        self.cloth = cloth.like(self.positions)
        self.limit_m = torch.tensor(move_limits(cloth), dtype=torch.float32)[:, None]
        self.scale = torch.tensor(STEP / vertex_stiffness(cloth, material), dtype=torch.float32)[:, None]
        self.first = torch.zeros_like(self.positions)  # Adam's first moment, then the velocity
        self.second = torch.zeros_like(self.positions)
        self.share = torch.ones(len(start), 1, 1)  # of a full step
        self.best = self._state()
        self.start_j = self.best.energy
        self.set_back = torch.zeros(len(start), dtype=torch.bool)

    def energy_and_gradient(self, positions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Energy [J] (F,) and its gradient [N] (F, V, 3)."""
        moving = positions.detach().requires_grad_()
        parts = energies.total(moving, self.cloth, self.material, distance=self.planes.distance(moving))
        energy = torch.stack(list(parts.values())).sum(dim=0)
        (gradient,) = torch.autograd.grad(energy.sum(), moving)
        return energy.detach(), gradient

    def refresh(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Looks for the nearest body vertices again; energy and gradient there.

        A frame that rose by more than ``RISE_SHARE``, and so each above its start, goes back to its best state and on
        from there in half steps.
        """
        finite = torch.isfinite(self.positions).flatten(1).all(dim=1)
        self.positions = torch.where(finite[:, None, None], self.positions, self.best.positions)
        now = self._state()
        bound = self.best.energy + RISE_SHARE * (self.start_j - self.best.energy)
        risen = ~(finite & (now.energy <= bound))  # written so that what is not a number counts as risen
        lower = now.energy < self.best.energy
        self.best = now.where(lower, self.best)
        factor = torch.where(risen, SHRINK, torch.where(lower, GROWTH, 1.0))
        self.share = torch.clamp(self.share * factor[:, None, None], max=1.0)
        if risen.any():
            now = self.best.where(risen, now)
            self.positions, self.second = now.positions, now.second
            self.first = torch.where(risen[:, None, None], 0.0, self.first)
            self.set_back |= risen
            self._find_planes()
        return now.energy, now.gradient

    def adam(self, gradient: torch.Tensor, step: int) -> None:
        """Adam's step (Kingma & Ba 2015), the rate falling geometrically."""
        a, b = ADAM_DECAYS
        self.first = a * self.first + (1.0 - a) * gradient
        self.second = b * self.second + (1.0 - b) * gradient.square()
        rate = ADAM_RATES_M[0] * (ADAM_RATES_M[1] / ADAM_RATES_M[0]) ** (step / ADAM_STEPS)
        mean, spread = self.first / (1.0 - a ** (step + 1)), self.second / (1.0 - b ** (step + 1))
        reach = self.share * torch.clamp(self.limit_m, max=rate)
        self.positions = self.positions - reach * mean / (spread.sqrt() + 1e-12)

    def fall(self, gradient: torch.Tensor) -> None:
        """A step of heavy-ball descent, each vertex scaled by its stiffness."""
        move = self.scale * gradient
        length = move.norm(dim=-1, keepdim=True)
        move = move * torch.clamp(self.limit_m / torch.clamp(length, min=1e-12), max=1.0)
        self.first = MOMENTUM * self.first - self.share * move
        self.positions = self.positions + self.first

    def keep(self, kept: np.ndarray) -> None:
        """Leaves out the frames not in ``kept`` (F,)."""
        self.bodies, self.normals = self.bodies[kept], self.normals[kept]
        chosen = torch.tensor(kept)
        self.positions, self.first, self.second = self.positions[chosen], self.first[chosen], self.second[chosen]
        self.share, self.best = self.share[chosen], _State(*(part[chosen] for part in self.best))
        self.start_j, self.set_back = self.start_j[chosen], self.set_back[chosen]
        self._find_planes()

    def _state(self) -> _State:
        self._find_planes()
        energy, gradient = self.energy_and_gradient(self.positions)
        return _State(energy, self.positions, gradient, self.second)

    def _find_planes(self) -> None:
        points = self.positions.double().numpy()
        self.planes = self.contact.planes(points, self.bodies, self.normals).like(self.positions)


def minimise(
    cloth: ClothMesh,
    material: Material,
    start: np.ndarray,
    contact: BodyContact,
    body_vertices: np.ndarray,
    *,
    step_limit: int = 2000,
    tolerance: float = TOLERANCE,
    name: str = "garment",
) -> Optimum:
    """The drape of least energy near ``start`` [m] (F, V, 3) over the posed bodies (F, Vb, 3).

    Ends for each frame when its energy changes twice by less than ``tolerance`` of what it
    has gained within 100 steps, or at ``step_limit``. Raises ``MeshError``, naming the garment ``name``, where a frame
    is not at rest then: where the force left is worth more than ``LEFT_LIMIT_J_M2``.
    """
    began = time.perf_counter()
    start = np.asarray(start, dtype=np.float64)
    count = len(start)
    running = np.arange(count)
    frames = _Frames(cloth, material, contact, start, body_vertices)
    vertices, gradient_n = start.copy(), np.zeros(start.shape)
    change, before, steps = np.full(count, np.inf), np.zeros(count), np.zeros(count, dtype=np.int64)
    checked, recent = None, []
    for step in range(step_limit):
        if step == ADAM_STEPS:
            frames.first = torch.zeros_like(frames.first)
        if step % REFRESH_STEPS == 0:
            energy, gradient = frames.refresh()
        else:
            ahead = 0.0 if step < ADAM_STEPS else MOMENTUM * frames.first
            energy, gradient = frames.energy_and_gradient(frames.positions + ahead)
        frames.adam(gradient, step) if step < ADAM_STEPS else frames.fall(gradient)
        recent.append(energy)
        if (step + 1) % CHECK_STEPS and step + 1 < step_limit:
            continue
        # The mean over one round of refreshes: the energy jumps a little whenever the planes change.
        now = torch.stack(recent[-REFRESH_STEPS:]).mean(dim=0)
        recent = []
        if checked is not None:
            gained = torch.clamp(frames.start_j - now, min=1e-9)
            moved = torch.where(frames.set_back, torch.inf, torch.abs(checked - now) / gained).numpy()
            # Twice in a row: energies that momentum lifts and lowers also meet by chance.
            change[running], before[running] = np.maximum(moved, before[running]), moved
        frames.set_back[:] = False
        steps[running] = step + 1
        vertices[running] = frames.best.positions.double().numpy()
        gradient_n[running] = frames.best.gradient.double().numpy()
        checked = now
        keep = change[running] >= tolerance if step + 1 > ADAM_STEPS else np.ones(len(running), dtype=bool)
        if not keep.any():
            break
        checked, running = checked[torch.tensor(keep)], running[keep]
        frames.keep(keep)
    height_m = metrics.mean_height(start, cloth)
    start_j, energy_j = (
        np.stack([*metrics.static_parts(x, cloth, material, contact, body_vertices, height_m=height_m).values()]).sum(0)
        for x in (start, vertices)
    )
    risen = ~(energy_j <= start_j)  # by rounding to float32, where nothing was gained
    vertices[risen], energy_j[risen] = start[risen], start_j[risen]
    force_n = np.linalg.norm(gradient_n, axis=-1)
    optimum = Optimum(
        vertices=vertices,
        start_j=start_j,
        energy_j=energy_j,
        residual_n=np.linalg.norm(force_n, axis=-1),
        left_j=(force_n**2 / (2.0 * vertex_stiffness(cloth, material))).sum(axis=-1),
        change=change,
        steps=steps,
        seconds=time.perf_counter() - began,
    )
    _refuse_unrest(optimum, cloth, material, name)
    return optimum


def _refuse_unrest(optimum: Optimum, cloth: ClothMesh, material: Material, name: str) -> None:
    """Raises ``MeshError`` if a step along the force that is left could still gain a good part of the energy."""
    limit_j = LEFT_LIMIT_J_M2 * cloth.vertex_area.sum()
    left_j = np.nan_to_num(optimum.left_j, nan=np.inf)
    worst = int(left_j.argmax())
    if left_j[worst] <= limit_j:
        return
    weight_n = material.gravity_m_s2 * cloth.vertex_mass(material).sum()
    lowest_mm = 1e3 / corner_slopes(cloth).max()
    raise MeshError(
        name,
        expected=f"a physics optimum at rest, the force that is left worth at most {limit_j:.2g} J",
        got=f"{optimum.residual_n[worst]:.3g} N ({weight_n:.2g} N weight) worth {left_j[worst]:.2g} J in pose {worst}, "
        f"energy {optimum.start_j[worst]:.4g} to {optimum.energy_j[worst]:.4g} J in {optimum.steps[worst]} steps",
        cure=f"Take more steps, or mesh it anew: its lowest triangle is {lowest_mm:.2g} mm high.",
    )
