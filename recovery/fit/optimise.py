"""Pattern optimisation (section 3.5 of Yu, Cordier and Seo 2024): steps of Adam, then damped Gauss-Newton steps.

Every evaluation drapes the pattern to rest from the last shape and differentiates through that drape. A step that folds
a panel over, or whose drape does not come to rest, is halved until it does neither. The paper stops at Adam; near the
end a few Gauss-Newton steps, which know the derivatives of the whole drape, go as far as hundreds of Adam's. Where
seams are a constraint both kinds of step go along it and end on it (``objective.py``).
"""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from drape.cloth.material import OrthotropicMaterial
from drape.errors import ArtifactError, InputError
from drape.files.atomic import whole_file
from recovery import progress as watch
from recovery.fit.forward import RestDrape
from recovery.fit.objective import Objective, SeamConstraint, gauss_newton_matrix
from recovery.pattern import geometry
from recovery.pattern.coordinates import with_controls
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.symmetry import FreeControls

HALVINGS = 8
BETAS = (0.9, 0.99)  # Adam's decay rates of both means
# Stands in for Adam's epsilon: a share of the largest root mean square gradient. Without it Adam moves corners that the
# target does not determine, as along a seam in the cloth, as far as those that it does.
FLOOR = 0.1
DAMPING = 1e-2  # damping of the first closing step, as a share of the loss's mean curvature
DAMPING_RANGE = (1e-4, 1e4)
SAVE_EVERY = 10  # steps
STATE_VERSION = 7
REACH_M = 0.045
POINTS = ("now", "best")  # evaluations that a state holds


@dataclass(frozen=True)
class FitOptions:
    """The options of a search: ``iterations`` of Adam, whose rate [m] falls as a cosine from ``rate_m`` to
    ``last_rate_m``, and ``closing`` steps of Gauss and Newton after them."""

    iterations: int = 20
    closing: int = 10
    rate_m: float = 1e-3
    last_rate_m: float = 2e-5

    def __post_init__(self) -> None:
        steps = self.iterations >= 0 and self.closing >= 0 and self.iterations + self.closing >= 1
        if not (steps and 0.0 < self.last_rate_m <= self.rate_m < 0.1):
            raise InputError(
                "fit options",
                expected="iterations + closing >= 1, neither < 0, 0 < last_rate_m <= rate_m < 0.1 m",
                got=f"{self}",
                cure="Leave them at their defaults.",
            )

    def rate(self, iteration: int) -> float:
        """Returns the rate [m] of Adam's step number ``iteration``, from 0."""
        share = 0.5 * (1.0 + np.cos(np.pi * min(1.0, iteration / max(1, self.iterations - 1))))
        return float(self.last_rate_m + share * (self.rate_m - self.last_rate_m))


DEFAULT_OPTIONS = FitOptions()


class Evaluation(NamedTuple):
    """A point of the search: the unknowns ``values`` [m] (Z,), which are free values of the control points, the drape's
    ``nodes`` [m] (N, 3), ``terms`` [m^2] (3,), and the loss's ``gradient`` [m] (Z,). ``terms`` are the loss, and
    surface and contours, whose sum times the regularisation it is."""

    values: np.ndarray
    nodes: np.ndarray
    terms: np.ndarray
    gradient: np.ndarray


@dataclass(frozen=True, eq=False)
class Fitted:
    """The best ``pattern`` of a search, the ``positions`` [m] (K, 2) of its control points, the ``nodes`` [m] (N, 3) of
    its drape, and the ``cloth`` that it is draped in.

    ``history`` (I + 1, 4): total loss, surface, contours [m^2] of every accepted step, and how often it was halved or
    damped. ``finished`` is False if the search ended early, because no step lessened the loss or came to rest without
    folds. It is True if the time limit (``recovery.progress``) ended the search; the best so far is given then.
    """

    pattern: Pattern
    positions: np.ndarray
    nodes: np.ndarray
    history: np.ndarray
    finished: bool
    cloth: OrthotropicMaterial


