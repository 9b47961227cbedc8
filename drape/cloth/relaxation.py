"""A quick, unconditionally stable relaxation of cloth: as rigid as possible, pulled by threads, kept off the body.

Local-global iterations (Sorkine and Alexa 2007; Bouaziz et al. 2014): every triangle keeps the rotation nearest to its
deformation, then one linear system moves all vertices towards those rotations, towards the ends of their threads
and out of the body. It knows neither gravity nor fabric, so the result is no drape: it brings cloth from the place of
the panels to a shape that a simulator can start from.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from drape.errors import MeshError
from drape.geometry import meshes
from drape.geometry.symmetric import symmetric_factor

Distance = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # points (N, 3) -> distance [m] (N,), gradient (N, 3)

# Weights beside the membrane's cotangent weights, which are numbers around one at every mesh size.
THREAD_WEIGHT = 10.0
CONTACT_WEIGHT = 10.0
INERTIA_WEIGHT = 0.02
BENDING_LENGTH_M = 0.01  # folds shorter than about this cost more to bend than to squeeze flat
LONGEST_MOVE_M = 0.02  # the longest way in an iteration: less than half a wrist, so that no vertex jumps through one
COLLAPSED = 1e-12


class Relaxation:
    """A cloth of V vertices that ``step`` brings nearer to its lengths at rest, off the body, iteration by iteration.
    Its ``faces`` (F, 3) have the flat corners ``rest`` [m] (F, 3, 2) at rest.

    ``distance`` is a function of points that gives their signed distances from the body and its outward normals, and
    cloth keeps ``gap_m`` [m], a number or (V,), from the body. ``threads`` (S, 2) are pairs of vertices that can be
    pulled together. At the vertices ``creases`` cloth folds without resistance. ``inertia``, a number or (V,), is the
    weight by which vertices are held where they are.
    """

    def __init__(
        self,
        faces: np.ndarray,
        rest: np.ndarray,
        distance: Distance,
        *,
        gap_m: float | np.ndarray,
        threads: np.ndarray | None = None,
        creases: np.ndarray | None = None,
        inertia: float | np.ndarray = INERTIA_WEIGHT,
    ) -> None:
        self._creases = np.zeros(0, dtype=np.int64) if creases is None else creases
        self.faces, self.distance, self.gap_m, self.inertia = faces, distance, gap_m, inertia
        self.count = count = int(faces.max()) + 1
        self._gradient, self._area = shape_gradients(rest)
        weights = self._area[:, None, None] * np.einsum("fic,fjc->fij", self._gradient, self._gradient)
        rows, columns = np.repeat(faces, 3, axis=1).reshape(-1), np.tile(faces, (1, 3)).reshape(-1)
        membrane = scipy.sparse.csr_matrix((weights.reshape(-1), (rows, columns)), shape=(count, count))
        self._constant = membrane + self._bending(membrane) + scipy.sparse.diags(np.broadcast_to(inertia, count))
        self.threads = np.zeros((0, 2), dtype=np.int64) if threads is None else threads
        ends = np.arange(len(self.threads))
        values = np.ones(len(ends))
        self._difference = scipy.sparse.csr_matrix(
            (
                np.concatenate([values, -values]),
                (np.concatenate([ends, ends]), np.concatenate([self.threads[:, 0], self.threads[:, 1]])),
            ),
            shape=(len(ends), count),
        )
        self._constant = self._constant + THREAD_WEIGHT * (self._difference.T @ self._difference)
        self._gather = scipy.sparse.csr_matrix(
            (np.ones(faces.size), (faces.reshape(-1), np.arange(faces.size))), shape=(count, faces.size)
        )

    def _bending(self, membrane: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """Squared mean curvature of the inner vertices; nothing at borders, where it is not defined."""
        area = np.bincount(self.faces.reshape(-1), np.repeat(self._area / 3.0, 3), minlength=self.count)
        inner = np.ones(self.count)
        for loop in meshes.boundary_loops(self.faces):
            inner[loop] = 0.0
        inner[self._creases] = 0.0
        scale = scipy.sparse.diags(BENDING_LENGTH_M**2 * inner / np.maximum(area, 1e-30))
        return scipy.sparse.csr_matrix(membrane.T @ scale @ membrane)

    def step(self, x: np.ndarray, lengths_m: np.ndarray | None = None) -> np.ndarray:
        """Returns the vertices [m] (V, 3) after one iteration from ``x`` [m] (V, 3). ``lengths_m`` [m] (S,) is how long
        each thread may be, zero if left out."""
        distance, normal = self.distance(x)
        touching = distance < self.gap_m
        goal = x + np.where(touching, self.gap_m - distance, 0.0)[:, None] * normal
        right = self._inward(x)
        right += CONTACT_WEIGHT * touching[:, None] * goal
        if lengths_m is not None:
            thread = self._difference @ x
            length = np.linalg.norm(thread, axis=1)
            share = np.minimum(1.0, lengths_m / np.maximum(length, 1e-12))
            right += THREAD_WEIGHT * (self._difference.T @ (share[:, None] * thread))
        system = self._constant + CONTACT_WEIGHT * scipy.sparse.diags(touching.astype(np.float64))
        return move_towards(x, symmetric_factor(system).solve(right))

    def thread_lengths(self, x: np.ndarray) -> np.ndarray:
        """Returns the lengths [m] (S,) of the threads for vertices ``x`` [m] (V, 3)."""
        return np.linalg.norm(self._difference @ x, axis=1)

    def _inward(self, x: np.ndarray) -> np.ndarray:
        """Right side (V, 3) of the cloth alone, which is neither pulled nor in contact."""
        return self._gather @ self._wanted(x).reshape(-1, 3) + np.reshape(self.inertia, (-1, 1)) * x

    def _wanted(self, x: np.ndarray) -> np.ndarray:
        """Right side (F, 3 corners, 3) of triangles turned to where they are and not stretched."""
        f = np.einsum("fcx,fcp->fxp", x[self.faces], self._gradient)
        return self._area[:, None, None] * np.einsum("fxp,fcp->fcx", nearest_isometry(f), self._gradient)


def move_towards(x: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Returns ``x`` [m] (V, 3), moved to ``goal`` (V, 3), but no vertex by more than ``LONGEST_MOVE_M``."""
    size = np.linalg.norm(goal - x, axis=1, keepdims=True)
    return x + (goal - x) * np.minimum(1.0, LONGEST_MOVE_M / np.maximum(size, 1e-12))


