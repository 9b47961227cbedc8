"""The simulator that judges motion: the full mesh by implicit Euler, with the fabric's friction on the skin.

Each frame is the minimum of energy, contact, inertia and friction: it settles under the cloth's stiffness and mass
(``drape.exact.settling``) and goes on by Newton's method. Friction is Coulomb's: a vertex that slips along the
skin, which its bones carry on between frames, is held by mu times the force of contact, and by less where it slips by
less than ``SLIP_M``. Friction acts as a spring, whose stiffness and place each of ``ROUNDS`` rounds takes anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from benchmarks.judge.physics import Waistband
from drape.body.model import BodyModel
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.exact import newton, settling
from drape.exact.newton import Band, Cloth, Descent
from drape.geometry import meshes

FIRST_STEPS, STEPS, TOLERANCE = 120, 12, 0.01  # steps of Newton's method; force that may be left over the weight
SETTLE = 50  # rounds of settling before Newton's steps
ROUNDS = 3
AIR_KG_M3 = 0.72  # half of air's density times the drag of a plate across, as swing has it
SLIP_M = 2e-4  # friction grows with the slip of a frame up to here


@dataclass(frozen=True, eq=False)
class SimulatedCloth:
    """The cloth of a simulation: a ``mesh`` of ``material`` with the coefficient of ``friction`` on the skin, whose
    velocity decays at the rate ``damping_per_s``."""

    mesh: ClothMesh
    material: Material
    friction: float
    damping_per_s: float


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """The motion of a ``body`` through F frames, ``fps`` a second: ``poses`` (F, 24, 3) [rad] and translations of the
    root ``trans`` (F, 3) [m]."""

    body: BodyModel
    poses: np.ndarray
    trans: np.ndarray
    fps: float


class MovingSkin:
    """The skin of the body of ``motion``, its vertices ``posed`` [m] (F, Vb, 3) without the translation of the root."""

    def __init__(self, motion: SimulatedMotion) -> None:
        self.posed = motion.body.posed_vertices(motion.poses)
        self._weights = motion.body.weights
        self._rotation, self._translation = motion.body.bones(motion.poses)

    def carried(self, x: np.ndarray, frame: int) -> np.ndarray:
        """Returns ``x`` [m] (V, 3), points of the frame before, after each has moved on to ``frame`` with the bones of
        the body vertex nearest to it."""
        near = self._weights[KDTree(self.posed[frame - 1]).query(x)[1]]
        (old, old_way), (new, new_way) = (self._blended(near, i) for i in (frame - 1, frame))
        rest = np.linalg.solve(old, (x - old_way)[..., None])
        return (new @ rest)[..., 0] + new_way

    def _blended(self, weights: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
        return (np.einsum("vj,jab->vab", weights, self._rotation[frame]), weights @ self._translation[frame])


def grip(descent: Descent, x: np.ndarray, stuck: np.ndarray, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the springs by which friction acts on vertices at ``x`` [m] (V, 3): their ends [m] (V, 3) and stiffness
    [N/m] (V,).

    Each vertex would be at ``stuck`` [m] (V, 3) had it not slipped. The force is ``friction`` times that of contact in
    ``descent``, and less in proportion where the slip along the skin is below ``SLIP_M``.
    """
    around, _ = descent.around(x)
    normal = around.normal / np.maximum(np.linalg.norm(around.normal, axis=1, keepdims=True), 1e-12)
    depth = float(descent.problem.constants.gap) - ((x - around.point) * normal).sum(axis=1)
    press_n = descent.problem.contact_n_per_m * np.maximum(depth, 0.0)
    slip = x - stuck
    slip = slip - (slip * normal).sum(axis=1, keepdims=True) * normal
    return x - slip, friction * press_n / np.maximum(np.linalg.norm(slip, axis=1), SLIP_M)


def simulate(
    sheet: SimulatedCloth, motion: SimulatedMotion, start: np.ndarray, waistband: Waistband | None
) -> tuple[np.ndarray, float]:
    """Returns the vertices [m] (F, V, 3) of ``sheet`` through ``motion``, without the translation of the root, and the
    share [%] of the frames in which Newton's method came to rest.

    The first frame is the optimum of its pose that ``start`` [m] (V, 3) leads to. ``waistband`` holds the cloth, if it
    has one.
    """
    mesh, material, skin = sheet.mesh, sheet.material, MovingSkin(motion)
    cloth, contact = Cloth.of(mesh, material, None), BodyContact(motion.body.faces, motion.body.vertex_count)
    limit_n, inertia = TOLERANCE * cloth.weight_n, mesh.vertex_mass(material) * motion.fps**2
    moving = cloth._replace(solve=settling.inverse(mesh, material, n_per_m=inertia))
    bands = [None if waistband is None else waistband.over(i, len(start)) for i in range(len(motion.poses))]
    x = newton.minimum(
        cloth, contact, skin.posed[0], [start], step_limit=FIRST_STEPS, tolerance=TOLERANCE, band=bands[0]
    ).x
    drapes, rested, speed = [x], 0, np.zeros_like(x)
    for i in range(1, len(motion.poses)):
        before = x - (motion.trans[i] - motion.trans[i - 1])
        ahead = before + slow_down(speed, before, sheet, motion.fps) / motion.fps
        stuck = skin.carried(x, i)
        now, at_rest = ahead, False
        for _ in range(ROUNDS if sheet.friction else 1):
            target, n_per_m = ahead, inertia
            if sheet.friction:
                probe = Descent(cloth, contact, skin.posed[i], now, band=bands[i])
                place, spring = grip(probe, now, stuck, sheet.friction)
                n_per_m = inertia + spring
                target = (inertia[:, None] * ahead + spring[:, None] * place) / n_per_m[:, None]
            pull = Band(target, n_per_m)  # inertia and friction
            step = Descent(moving, contact, skin.posed[i], now, band=bands[i], pull=pull)
            step.settle(SETTLE)
            end = step.run(STEPS, limit_n)
            now, at_rest = end.x, end.at_rest
        speed, x, rested = (now - before) * motion.fps, now, rested + at_rest
        drapes.append(x)
    return np.stack(drapes), 100.0 * rested / (len(drapes) - 1)


def slow_down(speed: np.ndarray, x: np.ndarray, sheet: SimulatedCloth, fps: float) -> np.ndarray:
    """Returns the velocities ``speed`` [m/s] (V, 3) of vertices at ``x`` [m] (V, 3) after damping and air have slowed
    them for one frame.

    Air slows the part along the vertex normal alone, as in ``drape.live.swing_step``.
    """
    speed = speed / (1.0 + sheet.damping_per_s / fps)
    normal = np.asarray(meshes.vertex_normals(x, sheet.mesh.faces))
    wind = (speed * normal).sum(axis=1, keepdims=True)
    slow = AIR_KG_M3 / float(sheet.material.density_kg_m2) * np.abs(wind) / fps
    return speed - wind * slow / (1.0 + slow) * normal
