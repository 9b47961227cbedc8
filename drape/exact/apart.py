"""Descent of cloth that may not pass through itself.

Energy and method are those of ``drape.exact.newton``. In addition a vertex and a triangle, or two edges, that share no
corner and are nearer than ``REACH_M`` push each other off by the barrier of incremental potential contact (Li et al.
2020, "Incremental Potential Contact", ACM TOG 39(4)); its formula and those of steps are in
``drape/engine/source/apart.hpp``.

No step lets anything pass through anything. Where cloth is in its own way, a step yields: the least change of it, to
first order, with which no pair comes nearer than a share of its distance, so that layers that lie on each other move
together (Harmon et al. 2008, "Robust treatment of simultaneous collisions", ACM TOG 27(3), does so with velocities).
What is left over is shortened as a whole (additive continuous detection: Li, Kaufman and Jiang 2021, "Codimensional
Incremental Potential Contact", ACM TOG 40(4)). A step that is shortened alone is stopped by a few pairs of ten
thousand. Cloth that is apart in the start ends apart; cloth that crosses in the start still crosses in the end.
"""

from __future__ import annotations

import numpy as np

from drape.cloth.contact import BodyContact
from drape.engine.calls import call, call_with_scratch
from drape.exact import hessian, newton
from drape.exact.newton import Band, Cloth
from drape.exact.settling import State
from drape.geometry import meshes
from drape.geometry.triangle_pairs import pairs_within

REACH_M = 0.002  # distance at which cloth feels cloth: about two layers of it
NEAR_M = 0.009  # distance up to which pairs are looked at
STEP_M = 0.5 * (NEAR_M - REACH_M)  # the most that a vertex moves: other pairs stay out of reach
SHARE = 0.45  # of the distance to the nearest pair that a sweep may go: two that approach each other do not meet
# A step of which less than the share ENOUGH is free yields (``yield_to``), and slows down where that is too little,
# BENDS times at most. PRESSED_M and CARRIED_M are the distances that it wants, under forces and without: cloth that is
# carried has no energy that would keep it away from other cloth.
ENOUGH, BENDS = 0.5, 3
PRESSED_M, CARRIED_M = (1e-4, 0.0), (5e-4, 1e-4)
# The barrier's stiffness k of a pair, as a share of the body's contact at a mean vertex; at half of the reach its
# second derivative is 6.4 k.
STIFFNESS = 1.0 / 6.0


def push_apart(x: np.ndarray, corner: np.ndarray, triangles: int, n_per_m: float, gradient: np.ndarray) -> float:
    """Returns the barrier's energy [J] for vertices ``x`` [m] (V, 3), and adds its gradient [N] to ``gradient`` (V, 3).

    ``corner`` (N, 4) are the corners of pairs that are near: the first ``triangles`` pairs are of a vertex and a
    triangle, the others of two edges. ``n_per_m`` [N/m] is the barrier's stiffness.
    """
    energy = np.empty(1)
    call("push_apart", np.float64, x, corner, len(corner), triangles, REACH_M, n_per_m, gradient, energy)
    return float(energy[0])


def add_curvature(
    x: np.ndarray, corner: np.ndarray, triangles: int, n_per_m: float, place: np.ndarray, blocks: np.ndarray
) -> None:
    """Adds the positive part of the barrier's Hessian [N/m] to ``blocks`` (M, 3, 3). The part of the corners i and j of
    pair n goes to block ``place[n, i, j]``, ``place`` (N, 4, 4). The other arguments are those of ``push_apart``."""
    call("add_curvature", np.float64, x, corner, len(corner), triangles, REACH_M, n_per_m, place, blocks)


def free_shares(x: np.ndarray, step: np.ndarray, corner: np.ndarray, triangles: int, share: np.ndarray) -> float:
    """Writes to ``share`` (V,) which share of its ``step`` [m] (V, 3) each vertex may go, in [0, 1], and returns the
    least.

    If all vertices go by the least, every pair keeps at least a fifth of its distance on all of the way. Pairs are
    those of ``push_apart``.
    """
    call("free_shares", np.float64, x, len(x), step, corner, len(corner), triangles, share)
    return float(share.min())


def yield_to(x: np.ndarray, step: np.ndarray, corner: np.ndarray, triangles: int, wanted: tuple[float, float]) -> None:
    """Changes ``step`` [m] (V, 3) in place until, to first order, every pair keeps a fifth of its distance. A pair
    nearer than the first of ``wanted`` [m] gains the second in distance.

    The step is projected onto one pair after the other. Pairs are those of ``push_apart``.
    """
    call_with_scratch("yield_to", np.float64, x, step, corner, len(corner), triangles, *wanted)


