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

WAY_M = 0.02  # the longest way of the cloth in a step of the body
CARRIED, STEPS = 6, 3  # in each of these: moves whatever the energy, then steps that lower it
ROUNDS, DEEP_M = 6, 0.002  # rounds of steps at most, as long as cloth is deeper than this in the skin
HOLD_N_PER_M = 2.0  # the stiffness, at a mean vertex, of the springs to where the skin would take the cloth
DRAWN_STEPS, DRAWN_N_PER_M = 30, 10.0  # the steps towards the drape that crosses, and the stiffness of their springs


@dataclass(frozen=True, eq=False)
class Body:
    """A body ``model`` in the shape ``betas`` (S,); its vertices and bones count from the root joint."""

    model: BodyModel
    betas: np.ndarray

    def bones(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the rotations (24, 3, 3) and translations [m] (24, 3) of the bones in a ``pose`` (24, 3) [rad]."""
        rotation, translation = self.model.bones(pose[None], self._centred, self.betas)
        return rotation[0], translation[0]

    def posed(self, pose: np.ndarray) -> np.ndarray:
        """Returns the body's vertices [m] (Vb, 3) in a ``pose`` (24, 3) [rad]."""
        return self.model.posed_vertices(pose[None], self._centred, self.betas)[0]

    @property
    def _centred(self) -> np.ndarray:
        return -self.model.rest_joints(self.betas)[:1]

    def carry(self, x: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Returns the points ``x`` [m] (V, 3) as they go from the pose ``before`` to ``after``, each (24, 3) [rad],
        with the skin: each by the skinning of the body vertex nearest to it."""
        near = self.model.weights[KDTree(self.posed(before)).query(x)[1]]
        (old, old_way), (new, new_way) = (
            (np.einsum("vj,jab->vab", near, rotation), near @ way)
            for rotation, way in (self.bones(before), self.bones(after))
        )
        rest = np.linalg.solve(old, (x - old_way)[..., None])
        return (new @ rest)[..., 0] + new_way


def pose_between(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """Returns the pose (24, 3) [rad] that is ``share``, 0 to 1, of the way from ``before`` to ``after``, joint by
    joint."""
    first, last = rotvec_to_matrix(before), rotvec_to_matrix(after)
    turn = matrix_to_rotvec(np.swapaxes(first, -1, -2) @ last)
    return matrix_to_rotvec(first @ rotvec_to_matrix(share * turn))


def poses_between(
    body: Body, x: np.ndarray, before: np.ndarray, after: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Returns an iterator over pairs of neighbouring poses, each (24, 3) [rad], on the way from ``before`` to
    ``after``. Between the two poses of a pair the skin takes no vertex of the cloth ``x`` [m] (V, 3) much farther than
    ``WAY_M``."""
    way_m = float(np.linalg.norm(body.carry(x, before, after) - x, axis=1).max())
    count = max(1, int(np.ceil(way_m / WAY_M)))
    poses = [pose_between(before, after, number / count) for number in range(count + 1)]
    return pairwise(poses)


def lead(
    cloth: Cloth, contact: BodyContact, body: Body, x: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Returns the cloth [m] (V, 3) in the second pose of ``ends``, each (24, 3) [rad]: the body takes it along from the
    first one, where it is ``x`` [m] (V, 3) and crosses itself nowhere."""
    for before, after in poses_between(body, x, *ends):
        goal = body.carry(x, before, after)
        x = _take_along(cloth, contact, body.posed(after), x, goal, least=1)
    return x


def follow(
    cloth: Cloth,
    contact: BodyContact,
    body: Body,
    x: np.ndarray,
    motion: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Returns the cloth [m] (V, 3) in the second pose of ``ends``, each (24, 3) [rad]: it moves by ``motion`` [m] (V,
    3) from the first one, where it is ``x`` [m] (V, 3) and crosses itself nowhere."""
    count = max(1, int(np.ceil(np.linalg.norm(motion, axis=1).max() / WAY_M)))
    for number in range(1, count + 1):
        posed = body.posed(pose_between(*ends, number / count))
        x = _take_along(cloth, contact, posed, x, x + motion / count, least=0)
    return x


def _take_along(
    cloth: Cloth, contact: BodyContact, posed: np.ndarray, x: np.ndarray, goal: np.ndarray, *, least: int
) -> np.ndarray:
    """The cloth ``x`` [m] (V, 3), moved towards ``goal`` (V, 3) over the ``posed`` body in ``least`` rounds of steps at
    least, and more while it is in the skin."""
    outer = creases.without_creases(contact, posed)
    goal = creases.move_out(outer, posed, goal, float(cloth.problem.constants.gap))
    descent = apart.ApartDescent(cloth, outer, posed, x, pull=_towards(goal, cloth, HOLD_N_PER_M))
    _go(descent, goal)
    for number in range(1, ROUNDS + 1):
        if number > least and descent.deepest_m() < DEEP_M:
            break
        descent.run(number * STEPS, 0.0)
    return descent.now.x


def draw_to(
    cloth: Cloth, contact: BodyContact, posed: np.ndarray, x: np.ndarray, goal: np.ndarray, band: Band | None
) -> np.ndarray:
    """Returns the cloth [m] (V, 3) as near to ``goal`` [m] (V, 3) as springs draw it over the ``posed`` body [m] (Vb,
    3). It starts at ``x`` [m] (V, 3), where it crosses itself nowhere."""
    outer = creases.without_creases(contact, posed)
    goal = creases.move_out(outer, posed, goal, float(cloth.problem.constants.gap))
    descent = apart.ApartDescent(cloth, outer, posed, x, band=band, pull=_towards(goal, cloth, DRAWN_N_PER_M))
    _go(descent, goal)
    descent.run(DRAWN_STEPS, 0.0)
    return descent.now.x


def _towards(goal: np.ndarray, cloth: Cloth, n_per_m: float) -> Band:
    """Springs to ``goal`` [m] (V, 3), of ``n_per_m`` at a mean vertex."""
    return Band(goal, n_per_m * cloth.problem.contact_n_per_m / cloth.problem.contact_n_per_m.mean())


def _go(descent: apart.ApartDescent, goal: np.ndarray) -> None:
    """Moves towards ``goal`` [m] (V, 3), whatever the energy."""
    for _ in range(CARRIED):
        descent.go(goal - descent.now.x)
