"""The request of a recovery, and what it begins with: target read, wearer found, base drafted, all of it checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drape.errors import InputError
from drape.garment.files.mesh import GarmentMesh
from drape.garment.intake import garment_name
from drape.garment.mesh_checks import Unit, Up
from recovery import progress as watch
from recovery.drape.placement import posed_joints
from recovery.fit.grading import in_other_size
from recovery.fit.rounds import RoundsOptions
from recovery.pattern.bases import BASES, base_pattern, read_values
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.measurements import measure_body
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.style import NO_STYLE, Style, add_style_lines, finish_pattern
from recovery.run.cut import Cut, SeenGarment, collarless, differences, panel_count, pieces, tell_base
from recovery.run.draft import draft_near
from recovery.run.target import (
    OPENINGS,
    Front,
    TargetWearer,
    check_base,
    close_but_openings,
    inside_wearer,
    off_skin,
    placed_target,
    read_target_wearer,
)
from recovery.scan.holes import known_faces
from recovery.scan.repair import read_target

FIT_INSIDE = "fit"  # --body fit
MINUTES = 20.0


@dataclass(frozen=True, eq=False)
class RecoveryJob:
    """The request of a recovery: the file ``target``, the folder ``out``, and the options of the command line, whose
    help tells those that are not named here.

    ``body`` is a name, a file, or "fit" for a body to be fitted inside; ``base`` is a base pattern's name or a JSON
    file, None for the one that the target's openings choose. ``settings`` of a base are texts NAME=NUMBER, lengths in
    metres. After ``minutes`` the best so far is written. The pattern is written in ``sizes`` beside M, which fits the
    body, and with the lines of ``style``. ``retarget`` drapes it on other bodies, ``garment`` writes the garment cache.
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
    search: RoundsOptions = field(default_factory=RoundsOptions)
    retarget: bool = True
    garment: bool = True
    minutes: float = MINUTES
    sizes: Sequence[str] = ()
    style: Style = NO_STYLE


@dataclass(frozen=True, eq=False)
class Task:
    """A request that has been read: the target ``mesh`` [m] in the frame of the ``wearer``'s body, that is without
    ``wearer.trans``, the ``base`` drafted near it, and the ``cut`` of that.

    Faces that are not ``known`` (F,), bool, close holes; None if all are. ``warnings`` are sentences, to which every
    step adds its own.
    """

    job: RecoveryJob
    name: str
    mesh: GarmentMesh
    wearer: TargetWearer
    base: Pattern
    cut: Cut
    known: np.ndarray | None
    warnings: list[str]

    @property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [m] (V, 3) and faces (F, 3) of the target."""
        return self.mesh.vertices, self.mesh.faces


def read_base(source: str, wearer: TargetWearer, settings: Sequence[str] = ()) -> Pattern:
    """Returns the base called ``source`` drafted with ``settings`` for ``wearer``, or the pattern in the JSON file
    ``source``. Raises ``InputError`` for neither, and for settings of a file."""
    if source in BASES:
        return base_pattern(source, measure_body(wearer.shaped), settings)
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


def prepare(job: RecoveryJob) -> Task:
    """Returns the task of ``job``: all that it needs, read and checked.

    The drape's options then keep cloth as far off the skin as the target's lies. Raises ``ScanFault`` with its place in
    the file, and ``InputError``.
    """
    mesh = read_target(job.target, label=job.label)
    shown = pieces(mesh)
    mesh, wearer = _on_wearer(job, mesh)
    joints = posed_joints(wearer.shaped, wearer.pose)
    with watch.stage("openings are told from holes"):
        mesh, there = close_but_openings(mesh, joints, OPENINGS.get(job.base or ""))
    if job.base is not None:
        check_base(job.base, there)
    mesh, collar, collar_m = collarless(mesh, wearer.shaped, joints, there)
    base, cut = _near_target(job, mesh, wearer, joints, shown)
    cut = replace(cut, differs=(*collar, *cut.differs), collar_m=collar_m)
    if job.style:  # refused before an hour of drapes as well
        finish_pattern(add_style_lines(base, job.style), job.style)
    for size in job.sizes:  # refused before an hour of drapes, not after it
        in_other_size(base, cut.base, measure_body(wearer.shaped), cut.settings, size)
    known, name = known_faces(mesh), garment_name(job.name or job.target.stem)
    more_m = off_skin(replace(mesh, vertices=mesh.vertices + wearer.trans), wearer.skin, known)
    job = replace(job, search=replace(job.search, drape=replace(job.search.drape, off_skin_m=more_m)))
    return Task(job, name, mesh, wearer, replace(base, name=name), cut, known, _notes(mesh, wearer, cut, more_m))


def _on_wearer(job: RecoveryJob, mesh: GarmentMesh) -> tuple[GarmentMesh, TargetWearer]:
    """``mesh`` [m] in the frame of its wearer's body, and the wearer."""
    if job.body != FIT_INSIDE:
        wearer = read_target_wearer(job.body, betas=job.betas, pose=job.pose)
        mesh = placed_target(mesh, wearer.skin, unit=job.unit, up=job.up)
    elif job.betas is not None or job.pose is not None:
        raise InputError(
            "--body fit",
            expected="a body whose shape and pose are looked for",
            got="--betas or --pose",
            cure="Leave them out, or name the body.",
        )
    else:
        mesh, wearer = inside_wearer(mesh, unit=job.unit, up=job.up, front=job.front)
        mesh = placed_target(mesh, wearer.skin, unit="m", up="y")
    return replace(mesh, vertices=mesh.vertices - wearer.trans), wearer


def _notes(mesh: GarmentMesh, wearer: TargetWearer, cut: Cut, more_m: float) -> list[str]:
    """Sentences on what was made of the target so far."""
    notes = [f"On reading: {note}." for note in mesh.notes]
    if cut.by_openings:
        notes.append(f"The base was chosen by the target's openings: {cut.base}.")
    if wearer.residual_mm > 0.0:
        notes.append(f"The wearer is {wearer.source}. What it lacks in shape, the pattern makes up for.")
    notes += [f"{sentence}." for sentence in cut.differs]
    if more_m:
        notes.append(f"The target lies {1e3 * more_m:.1f} mm farther off the skin than our cloth; the drape does too.")
    return notes


def _near_target(
    job: RecoveryJob, mesh: GarmentMesh, wearer: TargetWearer, joints: np.ndarray, shown: int | None
) -> tuple[Pattern, Cut]:
    """The base drafted near the target ``mesh``, whose texture shows ``shown`` panels, and the cut."""
    body = measure_body(wearer.shaped)
    seen = SeenGarment(mesh.vertices, mesh.faces, joints, wearer.shaped.joints_template)
    name = job.base or tell_base(seen, body)
    settings: dict[str, float] = {}
    if name in BASES:
        given = read_values(job.settings)
        pattern, settings = draft_near(name, body, seen, panel_count(name, shown) | given)
    else:
        pattern = read_base(name, wearer, job.settings)
    return pattern, Cut(name, job.base is None, settings, differences(name, pattern, seen, body, shown))