class ApartDescent(newton.Descent):
    """A descent in which the cloth passes nowhere through itself, if it does not in the start."""

    def __init__(
        self, cloth: Cloth, contact: BodyContact, posed: np.ndarray, start: np.ndarray, **springs: Band | None
    ) -> None:
        self._faces = cloth.problem.triangles.corner
        self._edges = meshes.unique_edges(self._faces.astype(np.int64))
        self._stiffness = STIFFNESS * float(cloth.problem.contact_n_per_m.mean())
        start_of_row, column = cloth.pattern.start, cloth.pattern.column
        self._keys = np.repeat(np.arange(len(start)), np.diff(start_of_row)) * len(start) + column
        self._look(start)
        super().__init__(cloth, contact, posed, start, **springs)

    def _look(self, x: np.ndarray) -> None:
        """Looks up what is near to ``x``, and how far each vertex may go from there."""
        self._pairs, _, ways = pairs_within(x, self._faces, self._edges, NEAR_M)
        far = np.linalg.norm(ways, axis=1)
        pushes = far < REACH_M
        least = np.full(len(x), np.inf)
        np.minimum.at(least, self._pairs.corner[~pushes], far[~pushes, None])
        self.reach_m = np.minimum(SHARE * least, STEP_M)[:, None]
        self._pushed = np.flatnonzero(pushes)
        self._held = np.unique(self._pairs.corner[self._pushed])

    @property
    def _pushing(self) -> tuple[np.ndarray, int]:
        """The pairs that push, and how many of them are of a vertex and a triangle."""
        return self._pairs.corner[self._pushed], int((self._pushed < self._pairs.triangles).sum())

    def evaluate(self, x: np.ndarray) -> State:
        there = super().evaluate(x)
        return there._replace(energy=there.energy + push_apart(x, *self._pairs, self._stiffness, there.gradient))

    def _take(self, there: State) -> None:
        self._look(there.x)
        super()._take(there)

    def go(self, step: np.ndarray) -> None:
        """Moves the cloth by as much of ``step`` [m] (V, 3) as lets nothing pass through anything, even if its energy
        rises."""
        x = self.now.x + self._free(self._yielded(_short(step), CARRIED_M))
        self._look(x)
        self.now = self.best = self.evaluate(x)

    def _yielded(self, step: np.ndarray, wanted: tuple[float, float]) -> np.ndarray:
        bent = step.copy()
        yield_to(self.now.x, bent, *self._pairs, wanted)
        return _short(bent)

    def _free(self, step: np.ndarray) -> np.ndarray:
        """``step`` [m] (V, 3), bent and shortened so that nothing passes through anything."""
        share = np.empty(len(step))
        least = free_shares(self.now.x, step, *self._pairs, share)
        for _ in range(BENDS):
            if least >= ENOUGH:
                break
            step = self._yielded(step, PRESSED_M)
            least = free_shares(self.now.x, step, *self._pairs, share)
            if least < ENOUGH:
                step = share[:, None] * step
                least = free_shares(self.now.x, step, *self._pairs, share)
        return least * step

    def _sweep(self, order: np.ndarray, times: int = 1) -> None:
        super()._sweep(order[~np.isin(order, self._held)].astype(np.int32), times)

    def _swept(self, origin: np.ndarray, x: np.ndarray) -> np.ndarray:
        return origin + super()._limited(x - origin)

    def _limited(self, step: np.ndarray) -> np.ndarray:
        return self._free(_short(step))

    def _lay_out(self) -> bool:
        return False  # a triangle laid out anew may pass through others

    def _other_blocks(self) -> tuple[hessian.Pattern, np.ndarray]:
        """The pattern with the pairs that push, and the barrier's curvature in it."""
        count, (pushing, triangles) = len(self.now.x), self._pushing
        wanted = pushing[:, :, None].astype(np.int64) * count + pushing[:, None, :]
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
        place = np.searchsorted(keys, wanted).astype(np.int32)
        add_curvature(self.now.x, pushing, triangles, self._stiffness, place, blocks)
        return pattern, blocks


def _short(step: np.ndarray) -> np.ndarray:
    """``step`` [m] (V, 3) with no vertex's way longer than ``STEP_M``."""
    return step * np.minimum(1.0, STEP_M / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
