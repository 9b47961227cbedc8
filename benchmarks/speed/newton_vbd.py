"""One frame of cloth by Newton's VBD solver (https://github.com/newton-physics/newton), for ``benchmarks.latency``.

    PYTHON -m benchmarks.speed.newton_vbd SCENE.npz OUT.npz

Runs in an environment that has ``newton`` (1.8) and NumPy and nothing of ours. SCENE holds the rest mesh, a start, the
posed body and the cloth; OUT gets, for every count of ``iterations`` (I,), ``step_ms`` and ``collide_ms`` (I, R) of R
repeats and the ``vertices`` [m] (I, V, 3) after one step from the start at rest. A step's time includes its
collision detection, which ``collide_ms`` gives alone.
"""

from __future__ import annotations

import importlib
import sys
import time
from typing import Any

import numpy as np

STEP_S = 1.0 / 30.0
REPEATS = 5
RADIUS_M = 0.002


def bending_n(rest: np.ndarray, edges: np.ndarray, bending_j: float) -> np.ndarray:
    """Newton's hinge stiffness [N] (E,) of ours [J]; ``edges`` (E, 4): opposite corners, then both ends.

    Its energy is k l theta^2 / 2, ours about b l^2 / (A1 + A2) theta^2 / 2, so k = b l / (A1 + A2). Border edges: 0.
    """
    first, second, start, end = (rest[np.maximum(edges[:, column], 0)] for column in range(4))
    along = end - start
    areas = sum(0.5 * np.linalg.norm(np.cross(along, corner - start), axis=1) for corner in (first, second))
    return np.where((edges[:, :2] >= 0).all(axis=1), bending_j * np.linalg.norm(along, axis=1) / areas, 0.0)


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
        edge_ke=1.0,
        edge_kd=0.0,
        particle_radius=RADIUS_M,
    )
    body = newton.Mesh(scene["body_vertices"].astype(np.float32), scene["body_faces"].reshape(-1).astype(np.int32))
    builder.add_shape_mesh(body=-1, mesh=body)
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e2, 1e-2, 0.2
    hinges = model.edge_bending_properties.numpy()
    hinges[:, 0] = bending_n(rest, model.edge_indices.numpy(), float(scene["bending"]))
    model.edge_bending_properties.assign(hinges)
    counts = scene["iterations"]
    steps, detections = np.zeros((len(counts), REPEATS + 1)), np.zeros((len(counts), REPEATS + 1))
    vertices = np.zeros((len(counts), len(rest), 3))
    for row, iterations in enumerate(counts.tolist()):
        solver = newton.solvers.SolverVBD(model, iterations=iterations)
        before, after, control = model.state(), model.state(), model.control()
        for turn in range(REPEATS + 1):
            before.particle_q = warp.array(scene["start"].astype(np.float32), dtype=warp.vec3, device="cpu")
            before.particle_qd.zero_()
            began = time.perf_counter()
            contacts = model.collide(before)
            detected = time.perf_counter()
            solver.step(before, after, control, contacts, STEP_S)
            steps[row, turn] = 1e3 * (time.perf_counter() - began)
            detections[row, turn] = 1e3 * (detected - began)
        vertices[row] = after.particle_q.numpy()
    # The first call of each solver compiles.
    np.savez(sys.argv[2], iterations=counts, step_ms=steps[:, 1:], collide_ms=detections[:, 1:], vertices=vertices)


if __name__ == "__main__":
    main()
