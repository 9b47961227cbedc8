"""The descent of the physics optimum without its safeguards, to compare energies with."""

from __future__ import annotations

import numpy as np
import torch

from benchmarks.shared import physics
from drape.cloth import energies
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material


def plain_descent(
    cloth: ClothMesh,
    material: Material,
    start: np.ndarray,
    contact: BodyContact,
    body_vertices: np.ndarray,
    *,
    step_limit: int,
) -> np.ndarray:
    """Vertices [m] (F, V, 3) after ``step_limit`` steps: Adam's, as large everywhere, then those of the heavy ball."""
    x = torch.tensor(start, dtype=torch.float32)
    moving_cloth = cloth.like(x)
    first, second = torch.zeros_like(x), torch.zeros_like(x)
    scale = torch.tensor(physics.STEP / physics.vertex_stiffness(cloth, material), dtype=torch.float32)[:, None]
    (a, b), (fast, slow) = physics.ADAM_DECAYS, physics.ADAM_RATES_M
    for step in range(step_limit):
        if step % physics.REFRESH_STEPS == 0:
            planes = contact.planes(x.double().numpy(), body_vertices).like(x)
        if step == physics.ADAM_STEPS:
            first = torch.zeros_like(x)
        at = (x if step < physics.ADAM_STEPS else x + physics.MOMENTUM * first).requires_grad_()
        parts = energies.total(at, moving_cloth, material, distance=planes.distance(at))
        (gradient,) = torch.autograd.grad(torch.stack(list(parts.values())).sum(), at)
        x = x.detach()
        if step < physics.ADAM_STEPS:
            first, second = a * first + (1.0 - a) * gradient, b * second + (1.0 - b) * gradient.square()
            rate = fast * (slow / fast) ** (step / physics.ADAM_STEPS)
            spread = (second / (1.0 - b ** (step + 1))).sqrt() + 1e-12
            x = x - rate * first / (1.0 - a ** (step + 1)) / spread
        else:
            move = scale * gradient
            share = torch.clamp(physics.MOVE_LIMIT_M / move.norm(dim=-1, keepdim=True), max=1.0)
            first = physics.MOMENTUM * first - share * move
            x = x + first
    return x.double().numpy()
