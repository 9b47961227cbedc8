"""One recovery from file to files: the task read, its pattern searched, written, measured, and sewn anew."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery import progress as watch
from recovery.drape.output import panel_texture, write_shape
from recovery.fit.chamfer import Chamfer, SurfaceDistance, surface_chamfer, surface_distance
from recovery.fit.grading import in_other_size
from recovery.fit.objective import TargetSurface
from recovery.fit.outcome import Recovered
from recovery.fit.rounds import recover_pattern
from recovery.pattern.measurements import measure_body
from recovery.pattern.openings import COLLAR
from recovery.pattern.pattern_files import export_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.style import NO_STYLE, RIB_SHORTER, RIBS, Style, add_style_lines, cap_corners_deg, finish_pattern
from recovery.progress import Say
from recovery.run.cut import Cut
from recovery.run.identify import Identifiability, identifiability
from recovery.run.sew_anew import SewnAndWorn, sew_and_wear
from recovery.run.task import RecoveryJob, Task, prepare

LEAST_TOLERANCE_M = 1e-3  # no scan tells less than a millimetre
FAIR_DEG = 5.0  # a cap that turns at a corner by more is worth a sentence
SEARCH_SHARE = 0.7  # share of the time for the search; the rest is for sewing anew and for other bodies


class Written(NamedTuple):
    """A recovered pattern as it was written, and its ``files``: ``with_lines`` is cut along the lines of ``style``,
    ``finished`` has besides what is joined and drafted."""

    with_lines: Pattern
    finished: Pattern
    style: Style
    files: list[Path]


class Nearness(NamedTuple):
    """How near the garment of the search lies to the target: its ``distance`` and that of the base, ``before``; its
    ``chamfer`` distance, and the ``floor`` of that.

    ``identifiability`` is how well the target determines the pattern.
    """

    distance: SurfaceDistance
    before: SurfaceDistance
    chamfer: Chamfer
    floor: Chamfer
    identifiability: Identifiability


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a recovery's job, step by step, and the ``seconds`` [s] that it took."""

    task: Task
    recovered: Recovered
    written: Written
    near: Nearness
    sewn: SewnAndWorn
    seconds: float

    @property
    def nodes(self) -> np.ndarray:
        """Nodes [m] (N, 3) of the recovered garment, in the frame of the wearer's body."""
        return self.recovered.fitted.nodes

    @property
    def pattern(self) -> Pattern:
        """The recovered pattern, with the panels and seams of the base."""
        return self.recovered.fitted.pattern

    @property
    def files(self) -> list[Path]:
        """The paths of all files that were written but for the report's."""
        return [*self.written.files, *self.sewn.files]


def run_job(job: RecoveryJob, *, progress: Say = lambda line: None, say: Say = print) -> Outcome:
    """Returns the outcome of ``job``, whose pattern and garment are written as soon as they are found.

    ``progress`` is called every few seconds with a line on how far it is, ``say`` with lines on what was found. Raises
    ``InputError`` for what it refuses.
    """
    with watch.watched(write=progress, limit_s=60.0 * job.minutes) as clock:
        try:
            return _run(job, clock, say)
        except InputError as error:
            if not clock.stopped_in:
                raise
            raise InputError(
                "--minutes",
                expected="time for a first drape and its search",
                got=f"{job.minutes:g} minutes, over during: {clock.stopped_in}",
                cure="Give it more, or a coarser mesh (--edge-length).",
            ) from error


def _run(job: RecoveryJob, clock: watch.Watch, say: Say) -> Outcome:
    started = time.perf_counter()
    task = prepare(job)
    for note in task.warnings:
        say(f"note      {note}")
    say(f"target    {len(task.mesh.vertices):,} vertices, {len(task.mesh.faces):,} triangles, on {task.wearer.source}")
    recovered = search_pattern(task, say)
    if clock.stopped_in:
        task.warnings.append(stopped_words(job.minutes, clock.stopped_in))
    written = write_finished(task, recovered)
    near = measure_nearness(task, recovered, say)
    sewn = sew_and_wear(task, recovered, written.with_lines, say)
    return Outcome(task, recovered, written, near, sewn, time.perf_counter() - started)


def search_pattern(task: Task, say: Say) -> Recovered:
    """Returns the recovery of the pattern whose drape is nearest to the target, within ``SEARCH_SHARE`` of the job's
    time."""
    job = task.job
    job.out.mkdir(parents=True, exist_ok=True)
    options = replace(job.search, state_file=job.out / f"{task.name}.search.npz")
    target = TargetSurface.from_mesh(*task.surface, known=task.known)
    wearer = task.wearer
    with watch.limit_share(SEARCH_SHARE):
        return recover_pattern(target, task.base, wearer.shaped, options, pose=wearer.pose, report=say)


