"""One recovery from file to files: the task read, its pattern searched, written, measured, and sewn anew."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from drape.garment.contours import lost_parts, lost_words
from recovery import progress as watch
from recovery.drape.output import panel_texture, write_rest, write_shape
from recovery.drape.pattern_drape import Draped
from recovery.fit.chamfer import Chamfer, SurfaceDistance, surface_chamfer, surface_distance
from recovery.fit.recovered import Recovered
from recovery.fit.rounds import recover_pattern
from recovery.pattern.export import export_pattern
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern
from recovery.pattern.style import Style
from recovery.run.anew import SewnAnew, sewn_anew
from recovery.run.elsewhere import WornElsewhere, retargeted
from recovery.run.identify import Identifiability, identifiability
from recovery.run.nested import in_other_size
from recovery.run.styled import styled
from recovery.run.task import Job, Task, prepare

LEAST_TOLERANCE_M = 1e-3  # below a millimetre no scan tells
SEARCH_SHARE = 0.7  # of the time until the best so far is taken; the rest is for sewing anew and for other bodies
Say = Callable[[str], None]


class Written(NamedTuple):
    """The recovered pattern as it was written: ``with_lines``, the pattern with the lines of ``style``, and ``made``,
    the same with all that is drafted besides; the ``files``."""

    with_lines: Pattern
    made: Pattern
    style: Style
    files: list[Path]


class Nearness(NamedTuple):
    """How near the garment lies to the target: its ``distance``, that of the base ``before``, the ``chamfer`` distance
    and its ``floor``; and what of the pattern the target ``told``."""

    distance: SurfaceDistance
    before: SurfaceDistance
    chamfer: Chamfer
    floor: Chamfer
    told: Identifiability


class Sewn(NamedTuple):
    """The pattern sewn from flat panels, its ``distance`` from the target, the garment elsewhere, and files of it.

    ``anew`` and ``distance`` are None where it cannot be sewn.
    """

    anew: SewnAnew | None
    distance: SurfaceDistance | None
    worn: list[WornElsewhere]
    files: list[Path]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a job, step by step."""

    task: Task
    found: Recovered
    written: Written
    near: Nearness
    sewn: Sewn
    seconds: float

    @property
    def nodes(self) -> np.ndarray:
        """Nodes [m] (N, 3) of the recovered garment, in the frame of the target."""
        return self.found.fitted.nodes

    @property
    def pattern(self) -> Pattern:
        """The recovered pattern, panels and seams those of the base."""
        return self.found.fitted.pattern

    @property
    def files(self) -> list[Path]:
        """Every file that was written."""
        return [*self.written.files, *self.sewn.files]


def run_job(job: Job, *, progress: Say = lambda line: None, say: Say = print) -> Outcome:
    """Does ``job`` and returns its outcome. Pattern and garment are written as soon as they are found.

    ``progress`` is called every few seconds with a line on how far it is, ``say`` with what was found. Raises
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


def _run(job: Job, clock: watch.Watch, say: Say) -> Outcome:
    started = time.perf_counter()
    task = prepare(job)
    for note in task.warnings:
        say(f"note      {note}")
    say(f"target    {len(task.mesh.vertices):,} vertices, {len(task.mesh.faces):,} triangles, on {task.wearer.source}")
    search = searched(task, say)
    if clock.stopped_in:
        task.warnings.append(stopped_words(job.minutes, clock.stopped_in))
    written = write_pattern(task, search)
    near = measured(task, search, say)
    sewn = sewn_and_worn(task, search, written.with_lines, say)
    return Outcome(task, search, written, near, sewn, time.perf_counter() - started)


def searched(task: Task, say: Say) -> Recovered:
    """The pattern whose drape is nearest to the target, within the search's share of the time."""
    job = task.job
    job.out.mkdir(parents=True, exist_ok=True)
    with watch.within(SEARCH_SHARE):
        return recover_pattern(
            *task.surface,
            task.base,
            task.wearer.shaped,
            drape=job.drape,
            fit=job.fit,
            reach_m=job.reach_m,
            pose=task.wearer.pose,
            meshes_m=job.meshes_m,
            state_file=job.out / f"{task.name}.search.npz",
            report=say,
            known=task.known,
        )


def write_pattern(task: Task, found: Recovered) -> Written:
    """Writes the pattern in all of its sizes, and the garment of the search."""
    job, cut, fitted, wearer = task.job, task.cut, found.fitted, task.wearer
    style, with_lines, pattern = styled(job.style, cut, fitted.pattern, task.warnings)
    files = export_pattern(pattern, job.out)
    for size in job.sizes:
        graded = in_other_size(fitted.pattern, cut.base, measure(wearer.shaped), cut.settings, size)
        graded = styled(style, replace(cut, collar_m=0.0), graded, told := [])[2]
        task.warnings.extend(f"Size {size}: {words}" for words in told if words not in task.warnings)
        files += export_pattern(replace(graded, name=f"{task.name}_{size}"), job.out)
    cloth = found.search.mesh_of(fitted)
    files += write_shape(job.out, task.name, cloth, fitted.nodes + wearer.trans, panel_texture(cloth))
    return Written(with_lines, pattern, style, files)


