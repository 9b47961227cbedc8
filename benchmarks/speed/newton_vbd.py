"""A clip of cloth by Newton's VBD solver (https://github.com/newton-physics/newton), for ``benchmarks.tradeoff``.

    PYTHON -m benchmarks.speed.newton_vbd SCENE.npz OUT.npz

Runs in an environment that has ``newton`` (1.8) and NumPy and nothing of ours. SCENE holds the cloth's rest state, a
start, the clip of the body, and ``paces`` (P, 2): steps and iterations of a frame.

The body is ``body_vertices`` [m] (F, B, 3) and moves in a straight line within a frame, by a part of it before every
step, with its speed told to friction and damping. The first frame is settled, which is not timed: ``SETTLE_STEPS``
steps that each forget their speed. The others go on from the frame before with their speed. The cloth's rest state is
that of sewn sheets: see ``take_rest_state``. ``pinned`` (n,) vertices go where ``anchor`` (F, n, 3) has them.

OUT gets ``vertices`` [m] (P, F, V, 3) float32, and ``wall_ms`` and ``cpu_ms`` (P, F) of a frame, which hold the motion
of the collision mesh and the detection before every step, but not the pose of the body. Warp runs kernels of a
processor on one thread.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

# In steps of a thirtieth of a second ten iterations do not carry what the shoulders hold to the hem: cloth falls off.
SETTLE_STEPS, SETTLE_ITERATIONS, SETTLE_STEP_S = 120, 5, 1.0 / 960.0
REACH_M = 0.02  # past the radius: how far from the skin, and in it, contact is looked for


def cloth_and_body(warp: Any, newton: Any, scene: Mapping[str, np.ndarray], body: Any, skin: Any) -> Any:
    """The model of the scene's cloth and of the mesh ``body``, which is ``skin``."""
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
        particle_radius=float(scene["radius"]),
    )
    for vertex in scene["pinned"].tolist():
        builder.particle_mass[vertex] = 0.0
        builder.particle_flags[vertex] &= ~newton.ParticleFlags.ACTIVE
    builder.add_shape_mesh(body=-1, mesh=body, cfg=skin)
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    hinges = model.edge_bending_properties.numpy()
    hinges[:, 0] = take_rest_state(model, scene)
    model.edge_bending_properties.assign(hinges)
    return model


def take_rest_state(model: Any, scene: Mapping[str, np.ndarray]) -> np.ndarray:
    """Gives ``model`` the sewn rest state of the scene, which no places in space have; stiffness [N] (E,) of hinges."""
    assert np.array_equal(model.tri_indices.numpy(), scene["faces"]), "Newton left triangles out"
    model.tri_poses.assign(scene["inverse_shape"].T.reshape(-1, 2, 2).transpose(0, 2, 1).astype(np.float32))
    model.tri_areas.assign(scene["face_area"].astype(np.float32))
    mass = scene["vertex_kg"].astype(np.float32)
    mass[scene["pinned"]] = 0.0
    model.particle_mass.assign(mass)
    model.particle_inv_mass.assign(np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0))
    edges, angles = model.edge_indices.numpy(), model.edge_rest_angle.numpy()
    hinge, stiff = matched(edges, scene["hinge_edge"], len(mass)), np.zeros(len(edges))
    found, ours = hinge >= 0, hinge[hinge >= 0]
    stiff[found] = scene["hinge_j"][ours] / model.edge_rest_length.numpy()[found]
    angles[found] = scene["hinge_angle"][ours]
    model.edge_rest_angle.assign(angles)
    return stiff


def matched(edges: np.ndarray, ends: np.ndarray, count: int) -> np.ndarray:
    """Which of ``ends`` (H, 2) an edge of Newton's (E, 4: opposite corners, then both ends) is, -1 for none (E,)."""
    wanted, keys = (low.min(axis=1) * count + low.max(axis=1) for low in (edges[:, 2:].astype(int), ends.astype(int)))
    order = np.argsort(keys)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    return np.where(keys[order[place]] == wanted, order[place], -1)


