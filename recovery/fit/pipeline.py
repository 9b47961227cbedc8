"""A base pattern and a draped target in, the target's pattern out: draped, graded, draped again, optimised in rounds.

Two triangulations of one pattern drape half a millimetre apart at 5 cm, and a search that may not change its own makes
up for that with the pattern. So each round meshes what the one before found anew, drapes it from scratch, and goes on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from recovery.drape.pipeline import Draped, DrapeOptions, drape_pattern
from recovery.fit.belt import held_as_target
from recovery.fit.cloth import Fabric, FreeCloth, named, nearest_fabric
from recovery.fit.contours import Contour, Match, match_contours, open_contours
from recovery.fit.forward import RestDrape
from recovery.fit.grading import Graded, grade, graded_again, ungraded
from recovery.fit.objective import DEFAULT_WEIGHTS, Objective, Target, Weights
from recovery.fit.optimise import DEFAULT_OPTIONS, FitOptions, Fitted, PatternSearch
from recovery.pattern.coordinates import control_points
from recovery.pattern.model import Pattern
from recovery.pattern.symmetry import Symmetries, find_symmetries, free_controls, symmetrised
from recovery.sim.sdf import SignedDistance

DEFAULT_DRAPE = DrapeOptions()
GRADINGS = 2
LENGTHS_TRIED = (1.0, 0.93, 1.07, 0.87)  # of the edge length asked for
ROUNDS = 3
SETTLED_M = 1e-4  # of every control point in a round: where the mesh stays as well, the next would find the same
TRIED = FitOptions(iterations=0, closing=3)  # of the search with each fabric: its signature is mixed with the size's


@dataclass(frozen=True, eq=False)
class Round:
    """One search: what its pattern draped to at the ``start``, pairs of contours, and what was ``fitted`` with what.

    It took ``seconds`` by the clock and ``processor_s`` of the processor, over all threads; its mesh and the drape at
    its start count with it, for the first round all that goes before: base, grading, choice of the fabric.
    """

    start: Draped
    matches: list[Match]
    search: PatternSearch
    fitted: Fitted
    seconds: float
    processor_s: float


@dataclass(frozen=True, eq=False)
class Recovered:
    """A recovery: what the base and the graded pattern draped to, the ``graded`` pattern, and what was ``fitted``.

    ``start``, ``matches``, ``search``, ``fitted`` are those of the best of the ``rounds``, of those with a free cloth
    if there are any. ``matches`` pair the start's contours with the target's; ``holes`` are contours of the target that
    are left. ``search`` holds what was searched with: mesh, free numbers, simulator, loss. ``fabric`` is the named one
    nearest to the cloth of the drape; ``fabric_losses`` [m^2] is what the search fell to with each that was tried.
    """

    symmetries: Symmetries
    base: Draped
    graded: Graded
    start: Draped
    matches: list[Match]
    holes: list[int]
    search: PatternSearch
    fitted: Fitted
    rounds: tuple[Round, ...]
    fabric: Fabric
    fabric_losses: dict[str, float]


def recover_pattern(
    vertices: np.ndarray,
    faces: np.ndarray,
    base: Pattern,
    body: BodyModel,
    *,
    drape: DrapeOptions = DEFAULT_DRAPE,
    fit: FitOptions = DEFAULT_OPTIONS,
    weights: Weights = DEFAULT_WEIGHTS,
    pose: np.ndarray | None = None,
    meshes_m: Sequence[float] | None = None,
    fabrics: Sequence[str] = (),
    free_cloth: bool = False,
    grading: bool = True,
    state_file: Path | None = None,
    progress: bool = False,
    report: Callable[[str], None] | None = None,
) -> Recovered:
    """The pattern whose drape on ``body`` is nearest to a target, in the T-pose or in ``pose`` (24, 3).

    The target, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), is one garment's surface, open where the garment is;
    ``base`` is a pattern of its kind with the same panels. ``meshes_m`` are the edge lengths [m] of the rounds, by
    default three times that of ``drape``; Adam's steps are taken in the first alone. Of ``fabrics`` and that of
    ``drape`` the one that comes nearest in a short search is taken; with ``free_cloth`` its constants are
    unknowns after the first round. Without ``grading`` the search begins at the base. Raises ``InputError`` where
    contours have no counterpart or a drape does not come to rest.
    """
    say = report or (lambda line: None)
    began = time.perf_counter(), time.process_time()
    lengths = list(meshes_m) if meshes_m is not None else [drape.edge_length_m] * ROUNDS
    if not lengths:
        raise InputError("meshes_m", expected="an edge length or more", got="none", cure="Leave it at its default.")
    contours_there = open_contours(vertices, faces)
    symmetries = find_symmetries(base)
    base = symmetrised(base, symmetries)
    for line in symmetries.describe(base):
        say(f"symmetry  {line}")
    joints = body.joints_template if pose is None else posed_joints(body, pose)
    bare = drape.skin(body.v_template, body.faces, say)
    first = drape_pattern(base, body, drape, pose=pose, skin=bare)
    graded, start = ungraded(base), first

    def grade_on(before: Graded, draped: Draped) -> tuple[Graded, Draped]:
        """``before`` graded once more by what it draped to, and what that drapes to."""
        matches, _ = _matched(draped, contours_there, joints)
        contours = open_contours(draped.nodes, draped.mesh.faces)
        after = graded_again(before, grade(draped.mesh, draped.nodes, contours, matches, symmetries))
        return after, _drape(after.pattern, body, replace(drape, edge_length_m=lengths[0]), pose, bare)

    if grading:
        # Once is linear: a second time halves what the first one left.
        for _ in range(GRADINGS):
            graded, start = grade_on(graded, start)
    else:
        start = _drape(base, body, replace(drape, edge_length_m=lengths[0]), pose, bare)
    target = Target.from_mesh(vertices, faces, contours_there, folds=weights.folds)
    skin = bare
    if pose is not None:
        skin = drape.skin(body.posed_vertices(pose[None])[0], body.faces, say)
    cloth, losses = named(drape.fabric), {}
    if fabrics:
        task = _Task(target, contours_there, joints, skin, symmetries, graded.pattern, weights)
        starts = {drape.fabric: start}
        for name in fabrics:
            # From scratch: what hangs from a belt closes round the body elsewhere in another fabric.
            options = replace(drape, fabric=name, edge_length_m=lengths[0])
            starts.setdefault(name, drape_pattern(graded.pattern, body, options, pose=pose, skin=bare))
        losses = {name: task.tried(task.held(one, named(name)), base, named(name)) for name, one in starts.items()}
        name = min(losses, key=lambda one: losses[one])
        told = ", ".join(f"{one} {1e3 * np.sqrt(0.5 * loss):.2f}" for one, loss in losses.items())
        say(f"fabric    {name}; left to the target [mm]: {told}")
        if name != drape.fabric:
            drape, cloth = replace(drape, fabric=name), named(name)
            start = starts[name]
            if grading:
                graded, start = grade_on(graded, start)
    say(
        f"graded    widths times {graded.widths.min():.3f} to {graded.widths.max():.3f}, heights "
        f"{graded.heights.min():.3f} to {graded.heights.max():.3f}; misfit {100 * graded.misfit:.1f} %"
    )
    task = _Task(target, contours_there, joints, skin, symmetries, graded.pattern, weights)
    likely = cloth
    start = task.held(start, cloth)
    rounds: list[Round] = []
    pattern, ratios = graded.pattern, base
    for number, length in enumerate(lengths):
        if number:
            options = replace(drape, edge_length_m=length)
            start = task.held(drape_pattern(pattern, body, options, pose=pose, cloth=cloth, skin=bare), cloth)
            if not start.at_rest or not _would_change(rounds, start, free_cloth=free_cloth):
                say(f"round {number + 1}   left: {'it would find the same' if start.at_rest else 'no drape at rest'}")
                break
        free = FreeCloth(cloth) if free_cloth and (number or len(lengths) == 1) else None
        search, matches = task.search(start, pattern, ratios, cloth, free, likely)
        if number and search.evaluate(np.zeros(search.count), start.nodes) is None:
            say(f"round {number + 1}   left: no drape at rest")
            break
        if not number:
            say(f"search    {search.free.count} numbers are free, {start.mesh.node_count} nodes")
        steps = fit if number == 0 else replace(fit, iterations=0, closing=max(fit.closing, 1))
        file = None if state_file is None else state_file.with_stem(state_file.stem + (f"_{number}" if number else ""))
        fitted = search.run(start.nodes, steps, state_file=file, progress=progress)
        ended = time.perf_counter(), time.process_time()
        rounds.append(Round(start, matches, search, fitted, ended[0] - began[0], ended[1] - began[1]))
        began = ended
        apart = [1e3 * float(np.sqrt(0.5 * terms)) for terms in (fitted.history[0, 1], _least(rounds[-1])[1])]
        say(f"round {number + 1}   {start.mesh.node_count} nodes: surfaces {apart[0]:.2f} to {apart[1]:.2f} mm apart")
        # The base's seams were scaled by it; what the target tells of them is kept from here on.
        pattern = ratios = fitted.pattern
        cloth = fitted.cloth
    best = min([one for one in rounds if one.search.cloth is not None] or rounds, key=lambda one: _least(one)[0])
    _, holes = _matched(best.start, contours_there, joints)
    fabric = nearest_fabric(best.fitted.cloth)
    apart = [1e3 * float(np.sqrt(0.5 * terms)) for terms in (rounds[0].fitted.history[0, 1], _least(best)[1])]
    say(f"fitted    surfaces {apart[0]:.2f} mm apart at the start, {apart[1]:.2f} mm at the end (root mean square)")
    if free_cloth:
        say(f"cloth     {fabric.describe()}")
    return Recovered(
        symmetries,
        first,
        graded,
        best.start,
        best.matches,
        holes,
        best.search,
        best.fitted,
        tuple(rounds),
        fabric,
        losses,
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays from round to round."""

    target: Target
    contours: list[Contour]
    joints: np.ndarray
    skin: SignedDistance
    symmetries: Symmetries
    graded: Pattern
    weights: Weights

    def held(self, draped: Draped, cloth: OrthotropicMaterial) -> Draped:
        """``draped`` with its belt where the target's is."""
        return held_as_target(draped, _matched(draped, self.contours, self.joints)[0], self.contours, self.skin, cloth)

    def search(
        self,
        start: Draped,
        pattern: Pattern,
        ratios: Pattern,
        cloth: OrthotropicMaterial,
        free: FreeCloth | None,
        likely: OrthotropicMaterial,
    ) -> tuple[PatternSearch, list[Match]]:
        """The search from ``start``, what ``pattern`` draped to; seams keep the ratios of lengths of ``ratios``."""
        contours = open_contours(start.nodes, start.mesh.faces)
        matches, _ = _matched(start, self.contours, self.joints)
        controls = free_controls(pattern, self.symmetries)
        centre = controls.values(control_points(self.graded).positions)
        found = PatternSearch(
            start.mesh,
            controls,
            RestDrape(start.mesh, self.skin, cloth, held=start.rest.held),
            Objective(start.mesh, self.target, contours, matches, self.weights, base=ratios),
            cloth=free,
            likely=centre if free is None else np.concatenate([centre, free.values_of(likely)]),
        )
        return found, matches

    def tried(self, start: Draped, base: Pattern, cloth: OrthotropicMaterial) -> float:
        """The least loss [m^2] of a short search with ``cloth``; infinite where the graded pattern does not rest."""
        if not start.at_rest:
            return float("inf")
        search, _ = self.search(start, self.graded, base, cloth, None, cloth)
        if search.evaluate(np.zeros(search.count), start.nodes) is None:
            return float("inf")
        return float(search.run(start.nodes, TRIED).history[:, 0].min())