class PatternSearch:
    """The search for the control points ``free`` of ``mesh``; ``forward`` drapes them and ``objective`` is their loss.

    With ``seams`` every pattern on the way can be sewn, if the first one can. The loss doubles where the unknowns are
    ``reach_m`` [m] (by their norm) from the ``likely`` ones [m] (Z,), by default those that the search begins at. This
    multiplicative regularisation (van den Berg, van Broekhoven and Abubakar 1999) keeps what a drape hardly shows, and
    leaves an exact fit exact.
    """

    def __init__(
        self,
        mesh: PatternMesh,
        free: FreeControls,
        forward: RestDrape,
        objective: Objective,
        *,
        seams: SeamConstraint | None = None,
        likely: np.ndarray | None = None,
        reach_m: float = REACH_M,
    ) -> None:
        self.mesh, self.free, self.forward, self.objective = mesh, free, forward, objective
        self.constraint, self.reach_m = seams, reach_m
        self.likely = np.zeros(free.count) if likely is None else np.asarray(likely, dtype=np.float64)
        self._origin = torch.from_numpy(mesh.weights @ free.origin.reshape(-1))
        self._basis = torch.from_numpy(np.ascontiguousarray(mesh.weights @ free.basis))

    def mesh_of(self, fitted: Fitted) -> PatternMesh:
        """Returns the search's mesh with the pattern and the panel vertices that it ``fitted``."""
        return replace(self.mesh, pattern=fitted.pattern, rest=self.mesh.rest_at(fitted.positions))

    def rests(self, nodes: np.ndarray) -> bool:
        """Returns whether the unchanged pattern has a drape at rest that is found from ``nodes`` [m] (N, 3)."""
        return self.evaluate(np.zeros(self.free.count), nodes) is not None

    def evaluate(self, values: np.ndarray, near: np.ndarray) -> Evaluation | None:
        """Returns the loss and its gradient at ``values`` [m] (Z,), with the drape sought from ``near`` [m] (N, 3).

        None where a panel is folded over, where its outline crosses itself between the corners of triangles, or where
        the drape does not come to rest.
        """
        z = torch.tensor(values, dtype=torch.float64, requires_grad=True)
        rest = self._rest(z)
        if len(self.mesh.folded(rest.detach().numpy())) or self._crosses(values):
            return None
        x, report = self.forward(rest, near)
        if not report.converged:
            return None
        terms = self.objective(x)
        loss = terms.total * self._doubt(z)
        (gradient,) = torch.autograd.grad(loss, z)
        losses = torch.stack([loss, *terms[1:]]).detach().numpy()
        return Evaluation(values, x.detach().numpy(), losses, gradient.numpy())

    def _crosses(self, values: np.ndarray) -> bool:
        """Whether the outline of a panel at ``values`` (Z,) crosses itself."""
        panels = with_controls(self.mesh.pattern, self.mesh.controls, self.free.positions(values)).panels
        return any(geometry.first_crossing(geometry.outline(panel)) is not None for panel in panels)

    def _along(self, values: np.ndarray) -> np.ndarray:
        """Orthonormal directions (Z, M) that a step from ``values`` (Z,) may take."""
        if self.constraint is None:
            return np.eye(self.free.count)
        return np.ascontiguousarray(self.constraint.along(values))

    def _tried(self, values: np.ndarray, near: np.ndarray) -> Evaluation | None:
        """``evaluate`` at ``values``, brought back to where the seams are as asked for."""
        if self.constraint is not None:
            kept = self.constraint.kept(values)
            return None if kept is None else self.evaluate(kept, near)
        return self.evaluate(values, near)

    def _doubt(self, values: torch.Tensor) -> torch.Tensor:
        """The factor of the loss at ``values`` (Z,): 1 where they are those held likely, growing with the distance."""
        off = values - torch.from_numpy(self.likely)
        return 1.0 + off @ off / self.reach_m**2

    def _rest(self, values: torch.Tensor) -> torch.Tensor:
        """Panel vertices [m] (P, 2) at ``values`` (Z,)."""
        return (self._origin + self._basis @ values).reshape(-1, 2)

    def run(
        self,
        nodes: np.ndarray,
        options: FitOptions = DEFAULT_OPTIONS,
        *,
        state_file: Path | None = None,
        limit: int | None = None,
    ) -> Fitted:
        """Returns the best pattern of a search from the pattern as it is, draped at ``nodes`` [m] (N, 3).

        ``state_file`` is written every ``SAVE_EVERY`` steps and at the end; where it exists the search goes on from it,
        bit for bit as if it had not stopped. ``limit`` ends this run after that many steps. Raises ``InputError`` where
        the start itself folds or does not come to rest, ``ArtifactError`` for the state of another search.
        """
        digest = self._digest(options)
        state = _read(state_file, digest) if state_file is not None and state_file.exists() else self._start(nodes)
        total = options.iterations + options.closing
        last = total if limit is None else min(total, state.step + limit)
        while state.step < last and not state.stuck and not watch.over():
            surface_mm = 1e3 * np.sqrt(0.5 * state.now.terms[1])
            watch.tick(f"search, step {state.step + 1} of {total}, surfaces {surface_mm:.2f} mm apart")
            state = self._advance(state, options) if state.step < options.iterations else self._close(state)
            if state_file is not None and state.step % SAVE_EVERY == 0:
                _write(state_file, digest, state)
        if state_file is not None:
            _write(state_file, digest, state)
        positions = self.free.positions(state.best.values)
        pattern = with_controls(self.mesh.pattern, self.mesh.controls, positions)
        fitted = Fitted(pattern, positions, state.best.nodes, state.history, not state.stuck, self.forward.cloth)
        return replace(fitted, nodes=self.forward.ended(self.mesh_of(fitted), fitted.nodes))

    def _start(self, nodes: np.ndarray) -> _State:
        first = self.evaluate(np.zeros(self.free.count), self.forward.begun(nodes))
        if first is None:
            raise InputError(
                "start of the search",
                expected="a pattern without folds whose drape comes to rest",
                got="one that does not",
                cure="Drape it first (recovery.drape), take another mesh, or allow more iterations of Newton.",
            )
        zeros = np.zeros(self.free.count)
        return _State(first, first, zeros, zeros, DAMPING, 0, np.array([[*first.terms, 0.0]]), False)

    def _advance(self, state: _State, options: FitOptions) -> _State:
        """One step of Adam, halved until its pattern does not fold and its drape comes to rest."""
        ways, count = self._along(state.now.values), state.step + 1
        gradient = ways @ (ways.T @ state.now.gradient)
        mean = BETAS[0] * state.mean + (1.0 - BETAS[0]) * gradient
        square = BETAS[1] * state.square + (1.0 - BETAS[1]) * gradient**2
        way, size = mean / (1.0 - BETAS[0] ** count), np.sqrt(square / (1.0 - BETAS[1] ** count))
        step = -options.rate(state.step) * way / (size + FLOOR * size.max() + 1e-300)
        step = ways @ (ways.T @ step)
        for halved in range(HALVINGS):
            if watch.over():
                return state
            point = self._tried(state.now.values + 0.5**halved * step, state.now.nodes)
            if point is not None:
                best = point if point.terms[0] < state.best.terms[0] else state.best
                history = np.concatenate([state.history, [[*point.terms, float(halved)]]])
                return _State(point, best, mean, square, state.damping, count, history, False)
        return state if watch.over() else state._replace(stuck=True)

    def _close(self, state: _State) -> _State:
        """One damped Gauss-Newton step from the best evaluation; a worse one is damped more."""
        start = state.best
        ways = self._along(start.values)
        matrix, gradient = ways.T @ self._curvature(start) @ ways, ways.T @ start.gradient
        scale = np.trace(matrix) / len(matrix)
        damping = state.damping
        for tried in range(HALVINGS):
            if watch.over():
                return state
            step = ways @ np.linalg.solve(matrix + damping * scale * np.eye(len(matrix)), -gradient)
            point = self._tried(start.values + step, start.nodes)
            if point is not None and point.terms[0] < start.terms[0]:
                history = np.concatenate([state.history, [[*point.terms, float(tried)]]])
                damping = max(0.2 * damping, DAMPING_RANGE[0]) if tried == 0 else damping
                return state._replace(now=point, best=point, damping=damping, step=state.step + 1, history=history)
            damping = min(10.0 * damping, DAMPING_RANGE[1])
        return state if watch.over() else state._replace(stuck=True, damping=damping)

    def _curvature(self, at: Evaluation) -> np.ndarray:
        """Gauss-Newton matrix (Z, Z) of the loss, without the mixed term of its two factors."""
        rest = self._rest(torch.from_numpy(at.values))
        moves = self._basis.numpy().reshape(len(rest), 2, -1)
        drape_moves = self.forward.sensitivity(rest, at.nodes, moves)
        matrix = gauss_newton_matrix(self.objective, at.nodes, drape_moves)
        z = torch.from_numpy(at.values)
        doubt = float(self._doubt(z))
        of_doubt = torch.autograd.functional.hessian(self._doubt, z)
        return doubt * matrix + at.terms[0] / doubt * of_doubt.numpy()  # type: ignore[union-attr]

    def _digest(self, options: FitOptions) -> str:
        """The sha256 of all that a stored state must agree with: options, mesh, target, constants."""
        target = self.objective.target
        arrays = [
            self.mesh.rest,
            self.mesh.faces,
            self.free.origin,
            self.free.basis,
            self.likely,
            target.vertices,
            target.faces,
            target.known,
            self.forward.parameters.stretch.numpy(),
            self.forward.parameters.bending_j.numpy(),
            self.forward.model.fixed,
        ]
        if self.constraint is not None:
            arrays.append(self.constraint.offset)
        digest = hashlib.sha256(repr((STATE_VERSION, asdict(options), self.reach_m)).encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


class _State(NamedTuple):
    """A search on its way: the last and the best evaluation, Adam's means (Z,), the damping, steps done, history."""

    now: Evaluation
    best: Evaluation
    mean: np.ndarray
    square: np.ndarray
    damping: float
    step: int
    history: np.ndarray
    stuck: bool


def _write(path: Path, digest: str, state: _State) -> None:
    arrays = {f"{name}_{part}": value for name in POINTS for part, value in getattr(state, name)._asdict().items()}
    arrays |= {name: value for name, value in state._asdict().items() if name not in POINTS}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        np.savez(file, allow_pickle=False, digest=np.array(digest), **arrays)


def _read(path: Path, digest: str) -> _State:
    try:
        with np.load(path, allow_pickle=False) as data:
            held = {name: data[name] for name in data.files}
        now, best = (Evaluation(*(held[f"{name}_{part}"] for part in Evaluation._fields)) for name in POINTS)
        damping, step, stuck = (held[name].item() for name in ("damping", "step", "stuck"))
        state = _State(now, best, held["mean"], held["square"], damping, step, held["history"], stuck)
        of = str(held["digest"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ArtifactError(
            path.name, expected="the state of a search", got=f"{error}", cure="Delete the file and start anew."
        ) from error
    if of != digest:
        raise ArtifactError(
            path.name,
            expected="the state of this search",
            got="that of another pattern, target or other options",
            cure="Delete the file, or search with what it was written for.",
        )
    return state