class Stage:
    """A scene's clip in Newton: a body that moves, and the cloth, a step at a time."""

    def __init__(self, warp: Any, newton: Any, scene: Mapping[str, np.ndarray]) -> None:
        self.newton, self.scene = newton, scene
        self.places = scene["body_vertices"].astype(np.float32)
        self.fps, self.pinned = float(scene["fps"]), scene["pinned"]
        mesh = newton.Mesh(self.places[0], scene["body_faces"].reshape(-1).astype(np.int32))
        # Newton takes the mean of both sides for stiffness and damping, and the geometric one for friction.
        stiff, damped, rough = (float(scene[name]) for name in ("contact_ke", "contact_kd", "friction"))
        skin = newton.ModelBuilder.ShapeConfig(ke=stiff, kd=damped, mu=rough)
        self.model = cloth_and_body(warp, newton, scene, mesh, skin)
        self.model.soft_contact_ke, self.model.soft_contact_kd, self.model.soft_contact_mu = stiff, damped, rough
        # The box outside of which no contact is looked for is that of the mesh as it was first: of the whole clip here.
        bounds = self.places.min(axis=(0, 1)), self.places.max(axis=(0, 1))
        self.model.shape_collision_aabb_lower.assign([warp.vec3(*map(float, bounds[0]))])
        self.model.shape_collision_aabb_upper.assign([warp.vec3(*map(float, bounds[1]))])
        self.skin = mesh.mesh  # Warp's, which the model has by its address
        self.pipeline = newton.CollisionPipeline(self.model, soft_contact_gap=REACH_M)
        self.contacts, self.control = self.pipeline.contacts(), self.model.control()
        self.now, self.after = self.model.state(), self.model.state()

    def begin(self, vertices: np.ndarray) -> None:
        """Puts the cloth at ``vertices`` (V, 3), at rest."""
        self.now.particle_q.assign(vertices.astype(np.float32))
        self.now.particle_qd.zero_()

    def solver(self, iterations: int) -> Any:
        """One that computes so many ``iterations`` of a step."""
        return self.newton.solvers.SolverVBD(self.model, iterations=iterations)

    def step(self, solver: Any, frame: int, share: float, step_s: float) -> None:
        """One step, at the end of which the body is by ``share`` of the way from the frame before to ``frame``."""
        before, way = self.places[max(frame - 1, 0)], self.places[frame] - self.places[max(frame - 1, 0)]
        self.skin.points.assign(before + np.float32(share) * way)
        self.skin.velocities.assign(np.float32(self.fps) * way)
        self.skin.refit()
        anchor = self.scene["anchor"]
        held = anchor[max(frame - 1, 0)] + share * (anchor[frame] - anchor[max(frame - 1, 0)])
        self.now.particle_q.numpy()[self.pinned] = held  # a view
        self.pipeline.collide(self.now, self.contacts)
        solver.step(self.now, self.after, self.control, self.contacts, step_s)
        self.now, self.after = self.after, self.now

    @property
    def vertices(self) -> np.ndarray:
        """Where the cloth is (V, 3) [m]."""
        return self.now.particle_q.numpy().copy()


def whole_clip(warp: Any, newton: Any, scene: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What OUT gets of a clip."""
    stage, paces, frames = Stage(warp, newton, scene), scene["paces"], len(scene["body_vertices"])
    stage.begin(scene["start"])
    solver = stage.solver(SETTLE_ITERATIONS)
    for _ in range(SETTLE_STEPS):
        stage.step(solver, 0, 0.0, SETTLE_STEP_S)
        stage.now.particle_qd.zero_()
    settled = stage.vertices
    vertices = np.empty((len(paces), frames, *settled.shape), np.float32)
    wall_ms, cpu_ms = np.zeros((2, len(paces), frames))
    for row, (steps, iterations) in enumerate(paces.tolist()):
        solver = stage.solver(iterations)
        stage.step(solver, 0, 0.0, SETTLE_STEP_S)  # compiles, and allocates what this one needs
        stage.begin(settled)
        vertices[row, 0] = settled
        for frame in range(1, frames):
            wall, cpu = time.perf_counter(), time.process_time()
            for step in range(steps):
                stage.step(solver, frame, (step + 1) / steps, 1.0 / (stage.fps * steps))
            vertices[row, frame] = stage.vertices
            cpu_ms[row, frame] = 1e3 * (time.process_time() - cpu)
            wall_ms[row, frame] = 1e3 * (time.perf_counter() - wall)
    return {"vertices": vertices, "wall_ms": wall_ms, "cpu_ms": cpu_ms}


def main() -> None:
    """Command line entry."""
    warp: Any = importlib.import_module("warp")
    newton: Any = importlib.import_module("newton")
    warp.config.quiet = True
    with np.load(sys.argv[1]) as read:
        scene = {name: read[name] for name in read.files}
    found: dict[str, Any] = whole_clip(warp, newton, scene)
    np.savez(sys.argv[2], **found)


if __name__ == "__main__":
    main()