def shape_gradients(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns for flat triangles ``rest`` [m] (F, 3, 2) the gradients [1/m] (F, 3, 2) of the shape functions of their
    corners, and their areas [m^2] (F,).

    Raises ``MeshError`` for a triangle without area.
    """
    first, second = rest[:, 1] - rest[:, 0], rest[:, 2] - rest[:, 0]
    double = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    if not (np.abs(double) > COLLAPSED * np.abs(double).mean()).all():
        raise MeshError(
            "panels",
            expected="triangles with an area",
            got=f"a flat one, number {int(np.abs(double).argmin())}",
            cure="Remove collapsed triangles of the panel.",
        )
    g1 = np.stack([second[:, 1], -second[:, 0]], axis=1) / double[:, None]
    g2 = np.stack([-first[:, 1], first[:, 0]], axis=1) / double[:, None]
    return np.stack([-g1 - g2, g1, g2], axis=1), 0.5 * np.abs(double)


def principal_stretches(faces: np.ndarray, rest: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Returns the principal stretches (F, 2) of ``faces`` (F, 3) at ``x`` [m] (V, 3), the larger one first; 1 is
    unstretched.

    ``rest`` [m] (F, 3, 2) are the flat corners at rest.
    """
    gradient, _ = shape_gradients(rest)
    return np.linalg.svd(np.einsum("fcx,fcp->fxp", x[faces], gradient), compute_uv=False)


def nearest_isometry(f: np.ndarray) -> np.ndarray:
    """Returns the matrices (F, 3, 2) with orthonormal columns nearest to ``f`` (F, 3, 2): f (f^T f)^(-1/2), in closed
    form."""
    c00, c11 = (f[:, :, 0] ** 2).sum(axis=1), (f[:, :, 1] ** 2).sum(axis=1)
    c01 = (f[:, :, 0] * f[:, :, 1]).sum(axis=1)
    # Root of a 2 x 2 matrix C: (C + s I) / t with s^2 = det C, t^2 = tr C + 2 s; s is bounded for flat triangles.
    s = np.sqrt(np.maximum(c00 * c11 - c01 * c01, COLLAPSED * (c00 + c11) ** 2 + 1e-30))
    t = np.sqrt(c00 + c11 + 2.0 * s)
    r00, r11, r01 = (c00 + s) / t, (c11 + s) / t, c01 / t
    determinant = r00 * r11 - r01 * r01
    first = (f[:, :, 0] * r11[:, None] - f[:, :, 1] * r01[:, None]) / determinant[:, None]
    second = (f[:, :, 1] * r00[:, None] - f[:, :, 0] * r01[:, None]) / determinant[:, None]
    return np.stack([first, second], axis=2)
