"""Cloth that hangs over a body, at rest: the relaxation of ``relaxation`` with weight, in contact that lets it slide.

Of implicit steps without velocity each keeps the lengths of the cloth, lets it sink by its weight, and holds what lies
on the skin by a weak spring along all directions: what is held by little slides, and slides on in the next step. Cloth
in the skin is first put onto it, so the spring need not carry it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from drape.cloth.relaxation import Relaxation, move_towards, shape_gradients
from drape.geometry import meshes
from drape.geometry.symmetric import symmetric_factor

DENSITY_KG_M2, STIFFNESS_N_PER_M, GRAVITY_M_S2 = 0.2, 200.0, 9.81
STEP_S = 0.04  # a free vertex sinks by 16 mm
GAP_M, NEAR_M = 0.008, 0.012  # the distance that cloth keeps from the skin, and that below which it is held
REACH_M = 0.08  # the plane of a vertex counts up to this distance from it
FIRM, LOOSE = 4.0, 0.5  # weights of contact where the skin holds cloth, and where it lets it slide
RENEWED = 5  # one factor serves so many steps


class HoldingSkin:
    """A posed body that cloth hangs on: ``vertices`` [m] (Vb, 3), ``faces``, and how ``firm`` (Vb,) in [0, 1] each
    vertex holds cloth."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, firm: np.ndarray) -> None:
        self._vertices, self._weight = vertices, LOOSE + (FIRM - LOOSE) * firm
        self._normals, self._tree = meshes.vertex_normals(vertices, faces), KDTree(vertices)

    def contact(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns for points ``x`` [m] (V, 3) their signed distances [m] (V,) from the body, positive outside, its
        outward unit normals (V, 3) there, and the weights (V,) of contact, ``LOOSE`` to ``FIRM``."""
        far, near = self._tree.query(x)
        along = np.einsum("vc,vc->v", x - self._vertices[near], self._normals[near])
        return np.where(far < REACH_M, along, far), self._normals[near], self._weight[near]


class HangingCloth(Relaxation):
    """A cloth that hangs over a body: its weight pulls it down, its triangles keep their lengths, it keeps
    ``GAP_M`` off the skin, and what is nearer than ``NEAR_M`` to the skin is held there by weak springs.

    ``faces`` (F, 3) have at rest the edge lengths that they have at ``vertices`` [m] (V, 3).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        first, second = meshes.corner_edges(vertices, faces)
        length = np.linalg.norm(first, axis=1)
        along = np.einsum("fc,fc->f", first, second) / length
        across = np.linalg.norm(np.cross(first, second), axis=1) / length
        none = np.zeros(len(faces))
        rest = np.array([[none, none], [length, none], [along, across]]).transpose(2, 0, 1)
        area = np.bincount(faces.reshape(-1), np.repeat(shape_gradients(rest)[1] / 3.0, 3), len(vertices))
        softness = DENSITY_KG_M2 * area / STIFFNESS_N_PER_M
        super().__init__(faces, rest, lambda x: (np.ones(len(x)), x), gap_m=GAP_M, inertia=softness / STEP_S**2)
        self._sag = GRAVITY_M_S2 * softness

    def hang(self, x: np.ndarray, skin: HoldingSkin, steps: int) -> np.ndarray:
        """Returns the vertices [m] (V, 3) of the cloth after it has sunk for ``steps`` steps from ``x`` [m] (V, 3) over
        ``skin``. At last vertices that lie inside the skin are put onto it."""
        for number in range(steps):
            distance, out, weight = skin.contact(x)
            if number % RENEWED == 0:
                held = np.where(distance < NEAR_M, weight, 0.0)
                factor = symmetric_factor(self._constant + scipy.sparse.diags(held))
            x = x + np.maximum(-distance, 0.0)[:, None] * out
            goal = x + np.clip(GAP_M - distance, 0.0, GAP_M)[:, None] * out
            right = self._inward(x) + held[:, None] * goal
            right[:, 1] -= self._sag
            x = move_towards(x, factor.solve(right))
        distance, out, _ = skin.contact(x)
        return x + np.maximum(-distance, 0.0)[:, None] * out