def _drape(
    pattern: Pattern, body: BodyModel, drape: DrapeOptions, pose: np.ndarray | None, skin: SignedDistance
) -> Draped:
    """What the graded ``pattern`` drapes to, on a mesh a little finer or coarser where Newton sticks on its own.

    Raises ``InputError`` where none comes to rest.
    """
    left: list[float] = []
    for share in LENGTHS_TRIED:
        length = share * drape.edge_length_m
        start = drape_pattern(pattern, body, replace(drape, edge_length_m=length), pose=pose, skin=skin)
        if start.at_rest:
            return start
        left.append(max(one.report.residual_n for one in (start.rest, start.posed) if one is not None))
    raise InputError(
        "graded pattern",
        expected="a drape at rest to start from",
        got=f"{min(left):.1e} N left at a node, on the best of {len(left)} meshes",
        cure="Take another mesh (edge_length_m), more iterations, or a base nearer to the target.",
    )


def posed_joints(body: BodyModel, pose: np.ndarray) -> np.ndarray:
    """Joints [m] (24, 3) of ``body`` in ``pose`` (24, 3)."""
    rotations, translations = body.bones(pose[None])
    return np.einsum("jab,jb->ja", rotations[0], body.joints_template) + translations[0]


def _matched(draped: Draped, there: list[Contour], joints: np.ndarray) -> tuple[list[Match], list[int]]:
    """Pairs of the contours of a drape and those of the target, and the target's that are left."""
    return match_contours(open_contours(draped.nodes, draped.mesh.faces), there, joints)


def _least(one: Round) -> np.ndarray:
    """The row of a round's history that its pattern is of."""
    return one.fitted.history[one.fitted.history[:, 0].argmin()]


def _would_change(rounds: list[Round], start: Draped, *, free_cloth: bool) -> bool:
    """Whether a search from ``start`` can find anything else than the last of ``rounds`` did."""
    last = rounds[-1]
    if free_cloth and len(rounds) == 1:
        return True
    moved = np.abs(last.fitted.positions - control_points(last.start.mesh.pattern).positions).max()
    return not np.array_equal(last.start.mesh.faces, start.mesh.faces) or bool(moved > SETTLED_M)
