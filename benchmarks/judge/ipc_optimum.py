"""The physics optimum of cloth that may not pass through itself: it judges folds that keep cloth apart.

The energy and the method are those of ``benchmarks.judge.newton``. In addition a vertex and a triangle, or two edges,
that share no corner and are nearer than r = ``REACH_M`` push each other off by the barrier of incremental potential
contact (Li et al. 2020, "Incremental Potential Contact", ACM TOG 39(4))

    b(d) = -k (d - r)^2 ln(d / r).

No step moves a vertex by more than a share of its distance to the nearest element, so that nothing passes through
anything (Wu, Parker and Kim 2020, "A Safe and Fast Repulsion Method for GPU-based Cloth Self Collisions", ACM TOG
40(1)). Cloth that is apart in the start ends apart; cloth that crosses in the start still crosses in the end.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks.judge import hessian, newton, physics, physics_cache
from benchmarks.judge.newton import Band, Cloth, Found
from drape.cloth.contact import BodyContact
from drape.geometry import meshes
from drape.kernels import triangle_pairs
from drape.kernels.compiled import kernel
from drape.kernels.elements import dot
from drape.kernels.triangle_pairs import pairs_within, way_between

REACH_M = 0.002  # distance at which cloth feels cloth: about two layers of it
NEAR_M = 0.009  # distance up to which pairs are looked at
STEP_M = 0.5 * (NEAR_M - REACH_M)  # the most that a vertex moves: what is not looked at stays out of reach
SHARE = 0.45  # of the distance to what is nearest: two that come towards each other do not meet
STEPS = 120  # at most; they end a few hundredths of a joule above where they lead
STIFFNESS = 1.0 / 6.0  # of the body's contact at a mean vertex: k, per pair; b'' at half of the reach is 6.4 k


# --- the barrier ------------------------------------------------------------------------------------------------------


@kernel
def _barrier(d, k):
    """Energy [J], its first [N] and second [N/m] derivative at the distance d."""
    if d >= REACH_M:
        return 0.0, 0.0, 0.0
    off, log = d - REACH_M, np.log(d / REACH_M)
    return (
        -k * off * off * log,
        -k * (2.0 * off * log + off * off / d),
        -k * (2.0 * log + 4.0 * off / d - off * off / (d * d)),
    )


@kernel
def push_apart(x, corner, triangles, k, gradient):
    """The barrier's energy [J]; its gradient [N] is added to ``gradient`` (V, 3)."""
    total = 0.0
    for n in range(len(corner)):
        weight, way = way_between(x, corner[n], n < triangles)
        d = np.sqrt(dot(way, way))
        if d < REACH_M:
            energy, slope, _ = _barrier(max(d, 1e-9), k)
            total += energy
            for c in range(4):
                for i in range(3):
                    gradient[corner[n, c], i] += slope * weight[c] * way[i] / max(d, 1e-9)
    return total


@kernel
def _add_curvature(x, corner, triangles, k, place, blocks):
    """Adds the positive part of the barrier's Hessian to ``blocks``; pair n has its own at ``place[n]`` (4, 4)."""
    for n in range(len(corner)):
        weight, way = way_between(x, corner[n], n < triangles)
        d = max(np.sqrt(dot(way, way)), 1e-9)
        curvature = _barrier(d, k)[2]
        for a in range(4):
            for b in range(4):
                factor = curvature * weight[a] * weight[b] / (d * d)
                for i in range(3):
                    for j in range(3):
                        blocks[place[n, a, b], i, j] += factor * way[i] * way[j]


class Descent(newton.Descent):
    """A descent that keeps the cloth apart from itself."""

    def __init__(
        self,
        cloth: Cloth,
        contact: BodyContact,
        posed: np.ndarray,
        start: np.ndarray,
        *,
        band: Band | None = None,
    ) -> None:
        self._faces = cloth.problem.triangles.corner
        self._edges = meshes.unique_edges(self._faces.astype(np.int64))
        self._stiffness = STIFFNESS * float(cloth.problem.contact_n_per_m.mean())
        start_of_row, column = cloth.pattern.start, cloth.pattern.column
        self._keys = np.repeat(np.arange(len(start)), np.diff(start_of_row)) * len(start) + column
        self._look(start)
        super().__init__(cloth, contact, posed, start, band=band)

    def _look(self, x: np.ndarray) -> None:
        """Looks up what is near to ``x``, and how far each vertex may go from there."""
        self._pairs, _, ways = pairs_within(x, self._faces, self._edges, NEAR_M)
        far = np.linalg.norm(ways, axis=1)
        least = np.full(len(x), np.inf)
        np.minimum.at(least, self._pairs.corner, far[:, None])
        self.reach_m = np.minimum(SHARE * least, STEP_M)[:, None]
        self._pushed = np.flatnonzero(far < REACH_M)
        self._held = np.unique(self._pairs.corner[self._pushed])

    def found(self, x: np.ndarray) -> Found:
        there = super().found(x)
        return there._replace(energy=there.energy + push_apart(x, *self._pairs, self._stiffness, there.force))

    def _take(self, there: Found) -> None:
        self._look(there.x)
        super()._take(there)

    def _sweep(self, order: np.ndarray, times: int = 1) -> None:
        super()._sweep(order[~np.isin(order, self._held)].astype(np.int32), times)

    def _swept(self, origin: np.ndarray, x: np.ndarray) -> np.ndarray:
        return origin + self._limited(x - origin)

    def _lay_out(self) -> bool:
        return False  # a triangle laid out anew may pass through others

    def _other_blocks(self) -> tuple[hessian.Pattern, np.ndarray]:
        """The pattern with the pairs that push, and the barrier's curvature in it."""
        count, corner = len(self.now.x), self._pairs.corner[self._pushed].astype(np.int64)
        wanted = corner[:, :, None] * count + corner[:, None, :]
        keys = np.union1d(self._keys, wanted)
        moved = np.searchsorted(keys, self._keys).astype(np.int32)
        plain = self.cloth.pattern
        pattern = hessian.Pattern(
            np.searchsorted(keys, np.arange(count + 1) * count).astype(np.int32),
            (keys % count).astype(np.int32),
            moved[plain.diagonal],
            moved[plain.face],
            moved[plain.hinge],
        )
        blocks = np.zeros((len(keys), 3, 3))
        triangles = int((self._pushed < self._pairs.triangles).sum())
        _add_curvature(self.now.x, corner, triangles, self._stiffness, np.searchsorted(keys, wanted), blocks)
        return pattern, blocks


def stored_minimum(task: physics.Task, folder: Path | None) -> tuple[physics.Optimum, bool]:
    """The optimum of ``minimise`` for ``task``, and whether it was in ``folder`` (``physics_cache.cached``)."""
    plain = physics_cache.cache_key(task, STEPS, physics.TOLERANCE)
    key = physics_cache.key_of([plain], (), (sys.modules[__name__], triangle_pairs))
    return physics_cache.cached(key, lambda: minimise(task, step_limit=STEPS), folder)


def minimise(task: physics.Task, *, step_limit: int = STEPS, tolerance: float = physics.TOLERANCE) -> physics.Optimum:
    """The drape of least energy that is reached from the first start of ``task`` without passing through itself.

    Energies are of cloth and body, without the barrier. ``converged`` and ``residual_n`` count the barrier's force.
    """

    def descend(cloth: Cloth, posed: np.ndarray, starts: list[np.ndarray], band: Band | None) -> Found:
        one = Descent(cloth, task.contact, posed, starts[0], band=band)
        return one.run(step_limit, tolerance * cloth.weight_n)

    return physics.reached(task, descend)
