"""The physics optimum of cloth that may not pass through itself: the judge of folds that keep cloth apart.

The energy and the method are those of ``benchmarks.judge.newton``. Beside them every vertex and triangle, and every
two edges, that share no corner push each other off from ``REACH_M`` on, by the barrier of incremental potential contact
(Li et al. 2020, "Incremental Potential Contact", ACM TOG 39(4))

    b(d) = -k (d - r)^2 ln(d / r).

No step moves a vertex by more than a part of the distance to what is nearest to it, so that nothing passes through
anything (Wu, Parker and Kim 2020, "A Safe and Fast Repulsion Method for GPU-based Cloth Self Collisions", ACM TOG
40(1)): what is apart in the start ends apart. What crosses in the start is found crossing in the end.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

from benchmarks.judge import descent, hessian, linear, newton, physics, physics_cache
from drape.cloth import metrics
from drape.cloth.contact import BodyContact
from drape.cloth.waistband import band_energy
from drape.geometry import meshes
from drape.kernels.elements import add, at, dot, sub
from drape.kernels.grid import cells_within, column, grid_of

REACH_M = 0.002  # distance at which cloth feels cloth: about two layers of it
NEAR_M = 0.009  # distance up to which pairs are looked at
STEP_M = 0.5 * (NEAR_M - REACH_M)  # the most that a vertex moves: what is not looked at stays out of reach
SHARE = 0.45  # of the distance to what is nearest: two that come towards each other do not meet
STEPS = 120  # at most; they end a few hundredths of a joule above where they lead
STIFFNESS = 1.0 / 6.0  # of the body's contact at a mean vertex: k, per pair; b'' at half of the reach is 6.4 k


class Pairs(NamedTuple):
    """``corner`` (N, 4): a vertex and a triangle, the first ``triangles`` rows, then two edges; both by vertex."""

    corner: np.ndarray
    triangles: int


# --- distances --------------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _clamped(a):
    return min(max(a, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _weights_in_triangle(p, a, b, c):
    """Barycentric coordinates of the point of the triangle a, b, c that is nearest to p (Ericson 2005, 5.1.5)."""
    ab, ac, ap = sub(b, a), sub(c, a), sub(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    bp = sub(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    cp = sub(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / (d4 - d3 + d5 - d6)
        return 0.0, 1.0 - t, t
    total = va + vb + vc
    return va / total, vb / total, vc / total


@njit(cache=True, error_model="numpy")
def _shares_of_edges(p, q, r, s):
    """How far along the edges pq and rs the two points are that are nearest to each other (Ericson 2005, 5.1.9)."""
    first, second, between = sub(q, p), sub(s, r), sub(p, r)
    a, e, f = dot(first, first), dot(second, second), dot(second, between)
    b, c = dot(first, second), dot(first, between)
    denominator = a * e - b * b
    t = _clamped((b * f - c * e) / denominator) if denominator > 1e-9 * a * e else 0.0
    u = (b * t + f) / e
    if u < 0.0:
        return _clamped(-c / a), 0.0
    if u > 1.0:
        return _clamped((b - c) / a), 1.0
    return t, u


@njit(cache=True, error_model="numpy")
def _apart(x, corner, by_triangle):
    """The weights of the four corners in the vector between the nearest points of a pair, and that vector."""
    a, b, c, d = at(x, corner[0]), at(x, corner[1]), at(x, corner[2]), at(x, corner[3])
    if by_triangle:
        u, v, w = _weights_in_triangle(a, b, c, d)
        weight = (1.0, -u, -v, -w)
    else:
        t, u = _shares_of_edges(a, b, c, d)
        weight = (1.0 - t, t, u - 1.0, -u)
    way = (
        weight[0] * a[0] + weight[1] * b[0] + weight[2] * c[0] + weight[3] * d[0],
        weight[0] * a[1] + weight[1] * b[1] + weight[2] * c[1] + weight[3] * d[1],
        weight[0] * a[2] + weight[1] * b[2] + weight[2] * c[2] + weight[3] * d[2],
    )
    return weight, way


# --- what is near -----------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
def _near_pairs(x, first, second, near):
    """Pairs (N, 4) of a row of ``first`` and one of ``second``, vertices of points, edges or triangles, that share no
    corner and whose balls are nearer than ``near`` [m]; edges with edges once."""
    middle, size = np.zeros((len(second), 3)), np.zeros(len(second))
    largest = 0.0
    for f in range(len(second)):
        for n in range(second.shape[1]):
            for i in range(3):
                middle[f, i] += x[second[f, n], i] / second.shape[1]
        for n in range(second.shape[1]):
            way = sub(at(x, second[f, n]), at(middle, f))
            size[f] = max(size[f], np.sqrt(dot(way, way)))
        largest = max(largest, size[f])
    same = first.shape[1] == second.shape[1]
    cell = near + (2.0 if same else 1.0) * largest
    grid, around = grid_of(middle, 1.0 / cell), (cell, cell, cell)
    found, filled = np.empty((16 * len(first), 4), np.int32), 0
    for e in range(len(first)):
        own, own_size = at(x, first[e, 0]), 0.0
        if same:
            own, own_size = at(middle, e), size[e]
        low, high = cells_within(grid, sub(own, around), add(own, around))
        for i in range(low[0], high[0]):
            for j in range(low[1], high[1]):
                begin, end = column(grid, i, j, low, high)
                for entry in range(begin, end):
                    f = grid.member[entry]
                    if same and f <= e:
                        continue
                    way = sub(own, at(middle, f))
                    most = near + own_size + size[f]
                    if dot(way, way) > most * most:
                        continue
                    shared = False
                    for n in range(first.shape[1]):
                        for m in range(second.shape[1]):
                            shared |= first[e, n] == second[f, m]
                    if shared:
                        continue
                    if filled == len(found):
                        longer = np.empty((2 * len(found), 4), np.int32)
                        longer[:filled] = found
                        found = longer
                    for n in range(first.shape[1]):
                        found[filled, n] = first[e, n]
                    for m in range(second.shape[1]):
                        found[filled, first.shape[1] + m] = second[f, m]
                    filled += 1
    return found[:filled]


@njit(cache=True, error_model="numpy")
def distances(x, corner, triangles):
    """The distance [m] (N,) of each pair."""
    found = np.empty(len(corner))
    for n in range(len(corner)):
        _, way = _apart(x, corner[n], n < triangles)
        found[n] = np.sqrt(dot(way, way))
    return found


def pairs_near(x: np.ndarray, faces: np.ndarray, edges: np.ndarray, near_m: float = NEAR_M) -> tuple[Pairs, np.ndarray]:
    """The pairs of ``x`` [m] (V, 3) within ``near_m`` that share no corner, and their distances [m] (N,)."""
    faces, edges = np.ascontiguousarray(faces, np.int32), np.ascontiguousarray(edges, np.int32)
    points = np.arange(len(x), dtype=np.int32)[:, None]
    by_triangle, by_edge = _near_pairs(x, points, faces, near_m), _near_pairs(x, edges, edges, near_m)
    corner, count = np.concatenate([by_triangle, by_edge]), len(by_triangle)
    far = distances(x, corner, count)
    near = far < near_m
    return Pairs(corner[near], int(near[:count].sum())), far[near]


# --- the barrier ------------------------------------------------------------------------------------------------------


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def push_apart(x, corner, triangles, k, gradient):
    """The barrier's energy [J]; its gradient [N] is added to ``gradient`` (V, 3)."""
    total = 0.0
    for n in range(len(corner)):
        weight, way = _apart(x, corner[n], n < triangles)
        d = np.sqrt(dot(way, way))
        if d < REACH_M:
            energy, slope, _ = _barrier(max(d, 1e-9), k)
            total += energy
            for c in range(4):
                for i in range(3):
                    gradient[corner[n, c], i] += slope * weight[c] * way[i] / max(d, 1e-9)
    return total


