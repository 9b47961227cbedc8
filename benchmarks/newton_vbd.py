"""One frame of cloth by Newton's VBD solver (https://github.com/newton-physics/newton), for ``benchmarks.latency``.

    PYTHON -m benchmarks.newton_vbd SCENE.npz

Runs in an environment that has ``newton`` and NumPy and nothing of ours. The scene holds the rest mesh, a start, the
posed body and the cloth; the last line printed is a JSON list with time and edge strain for every count of iterations.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from typing import Any

import numpy as np

STEP_S = 1.0 / 30.0
REPEATS = 5
RADIUS_M = 0.002


def edge_strain_pct(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> float:
    """Mean relative change of edge lengths [%], as ``drape.cloth.metrics.edge_strain_pct``."""
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)

    def lengths(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)

    return float(100.0 * np.mean(np.abs(lengths(vertices) / lengths(rest) - 1.0)))


def main() -> None:
    """Command line entry."""
    warp: Any = importlib.import_module("warp")
    newton: Any = importlib.import_module("newton")
    warp.config.quiet = True
    scene = np.load(sys.argv[1])
    rest, faces = scene["rest"], scene["faces"]
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -9.81, 0.0))
    builder.add_cloth_mesh(
        pos=warp.vec3(0.0, 0.0, 0.0),
        rot=warp.quat_identity(),
        scale=1.0,
        vel=warp.vec3(0.0, 0.0, 0.0),
        vertices=[warp.vec3(*map(float, place)) for place in rest],
        indices=faces.reshape(-1).tolist(),
        density=float(scene["density"]),
        tri_ke=float(scene["membrane"]),
        tri_ka=float(scene["area"]),
        tri_kd=0.0,
        edge_ke=float(scene["bending"]),
        edge_kd=0.0,
        particle_radius=RADIUS_M,
    )
    body = newton.Mesh(scene["body_vertices"].astype(np.float32), scene["body_faces"].reshape(-1).astype(np.int32))
    builder.add_shape_mesh(body=-1, mesh=body)
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e2, 1e-2, 0.2
    rows = []
    for iterations in scene["iterations"].tolist():
        solver = newton.solvers.SolverVBD(model, iterations=iterations)
        before, after, control = model.state(), model.state(), model.control()
        taken = []
        for _ in range(REPEATS + 1):
            before.particle_q = warp.array(scene["start"].astype(np.float32), dtype=warp.vec3, device="cpu")
            before.particle_qd.zero_()
            began = time.perf_counter()
            solver.step(before, after, control, model.collide(before), STEP_S)
            taken.append(1e3 * (time.perf_counter() - began))
        p50, p95, p99 = np.percentile(taken[1:], [50, 95, 99])  # the first call compiles
        rows.append(
            {
                "iterations": iterations,
                "p50_ms": float(p50),
                "p95_ms": float(p95),
                "p99_ms": float(p99),
                "edge_pct": edge_strain_pct(after.particle_q.numpy().astype(np.float64), rest, faces),
            }
        )
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