def write_finished(task: Task, recovered: Recovered) -> Written:
    """Writes the pattern in all of its sizes, and the garment of the search. Returns what was written."""
    job, cut, fitted, wearer = task.job, task.cut, recovered.fitted, task.wearer
    style, with_lines, pattern = style_pattern(job.style, cut, fitted.pattern, task.warnings)
    files = export_pattern(pattern, job.out)
    for size in job.sizes:
        graded = in_other_size(fitted.pattern, cut.base, measure_body(wearer.shaped), cut.settings, size)
        graded = style_pattern(style, replace(cut, collar_m=0.0), graded, notes := [])[2]
        task.warnings.extend(f"Size {size}: {words}" for words in notes if words not in task.warnings)
        files += export_pattern(replace(graded, name=f"{task.name}_{size}"), job.out)
    cloth = recovered.search.mesh_of(fitted)
    files += write_shape(job.out, task.name, cloth, fitted.nodes + wearer.trans, panel_texture(cloth))
    return Written(with_lines, pattern, style, files)


def style_pattern(asked: Style, cut: Cut, pattern: Pattern, warnings: list[str]) -> tuple[Style, Pattern, Pattern]:
    """Returns the style of a recovered ``pattern``, the pattern cut along its lines, and that with all that is joined
    and drafted besides.

    ``asked`` is the style that the user asked for; the target's own collar (``cut``) is added unless it has one. If the
    panels have no room for the lines, all of them are left out. ``warnings`` get a sentence on that, on a collar, on
    ribs, and on sleeve caps that are not smooth.
    """
    style = asked
    if cut.collar_m and COLLAR not in asked.widths_m:
        style = replace(asked, widths_m={**asked.widths_m, COLLAR: cut.collar_m})
    try:
        with_lines = add_style_lines(pattern, style)
        cut_pattern = finish_pattern(with_lines, style)
    except InputError as error:
        warnings.append(f"The style lines ({style.words()}) were left out: {error}")
        return NO_STYLE, pattern, pattern
    if COLLAR in style.widths_m:
        warnings.append(
            f"The collar is drafted: straight, as long as the neckline, {100 * style.widths_m[COLLAR]:.1f} cm wide. "
            "It was neither draped nor fitted."
        )
    if ribs := [name for name in RIBS if name in style.widths_m]:
        shorter = ", ".join(f"{name.replace('_', ' ')} by {RIB_SHORTER[RIBS[name]]:.0%}" for name in ribs)
        warnings.append(
            f"Ribs are drafted: straight, in place of what was cut off, shorter than what holds them ({shorter}). "
            "They were neither draped nor fitted."
        )
    if turned := {name: turn for name, turn in cap_corners_deg(cut_pattern).items() if turn > FAIR_DEG}:
        words = " and ".join(f"that of {name} by {turn:.0f}" for name, turn in turned.items())
        warnings.append(f"Where halves of sleeves met, their caps turn at a corner, {words} degrees: draw them fair.")
    return style, with_lines, cut_pattern


def measure_nearness(task: Task, recovered: Recovered, say: Say) -> Nearness:
    """Returns how near the garment of the search lies to the target, and how well the target determines the pattern.
    ``say`` gets a line on it."""
    here = (recovered.fitted.nodes, recovered.search.mesh_of(recovered.fitted).faces)
    distance = surface_distance(here, task.surface, known=task.known)
    before = surface_distance((recovered.base.nodes, recovered.base.mesh.faces), task.surface, known=task.known)
    chamfer, floor = surface_chamfer(here, task.surface, known=task.known)
    say(
        f"distance  {distance.mean_mm:.2f} mm mean, {distance.largest_mm:.1f} largest; Chamfer "
        f"{chamfer.squared_cm2:.4f} cm^2, floor {floor.squared_cm2:.4f}"
    )
    with watch.stage("what the target tells"):
        limits = identifiability(recovered, max(LEAST_TOLERANCE_M, 1e-3 * distance.rms_mm))
    return Nearness(distance, before, chamfer, floor, limits)


def stopped_words(minutes: float, stage: str) -> str:
    """Returns the sentence of the report on a search of a job of ``minutes`` that ended with its time in ``stage``."""
    return (
        f"The search ended with its time, {SEARCH_SHARE:.0%} of {minutes:g} minutes (--minutes), during: {stage}. The "
        "pattern is the best so far."
    )