@njit(cache=True, error_model="numpy")
def _add_curvature(x, corner, triangles, k, place, blocks):
    """Adds what of the barrier's Hessian is surely positive to ``blocks``: those of pair n at ``place`` (n, 4, 4)."""
    for n in range(len(corner)):
        weight, way = _apart(x, corner[n], n < triangles)
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
        cloth: newton.Cloth,
        contact: BodyContact,
        posed: np.ndarray,
        start: np.ndarray,
        *,
        band: newton.Band | None = None,
    ) -> None:
        self._faces = cloth.problem.triangles.corner
        self._edges = meshes.unique_edges(self._faces.astype(np.int64))
        self._stiffness = STIFFNESS * float(cloth.problem.contact_n_per_m.mean())
        self._plain = cloth.pattern
        self._keys = np.repeat(np.arange(len(start)), np.diff(self._plain.start)) * len(start) + self._plain.column
        self._look(start)
        super().__init__(cloth, contact, posed, start, band=band)

    def _look(self, x: np.ndarray) -> None:
        """Looks up what is near to ``x``, and how far each vertex may go from there."""
        self._pairs, far = pairs_near(x, self._faces, self._edges)
        least = np.full(len(x), np.inf)
        np.minimum.at(least, self._pairs.corner, far[:, None])
        self._free = np.minimum(SHARE * least, STEP_M)
        self._pushed = np.flatnonzero(far < REACH_M)
        self._held = np.unique(self._pairs.corner[self._pushed])

    def found(self, x: np.ndarray) -> newton.Found:
        there = super().found(x)
        return there._replace(energy=there.energy + push_apart(x, *self._pairs, self._stiffness, there.force))

    def _take(self, there: newton.Found) -> None:
        self._look(there.x)
        super()._take(there)

    def _sweep(self, order: np.ndarray, times: int = 1) -> None:
        order = order[~np.isin(order, self._held)].astype(np.int32)
        origin, around = self.now.x, self.around(self.now.x)[0]
        x = origin.copy()
        for _ in range(times):
            descent.sweep(x, self.problem._replace(order=order), around, True)
            x = origin + self._within(x - origin)
        there = self.found(x)
        if there.energy < self.now.energy:
            self._take(there)

    def _lay_out(self) -> bool:
        return False  # a triangle laid out anew may pass through others

    def _within(self, step: np.ndarray) -> np.ndarray:
        length = np.linalg.norm(step, axis=1)
        return step * np.minimum(1.0, self._free / np.maximum(length, 1e-12))[:, None]

    def _joined(self) -> tuple[hessian.Pattern, np.ndarray, int]:
        """The pattern with the pairs that push, their blocks (n, 4, 4) in it, and how many of these pairs are
        triangles."""
        count, corner = len(self._free), self._pairs.corner[self._pushed].astype(np.int64)
        wanted = corner[:, :, None] * count + corner[:, None, :]
        keys = np.union1d(self._keys, wanted)
        moved = np.searchsorted(keys, self._keys).astype(np.int32)
        start = np.searchsorted(keys, np.arange(count + 1) * count).astype(np.int32)
        plain = self._plain
        joined = hessian.Pattern(
            start, (keys % count).astype(np.int32), moved[plain.diagonal], moved[plain.face], moved[plain.hinge]
        )
        return joined, np.searchsorted(keys, wanted), int((self._pushed < self._pairs.triangles).sum())

    def _direction(self) -> tuple[np.ndarray, int]:
        """As without other cloth, with the barrier's curvature, and no farther than is free."""
        x, problem = self.now.x, self.problem
        pattern, place, triangles = self._joined()
        around, bend = self.around(x)
        depth = np.maximum(problem.constants.gap - ((x - around.point) * around.normal).sum(axis=1), 0.0)
        bend = (problem.contact_n_per_m * depth)[:, None, None] * bend
        between = np.zeros((len(pattern.column), 3, 3))
        corner = self._pairs.corner[self._pushed]
        _add_curvature(x, corner, triangles, self._stiffness, place, between)
        descent.diagonal_blocks(x, problem, around, self._diagonal)
        inverse = np.linalg.inv(self._diagonal + between[pattern.diagonal]).astype(np.float32)
        moved, force = np.empty(x.shape, np.float32), (-self.now.force).astype(np.float32)
        blocks = np.empty_like(between)
        self.cloth = self.cloth._replace(pattern=pattern)  # the coarse matrix is of all blocks
        while True:
            exact, left = (self.exact, newton.ROUGH) if self.shift is None else (1.0, newton.FINE)
            hessian.assemble(x, problem, around, pattern, exact, blocks)
            blocks += between
            blocks[pattern.diagonal] += newton.DAMPING * self._diagonal - exact * bend
            if self.shift is not None:
                blocks[pattern.diagonal] += self.shift * self._per_shift
            single = blocks.astype(np.float32)
            self._renew_coarse(single)
            system = linear.System(pattern, single, inverse, self.cloth.charts, self._coarse)
            count = linear.conjugate_gradients(system, force, np.float32(left), newton.ITERATIONS, moved)
            if self.shift is not None:
                if count > 0 or count < -newton.LATE or self.shift > 1e8:
                    break
                self.shift *= 4.0
            elif count > 0 or count < -8 or self.exact == 0.0:
                break
            else:
                self.exact = 0.5 * self.exact if self.exact > newton.EXACT_LEAST else 0.0
        return self._within(moved.astype(np.float64)), count


