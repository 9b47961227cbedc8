"""The pattern of a draped target, found from a base pattern: draped, graded, draped again, optimised in rounds.

Two triangulations of one pattern drape half a millimetre apart at 5 cm. A search that keeps its triangles makes up for
that with the pattern. So each round meshes the pattern of the round before anew and drapes it from scratch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.garment.contours import ContourPlace, Match, bone_chains, match_contours, open_contours, place_of
from recovery import progress as watch
from recovery.drape.pattern_drape import Draped, SewingOptions, hanging
from recovery.drape.placement import posed_joints
from recovery.fit.forward import RestDrape, belt_of, hold_as_target
from recovery.fit.grading import Graded, combine_grades, grade, ungraded
from recovery.fit.laying import EDGE_M, Dressing, LaidDrape, Shown, is_laid, lay_on_target, laying_options, let_go
from recovery.fit.objective import Objective, SeamConstraint, TargetSurface, sewable
from recovery.fit.optimise import DEFAULT_OPTIONS, REACH_M, FitOptions, PatternSearch
from recovery.fit.outcome import NOT_AT_REST, SAME, Recovered, Round, apart_mm, clocks, why_left
from recovery.fit.starts import DrapeStart, drape_at_rest, drape_worn, needed_length, sew_and_dress
from recovery.pattern.coordinates import control_points
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.symmetry import Symmetries, find_symmetries, free_controls, symmetrised
from recovery.progress import Say
from recovery.sim.skin_contact import SignedDistance

GRADINGS = 2  # one is linear: a second one mostly halves what the first one left
ROUNDS = 3
# Where surfaces are this far apart (root mean square) at the first round's start, or at the end of a round, the reach
# may hold the search back: the next round's is as many times larger. A small reach keeps what a drape hardly shows as
# it is in the graded base.
START_FAR_MM, FAR_MM, REACH_GROWS = 10.0, 3.0, 3.0
LAID_FAR_MM = 5.0  # a base that springs lay nearer (root mean square) is not graded: that narrows what is gathered


@dataclass(frozen=True)
class RoundsOptions:
    """The options of a recovery: ``drape`` of every garment on the way, ``fit`` of every search, whose loss doubles
    where its unknowns are ``reach_m`` [m] from the graded base.

    ``meshes_m`` are the edge lengths [m] of the rounds. By default there are ``ROUNDS`` with that of ``drape``, or a
    single one for a garment that springs lay on its target (``is_laid``), whose edges have at most ``EDGE_M``. Adam's
    steps are taken in the first round alone. Each round writes a ``state_file`` of its own, numbered from the second
    on, and goes on from it. Raises ``InputError`` for a reach that is not positive, and for no rounds.
    """

    drape: SewingOptions = field(default_factory=SewingOptions)
    fit: FitOptions = DEFAULT_OPTIONS
    reach_m: float = REACH_M
    meshes_m: Sequence[float] | None = None
    state_file: Path | None = None

    def __post_init__(self) -> None:
        if not self.reach_m > 0.0:
            got, cure = f"{self.reach_m:g}", "Leave it at its default."
            raise InputError("reach (--reach)", expected="more than 0 m", got=got, cure=cure)
        if self.meshes_m is not None and not self.meshes_m:
            raise InputError("meshes_m", expected="an edge length or more", got="none", cure="Leave it at its default.")

    def lengths_m(self, *, laid: bool) -> list[float]:
        """Returns the edge lengths [m] of the rounds, those of cloth that springs lay (``laid``) at most ``EDGE_M``."""
        lengths = self.meshes_m or [self.drape.edge_length_m] * (1 if laid else ROUNDS)
        return [min(length, EDGE_M) if laid else length for length in lengths]


def recover_pattern(
    target: TargetSurface,
    base: Pattern,
    body: BodyModel,
    options: RoundsOptions | None = None,
    *,
    pose: np.ndarray | None = None,
    report: Say | None = None,
) -> Recovered:
    """Returns the pattern whose drape on ``body`` is nearest to ``target``, in the T-pose or in ``pose`` [rad] (24, 3),
    with all that led to it.

    The target is one garment's surface, open where the garment is; ``base`` is a pattern of its kind with the same
    panels. ``report`` gets lines on what was found. Raises ``InputError`` where contours have no counterpart or a drape
    does not come to rest. When the time is up (``recovery.progress``) the best so far is returned.
    """
    began = clocks()
    rounds = _prepared(target, base, body, options or RoundsOptions(), pose, report or (lambda line: None))
    first, rounds = rounds.with_base()
    graded, start = rounds.graded_start(first)
    searched, left = rounds.searched(start, graded.pattern, began)
    return rounds.best_of(searched, left, first, graded)


def _prepared(
    target: TargetSurface, base: Pattern, body: BodyModel, options: RoundsOptions, pose: np.ndarray | None, say: Say
) -> _Rounds:
    """The base made symmetric and sewable, and the body's distances."""
    symmetries = find_symmetries(base)
    base = symmetrised(base, symmetries)
    base = sewable(base, base, symmetries)
    for line in symmetries.describe(base):
        say(f"symmetry  {line}")
    bare = options.drape.skin(body.v_template, body.faces)
    skin = bare if pose is None else options.drape.skin(body.posed_vertices(pose[None])[0], body.faces)
    rounds = _Rounds(target, body, pose, bare, skin, base, symmetries, options, (), say)
    if rounds.lays:
        options = replace(options, drape=laying_options(options.drape))
    return replace(rounds, options=options, lengths_m=tuple(options.lengths_m(laid=rounds.lays)))


