"""The way to a pose from one in which the cloth is apart: the body moves in small steps and takes the cloth along.

A drape that passes through itself can rarely be brought apart where it is: sheets that lie deep in each other have no
short way out. So the cloth comes to the pose from another one in which nothing crosses, such as the T-pose. In each
step every vertex is drawn to where the skin nearest to it would take it; skin in creases takes no part
(``drape.exact.creases``). On this way nothing passes through anything (``drape.exact.apart``). At the end the cloth is
drawn towards the drape that crosses, as near as it can come.

Between two frames of a clip the way is short: the cloth moves as the drapes of the two frames do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.cloth.contact import BodyContact
from drape.exact import apart, creases
from drape.exact.newton import Band, Cloth
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix

WAY_M = 0.02  # of the cloth in a step of the body
CARRIED, STEPS = 6, 3  # moves without, and steps with, an energy in each of these
ROUNDS, DEEP_M = 6, 0.002  # so many times as many steps at most, while cloth is deeper than this in the skin
HOLD_N_PER_M = 2.0  # of the springs to where the skin would take the cloth, at a mean vertex
DRAWN_STEPS, DRAWN_N_PER_M = 30, 10.0  # of the way to the drape that crosses


@dataclass(frozen=True, eq=False)
class Body:
    """A ``model`` in the shape ``betas`` (S,), whose root is where vertices count from."""

    model: BodyModel
    betas: np.ndarray

    def bones(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (24, 3, 3) and translations [m] (24, 3) of the bones in a ``pose`` (24, 3) [rad]."""
        rotation, translation = self.model.bones(pose[None], self._centred, self.betas)
        return rotation[0], translation[0]

    def posed(self, pose: np.ndarray) -> np.ndarray:
        """Vertices [m] (Vb, 3) in a ``pose`` (24, 3) [rad]."""
        return self.model.posed_vertices(pose[None], self._centred, self.betas)[0]

    @property
    def _centred(self) -> np.ndarray:
        return -self.model.rest_joints(self.betas)[:1]

    def carried(self, x: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Points ``x`` [m] (V, 3) at the pose ``before``, each moved on to ``after`` with the nearest vertex's skin."""
        near = self.model.weights[KDTree(self.posed(before)).query(x)[1]]
        (old, old_way), (new, new_way) = (
            (np.einsum("vj,jab->vab", near, rotation), near @ way)
            for rotation, way in (self.bones(before), self.bones(after))
        )
        rest = np.linalg.solve(old, (x - old_way)[..., None])
        return (new @ rest)[..., 0] + new_way


def between(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """The pose (24, 3) [rad] that is ``share`` of the way from ``before`` to ``after``, joint by joint."""
    first, last = rotvec_to_matrix(before), rotvec_to_matrix(after)
    turn = matrix_to_rotvec(np.swapaxes(first, -1, -2) @ last)
    return matrix_to_rotvec(first @ rotvec_to_matrix(share * turn))


def poses_between(
    body: Body, x: np.ndarray, before: np.ndarray, after: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of neighbouring poses (24, 3) [rad] on the way from ``before`` to ``after``: between the two of a pair the
    skin moves no part of the cloth ``x`` [m] (V, 3) much farther than ``WAY_M``."""
    way_m = float(np.linalg.norm(body.carried(x, before, after) - x, axis=1).max())
    count = max(1, int(np.ceil(way_m / WAY_M)))
    poses = [between(before, after, number / count) for number in range(count + 1)]
    return pairwise(poses)


def led(
    cloth: Cloth, contact: BodyContact, body: Body, x: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Returns the cloth ``x`` [m] (V, 3) taken along from the first pose of ``ends`` (24, 3) [rad], where it is apart,
    to the second one."""
    for before, after in poses_between(body, x, *ends):
        goal = body.carried(x, before, after)
        x = _taken(cloth, contact, body.posed(after), x, goal, least=1)
    return x


def followed(
    cloth: Cloth,
    contact: BodyContact,
    body: Body,
    x: np.ndarray,
    motion: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Returns the cloth ``x`` [m] (V, 3) moved by ``motion`` [m] (V, 3) on the way from the first pose of ``ends`` (24,
    3) [rad], where it is apart, to the second one."""
    count = max(1, int(np.ceil(np.linalg.norm(motion, axis=1).max() / WAY_M)))
    for number in range(1, count + 1):
        posed = body.posed(between(*ends, number / count))
        x = _taken(cloth, contact, posed, x, x + motion / count, least=0)
    return x


def _taken(
    cloth: Cloth, contact: BodyContact, posed: np.ndarray, x: np.ndarray, goal: np.ndarray, *, least: int
) -> np.ndarray:
    """The cloth ``x`` [m] (V, 3), moved towards ``goal`` (V, 3) over the ``posed`` body in ``least`` rounds of steps at
    least, and more while it is in the skin."""
    outer = creases.outside(contact, posed)
    goal = creases.out_of(outer, posed, goal, float(cloth.problem.constants.gap))
    descent = apart.ApartDescent(cloth, outer, posed, x, drawn=_towards(goal, cloth, HOLD_N_PER_M))
    _go(descent, goal)
    for number in range(1, ROUNDS + 1):
        if number > least and descent.deepest_m() < DEEP_M:
            break
        descent.run(number * STEPS, 0.0)
    return descent.now.x


def drawn_to(
    cloth: Cloth, contact: BodyContact, posed: np.ndarray, x: np.ndarray, goal: np.ndarray, band: Band | None
) -> np.ndarray:
    """Returns the cloth ``x`` [m] (V, 3), which is apart over the ``posed`` body (Vb, 3), drawn as near to ``goal`` [m]
    (V, 3) as it comes."""
    outer = creases.outside(contact, posed)
    goal = creases.out_of(outer, posed, goal, float(cloth.problem.constants.gap))
    one = apart.ApartDescent(cloth, outer, posed, x, band=band, drawn=_towards(goal, cloth, DRAWN_N_PER_M))
    _go(one, goal)
    one.run(DRAWN_STEPS, 0.0)
    return one.now.x


def _towards(goal: np.ndarray, cloth: Cloth, n_per_m: float) -> Band:
    """Springs to ``goal`` [m] (V, 3), of ``n_per_m`` at a mean vertex."""
    return Band(goal, n_per_m * cloth.problem.contact_n_per_m / cloth.problem.contact_n_per_m.mean())


def _go(one: apart.ApartDescent, goal: np.ndarray) -> None:
    """Moves towards ``goal`` [m] (V, 3), whatever the energy."""
    for _ in range(CARRIED):
        one.go(goal - one.now.x)
