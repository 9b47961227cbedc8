"""Newton's method for one drape over one posed body, with conjugate gradients, charts and line search.

The energy is that of ``drape.cloth.energies`` with the planes of the nearest body vertices. So it jumps where a vertex
comes nearer to another body vertex: space falls into cells, and the energy is smooth within each. ``descend`` lets
vertices cross, which finds low energies but never rests: some vertex always meets a step up. ``settle`` keeps a vertex
in its cell where the next one costs more, by a fence just before the border, and there finds rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.spatial import KDTree

from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.solver import descent, hessian, linear
from drape.solver.linear import Charts
from drape.solver.problem import Options, Problem, Surroundings, problem, surroundings

REACH_M = 0.01  # the most that one step moves a vertex
SWEEPS = 4  # of vertex block descent before the first step: they take the worst of the start away
DAMPING = 1e-3, 1e-4  # of the diagonal blocks, on top of the Hessian, while descending and while settling
ITERATIONS = 100  # of conjugate gradients per step, at most
ROUGH, FINE = 0.3, 0.05  # share of the residual that they leave, while descending and while settling
EXACT_START, EXACT_LEAST = 0.05, 0.02
HALVINGS = 8
COARSE_AGE = 4  # steps that an inverse on the charts serves
FENCE_M = 2e-4  # how far before its cell's border a vertex stands
FENCE_STIFFNESS = 100.0  # in those of the contact
STEP_UP_J = 1e-9  # what counts as a step of the energy
STALLS = 8  # steps without a lower energy, one after the other, before settling gives up


class Cloth(NamedTuple):
    """What does not change between poses: the flat problem, its pattern, its stiffest step, charts in float32."""

    problem: Problem
    pattern: hessian.Pattern
    charts: Charts

    @classmethod
    def of(cls, cloth: ClothMesh, material: Material, charts: Charts | None) -> Cloth:
        made = problem(cloth, material, dtype=np.float64, options=Options(reach_m=REACH_M))
        charts = charts or linear.no_charts(cloth.vertex_count, np.float32)
        patch, weight = charts
        single = Charts(np.ascontiguousarray(patch, dtype=np.int32), np.ascontiguousarray(weight, dtype=np.float32))
        return cls(made, hessian.pattern(cloth), single)

    @property
    def weight_n(self) -> float:
        """The cloth's weight [N]."""
        return float(self.problem.weight_n.sum())


class Band(NamedTuple):
    """What holds a waist over one body: the ``anchor`` (V, 3) [m] of every vertex and its spring (V,) [N/m] or zero."""

    anchor: np.ndarray
    n_per_m: np.ndarray


