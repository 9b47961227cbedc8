"""Descent of cloth that may not pass through itself.

Energy and method are those of ``drape.exact.newton``. In addition a vertex and a triangle, or two edges, that share no
corner and are nearer than r = ``REACH_M`` push each other off by the barrier of incremental potential contact (Li et
al. 2020, "Incremental Potential Contact", ACM TOG 39(4))

    b(d) = -k (d - r)^2 ln(d / r).

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
from drape.exact import hessian, newton
from drape.exact.newton import Band, Cloth, Found
from drape.geometry import meshes
from drape.kernels.compiled import kernel
from drape.kernels.elements import dot
from drape.kernels.triangle_pairs import pairs_within, way_between

REACH_M = 0.002  # distance at which cloth feels cloth: about two layers of it
NEAR_M = 0.009  # distance up to which pairs are looked at
STEP_M = 0.5 * (NEAR_M - REACH_M)  # the most that a vertex moves: what is not looked at stays out of reach
SHARE = 0.45  # of the distance to what is nearest, in a sweep: two that come towards each other do not meet
# The share of a pair's distance that a step leaves at least; below the floor more of it, or many steps one after the
# other would come to the last digits of a number. Near to what it leaves the search ends.
KEPT, LATE, FLOOR_M, NEARLY = 0.2, 0.9, 1e-4, 1.01
# A step that may go by less than ``ENOUGH`` yields, in so many sweeps over the pairs, and slows down where that is too
# little, ``BENDS`` times at most. Pairs nearer than the first of its distances come no nearer, and open by the second:
# carried cloth has no energy that would keep it away from the floor.
ENOUGH, BENDS, SWEEPS = 0.5, 3, 40
PRESSED_M, CARRIED_M = (1e-4, 0.0), (5e-4, 1e-4)
SLIGHT_M = 1e-7  # a lack that counts as none
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


@kernel
def free_shares(x, step, corner, triangles, share):
    """Writes to ``share`` (V,) how much of ``step`` [m] (V, 3) each vertex may go, at most 1; returns the least.

    If all go by the least, every pair keeps at least ``KEPT`` of its distance on all of the way.
    """
    share[:] = 1.0
    own = np.array([0, 1, 2, 3], corner.dtype)
    place, mean = np.empty((4, 3)), np.empty(3)
    for n in range(len(corner)):
        c = corner[n]
        for i in range(3):
            mean[i] = 0.25 * (step[c[0], i] + step[c[1], i] + step[c[2], i] + step[c[3], i])
        first, second = 1 if n < triangles else 2, 0.0
        pace = most = 0.0  # of either element, the fastest corner against the mean
        for corners in range(4):
            square = 0.0
            for i in range(3):
                square += (step[c[corners], i] - mean[i]) ** 2
            if corners < first:
                most = max(most, square)
            else:
                second = max(second, square)
        pace = np.sqrt(most) + np.sqrt(second)
        if not pace > 0.0:
            continue
        gone = kept = 0.0
        while gone < 1.0:
            for corners in range(4):
                for i in range(3):
                    place[corners, i] = x[c[corners], i] + gone * step[c[corners], i]
            _, way = way_between(place, own, n < triangles)
            d = np.sqrt(dot(way, way))
            if gone == 0.0:
                kept = max(KEPT * d, min(LATE * d, FLOOR_M))
            elif d < NEARLY * kept:
                break
            gone += (d - kept) / pace
        for corners in range(4):
            share[c[corners]] = min(share[c[corners]], gone)
    return share.min()


@kernel
def yield_to(x, step, corner, triangles, wanted):
    """Bends ``step`` [m] (V, 3) until, to first order, every pair keeps ``KEPT`` of its distance, and where it is
    nearer than the first of ``wanted`` [m] gains the second: projections onto one pair after the other."""
    count = len(corner)
    weights, normals, least = np.empty((count, 4)), np.empty((count, 3)), np.empty(count)
    for n in range(count):
        weight, way = way_between(x, corner[n], n < triangles)
        d = max(np.sqrt(dot(way, way)), 1e-12)
        for c in range(4):
            weights[n, c] = weight[c]
        for i in range(3):
            normals[n, i] = way[i] / d
        least[n] = max(KEPT * d, min(wanted[0], d + wanted[1])) - d
    for _ in range(SWEEPS):
        enough = True
        for n in range(count):
            gain = size = 0.0
            for c in range(4):
                size += weights[n, c] * weights[n, c]
                for i in range(3):
                    gain += weights[n, c] * normals[n, i] * step[corner[n, c], i]
            lack = least[n] - gain
            if lack > SLIGHT_M:
                enough = False
                for c in range(4):
                    for i in range(3):
                        step[corner[n, c], i] += lack / size * weights[n, c] * normals[n, i]
        if enough:
            break


class Descent(newton.Descent):
    """A descent that keeps the cloth apart from itself."""

    def __init__(
        self,
        cloth: Cloth,
        contact: BodyContact,
        posed: np.ndarray,
        start: np.ndarray,
        **springs: Band | None,
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

    def found(self, x: np.ndarray) -> Found:
        there = super().found(x)
        return there._replace(energy=there.energy + push_apart(x, *self._pairs, self._stiffness, there.force))

    def _take(self, there: Found) -> None:
        self._look(there.x)
        super()._take(there)

    def go(self, step: np.ndarray) -> None:
        """Moves by as much of ``step`` [m] (V, 3) as lets nothing pass through anything, whatever its energy."""
        x = self.now.x + self._free(self._yielded(_short(step), CARRIED_M))
        self._look(x)
        self.now = self.best = self.found(x)

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
        corner = pushing.astype(np.int64)
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
        _add_curvature(self.now.x, corner, triangles, self._stiffness, np.searchsorted(keys, wanted), blocks)
        return pattern, blocks


def _short(step: np.ndarray) -> np.ndarray:
    """``step`` [m] (V, 3) with no vertex's way longer than ``STEP_M``."""
    return step * np.minimum(1.0, STEP_M / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
