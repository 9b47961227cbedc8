"""One recovery from file to files: target read, wearer found, pattern fitted, garment sewn anew, files written."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from drape.garment.contours import lost_parts, lost_words
from drape.garment.files.mesh import GarmentMesh
from drape.garment.intake import garment_name
from drape.garment.mesh_checks import Unit, Up, place
from recovery import progress as watch
from recovery.drape.output import panel_texture, write_rest, write_shape
from recovery.drape.pipeline import DrapeOptions
from recovery.drape.posing import posed_joints
from recovery.fit.chamfer import Chamfer, SurfaceDistance, surface_chamfer, surface_distance
from recovery.fit.optimise import REACH_M, FitOptions
from recovery.fit.pipeline import recover_pattern
from recovery.fit.recovered import Recovered
from recovery.pattern.bases import BASES, base_pattern, read_values
from recovery.pattern.export import export_pattern
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern
from recovery.pattern.style import NO_STYLE, Style, finished, lined
from recovery.run.anew import SewnAnew, sewn_anew
from recovery.run.cut import Cut, collarless, differences, kind_of, panel_count, told_base
from recovery.run.drafted import drafted
from recovery.run.identify import Identifiability, identifiability
from recovery.run.nested import in_other_size
from recovery.run.retarget import Worn, retargeted
from recovery.run.seen import Seen, pieces
from recovery.run.styled import styled
from recovery.run.target import OPENINGS, check_base, off_skin, opened, placed_target, read_target
from recovery.run.wearer import Front, Wearer, inside_wearer, read_wearer
from recovery.scan.holes import known_faces
from recovery.scan.places import ScanFault, on_body

FIT_INSIDE = "fit"  # --body fit
LEAST_TOLERANCE_M = 1e-3  # below a millimetre no scan tells
MINUTES = 20.0
SEARCH_SHARE = 0.7  # of the time until the best so far is taken; the rest is for sewing anew and for other bodies
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Job:
    """The request: ``body`` is a name, a file, or ``fit``; ``base`` is a base pattern's name or a JSON file, None
    for the one that the target tells.

    ``settings`` of a base are texts NAME=NUMBER, lengths in metres.
    ``meshes_m`` are the edge lengths [m] of the rounds, by default three times that of ``drape``. After ``minutes``
    the best so far is written. The pattern is written in ``sizes`` beside M, which fits the body, and with the lines of
    ``style``.
    """

    target: Path
    out: Path
    base: str | None
    body: str
    betas: np.ndarray | None = None
    pose: np.ndarray | None = None
    name: str | None = None
    label: str | None = None
    settings: Sequence[str] = ()
    unit: Unit = "auto"
    up: Up = "auto"
    front: Front = "auto"
    drape: DrapeOptions = field(default_factory=DrapeOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    reach_m: float = REACH_M
    meshes_m: Sequence[float] | None = None
    retarget: bool = True
    garment: bool = True
    minutes: float = MINUTES
    sizes: Sequence[str] = ()
    style: Style = NO_STYLE


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a job. ``target`` and ``nodes`` [m] (N, 3) lie in the body's frame, without ``wearer.trans``.

    ``made`` is what is written: the recovered pattern with the lines of ``style``.
    ``anew`` is the recovered pattern sewn from flat panels, ``sewn_distance`` its distance from the target; None if
    that was refused. ``warnings`` are sentences.
    """

    job: Job
    name: str
    target: GarmentMesh
    wearer: Wearer
    base: Pattern
    cut: Cut
    found: Recovered
    distance: SurfaceDistance
    before: SurfaceDistance
    chamfer: Chamfer
    floor: Chamfer
    told: Identifiability
    anew: SewnAnew | None
    sewn_distance: SurfaceDistance | None
    worn: list[Worn]
    files: list[Path]
    warnings: list[str]
    seconds: float
    made: Pattern
    style: Style

    @property
    def nodes(self) -> np.ndarray:
        """Nodes [m] (N, 3) of the recovered garment."""
        return self.found.fitted.nodes

    @property
    def pattern(self) -> Pattern:
        """The recovered pattern, panels and seams those of the base."""
        return self.found.fitted.pattern