def stored_minimum(task: physics.Task, folder: Path | None) -> tuple[physics.Optimum, bool]:
    """What ``minimise`` finds of ``task``, and whether it was in ``folder``: see ``physics_cache.cached``."""
    plain = physics_cache.cache_key(task, STEPS, physics.TOLERANCE)
    key = physics_cache.key_of([plain], (), (sys.modules[__name__],))
    return physics_cache.cached(key, lambda: minimise(task, step_limit=STEPS), folder)


def minimise(task: physics.Task, *, step_limit: int = STEPS, tolerance: float = physics.TOLERANCE) -> physics.Optimum:
    """The drape of least energy that is reached from the first start of ``task`` without passing through itself.

    Energies are of cloth and body, without the barrier. ``converged`` and ``residual_n`` count the barrier's force.
    """
    began = time.perf_counter()
    cloth = newton.Cloth.of(task.cloth, task.material, task.charts)
    ends, processor_s = [], []
    start = np.asarray(task.starts[0], dtype=np.float64)
    for frame, posed in enumerate(task.body_vertices):
        before_s = time.process_time()
        band = task.held.over(frame, task.cloth.vertex_count) if task.held else None
        one = Descent(cloth, task.contact, posed, np.ascontiguousarray(start[frame]), band=band)
        ends.append(one.run(step_limit, tolerance * cloth.weight_n))
        processor_s.append(time.process_time() - before_s)
    vertices, height_m = np.stack([end.x for end in ends]), metrics.mean_height(start, task.cloth)

    def energy(x: np.ndarray, parts_of: Callable[..., dict[str, np.ndarray]] = physics.energy_parts) -> np.ndarray:
        parts = parts_of(x, task.cloth, task.material, task.contact, task.body_vertices, height_m=height_m)
        total = np.stack([*parts.values()]).sum(axis=0)
        if task.held is None:
            return total
        return total + band_energy(x[:, task.held.vertex] - task.held.anchor, task.held.length_m)

    return physics.Optimum(
        vertices=vertices,
        start_j=energy(start),
        energy_j=energy(vertices),
        nearest_j=energy(vertices, metrics.static_parts),
        residual_n=np.array([np.linalg.norm(end.force) for end in ends]),
        converged=np.array([end.at_rest for end in ends]),
        steps=np.array([end.steps for end in ends]),
        processor_s=np.array(processor_s),
        seconds=time.perf_counter() - began,
    )
