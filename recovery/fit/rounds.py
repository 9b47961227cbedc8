"""The pattern of a draped target, found from a base pattern: draped, graded, draped again, optimised in rounds.

Two triangulations of one pattern drape half a millimetre apart at 5 cm. A search that keeps its triangles makes up for
that with the pattern. So each round meshes the pattern of the round before anew and drapes it from scratch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.garment.contours import Match, Place, bone_chains, match_contours, open_contours, place_of
from recovery import progress as watch
from recovery.drape.pattern_drape import Draped, DrapeOptions, hanging
from recovery.drape.posing import posed_joints
from recovery.fit import laying
from recovery.fit.belt import belt_of, held_as_target
from recovery.fit.forward import RestDrape
from recovery.fit.grading import Graded, grade, graded_again, ungraded
from recovery.fit.laying import EDGE_M, LaidDrape, hung_as, is_laid, laid, laying_options, let_go
from recovery.fit.objective import Objective, Target
from recovery.fit.optimise import DEFAULT_OPTIONS, REACH_M, FitOptions, Fitted, PatternSearch
from recovery.fit.recovered import NOT_AT_REST, SAME, Recovered, Round, Sewn, apart_mm, clocks, why_left
from recovery.fit.seams import SeamConstraint, sewable
from recovery.fit.starts import Start, drape_at_rest, needed_length, worn_drape
from recovery.pattern.coordinates import control_points
from recovery.pattern.model import Pattern
from recovery.pattern.symmetry import Symmetries, find_symmetries, free_controls, symmetrised
from recovery.sim.sdf import SignedDistance

DEFAULT_DRAPE = DrapeOptions()
GRADINGS = 2  # one is linear: a second one mostly halves what the first one left
ROUNDS = 3
# Where surfaces are this far apart (root mean square) at the first round's start or the end of one, the reach may hold
# the search back: the next one has as many times more. Else what a drape hardly shows stays as in the graded base.
START_FAR_MM, FAR_MM, REACH_GROWS = 10.0, 3.0, 3.0
LAID_FAR_MM = 5.0  # a base that springs lay nearer (root mean square) is not graded: that narrows what is gathered

Say = Callable[[str], None]


def recover_pattern(
    vertices: np.ndarray,
    faces: np.ndarray,
    base: Pattern,
    body: BodyModel,
    *,
    drape: DrapeOptions = DEFAULT_DRAPE,
    fit: FitOptions = DEFAULT_OPTIONS,
    reach_m: float = REACH_M,
    pose: np.ndarray | None = None,
    meshes_m: Sequence[float] | None = None,
    state_file: Path | None = None,
    progress: bool = False,
    report: Say | None = None,
    known: np.ndarray | None = None,
) -> Recovered:
    """The pattern whose drape on ``body`` is nearest to a target, in the T-pose or in ``pose`` (24, 3).

    The target, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), is one garment's surface, open where the garment is;
    ``base`` is a pattern of its kind with the same panels. ``meshes_m`` are the edge lengths [m] of the rounds, by
    default three times that of ``drape``, or once 3 cm where a seam gathers; Adam's steps are taken in the first
    alone. A search's loss doubles where its unknowns are ``reach_m`` [m] from the graded base. Faces that are not
    ``known`` (F,) close holes and have no weight. Raises ``InputError`` where contours have no counterpart or a drape
    does not come to rest. When the time is up (``recovery.progress``) the best so far is given.
    """
    say = report or (lambda line: None)
    began = clocks()
    lengths = [drape.edge_length_m] * ROUNDS if meshes_m is None else list(meshes_m)
    if not lengths:
        raise InputError("meshes_m", expected="an edge length or more", got="none", cure="Leave it at its default.")
    target = Target.from_mesh(vertices, faces, open_contours(vertices, faces), known=known)
    symmetries = find_symmetries(base)
    base = symmetrised(base, symmetries)
    base = sewable(base, base, symmetries)
    for line in symmetries.describe(base):
        say(f"symmetry  {line}")
    bare = drape.skin(body.v_template, body.faces)
    skin = bare if pose is None else drape.skin(body.posed_vertices(pose[None])[0], body.faces)
    task = _Task(
        target=target,
        body=body,
        pose=pose,
        bare=bare,
        skin=skin,
        base=base,
        symmetries=symmetries,
        reach_m=reach_m,
        drape=replace(drape, edge_length_m=lengths[0]),
        say=say,
    )
    if task.lays:
        drape, lengths = laying_options(drape), [min(length, EDGE_M) for length in meshes_m or lengths[:1]]
        task = replace(task, drape=replace(drape, edge_length_m=lengths[0]))
    with watch.stage("drape of the base"):
        first = worn_drape(base, task.start(drape), rest=False)
    lengths = [min(length, needed_length(first, drape)) for length in lengths]
    task = replace(task, drape=replace(task.drape, edge_length_m=lengths[0]))
    graded, start = ungraded(base), first
    with watch.stage("drape of the graded base"):
        if task.lays:
            graded, start = task.nearer(graded, start)
        else:
            graded, start = task.best_graded(graded, start, GRADINGS)
    if not math.isnan(graded.misfit):
        say(
            f"graded    widths times {graded.widths.min():.3f} to {graded.widths.max():.3f}, heights "
            f"{graded.heights.min():.3f} to {graded.heights.max():.3f}; misfit {100 * graded.misfit:.1f} %"
        )

    def search(found: PatternSearch, nodes: np.ndarray, number: int) -> Fitted:
        steps, file = fit, state_file
        if number:
            steps = replace(fit, iterations=0, closing=max(fit.closing, 1))
            file = state_file and state_file.with_stem(f"{state_file.stem}_{number}")
        with watch.stage(f"round {number + 1}"):
            return found.run(nodes, steps, state_file=file, progress=progress)

    rounds, left = task.rounds(start, graded.pattern, lengths, search, began)
    if rounds[-1].sewn is None and not watch.over():
        with watch.stage("the last round's pattern, sewn"), suppress(InputError):
            rounds[-1] = task.sewn(rounds[-1], lengths[-1])[0]
    return _recovered(task, first, graded, rounds, left)


def _recovered(task: _Task, base: Draped, graded: Graded, rounds: list[Round], left: str) -> Recovered:
    """The best of ``rounds`` with all that led there."""
    best, fabric = min(rounds, key=lambda one: one.rank), task.drape.fabric
    # The base's own note is of another cloth than the one that was draped; of name and weight a cutter knows the bolt.
    bolt = f"{fabric} {1e3 * best.fitted.cloth.density_kg_m2:.0f} g/m²"
    fitted = replace(best.fitted, pattern=replace(best.fitted.pattern, material=bolt))
    far = [apart_mm(squared) for squared in (rounds[0].fitted.history[0, 1], best.surface_m2, best.sewn_m2)]
    ends = f"{far[0]:.2f} mm apart at the start, {far[1]:.2f} mm at the end, {far[2]:.2f} mm sewn"
    task.say(f"fitted    surfaces {ends} (root mean square)")
    return Recovered(
        symmetries=task.symmetries,
        base=base,
        graded=graded,
        start=best.start,
        matches=best.matches,
        holes=task.matches(best.start)[1],
        search=best.search,
        fitted=fitted,
        edge_length_m=best.edge_length_m,
        sewn=best.sewn,
        rounds=tuple(rounds),
        left=left,
        fabric=fabric,
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """The facts that no round changes: the target, and the body with its distances in the T-pose and in its pose.

    ``bare`` is the distance in the T-pose, ``skin`` that in the pose. ``base`` says how long seams are. ``drape`` has
    the edge length of the first round.
    """

    target: Target
    body: BodyModel
    pose: np.ndarray | None
    bare: SignedDistance
    skin: SignedDistance
    base: Pattern
    symmetries: Symmetries
    reach_m: float
    drape: DrapeOptions
    say: Say

    @cached_property
    def lays(self) -> bool:
        """Whether the garment is laid in the target's folds."""
        return is_laid(self.base, [place.part for place in self.places])

    @cached_property
    def places(self) -> list[Place]:
        """Where the target's contours lie on the body."""
        chains = bone_chains(posed_joints(self.body, self.pose))
        return [place_of(contour, chains) for contour in self.target.contours]

    def start(self, drape: DrapeOptions, cloth: OrthotropicMaterial | None = None) -> Start:
        """How drapes begin on this body; what the target goes round, they should."""
        parts = [place.part for place in self.places if place.part is not None]
        return Start(self.body, drape, self.pose, self.bare, tuple(parts), cloth)

    def matches(self, draped: Draped) -> tuple[list[Match], list[int]]:
        """Pairs of the contours of a drape and those of the target, and the target's that are left."""
        contours = open_contours(draped.nodes, draped.mesh.faces)
        return match_contours(contours, self.target.contours, posed_joints(self.body, self.pose))

    def graded(self, before: Graded, draped: Draped) -> tuple[Graded, Draped]:
        """``before`` graded once more by its drape ``draped``, and the drape of that."""
        contours = open_contours(draped.nodes, draped.mesh.faces)
        found = grade(draped.mesh, draped.nodes, contours, self.matches(draped)[0], self.symmetries)
        after = graded_again(before, found)
        after = replace(after, pattern=sewable(after.pattern, self.base, self.symmetries))
        return after, worn_drape(after.pattern, self.start(self.drape), rest=False)

    def best_graded(self, base: Graded, draped: Draped, times: int) -> tuple[Graded, Draped]:
        """``base``, whose drape is ``draped``, graded up to so many ``times``; the last one worn right and at rest."""
        start, tried = self.start(self.drape), [self.graded(base, draped)]
        with suppress(InputError):  # panels that shrink too far, or a drape that lost a part
            while len(tried) < times:
                tried.append(self.graded(*tried[-1]))
        best, worn = min(reversed(tried), key=lambda one: (len(start.lost(one[1])), not one[1].at_rest))
        return best, worn if worn.at_rest else drape_at_rest(best.pattern, start)

    def nearer(self, base: Graded, draped: Draped) -> tuple[Graded, Draped]:
        """``base``, whose drape is ``draped``, or, where springs do not lay that near, graded if it is then nearer."""
        cloth = hanging(self.drape.fabric, self.drape.hangs_longer)

        def far(one: Draped) -> float:
            return apart_mm(self.surface(laid(one, self.target, self.skin, cloth)))

        self.say(f"laid      the base within {(before := far(draped)):.2f} mm (root mean square)")
        after = self.graded(base, draped) if before > LAID_FAR_MM else (base, draped)
        return after if after[1] is not draped and far(after[1]) < before else (base, draped)

    def surface(self, draped: Draped) -> float:
        """The squared distance [m^2] of a drape and the target, both directions summed, as the loss has it."""
        objective = Objective(draped.mesh, self.target, [], [])
        return float(objective.surface(torch.from_numpy(draped.nodes)))

    def held(self, draped: Draped, cloth: OrthotropicMaterial) -> Draped:
        """``draped`` with its belt where the target's is, or let go from the target's folds."""
        if self.lays:
            return let_go(laid(draped, self.target, self.skin, cloth), self.skin, cloth)
        return held_as_target(draped, self.matches(draped)[0], self.target.contours, self.skin, cloth)

    def search(
        self, start: Draped, centre: Pattern, cloth: OrthotropicMaterial, reach_m: float
    ) -> tuple[PatternSearch, list[Match]]:
        """The search from ``start`` in ``cloth`` with this reach [m], and how its contours are paired.

        The corners of ``centre`` are what the reach of the loss is counted from.
        """
        contours = open_contours(start.nodes, start.mesh.faces)
        matches, _ = self.matches(start)
        controls = free_controls(start.mesh.pattern, self.symmetries)
        belt = belt_of(start, matches, self.target.contours)
        forward = RestDrape(start.mesh, self.skin, cloth, held=start.rest.held, belt=belt)
        if self.lays:
            forward = LaidDrape(start.mesh, self.skin, cloth, self.target)
        found = PatternSearch(
            start.mesh,
            controls,
            forward,
            Objective(start.mesh, self.target, contours, matches),
            seams=SeamConstraint(start.mesh.pattern, controls, self.base),
            reach_m=reach_m,
            likely=controls.values(control_points(centre).positions),
        )
        return found, matches

    def sewn(self, last: Round, length_m: float) -> tuple[Round, Draped]:
        """``last`` with its pattern sewn on a mesh of edges ``length_m``, and that drape with its belt laid.

        What is not worn so, or fell into other folds, is hung in those of ``last`` if it is nearer to the target then.
        Raises ``InputError`` where it cannot be sewn.
        """
        cloth, start = last.fitted.cloth, self.start(replace(self.drape, edge_length_m=length_m), last.fitted.cloth)
        shown, pairs = (last.search.mesh_of(last.fitted), last.fitted.nodes), list[Sewn]()

        def far(one: Draped) -> float:
            return self.surface(one) if one.at_rest and not start.lost(one) else math.inf

        def mended(loose: Draped) -> Draped:
            if self.lays:
                worn = hung_as(loose, *shown, self.skin, cloth)
            elif len(loose.rest.held) and start.lost(loose):
                worn = laying.put_on(loose, *shown, lambda one: self.held(one, cloth))
            else:
                worn = self.held(loose, cloth)
            if not self.lays and (
                laying.in_other_folds(worn, *shown) or (math.isinf(far(worn)) and not len(worn.rest.held))
            ):
                worn = min((worn, laying.hung_at_rest(loose, *shown, self.skin, cloth)), key=far)
            pairs.append(Sewn(loose, worn))
            return worn

        worn = worn_drape(last.fitted.pattern, start, rest=not self.lays, mended=mended)
        return replace(last, sewn=next(pair for pair in pairs if pair.worn is worn), sewn_m2=far(worn)), worn

    def rounds(
        self,
        start: Draped,
        graded: Pattern,
        lengths_m: list[float],
        run: Callable[[PatternSearch, np.ndarray, int], Fitted],
        began: np.ndarray,
    ) -> tuple[list[Round], str]:
        """The searches, ``run`` one after the other, each on a new mesh of the pattern that the one before found.

        With them why the last ones were left out, empty for none. The first goes from the drape ``start`` of the
        pattern ``graded``; its clocks ``began`` earlier.
        """
        cloth = hanging(self.drape.fabric, self.drape.hangs_longer)
        reach_m = self.reach_m
        rounds: list[Round] = []
        for number, length in enumerate(lengths_m):
            if number and watch.over():
                return rounds, self._left(number, len(lengths_m), "the time is up")
            try:
                if number:
                    with watch.stage(f"drape of round {number + 1}"):
                        rounds[-1], start = self.sewn(rounds[-1], length)
                elif not self.lays:
                    start = self.held(start, cloth)
            except InputError as error:
                if not number:
                    raise
                return rounds, self._left(number, len(lengths_m), f"the pattern sewn anew is not worn so: {error}")
            far_m2, limit = (rounds[-1].least[1], FAR_MM) if number else (self.surface(start), START_FAR_MM)
            held_back = apart_mm(far_m2) > limit
            why = why_left(rounds, start) if number else ""
            if why and not (why == SAME and held_back):
                return rounds, self._left(number, len(lengths_m), why)
            reach_m *= REACH_GROWS if held_back else 1.0
            search, matches = self.search(start, graded, cloth, reach_m)
            if number and not self.lays and not search.rests(start.nodes):
                return rounds, self._left(number, len(lengths_m), NOT_AT_REST)
            if not number:
                self.say(f"search    {search.free.count} numbers are free, {start.mesh.node_count} nodes")
            fitted = run(search, start.nodes, number)
            now = clocks()
            rounds.append(Round(start, matches, search, fitted, length, *(now - began).tolist()))
            began = now
            first, last = (apart_mm(surface) for surface in (fitted.history[0, 1], rounds[-1].surface_m2))
            self.say(f"round {number + 1}   {start.mesh.node_count} nodes: surfaces {first:.2f} to {last:.2f} mm apart")
        return rounds, ""

    def _left(self, number: int, count: int, why: str) -> str:
        """Says and returns that the rounds from ``number`` on, of ``count``, are left out."""
        self.say(f"round {number + 1}   left: {why}")
        return "" if why == SAME else f"round {number + 1} of {count}: {why}"