class Nearest:
    """Nearest body vertices of moving points, asked for again only where a point has moved enough for another one."""

    def __init__(self, contact: BodyContact, posed: np.ndarray, point_count: int) -> None:
        self.posed, self.normals = posed, np.asarray(contact.normals(posed))
        self._chosen = np.arange(len(posed)) if contact.vertices is None else contact.vertices
        self._tree = KDTree(posed[self._chosen], balanced_tree=False, compact_nodes=False)
        self._asked = np.zeros((point_count, 3))
        self._margin = np.full(point_count, -1.0)  # how much nearer the first is than the second
        self._index = np.zeros(point_count, dtype=np.int64)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Index (V,) of the body vertex nearest to each of ``x`` (V, 3)."""
        stale = np.flatnonzero(2.0 * np.linalg.norm(x - self._asked, axis=1) >= self._margin)
        if len(stale):
            distance, found = (np.asarray(part) for part in self._tree.query(x[stale], k=2))
            self._asked[stale], self._margin[stale] = x[stale], distance[:, 1] - distance[:, 0]
            self._index[stale] = self._chosen[found[:, 0]]
        return self._index.copy()


@dataclass(eq=False)
class Place:
    """Where a drape is: ``x`` (V, 3), in the cells ``cell`` (V,), behind fences (V, 3) where ``fence_n_per_m`` > 0."""

    x: np.ndarray
    cell: np.ndarray
    fence: np.ndarray
    fence_normal: np.ndarray
    fence_n_per_m: np.ndarray

    def copy(self) -> Place:
        return Place(*(array.copy() for array in vars(self).values()))


class Found(NamedTuple):
    """An end: ``x`` (V, 3), ``energy`` [J] over the nearest planes, ``force`` [N] (V, 3) left, at rest or not."""

    x: np.ndarray
    energy: float
    force: np.ndarray
    at_rest: bool
    steps: int


class Descent:
    """One drape on its way down. ``best`` is what it has met of least energy."""

    def __init__(
        self, cloth: Cloth, contact: BodyContact, posed: np.ndarray, start: np.ndarray, *, band: Band | None = None
    ) -> None:
        self.cloth, self.problem, self.band = cloth, cloth.problem, band
        self.nearest = Nearest(contact, posed, len(start))
        self.steps = 0
        self.exact = 0.0  # how much of the Hessian's indefinite part is in it
        self._blocks = np.empty((len(cloth.pattern.column), 3, 3))
        self._diagonal = np.empty((len(start), 3, 3))
        self._coarse, self._coarse_age = np.zeros((0, 0), np.float32), COARSE_AGE
        energy, force = self.evaluate(start, self.around(self.nearest(start)))
        self.start_j = energy
        self.best = Found(start, energy, force, False, 0)

    def around(self, cell: np.ndarray) -> Surroundings:
        """The planes of the body vertices ``cell`` (V,)."""
        planes = surroundings(self.problem, self.nearest.posed[cell], self.nearest.normals[cell])
        return planes if self.band is None else planes._replace(band=self.band.anchor, band_n_per_m=self.band.n_per_m)

    def evaluate(self, x: np.ndarray, around: Surroundings) -> tuple[float, np.ndarray]:
        """Energy [J] and its gradient [N] (V, 3)."""
        gradient = np.empty_like(x)
        return descent.energy_and_gradient(x, self.problem, around, gradient), gradient

    def descend(self, step_limit: int, tolerance_n: float) -> None:
        """Steps within the planes that are nearest at their beginning; the energy may rise where planes change."""
        x = self.best.x.copy()
        for _ in range(SWEEPS):
            descent.sweep(x, self.problem, self.around(self.nearest(x)), True)
        for _ in range(step_limit):
            around = self.around(self.nearest(x))
            energy, gradient = self.evaluate(x, around)
            self._keep(x, energy, gradient)
            if np.linalg.norm(gradient) <= tolerance_n:
                return
            step, count = self._direction(x, around, gradient, (ROUGH, DAMPING[0]))
            slope, share = float((gradient * step).sum()), 1.0
            for _ in range(HALVINGS):
                if self.evaluate(x + share * step, around)[0] < energy + 1e-4 * share * slope:
                    x = x + share * step
                    break
                share *= 0.5
            else:
                share = 0.0
            self._adapt(share, count)
        energy, gradient = self.evaluate(x, self.around(self.nearest(x)))
        self._keep(x, energy, gradient)

    def settle(self, step_limit: int, tolerance_n: float) -> Found:
        """From ``best`` to rest: until the norm of the force left is at most ``tolerance_n``, or ``step_limit``."""
        place = self.place(self.best.x)
        stalls = 0
        for _ in range(step_limit):
            for sweeps in range(2):
                if sweeps:
                    place = self._swept(place)
                around = self._fenced(place)
                energy, gradient = self.evaluate(place.x, around)
                true, _ = self.evaluate(place.x, self.around(self.nearest(place.x)))
                self._keep(place.x, true, gradient)
                if np.linalg.norm(gradient) <= tolerance_n and true <= self.start_j:
                    return Found(place.x, true, gradient, True, self.steps)
            step, iterations = self._direction(place.x, around, gradient, (FINE, DAMPING[1]))
            share, there = 1.0, place
            for _ in range(HALVINGS):
                there = self.arrive(place, place.x + share * step)
                if self.evaluate(there.x, self._fenced(there))[0] < energy:
                    break
                share *= 0.5
            else:
                share = 0.0
            self._adapt(share, iterations)
            stalls = 0 if share else stalls + 1
            if stalls == STALLS:
                break
            if share:
                place = there
                continue
            self.exact = 0.0
            place = self._with_new_fences(place, place.x + 0.1 * step)
            for _ in range(SWEEPS):
                place = self._swept(place)
        return self.best._replace(steps=self.steps)

    def _keep(self, x: np.ndarray, energy: float, gradient: np.ndarray) -> None:
        if energy < self.best.energy:
            self.best = Found(x.copy(), energy, gradient, False, self.steps)

    def _adapt(self, share: float, iterations: int) -> None:
        self.steps += 1
        if share == 1.0 and iterations > 0:
            self.exact = min(1.0, max(2.0 * self.exact, EXACT_START))
        elif share < 0.2:
            self.exact *= 0.5

    def _direction(
        self, x: np.ndarray, around: Surroundings, gradient: np.ndarray, how: tuple[float, float]
    ) -> tuple[np.ndarray, int]:
        """A step [m] (V, 3) along which the energy falls, and the iterations that it took, negative if cut off."""
        problem, pattern, (left, damping) = self.problem, self.cloth.pattern, how
        descent.diagonal_blocks(x, problem, around, self._diagonal)
        inverse = np.linalg.inv((1.0 + damping) * self._diagonal).astype(np.float32)
        moved, force = np.empty(x.shape, np.float32), (-gradient).astype(np.float32)
        while True:
            hessian.assemble(x, problem, around, pattern, self.exact, self._blocks)
            self._blocks[pattern.diagonal] += damping * self._diagonal
            single = self._blocks.astype(np.float32)
            self._renew_coarse(single)
            system = linear.System(pattern, single, inverse, self.cloth.charts, self._coarse)
            count = linear.conjugate_gradients(system, force, np.float32(left), ITERATIONS, moved)
            # A direction that curves down leads far away: less of what is indefinite, unless it came late.
            if count > 0 or count < -8 or self.exact == 0.0:
                break
            self.exact = 0.5 * self.exact if self.exact > EXACT_LEAST else 0.0
        step = moved.astype(np.float64)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(1.0, REACH_M / np.maximum(length, 1e-12))
        return step, count

    def _renew_coarse(self, blocks: np.ndarray) -> None:
        """Takes the inverse on the charts anew when it is old; where it is not positive, none."""
        self._coarse_age += 1
        if self.cloth.charts.patch.size == 0 or self._coarse_age < COARSE_AGE:
            return
        self._coarse_age = 0
        size = 3 * (int(self.cloth.charts.patch.max()) + 1)
        matrix = np.empty((size, size), np.float32)
        linear.galerkin(self.cloth.charts, self.cloth.pattern, blocks, matrix)
        factorise, invert = scipy.linalg.get_lapack_funcs(("potrf", "potri"), (matrix,))
        factor, failed = factorise(matrix, lower=1)
        if failed:
            self._coarse = np.zeros((0, 0), np.float32)
            return
        lower = np.tril(invert(factor, lower=1)[0])
        self._coarse = np.ascontiguousarray(lower + np.tril(lower, -1).T)

    # --- fences ------------------------------------------------------------------------------------------------------

    def place(self, x: np.ndarray) -> Place:
        """``x`` (V, 3) in its cells, without fences."""
        nowhere = np.zeros(x.shape)
        return Place(x.copy(), self.nearest(x), nowhere, nowhere.copy(), np.zeros(len(x)))

    def _fenced(self, place: Place) -> Surroundings:
        return self.around(place.cell)._replace(
            fence=place.fence, fence_normal=place.fence_normal, fence_n_per_m=place.fence_n_per_m
        )

    def _contact_j(self, x: np.ndarray, cell: np.ndarray) -> np.ndarray:
        distance = ((x - self.nearest.posed[cell]) * self.nearest.normals[cell]).sum(axis=1)
        depth = np.maximum(self.problem.constants.gap - distance, 0.0)
        return 0.5 * self.problem.contact_n_per_m * depth * depth

    def _swept(self, place: Place) -> Place:
        x = place.x.copy()
        descent.sweep(x, self.problem, self._fenced(place), True)
        return self.arrive(place, x)

    def arrive(self, before: Place, x: np.ndarray) -> Place:
        """``before`` moved to ``x`` (V, 3): what would step up in energy stops at the border of its cell.

        Where the fence there does not keep a vertex in its cell, in a corner between several, it stays where it was.
        """
        place = before.copy()
        place.x = x.copy()
        for attempt in range(3):
            cell = self.nearest(place.x)
            up = self._steps_up(place, place.x, cell)
            down = (cell != place.cell) & ~up
            place.cell[down], place.fence_n_per_m[down] = cell[down], 0.0
            stopped = np.flatnonzero(up)
            if len(stopped) == 0:
                break
            if attempt == 0:
                self._fence(place, stopped, cell, before.x)
                past = ((place.x[stopped] - place.fence[stopped]) * place.fence_normal[stopped]).sum(axis=1)
                place.x[stopped] -= np.minimum(past, 0.0)[:, None] * place.fence_normal[stopped]
            else:
                place.x[stopped] = before.x[stopped]
        place.cell = self.nearest(place.x)
        return place

    def _steps_up(self, place: Place, x: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Which vertices (V,) at ``x`` are in another cell than theirs, ``cell``, and have more energy for it."""
        more = self._contact_j(x, cell) > self._contact_j(x, place.cell) + STEP_UP_J
        return (cell != place.cell) & more

    def _with_new_fences(self, place: Place, x: np.ndarray) -> Place:
        """``place`` as it is, with the fences that a step to ``x`` meets."""
        cell = self.nearest(x)
        fenced = place.copy()
        new = self._steps_up(place, x, cell) & (place.fence_n_per_m == 0.0)
        self._fence(fenced, np.flatnonzero(new), cell, place.x)
        return fenced

    def _fence(self, place: Place, which: np.ndarray, cell: np.ndarray, x: np.ndarray) -> None:
        """Fences of the vertices ``which`` before the border to ``cell`` (V,), none of them beyond where ``x`` is."""
        own, other = self.nearest.posed[place.cell[which]], self.nearest.posed[cell[which]]
        normal = own - other
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        middle = 0.5 * (own + other)
        room = ((x[which] - middle) * normal).sum(axis=1)
        place.fence[which] = middle + np.clip(room, 0.0, FENCE_M)[:, None] * normal
        place.fence_normal[which] = normal
        place.fence_n_per_m[which] = FENCE_STIFFNESS * self.problem.contact_n_per_m[which]


def minimum(
    cloth: Cloth,
    contact: BodyContact,
    posed: np.ndarray,
    starts: list[np.ndarray],
    *,
    step_limits: tuple[int, int],
    tolerance: float,
    band: Band | None = None,
) -> Found:
    """The lowest drape over ``posed`` (Vb, 3) from ``starts`` (each V, 3), and never above the lowest of them.

    Every start takes the first of ``step_limits`` at most; the lowest of them goes on to rest, where the force left is
    at most ``tolerance`` of the weight, or until it has taken the second.
    """
    rough, most = step_limits
    limit_n = tolerance * cloth.weight_n
    descents = [Descent(cloth, contact, posed, start, band=band) for start in starts]
    for one in descents:
        if np.isfinite(one.start_j):
            one.descend(min(rough, most), limit_n)
    lowest = min(descents, key=lambda one: one.best.energy if np.isfinite(one.start_j) else np.inf)
    if not np.isfinite(lowest.start_j):
        return lowest.best
    lowest.start_j = min(one.start_j for one in descents if np.isfinite(one.start_j))
    return lowest.settle(most - lowest.steps, limit_n)
