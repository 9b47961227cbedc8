"""A sewn garment draped to rest by Newton's Style3D solver (https://github.com/newton-physics/newton).

    PYTHON -m benchmarks.recovery.newton_drape SCENE.npz OUT.npz

Runs in an environment that has ``newton`` (1.8) and NumPy and nothing of ours, for ``benchmarks.recovery_targets``. It
is another cloth than ours: Baraff and Witkin's stretch without Poisson's effect, Bergou's quadratic bending, contact of
the cloth with itself, friction.

SCENE: ``nodes`` [m] (N, 3) sewn round the body, ``faces`` (F, 3), ``panels`` [m] (P, 2) and ``panel_faces`` (F, 3) the
flat panels, ``body_vertices``, ``body_faces``, ``held`` nodes of a belt (may be none), and the numbers ``stretch`` and
``shear`` [N/m], ``bending`` [J], ``density`` [kg/m^2], ``gravity`` [m/s^2], ``friction``, ``gap_m`` from skin to cloth.
A belt's garment first closes round the body without weight.

OUT: ``nodes`` (N, 3), ``moved_mm`` the largest move of a node over the last second, ``seconds`` simulated.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np

STEP_S = 1.0 / 30.0
ITERATIONS, LINEAR_ITERATIONS = 8, 20
KEPT_SPEED = 0.9  # of every step's velocity: the shape at rest is sought, not the way there
CLOSING_S = 1.0
LONGEST_S = 30.0
AT_REST_MM = 0.3  # a second
CONTACT_N_M = 200.0


class Garment:
    """The scene in Newton and its state."""

    def __init__(self, scene: Any) -> None:
        self.warp: Any = importlib.import_module("warp")
        self.newton: Any = importlib.import_module("newton")
        style3d: Any = importlib.import_module("newton.solvers").style3d
        self.warp.config.quiet = True
        newton, warp = self.newton, self.warp
        self.gravity = (0.0, -float(scene["gravity"]), 0.0)
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=self.gravity)
        newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        panels, panel_faces = outward(scene["panels"], scene["panel_faces"])
        stretch = float(scene["stretch"])
        style3d.add_cloth_mesh(
            builder,
            pos=warp.vec3(0.0, 0.0, 0.0),
            rot=warp.quat_identity(),
            vel=warp.vec3(0.0, 0.0, 0.0),
            vertices=scene["nodes"].tolist(),
            indices=scene["faces"].reshape(-1).tolist(),
            panel_verts=panels.tolist(),
            panel_indices=panel_faces.reshape(-1).tolist(),
            density=float(scene["density"]),
            tri_aniso_ke=warp.vec3(stretch, stretch, float(scene["shear"])),
            edge_aniso_ke=warp.vec3(1.0, 1.0, 1.0),
            particle_radius=float(scene["gap_m"]),
        )
        body = newton.Mesh(scene["body_vertices"].astype(np.float32), scene["body_faces"].reshape(-1).astype(np.int32))
        builder.add_shape_mesh(body=-1, mesh=body)
        model = builder.finalize(device="cpu")
        model.soft_contact_ke, model.soft_contact_kd = CONTACT_N_M, 1e-4
        model.soft_contact_mu = float(scene["friction"])
        model.shape_material_mu.fill_(float(scene["friction"]))
        # Its energy of a hinge is 3 k l^2 theta^2 / (2 (A1 + A2)), ours b l^2 theta^2 / (2 (A1 + A2)).
        hinges = model.edge_bending_properties.numpy()
        hinges[:, 0] = float(scene["bending"]) / 3.0
        model.edge_bending_properties.assign(hinges)
        self.model = model
        config = newton.solvers.SolverStyle3D.Config(iterations=ITERATIONS, linear_iterations=LINEAR_ITERATIONS)
        self.solver = newton.solvers.SolverStyle3D(model, config=config)
        self.before, self.after, self.control = model.state(), model.state(), model.control()
        self.pipeline = newton.CollisionPipeline(model)
        self.contacts = self.pipeline.contacts()

    @property
    def nodes(self) -> np.ndarray:
        """Positions [m] (N, 3)."""
        return self.before.particle_q.numpy().astype(np.float64)

    def hold(self, nodes: np.ndarray) -> None:
        """Keeps ``nodes`` where they are."""
        flags = self.model.particle_flags.numpy()
        flags[nodes] &= ~int(self.newton.ParticleFlags.ACTIVE)
        self.model.particle_flags.assign(flags)
        self.before.particle_qd.zero_()

    def run(self, seconds: float) -> float:
        """Goes on by ``seconds``, and returns how far [mm] a node was moved over them, the largest."""
        start = self.nodes
        for _ in range(round(seconds / STEP_S)):
            self.pipeline.collide(self.before, self.contacts)
            self.before.clear_forces()
            self.solver.step(self.before, self.after, self.control, self.contacts, STEP_S)
            self.before, self.after = self.after, self.before
            self.before.particle_qd.assign(KEPT_SPEED * self.before.particle_qd.numpy())
        return 1e3 * float(np.linalg.norm(self.nodes - start, axis=1).max())


def outward(panels: np.ndarray, panel_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3 F, 2) of the flat triangles and their numbers (F, 3), mirrored where they run clockwise.

    Newton leaves out clockwise triangles; the cloth is the same on both sides.
    """
    corners = panels[panel_faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    corners = np.where(clockwise[:, None, None], corners * np.array([-1.0, 1.0]), corners)
    return corners.reshape(-1, 2), np.arange(3 * len(panel_faces)).reshape(-1, 3)


def main() -> None:
    """Command line entry."""
    scene = np.load(sys.argv[1])
    garment = Garment(scene)
    if len(scene["held"]):
        garment.model.set_gravity((0.0, 0.0, 0.0))
        garment.run(CLOSING_S)
        garment.model.set_gravity(garment.gravity)
        garment.hold(scene["held"])
    seconds, moved = 0.0, np.inf
    while seconds < LONGEST_S and moved > AT_REST_MM:
        moved = garment.run(1.0)
        seconds += 1.0
        print(f"{seconds:.0f} s: {moved:.2f} mm", flush=True)
    np.savez(sys.argv[2], nodes=garment.nodes, moved_mm=moved, seconds=seconds)


if __name__ == "__main__":
    main()