def read_base(source: str, wearer: Wearer, settings: Sequence[str] = ()) -> Pattern:
    """The base called ``source`` drafted with ``settings`` for ``wearer``, or the pattern in a JSON file."""
    if source in BASES:
        return base_pattern(source, measure(wearer.shaped), settings)
    path = Path(source)
    if settings:
        raise InputError(
            "--set", expected=f"a base of ours: {', '.join(sorted(BASES))}", got=source, cure="Leave --set out."
        )
    if path.suffix.lower() != ".json":
        raise InputError(
            "--base",
            expected=f"one of {', '.join(sorted(BASES))} or a JSON file",
            got=source,
            cure="Take the base of the target's kind.",
        )
    return read_pattern(path)


class Prepared(NamedTuple):
    """The target in the wearer's frame, the wearer, the base, notes on what was repaired, and the cut."""

    mesh: GarmentMesh
    wearer: Wearer
    base: Pattern
    notes: list[str]
    cut: Cut


def prepare(job: Job) -> Prepared:
    """What a recovery begins with; all checks are here."""
    try:
        mesh = read_target(job.target, label=job.label)
    except ScanFault as fault:
        raise _placed_fault(fault, job) from fault
    shown = pieces(mesh)
    if job.body == FIT_INSIDE:
        if job.betas is not None or job.pose is not None:
            raise InputError(
                "--body fit",
                expected="a body whose shape and pose are looked for",
                got="--betas or --pose",
                cure="Leave them out, or name the body.",
            )
        standard = read_wearer("anny_default")
        kind = job.base or kind_of(mesh)
        names = [kind, "strapless_dress"] if kind == "skirt" and not job.base else [kind]  # from waist or chest
        bases = [read_base(one, standard, job.settings if job.base else ()) for one in names]
        mesh, wearer = inside_wearer(mesh, bases, unit=job.unit, up=job.up, front=job.front, wanted=OPENINGS.get(kind))
        mesh = placed_target(mesh, wearer.skin, unit="m", up="y")
    else:
        kind = job.base
        wearer = read_wearer(job.body, betas=job.betas, pose=job.pose)
        mesh = placed_target(mesh, wearer.skin, unit=job.unit, up=job.up)
    mesh = replace(mesh, vertices=mesh.vertices - wearer.trans)
    joints = posed_joints(wearer.shaped, wearer.pose)
    with watch.stage("openings are told from holes"):
        mesh, there = opened(mesh, joints, None if kind is None else OPENINGS.get(kind))
    if job.base is not None:
        check_base(job.base, there)
    mesh, collar, collar_m = collarless(mesh, wearer.shaped, joints, there)
    base, cut = _near_target(job, mesh, wearer, joints, shown)
    cut = replace(cut, differs=(*collar, *cut.differs), collar_m=collar_m)
    if job.style:  # refused before an hour of drapes as well
        finished(lined(base, job.style), job.style)
    for size in job.sizes:  # refused before an hour of drapes, not after it
        in_other_size(base, cut.base, measure(wearer.shaped), cut.settings, size)
    notes = [f"On reading: {note}." for note in mesh.notes]
    if cut.told:
        notes.append(f"The base was chosen by the target's openings: {cut.base}.")
    if wearer.residual_mm > 0.0:
        notes.append(f"The wearer is {wearer.source}. What it lacks in shape, the pattern makes up for.")
    notes += [f"{sentence}." for sentence in cut.differs]
    return Prepared(mesh, wearer, base, notes, cut)