def measured(task: Task, found: Recovered, say: Say) -> Nearness:
    """How near the garment of the search is to the target, and which shapes of the pattern the target tells."""
    here = (found.fitted.nodes, found.search.mesh_of(found.fitted).faces)
    distance = surface_distance(here, task.surface, known=task.known)
    before = surface_distance((found.base.nodes, found.base.mesh.faces), task.surface, known=task.known)
    chamfer, floor = surface_chamfer(here, task.surface, known=task.known)
    say(
        f"distance  {distance.mean_mm:.2f} mm mean, {distance.largest_mm:.1f} largest; Chamfer "
        f"{chamfer.squared_cm2:.4f} cm^2, floor {floor.squared_cm2:.4f}"
    )
    with watch.stage("what the target tells"):
        told = identifiability(found, max(LEAST_TOLERANCE_M, 1e-3 * distance.rms_mm))
    return Nearness(distance, before, chamfer, floor, told)


def sewn_and_worn(task: Task, found: Recovered, pattern: Pattern, say: Say) -> Sewn:
    """The ``pattern``, with its style lines, sewn from flat panels and worn elsewhere; writes the garment at rest."""
    job, wearer = task.job, task.wearer
    parts = [match.place.part for match in found.matches if match.place.part is not None]
    options = replace(job.drape, edge_length_m=found.edge_length_m)
    try:
        with watch.stage("sewn anew"):
            anew = sewn_anew(found, wearer.shaped, options, wearer.pose, parts, pattern)
    except InputError as error:
        words = "The recovered pattern cannot be sewn from flat panels, so there is no garment cache"
        task.warnings.append(f"{words}: {error}")
        return Sewn(None, None, [], [])
    say(
        f"sewn anew {anew.distance.mean_mm:.2f} mm from the search's drape on average, {anew.distance.largest_mm:.1f} "
        f"largest; by itself {anew.by_itself.mean_mm:.2f}"
    )
    draped = anew.draped
    if lost := lost_parts(draped.rest.nodes, draped.mesh.faces, wearer.shaped.joints_template, parts):
        words = f"Sewn anew in the T-pose, {lost_words(lost)}"
        task.warnings.append(f"{words}: the garment cache is not worn as the target is.")
    worn = _worn_elsewhere(task, found, pattern, draped, parts, say)
    distance = surface_distance((draped.nodes, draped.mesh.faces), task.surface, known=task.known)
    say(f"sewn      {distance.mean_mm:.2f} mm from the target on average")
    # In the cache the garment of a body of another shape is moved to the standard one.
    avatar = {"betas": wearer.betas.tolist()} if wearer.betas.any() else "standard"
    files = write_rest(job.out, task.name, draped, wearer.standard, avatar=avatar, garment=job.garment, report=say)
    return Sewn(anew, distance, worn, files)


def _worn_elsewhere(
    task: Task, found: Recovered, pattern: Pattern, draped: Draped, parts: list[str], say: Say
) -> list[WornElsewhere]:
    """The garment on other bodies and in other poses, where these are asked for and time is left."""
    job, wearer = task.job, task.wearer
    if not job.retarget:
        return []
    if watch.over():
        words = f"Other bodies and poses were left out: {job.minutes:g} minutes (--minutes) were over."
        task.warnings.append(words)
        return []
    worn = []
    cloth = found.fitted.cloth
    for place in retargeted(pattern, draped, wearer.shaped, wearer.standard, job.drape, parts, cloth=cloth):
        say(f"worn      {place.what}: {place.refusal or describe_worn(place)}")
        worn.append(place)
    return worn


def stopped_words(minutes: float, stage: str) -> str:
    """The sentence of a report whose search ended with its time."""
    return (
        f"The search ended with its time, {SEARCH_SHARE:.0%} of {minutes:g} minutes (--minutes), during: {stage}. The "
        "pattern is the best so far."
    )


def describe_worn(place: WornElsewhere) -> str:
    """A phrase on how the garment lies there."""
    figures = place.figures
    end = "at rest" if figures["converged"] else f"not at rest ({figures['force_left_n']:.1e} N left)"
    lost = f"; {lost_words(place.lost)}" if place.lost else ""
    return (
        f"{end}{lost}; stretched by {figures['stretch_median_pct']:.1f} % (99th percentile "
        f"{figures['stretch_p99_pct']:.0f} %), {figures['edges_in_body_pct']:.1f} % of edges cut the body"
    )