@dataclass(frozen=True, eq=False)
class _Rounds:
    """The facts that no round changes: the target, and the body with its distances in the T-pose and in its pose.

    ``bare`` is the distance in the T-pose, ``skin`` that in the pose. ``base`` says how long seams are. ``lengths_m``
    are the edge lengths [m] of the rounds.
    """

    target: TargetSurface
    body: BodyModel
    pose: np.ndarray | None
    bare: SignedDistance
    skin: SignedDistance
    base: Pattern
    symmetries: Symmetries
    options: RoundsOptions
    lengths_m: tuple[float, ...]
    say: Say

    # --- base and grading ---

    def with_base(self) -> tuple[Draped, _Rounds]:
        """A drape of the base, and the rounds on meshes on which such a garment is worn."""
        drape = self.options.drape
        with watch.stage("drape of the base"):
            first = drape_worn(self.base, self.start(drape), rest=False)
        longest = needed_length(first, drape)
        return first, replace(self, lengths_m=tuple(min(length, longest) for length in self.lengths_m))

    def graded_start(self, first: Draped) -> tuple[Graded, Draped]:
        """The base graded by its drape ``first``, and the drape that the first search starts from."""
        with watch.stage("drape of the graded base"):
            plain = ungraded(self.base)
            graded, start = self.nearer(plain, first) if self.lays else self.best_graded(plain, first, GRADINGS)
        if not math.isnan(graded.misfit):
            self.say(
                f"graded    widths times {graded.widths.min():.3f} to {graded.widths.max():.3f}, heights "
                f"{graded.heights.min():.3f} to {graded.heights.max():.3f}; misfit {100 * graded.misfit:.1f} %"
            )
        return graded, start

    def graded(self, before: Graded, draped: Draped) -> tuple[Graded, Draped]:
        """``before`` graded once more by its drape ``draped``, and the drape of that."""
        contours = open_contours(*draped.surface)
        grading = grade(draped.mesh, draped.nodes, contours, self.matches(draped)[0], self.symmetries)
        after = combine_grades(before, grading)
        after = replace(after, pattern=sewable(after.pattern, self.base, self.symmetries))
        return after, drape_worn(after.pattern, self.start(self.drape), rest=False)

    def best_graded(self, base: Graded, draped: Draped, times: int) -> tuple[Graded, Draped]:
        """``base``, whose drape is ``draped``, graded up to so many ``times``; the last one worn right and at rest."""
        start, tried = self.start(self.drape), [self.graded(base, draped)]
        with suppress(InputError):  # panels that shrink too far, or a drape that lost a part
            while len(tried) < times:
                tried.append(self.graded(*tried[-1]))
        best, worn = min(reversed(tried), key=lambda pair: (len(start.lost(pair[1])), not pair[1].at_rest))
        return best, worn if worn.at_rest else drape_at_rest(best.pattern, start)

    def nearer(self, base: Graded, draped: Draped) -> tuple[Graded, Draped]:
        """``base``, whose drape is ``draped``, or, where springs do not lay that near, graded if it is then nearer."""

        def far_mm(draped: Draped) -> float:
            return apart_mm(self.surface(lay_on_target(draped, self.target, self.skin, self.cloth)))

        self.say(f"laid      the base within {(before := far_mm(draped)):.2f} mm (root mean square)")
        after = self.graded(base, draped) if before > LAID_FAR_MM else (base, draped)
        return after if after[1] is not draped and far_mm(after[1]) < before else (base, draped)

    # --- searches ---

    def searched(self, start: Draped, graded: Pattern, began: np.ndarray) -> tuple[list[Round], str]:
        """The searches, one after the other, each on a new mesh of the pattern that the one before found.

        With them why the last ones were left out, empty for none. The first goes from the drape ``start`` of the
        pattern ``graded``; its clocks ``began`` earlier. The pattern of the last is sewn, too.
        """
        reach_m, left = self.options.reach_m, ""
        rounds: list[Round] = []
        for number, length in enumerate(self.lengths_m):
            start, left = self._next_start(rounds, start, length)
            far_m2, limit = (rounds[-1].least[1], FAR_MM) if number else (self.surface(start), START_FAR_MM)
            held_back = apart_mm(far_m2) > limit
            if not left and number:
                why = why_left(rounds, start)
                left = "" if why == SAME and held_back else why
            reach_m *= REACH_GROWS if held_back else 1.0
            if not left:
                search, matches = self.search(start, graded, self.cloth, reach_m)
                if number and not self.lays and not search.rests(start.nodes):
                    left = NOT_AT_REST
            if left:
                self.say(f"round {number + 1}   left: {left}")
                left = "" if left == SAME else f"round {number + 1} of {len(self.lengths_m)}: {left}"
                break
            rounds.append(self._round(start, search, matches, number, began))
            began = clocks()
        if rounds[-1].sewn is None and not watch.over():
            with watch.stage("the last round's pattern, sewn"), suppress(InputError):
                rounds[-1] = self.sewn(rounds[-1], self.lengths_m[-1])[0]
        return rounds, left

    def _next_start(self, rounds: list[Round], start: Draped, length_m: float) -> tuple[Draped, str]:
        """The drape from which the next round starts, and why there is none, empty if there is one.

        The last of ``rounds`` gets the drape as well: its pattern, sewn.
        """
        if not rounds:
            return (start if self.lays else self.held(start, self.cloth)), ""
        if watch.over():
            return start, "the time is up"
        try:
            with watch.stage(f"drape of round {len(rounds) + 1}"):
                rounds[-1], start = self.sewn(rounds[-1], length_m)
        except InputError as error:
            return start, f"the pattern sewn anew is not worn so: {error}"
        return start, ""

    def _round(
        self, start: Draped, search: PatternSearch, matches: list[Match], number: int, began: np.ndarray
    ) -> Round:
        """Runs the ``search`` of a round; says how near it came."""
        if not number:
            self.say(f"search    {search.free.count} numbers are free, {start.mesh.node_count} nodes")
        steps, file = self.options.fit, self.options.state_file
        if number:
            steps = replace(steps, iterations=0, closing=max(steps.closing, 1))
            file = file and file.with_stem(f"{file.stem}_{number}")
        with watch.stage(f"round {number + 1}"):
            fitted = search.run(start.nodes, steps, state_file=file)
        finished = Round(start, matches, search, fitted, self.lengths_m[number], *(clocks() - began).tolist())
        first, last = (apart_mm(surface) for surface in (fitted.history[0, 1], finished.surface_m2))
        self.say(f"round {number + 1}   {start.mesh.node_count} nodes: surfaces {first:.2f} to {last:.2f} mm apart")
        return finished

    def search(
        self, start: Draped, centre: Pattern, cloth: OrthotropicMaterial, reach_m: float
    ) -> tuple[PatternSearch, list[Match]]:
        """The search from ``start`` in ``cloth`` with this reach [m], and how its contours are paired.

        The corners of ``centre`` are what the reach of the loss is counted from.
        """
        contours = open_contours(*start.surface)
        matches, _ = self.matches(start)
        controls = free_controls(start.mesh.pattern, self.symmetries)
        belt = belt_of(start, matches, self.target.contours)
        forward = RestDrape(start.mesh, self.skin, cloth, held=start.rest.held, belt=belt)
        if self.lays:
            forward = LaidDrape(start.mesh, self.skin, cloth, self.target)
        search = PatternSearch(
            start.mesh,
            controls,
            forward,
            Objective(start.mesh, self.target, contours, matches),
            seams=SeamConstraint(start.mesh.pattern, controls, self.base),
            reach_m=reach_m,
            likely=controls.values(control_points(centre).positions),
        )
        return search, matches

    def sewn(self, last: Round, length_m: float) -> tuple[Round, Draped]:
        """``last`` with its pattern sewn on a mesh of edges ``length_m``, and that drape as it is worn.

        Raises ``InputError`` where it cannot be sewn.
        """
        cloth, drape = last.fitted.cloth, replace(self.options.drape, edge_length_m=length_m)
        start, shown = self.start(drape, cloth), Shown(last.search.mesh_of(last.fitted), last.fitted.nodes)

        def far_m2(draped: Draped) -> float:
            return self.surface(draped) if draped.at_rest and not start.lost(draped) else math.inf

        dressing = Dressing(self.skin, cloth, self.lays, lambda draped: self.held(draped, cloth), start.lost, far_m2)
        pair = sew_and_dress(last.fitted.pattern, start, dressing, shown, rest=not self.lays)
        return replace(last, sewn=pair, sewn_m2=far_m2(pair.worn)), pair.worn

    def best_of(self, rounds: list[Round], left: str, base: Draped, graded: Graded) -> Recovered:
        """The best of ``rounds`` with all that led there."""
        best, fabric = min(rounds, key=lambda finished: finished.rank), self.options.drape.fabric
        # The base's own note names another cloth than the draped one. A cutter knows a bolt by name and weight.
        bolt = f"{fabric} {1e3 * best.fitted.cloth.density_kg_m2:.0f} g/m²"
        fitted = replace(best.fitted, pattern=replace(best.fitted.pattern, material=bolt))
        far = [apart_mm(squared) for squared in (rounds[0].fitted.history[0, 1], best.surface_m2, best.sewn_m2)]
        ends = f"{far[0]:.2f} mm apart at the start, {far[1]:.2f} mm at the end, {far[2]:.2f} mm sewn"
        self.say(f"fitted    surfaces {ends} (root mean square)")
        return Recovered(
            symmetries=self.symmetries,
            base=base,
            graded=graded,
            start=best.start,
            matches=best.matches,
            holes=self.matches(best.start)[1],
            search=best.search,
            fitted=fitted,
            edge_length_m=best.edge_length_m,
            sewn=best.sewn,
            rounds=tuple(rounds),
            left=left,
            fabric=fabric,
        )

    # --- what steps share ---

    @property
    def drape(self) -> SewingOptions:
        """The options on the first round's mesh."""
        return replace(self.options.drape, edge_length_m=self.lengths_m[0])

    @cached_property
    def cloth(self) -> OrthotropicMaterial:
        """The fabric as it is draped."""
        return hanging(self.options.drape.fabric, self.options.drape.hangs_longer)

    @cached_property
    def lays(self) -> bool:
        """Whether the garment is laid in the target's folds."""
        return is_laid(self.base, [place.part for place in self.places])

    @cached_property
    def places(self) -> list[ContourPlace]:
        """Where the target's contours lie on the body."""
        chains = bone_chains(posed_joints(self.body, self.pose))
        return [place_of(contour, chains) for contour in self.target.contours]

    def start(self, drape: SewingOptions, cloth: OrthotropicMaterial | None = None) -> DrapeStart:
        """How drapes begin on this body; what the target goes round, they should."""
        parts = [place.part for place in self.places if place.part is not None]
        return DrapeStart(self.body, drape, self.pose, self.bare, tuple(parts), cloth)

    def matches(self, draped: Draped) -> tuple[list[Match], list[int]]:
        """Pairs of the contours of a drape and those of the target, and the target's that are left."""
        contours = open_contours(*draped.surface)
        return match_contours(contours, self.target.contours, posed_joints(self.body, self.pose))

    def surface(self, draped: Draped) -> float:
        """The squared distance [m^2] of a drape and the target, both directions summed, as the loss has it."""
        objective = Objective(draped.mesh, self.target, [], [])
        return float(objective.surface(torch.from_numpy(draped.nodes)))

    def held(self, draped: Draped, cloth: OrthotropicMaterial) -> Draped:
        """``draped`` with its belt where the target's is, or let go from the target's folds."""
        if self.lays:
            return let_go(lay_on_target(draped, self.target, self.skin, cloth), self.skin, cloth)
        return hold_as_target(draped, self.matches(draped)[0], self.target.contours, self.skin, cloth)