def _near_target(
    job: Job, mesh: GarmentMesh, wearer: Wearer, joints: np.ndarray, shown: int | None
) -> tuple[Pattern, Cut]:
    """The base drafted near the target ``mesh``, whose texture shows ``shown`` panels, and the cut."""
    body = measure(wearer.shaped)
    seen = Seen(mesh.vertices, mesh.faces, joints, wearer.shaped.joints_template)
    name = job.base or told_base(seen, body)
    settings: dict[str, float] = {}
    if name in BASES:
        given = read_values(job.settings)
        pattern, settings = drafted(name, body, seen, panel_count(name, shown) | given)
    else:
        pattern = read_base(name, wearer, job.settings)
    return pattern, Cut(name, job.base is None, settings, differences(name, pattern, seen, body, shown))


def _placed_fault(fault: ScanFault, job: Job) -> ScanFault:
    """``fault`` with its place on the wearer, where a wearer is given; otherwise it has its place in the file."""
    if fault.mesh is None or job.body == FIT_INSIDE:
        return fault
    wearer = read_wearer(job.body, betas=job.betas, pose=job.pose)
    try:
        both = replace(fault.mesh, vertices=np.concatenate([fault.mesh.vertices, fault.points]))
        both = place(both, wearer.skin, unit=job.unit, up=job.up).vertices
    except InputError:
        return fault
    count = len(fault.mesh.vertices)
    placed, points = replace(fault.mesh, vertices=both[:count]), both[count:]
    joints = posed_joints(wearer.shaped, wearer.pose) + wearer.trans
    words = on_body(points[0], placed, joints)
    return ScanFault(fault.name, expected=fault.expected, got=f"{fault.got}; {words}", cure=fault.cure).at(
        placed, points
    )


