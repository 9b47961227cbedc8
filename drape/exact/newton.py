"""Newton's method for one drape over one posed body: conjugate gradients, charts, and a line search on the energy.

Far from rest the cloth first settles under its own stiffness (``drape.exact.settling``).

The energy is that of ``drape.cloth.energies``, over the blended planes of ``drape.exact.blended_planes``: those of
the nearest body vertices step where a vertex comes nearer to another one, and then there is no place of rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.cloth.problem import Problem, problem
from drape.exact import descent, hessian, linear, settling
from drape.exact.blended_planes import BlendedPlanes
from drape.exact.linear import Charts
from drape.exact.settling import State
from drape.exact.surroundings import Around, surroundings

TOLERANCE = 0.01  # share of the weight: at rest the norm of the force left is no larger
REACH_M = 0.01  # the most that one step moves a vertex
SWEEPS = 4  # sweeps before settling and before the first step: they take the largest forces away
WORST, WORST_SWEEPS = 0.05, 4  # after every step this share of the vertices, under the most force, is swept so often
DAMPING = 1e-5  # share of the diagonal blocks that is added to the Hessian
ITERATIONS = 100  # the most iterations of conjugate gradients in a step
ROUGH, FINE = 0.3, 0.1  # share of the residual that they leave: before the Hessian is exact, and when it is shifted
EXACT_START, EXACT_LEAST = 0.05, 0.02  # the share of the exact Hessian: the first one, and the least before none
SHIFTING = 0.05  # share of the weight: below this force the Hessian is exact, with a shift
SHIFT_N_PER_M, SHIFT_LEAST_N_PER_M = 1.0, 1e-3  # the first shift and the least, at a vertex of mean area
LATE = 60  # after so many iterations a direction is worth its step even if it met negative curvature
HALVINGS = 8
COARSE_AGE = 4  # an inverse on the charts serves so many steps
STALLS, STALLED_N_PER_M = 6, 16.0  # after so many steps in a row without gain it ends; the shift after the first
COLLAPSED = 0.05  # share of its area at rest: a smaller triangle is laid out anew where no step lowers the energy
LAYINGS = 6  # times at most
# Rounds of settling: of every start, of the lowest one, and the most for each step where few steps are wanted.
ROUGH_ROUNDS, ROUNDS, ROUNDS_PER_STEP = 40, 400, 10


class Cloth(NamedTuple):
    """The constants of a cloth that all poses share: its energy ``problem``, the ``pattern`` of its Hessian, ``charts``
    with weights in float32, and ``solve``, the function by which it settles (``settling.inverse``)."""

    problem: Problem
    pattern: hessian.Pattern
    charts: Charts
    solve: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def of(cls, cloth: ClothMesh, material: Material, charts: Charts | None) -> Cloth:
        energies = problem(cloth, material, dtype=np.float64, reach_m=REACH_M)
        charts = charts or linear.no_charts(cloth.vertex_count, np.float32)
        patch, weight = charts
        single = Charts(np.ascontiguousarray(patch, dtype=np.int32), np.ascontiguousarray(weight, dtype=np.float32))
        return cls(energies, hessian.pattern(cloth), single, settling.inverse(cloth, material))

    @property
    def weight_n(self) -> float:
        """The weight [N] of the whole cloth."""
        return float(self.problem.weight_n.sum())


class Band(NamedTuple):
    """A spring for each of V vertices: from ``anchor`` [m] (V, 3), of stiffness ``n_per_m`` [N/m] (V,), zero where
    there is none."""

    anchor: np.ndarray
    n_per_m: np.ndarray


class Descent:
    """The descent of one cloth over a ``posed`` body [m] (Vb, 3) from ``start`` [m] (V, 3): ``now`` is its state,
    ``best`` the state of least energy so far.

    A step moves no vertex by more than ``reach_m`` [m], a number or (V, 1). The springs of a waistband ``band`` have
    slack. The springs ``pull`` have none; their energy is part of the state's.
    """

    reach_m: float | np.ndarray = REACH_M

    def __init__(
        self,
        cloth: Cloth,
        contact: BodyContact,
        posed: np.ndarray,
        start: np.ndarray,
        *,
        band: Band | None = None,
        pull: Band | None = None,
    ) -> None:
        self.cloth, self.problem, self.band, self.pull = cloth, cloth.problem, band, pull
        self._planes = BlendedPlanes.of_body(contact, posed, len(start), float(cloth.problem.constants.gap))
        self._met: tuple[np.ndarray, Around, np.ndarray] | None = None  # the last argument and result of ``around``
        self.steps = self._layings = 0
        self.exact = 0.0  # share of the exact Hessian in it, until the force is small
        self.shift: float | None = None  # [N/m], added to the exact Hessian from then on
        triangles = self.problem.triangles
        area = np.bincount(triangles.corner.reshape(-1), np.repeat(triangles.area, 3), len(start))
        self._per_shift = (area / area.mean())[:, None, None] * np.eye(3)
        self._diagonal = np.empty((len(start), 3, 3))
        self._coarse, self._coarse_age = np.zeros((0, 0), np.float32), COARSE_AGE
        self.now = self.best = self.evaluate(np.ascontiguousarray(start, np.float64))
        self.start_j = self.now.energy

    def around(self, x: np.ndarray) -> tuple[Around, np.ndarray]:
        """Returns the planes and springs that act on the vertices ``x`` [m] (V, 3), and the second derivatives [1/m]
        (V, 3, 3) of their distances to the body."""
        if self._met is not None and self._met[0] is x:
            return self._met[1:]
        point, normal, bend = self._planes(x)
        planes = surroundings(self.problem, point, normal)
        if self.band is not None:
            planes = replace(planes, band=self.band.anchor, band_n_per_m=self.band.n_per_m)
        if self.pull is not None:
            planes = replace(planes, target=self.pull.anchor, target_n_per_m=self.pull.n_per_m)
        self._met = x, planes, bend
        return planes, bend

    def evaluate(self, x: np.ndarray) -> State:
        """Returns the state at ``x`` [m] (V, 3), with its energy and gradient."""
        gradient = np.empty_like(x)
        energy = descent.energy_and_gradient(x, self.problem, self.around(x)[0], gradient)
        return State(x, energy, gradient, steps=self.steps)

    def deepest_m(self) -> float:
        """Returns the depth [m] of the cloth in the skin where it is deepest; negative if it is nowhere in the skin."""
        around, _ = self.around(self.now.x)
        size = np.maximum(np.linalg.norm(around.normal, axis=1), 1e-12)
        return float((((around.point - self.now.x) * around.normal).sum(axis=1) / size).max())

    def settle(self, rounds: int) -> None:
        """Moves the cloth by a few sweeps, and then by at most ``rounds`` of settling (``drape.exact.settling``)."""
        for _ in range(SWEEPS):
            self._sweep(self.problem.order)
        self._take(settling.settle(self.now, self.evaluate, self.cloth.solve, rounds))

    def run(self, step_limit: int, tolerance_n: float) -> State:
        """Moves the cloth by Newton's method and returns the last state if it is at rest, else the state of least
        energy.

        It ends when the norm of the force left is at most ``tolerance_n`` [N], when no step lowers the energy, or after
        ``step_limit`` steps.
        """
        if self.steps == 0:
            for _ in range(SWEEPS):
                self._sweep(self.problem.order)
        stalls = 0
        while self.steps < step_limit:
            force = np.linalg.norm(self.now.gradient)
            if force <= tolerance_n and self.now.energy <= self.start_j:
                return self.now._replace(at_rest=True, steps=self.steps)
            if self.shift is None and force <= SHIFTING * self.cloth.weight_n:
                self.shift = SHIFT_N_PER_M
            self.steps += 1
            if self._step():
                size = (self.now.gradient**2).sum(axis=1)
                worst = np.argsort(-size, kind="stable")[: max(8, int(WORST * len(size)))]
                self._sweep(worst.astype(np.int32), WORST_SWEEPS)
                stalls = 0
                continue
            stalls += 1
            if stalls == STALLS:
                break
            if not self._lay_out():
                # So large a shift makes the step a short one of steepest descent.
                self.shift = max(4.0 * (self.shift or 0.0), STALLED_N_PER_M)
        at_rest = np.linalg.norm(self.now.gradient) <= tolerance_n and self.now.energy <= self.start_j
        return (self.now if at_rest else self.best)._replace(at_rest=bool(at_rest), steps=self.steps)

    def _take(self, there: State) -> None:
        self.now = there
        if there.energy < self.best.energy:
            self.best = there

    def _sweep(self, order: np.ndarray, times: int = 1) -> None:
        """Vertex block descent of the vertices ``order`` over the planes of now, if it lowers the energy."""
        origin, around = self.now.x, self.around(self.now.x)[0]
        x = origin.copy()
        for _ in range(times):
            descent.sweep(x, self.problem, around, True, order)
            x = self._swept(origin, x)
        there = self.evaluate(x)
        if there.energy < self.now.energy:
            self._take(there)

    def _step(self) -> bool:
        """One step of Newton with a line search; False where it finds nothing lower."""
        now = self.now
        step, iterations = self._direction()
        slope, share, lowered = float((now.gradient * step).sum()), 1.0, False
        for _ in range(HALVINGS):
            there = self.evaluate(now.x + share * step)
            lowered = there.energy < now.energy + 1e-4 * share * slope
            if lowered:
                self._take(there)
                break
            # The minimum of the parabola through both energies and the slope, but between a tenth and a half.
            wanted = -0.5 * share * share * slope / max(there.energy - now.energy - share * slope, 1e-300)
            share = min(max(wanted, 0.1 * share), 0.5 * share) if np.isfinite(wanted) else 0.1 * share
        share = share if lowered else 0.0
        if self.shift is not None:
            change = 0.5 if share == 1.0 else 4.0 if share < 0.3 else 1.0
            self.shift = max(change * self.shift, SHIFT_LEAST_N_PER_M)
        elif share == 1.0 and iterations > 0:
            self.exact = min(1.0, max(2.0 * self.exact, EXACT_START))
        elif share < 0.2:
            self.exact *= 0.5
        return lowered

    def _direction(self) -> tuple[np.ndarray, int]:
        """A step [m] (V, 3) along which the energy falls, and its iterations, negative where they were cut off."""
        x, problem, (pattern, others) = self.now.x, self.problem, self._other_blocks()
        around, bend = self.around(x)
        depth = np.maximum(problem.constants.gap - ((x - around.point) * around.normal).sum(axis=1), 0.0)
        bend = (problem.contact_n_per_m * depth)[:, None, None] * bend
        descent.diagonal_blocks(x, problem, around, self._diagonal)
        own = self._diagonal if others is None else self._diagonal + others[pattern.diagonal]
        inverse = np.linalg.inv(own).astype(np.float32)
        blocks = np.empty((len(pattern.column), 3, 3))
        moved, force = np.empty(x.shape, np.float32), (-self.now.gradient).astype(np.float32)
        while True:
            exact, left = (self.exact, ROUGH) if self.shift is None else (1.0, FINE)
            hessian.assemble(x, problem, around, pattern, exact, blocks)
            if others is not None:
                blocks += others
            blocks[pattern.diagonal] += DAMPING * self._diagonal - exact * bend
            if self.shift is not None:
                blocks[pattern.diagonal] += self.shift * self._per_shift
            single = blocks.astype(np.float32)
            self._renew_coarse(pattern, single)
            system = linear.System(pattern, single, inverse, self.cloth.charts, self._coarse)
            count = linear.conjugate_gradients(system, force, left, ITERATIONS, moved)
            # A direction of negative curvature leads far away, unless many iterations came before it.
            if self.shift is not None:
                if count > 0 or count < -LATE or self.shift > 1e8:
                    break
                self.shift *= 4.0
            elif count > 0 or count < -8 or self.exact == 0.0:
                break
            else:
                self.exact = 0.5 * self.exact if self.exact > EXACT_LEAST else 0.0
        return self._limited(moved.astype(np.float64)), count

    def _other_blocks(self) -> tuple[hessian.Pattern, np.ndarray | None]:
        """The pattern of the Hessian, and blocks that are added to those of the cloth: here none."""
        return self.cloth.pattern, None

    def _limited(self, step: np.ndarray) -> np.ndarray:
        """``step`` [m] (V, 3) with every vertex's way shortened to what it may go, ``reach_m`` () or (V, 1)."""
        length = np.linalg.norm(step, axis=1, keepdims=True)
        return step * np.minimum(1.0, self.reach_m / np.maximum(length, 1e-12))

    def _swept(self, origin: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The place where a sweep from ``origin`` to ``x`` ends: here ``x``."""
        return x

    def _renew_coarse(self, pattern: hessian.Pattern, blocks: np.ndarray) -> None:
        """Renews the inverse on the charts when it is old; a matrix that is not positive has none."""
        self._coarse_age += 1
        if self.cloth.charts.patch.size == 0 or self._coarse_age < COARSE_AGE:
            return
        self._coarse_age = 0
        size = 3 * (int(self.cloth.charts.patch.max()) + 1)
        matrix = np.empty((size, size), np.float32)
        linear.galerkin(self.cloth.charts, pattern, blocks, matrix)
        factorise, invert = scipy.linalg.get_lapack_funcs(("potrf", "potri"), (matrix,))
        factor, failed = factorise(matrix, lower=1)
        if failed:
            self._coarse = np.zeros((0, 0), np.float32)
            return
        lower = np.tril(invert(factor, lower=1)[0])
        self._coarse = np.ascontiguousarray(lower + np.tril(lower, -1).T)

    def _lay_out(self) -> bool:
        """Lays the corners of collapsed triangles between their neighbours; returns whether there were any.

        A triangle without an area has no fold, and its hinges cost as half a fold: a sharp well of the energy, from
        which no step leads down.
        """
        x, corner = self.now.x.copy(), self.problem.triangles.corner
        first, second = x[corner[:, 1]] - x[corner[:, 0]], x[corner[:, 2]] - x[corner[:, 0]]
        area = 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
        collapsed = corner[area < COLLAPSED * self.problem.triangles.area]
        self._layings += 1
        if len(collapsed) == 0 or self._layings > LAYINGS:
            return False
        chosen = np.unique(collapsed)
        total, count = np.zeros(x.shape), np.zeros(len(x))
        for side in range(3):
            for other in (side - 1, side - 2):
                np.add.at(total, corner[:, side], x[corner[:, other]])
                np.add.at(count, corner[:, side], 1.0)
        x[chosen] = total[chosen] / count[chosen, None]
        self._take(self.evaluate(x))
        near = np.unique(corner[np.isin(corner, chosen).any(axis=1)]).astype(np.int32)
        for _ in range(10):
            self._sweep(near)
        self.shift, self.exact = None, 0.0
        return True


def minimum(
    cloth: Cloth,
    contact: BodyContact,
    posed: np.ndarray,
    starts: list[np.ndarray],
    *,
    step_limit: int,
    tolerance: float,
    band: Band | None = None,
) -> State:
    """Returns the state of least energy over the body ``posed`` [m] (Vb, 3) that descents from ``starts``, each [m] (V,
    3), lead to. Its energy is never above the lowest of the starts.

    Every start settles a little. The lowest settles on and goes by Newton's method until the norm of the force left is
    at most ``tolerance`` of the weight, for ``step_limit`` steps at most.
    """
    limit_n = tolerance * cloth.weight_n
    descents = [Descent(cloth, contact, posed, start, band=band) for start in starts]
    finite = [start for start in descents if np.isfinite(start.start_j)]
    if not finite:
        return descents[0].best
    if len(finite) > 1:
        for start in finite:
            start.settle(min(ROUGH_ROUNDS, ROUNDS_PER_STEP * step_limit))
    lowest = min(finite, key=lambda start: start.best.energy)
    lowest.start_j = min(start.start_j for start in finite)
    lowest.settle(min(ROUNDS, ROUNDS_PER_STEP * step_limit))
    return lowest.run(step_limit, limit_n)
