"""Time of the differentiable simulator: 20 linearised steps forward and backward, and one converged step.

A square cloth falls on a ball whose distance stands in a grid, with friction. Beside it the published times of
Yu, Cordier and Seo (2024, table 1): 228.6 s and 186.3 s for 3,000 vertices on an RTX 3090.

    python -m benchmarks.simulate [--quick] [--steps 20] [--out FILE]
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

from benchmarks.harness import Benchmark, Option, Run
from drape.cloth.material import OrthotropicMaterial
from recovery.sim.contact import SkinContact
from recovery.sim.linearised import simulate
from recovery.sim.model import ClothModel
from recovery.sim.newton import newton_step
from recovery.sim.sdf import GridDistance

SIDES = (32, 55, 77, 109)  # vertices along an edge: about 1, 3, 6 and 12 thousand in all
QUICK_SIDES = (32, 55)
RADIUS_M, EDGE_M, SPACING_M = 0.2, 1.0, 0.02
DT_S = 0.05  # the paper's
CLOTH = OrthotropicMaterial(h00=60.0, h01=11.0, h11=45.0, h22=24.0, bending_j=1.5e-4, density_kg_m2=0.18)
COLUMNS = {
    "vertices": ",d", "steps": "d", "forward_s": ".3f", "backward_s": ".3f", "step_ms": ".1f",
    "newton_step_ms": ".1f", "newton_iterations": "d", "model_s": ".3f",
}  # fmt: skip


def square(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Panel vertices [m] (side^2, 2) and faces of a square with alternating diagonals."""
    line = np.linspace(0.0, EDGE_M, side)
    panel = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (index.reshape(-1) for index in np.meshgrid(np.arange(side - 1), np.arange(side - 1), indexing="ij"))
    a, b = i * side + j, (i + 1) * side + j
    odd = ((i + j) % 2 == 1)[:, None]
    first = np.where(odd, np.stack([a, b, b + 1], axis=1), np.stack([a, b, a + 1], axis=1))
    second = np.where(odd, np.stack([a, b + 1, a + 1], axis=1), np.stack([b, b + 1, a + 1], axis=1))
    return panel, np.concatenate([first, second])


def ball() -> GridDistance:
    """The grid of a ball under the middle of the square."""
    axis = np.arange(-0.4, 0.4 + SPACING_M, SPACING_M)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return GridDistance(np.linalg.norm(points, axis=-1) - RADIUS_M, np.full(3, -0.4), SPACING_M)


def measure(side: int, *, steps: int) -> dict[str, Any]:
    """The times of one mesh."""
    panel, faces = square(side)
    started = time.perf_counter()
    model = ClothModel(faces)
    built = time.perf_counter() - started
    nodes = np.stack([panel[:, 0] - 0.5 * EDGE_M, np.full(len(panel), RADIUS_M + 0.01), 0.5 * EDGE_M - panel[:, 1]], 1)
    parameters = model.parameters(panel, CLOTH)
    parameters.panels.requires_grad_(True)
    parameters.stretch.requires_grad_(True)
    contact = SkinContact(ball())
    started = time.perf_counter()
    state = simulate(model, model.state(nodes), parameters, dt_s=DT_S, steps=steps, contact=contact)
    forward = time.perf_counter() - started
    started = time.perf_counter()
    (state.x**2).sum().backward()
    backward = time.perf_counter() - started
    assert parameters.panels.grad is not None and bool(torch.isfinite(parameters.panels.grad).all())
    with torch.no_grad():
        started = time.perf_counter()
        _, report = newton_step(model, state, parameters, dt_s=DT_S, contact=contact, tolerance_n=1e-6)
        newton = time.perf_counter() - started
    return {
        "vertices": len(panel),
        "steps": steps,
        "forward_s": forward,
        "backward_s": backward,
        "step_ms": 1e3 * (forward + backward) / steps,
        "newton_step_ms": 1e3 * newton,
        "newton_iterations": report.iterations,
        "newton_residual_n": report.residual_n,
        "model_s": built,
    }


def growth(rows: list[dict[str, Any]], key: str) -> float:
    """Exponent of ``key`` in the number of vertices, by least squares in the logarithms."""
    sizes, times = (np.log([row[name] for row in rows]) for name in ("vertices", key))
    return float(np.polyfit(sizes, times, 1)[0])


@Benchmark(
    "simulate", "Time of the differentiable simulator.", COLUMNS, Option("--steps", 20, "linearised steps of a case")
)
def main(run: Run) -> None:
    """A row for each size of mesh."""
    measure(8, steps=2)  # loads and warms what the first call would pay for
    run.rows = [measure(side, steps=run.options.steps) for side in (QUICK_SIDES if run.options.quick else SIDES)]
    exponents = {key: growth(run.rows, key) for key in ("forward_s", "backward_s", "step_ms")}
    run.notes.append(f"growth with the vertices: step {exponents['step_ms']:.2f}")
    run.extra["growth_exponent"] = exponents


if __name__ == "__main__":
    main.command()