def run_job(job: Job, *, progress: Say = lambda line: None, say: Say = print) -> Outcome:
    """Does ``job``; writes pattern and garment as soon as they are found. Raises ``InputError`` for what it refuses.

    ``progress`` gets a line on how far it is every few seconds, ``say`` what was found.
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
    mesh, wearer, base, warnings, cut = prepare(job)
    name = garment_name(job.name or job.target.stem)
    base = replace(base, name=name)
    known = known_faces(mesh)
    more_m = off_skin(replace(mesh, vertices=mesh.vertices + wearer.trans), wearer.skin, known)
    job = replace(job, drape=replace(job.drape, off_skin_m=more_m))
    if more_m:
        warnings.append(
            f"The target lies {1e3 * more_m:.1f} mm farther off the skin than our cloth; the drape does too."
        )
    for note in warnings:
        say(f"note      {note}")
    say(f"target    {len(mesh.vertices):,} vertices, {len(mesh.faces):,} triangles, on {wearer.source}")
    job.out.mkdir(parents=True, exist_ok=True)
    with watch.within(SEARCH_SHARE):
        found = recover_pattern(
            mesh.vertices,
            mesh.faces,
            base,
            wearer.shaped,
            drape=job.drape,
            fit=job.fit,
            reach_m=job.reach_m,
            pose=wearer.pose,
            meshes_m=job.meshes_m,
            state_file=job.out / f"{name}.search.npz",
            report=say,
            known=known,
        )
    if clock.stopped_in:
        warnings.append(stopped_words(job.minutes, clock.stopped_in))
    fitted = found.fitted
    style, with_lines, made = styled(job.style, cut, fitted.pattern, warnings)
    files = export_pattern(made, job.out)
    for size in job.sizes:
        graded = in_other_size(fitted.pattern, cut.base, measure(wearer.shaped), cut.settings, size)
        graded = styled(style, replace(cut, collar_m=0.0), graded, told := [])[2]
        warnings += [f"Size {size}: {words}" for words in told if words not in warnings]
        files += export_pattern(replace(graded, name=f"{name}_{size}"), job.out)
    cloth = found.search.mesh_of(fitted)
    files += write_shape(job.out, name, cloth, fitted.nodes + wearer.trans, panel_texture(cloth))
    there = (mesh.vertices, mesh.faces)
    distance = surface_distance((fitted.nodes, cloth.faces), there, known=known)
    chamfer, floor = surface_chamfer((fitted.nodes, cloth.faces), there, known=known)
    say(
        f"distance  {distance.mean_mm:.2f} mm mean, {distance.largest_mm:.1f} largest; Chamfer "
        f"{chamfer.squared_cm2:.4f} cm^2, floor {floor.squared_cm2:.4f}"
    )
    with watch.stage("what the target tells"):
        told = identifiability(found, max(LEAST_TOLERANCE_M, 1e-3 * distance.rms_mm))
    anew, worn = _sewn_anew(job, wearer, found, with_lines, warnings, say)
    sewn_distance = None
    if anew is not None:
        sewn_distance = surface_distance((anew.draped.nodes, anew.draped.mesh.faces), there, known=known)
        say(f"sewn      {sewn_distance.mean_mm:.2f} mm from the target on average")
        # In the cache the garment of a body of another shape is moved to the standard one.
        avatar = {"betas": wearer.betas.tolist()} if wearer.betas.any() else "standard"
        files += write_rest(job.out, name, anew.draped, wearer.standard, avatar=avatar, garment=job.garment, report=say)
    return Outcome(
        job=job,
        name=name,
        target=mesh,
        wearer=wearer,
        base=base,
        cut=cut,
        found=found,
        distance=distance,
        before=surface_distance((found.base.nodes, found.base.mesh.faces), there, known=known),
        chamfer=chamfer,
        floor=floor,
        told=told,
        anew=anew,
        sewn_distance=sewn_distance,
        worn=worn,
        files=files,
        warnings=warnings,
        seconds=time.perf_counter() - started,
        made=made,
        style=style,
    )


def _sewn_anew(
    job: Job, wearer: Wearer, found: Recovered, pattern: Pattern, warnings: list[str], say: Say
) -> tuple[SewnAnew | None, list[Worn]]:
    """The ``pattern``, with its style lines, sewn from flat panels, and the garment elsewhere."""
    cloth = found.fitted.cloth
    parts = [match.place.part for match in found.matches if match.place.part is not None]
    options = replace(job.drape, edge_length_m=found.edge_length_m)
    try:
        with watch.stage("sewn anew"):
            anew = sewn_anew(found, wearer.shaped, options, wearer.pose, parts, pattern)
    except InputError as error:
        warnings.append(f"The recovered pattern cannot be sewn from flat panels, so there is no garment cache: {error}")
        return None, []
    say(
        f"sewn anew {anew.distance.mean_mm:.2f} mm from the search's drape on average, {anew.distance.largest_mm:.1f} "
        f"largest; by itself {anew.by_itself.mean_mm:.2f}"
    )
    draped = anew.draped
    if lost := lost_parts(draped.rest.nodes, draped.mesh.faces, wearer.shaped.joints_template, parts):
        warnings.append(f"Sewn anew in the T-pose, {lost_words(lost)}: the garment cache is not worn as the target is.")
    worn = []
    if job.retarget and watch.over():
        warnings.append(f"Other bodies and poses were left out: {job.minutes:g} minutes (--minutes) were over.")
    elif job.retarget:
        for place in retargeted(pattern, draped, wearer.shaped, wearer.standard, job.drape, parts, cloth=cloth):
            say(f"worn      {place.what}: {place.refusal or describe_worn(place)}")
            worn.append(place)
    return anew, worn


def stopped_words(minutes: float, stage: str) -> str:
    """The sentence of a report whose search ended with its time."""
    return (
        f"The search ended with its time, {SEARCH_SHARE:.0%} of {minutes:g} minutes (--minutes), during: {stage}. The "
        "pattern is the best so far."
    )


def describe_worn(place: Worn) -> str:
    """A phrase on how the garment lies there."""
    figures = place.figures
    end = "at rest" if figures["converged"] else f"not at rest ({figures['force_left_n']:.1e} N left)"
    lost = f"; {lost_words(place.lost)}" if place.lost else ""
    return (
        f"{end}{lost}; stretched by {figures['stretch_median_pct']:.1f} % (99th percentile "
        f"{figures['stretch_p99_pct']:.0f} %), {figures['edges_in_body_pct']:.1f} % of edges cut the body"
    )
