"""The physics optimum: every vertex free, each frame's energy minimised directly.

Adam first, which forgets the large strains of the start quickly; then heavy-ball
descent scaled by each vertex's stiffness, whose steps do not shrink, so that a small
change of energy means an optimum and not a small step. Contact planes follow the
nearest body vertices every few steps. How the method was chosen: docs/reference/quality.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch

from drape.cloth import energies
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material

ADAM_STEPS = 500
ADAM_RATES_M = (3e-3, 5e-4)
ADAM_DECAYS = (0.9, 0.97)
STEP, MOMENTUM = 0.2, 0.98
MOVE_LIMIT_M = 0.004
REFRESH_STEPS = 10
CHECK_STEPS = 100
TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Optimum:
    """What the minimiser reached, per frame.

    ``vertices`` [m] (F, V, 3); ``residual_n`` (F,) the norm of the force that is left, [N];
    ``change`` (F,) of the energy over the last 100 steps, as a share of all that was gained;
    ``steps`` (F,), ``seconds`` for all frames.
    """

    vertices: np.ndarray
    residual_n: np.ndarray
    change: np.ndarray
    steps: np.ndarray
    seconds: float


def vertex_stiffness(cloth: ClothMesh, material: Material) -> np.ndarray:
    """A bound [N/m] (V,) of the diagonal of the Hessian: membrane, hinges and half of the vertices' contact."""
    a, b, d = cloth.inverse_shape
    membrane = (2.0 * material.mu_n_per_m + material.lambda_n_per_m) * cloth.face_area
    corners = np.stack([a * a + (b + d) ** 2, a * a + b * b, d * d]) * membrane
    total = np.bincount(cloth.face_index, weights=corners.reshape(-1), minlength=cloth.vertex_count)
    # A hinge turns by 1 / height of its triangle per metre, and l^2 / (A1 + A2) = 2 l / (h1 + h2).
    hinge = material.bending_j * cloth.hinge_weight**3 / cloth.mean_edge_m**2
    total += np.bincount(cloth.hinge_index, weights=np.tile(hinge, 4), minlength=cloth.vertex_count)
    return total + material.contact_j_m4 * cloth.vertex_area


class _Frames:
    """The frames still running: positions, their contact planes and how far they have come."""

    def __init__(self, cloth: ClothMesh, material: Material, contact: BodyContact, start: np.ndarray) -> None:
        self.positions = torch.tensor(start, dtype=torch.float32)
        self.contact, self.material = contact, material
        self.cloth = cloth.like(self.positions)
        self.planes = None

    def refresh(self, body_vertices: np.ndarray, normals: np.ndarray) -> None:
        """Looks for the nearest body vertices again."""
        points = self.positions.double().numpy()
        self.planes = self.contact.planes(points, body_vertices, normals).like(self.positions)

    def energy_and_gradient(self, positions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Energy [J] (F,) and its gradient [N] (F, V, 3)."""
        assert self.planes is not None
        moving = positions.detach().requires_grad_()
        parts = energies.total(moving, self.cloth, self.material, distance=self.planes.distance(moving))
        energy = torch.stack(list(parts.values())).sum(dim=0)
        (gradient,) = torch.autograd.grad(energy.sum(), moving)
        return energy.detach(), gradient


def minimise(
    cloth: ClothMesh,
    material: Material,
    start: np.ndarray,
    contact: BodyContact,
    body_vertices: np.ndarray,
    *,
    step_limit: int = 2000,
    tolerance: float = TOLERANCE,
) -> Optimum:
    """The drape of least energy near ``start`` [m] (F, V, 3) over the posed bodies (F, Vb, 3).

    Ends for each frame when its energy changes by less than ``tolerance`` of what it
    has gained within 100 steps, or at ``step_limit``.
    """
    began = time.perf_counter()
    count = len(start)
    running = np.arange(count)
    normals = np.asarray(contact.normals(body_vertices))
    scale = torch.tensor(STEP / vertex_stiffness(cloth, material), dtype=torch.float32)[:, None]
    frames = _Frames(cloth, material, contact, start)
    first = torch.zeros_like(frames.positions)  # Adam's first moment, then the velocity
    second = torch.zeros_like(frames.positions)
    vertices, residual = np.array(start, dtype=np.float64), np.zeros(count)
    change, steps = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    initial, checked, recent = None, None, []
    for step in range(step_limit):
        if step % REFRESH_STEPS == 0:
            frames.refresh(body_vertices[running], normals[running])
        if step < ADAM_STEPS:
            energy, gradient = frames.energy_and_gradient(frames.positions)
            move, first, second = _adam(gradient, first, second, step)
            frames.positions = frames.positions - move
        else:
            if step == ADAM_STEPS:
                first = torch.zeros_like(first)
            energy, gradient = frames.energy_and_gradient(frames.positions + MOMENTUM * first)
            first = MOMENTUM * first - _limited(scale * gradient)
            frames.positions = frames.positions + first
        initial = energy.clone() if initial is None else initial
        recent.append(energy)
        if (step + 1) % CHECK_STEPS and step + 1 < step_limit:
            continue
        # The mean over one round of refreshes: the energy jumps a little whenever the planes change.
        now = torch.stack(recent[-REFRESH_STEPS:]).mean(dim=0)
        recent = []
        if checked is not None:
            gained = torch.clamp(initial - now, min=1e-9)
            change[running] = (torch.abs(checked - now) / gained).numpy()
        steps[running] = step + 1
        vertices[running] = frames.positions.double().numpy()
        residual[running] = gradient.square().sum(dim=(1, 2)).sqrt().numpy()
        checked = now
        keep = change[running] >= tolerance if step + 1 > ADAM_STEPS else np.ones(len(running), dtype=bool)
        if not keep.any():
            break
        kept = torch.tensor(keep)
        frames.positions, first, second = frames.positions[kept], first[kept], second[kept]
        initial, checked, running = initial[kept], checked[kept], running[keep]
        frames.refresh(body_vertices[running], normals[running])
    return Optimum(vertices, residual, change, steps, time.perf_counter() - began)


def _adam(
    gradient: torch.Tensor, first: torch.Tensor, second: torch.Tensor, step: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Adam's step [m] and its two moments (Kingma & Ba 2015), the rate falling geometrically."""
    a, b = ADAM_DECAYS
    first = a * first + (1.0 - a) * gradient
    second = b * second + (1.0 - b) * gradient.square()
    rate = ADAM_RATES_M[0] * (ADAM_RATES_M[1] / ADAM_RATES_M[0]) ** (step / ADAM_STEPS)
    mean, spread = first / (1.0 - a ** (step + 1)), second / (1.0 - b ** (step + 1))
    return rate * mean / (spread.sqrt() + 1e-12), first, second


def _limited(move: torch.Tensor) -> torch.Tensor:
    """``move`` (F, V, 3) with no vertex going farther than ``MOVE_LIMIT_M``."""
    length = move.norm(dim=-1, keepdim=True)
    return move * torch.clamp(MOVE_LIMIT_M / torch.clamp(length, min=1e-12), max=1.0)
