"""The recovered pattern sewn anew from its flat panels and worn as the report shows it: what a sewer will get.

Then on other bodies and in other poses (figure 6 of Yu, Cordier and Seo 2024).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.garment.contours import lost_parts, lost_words, match_contours, open_contours
from recovery import progress as watch
from recovery.drape.output import write_rest
from recovery.drape.pattern_drape import Draped, SewingOptions, drape_in_pose, drape_pattern
from recovery.drape.placement import posed_joints, read_pose
from recovery.fit.chamfer import SurfaceDistance, surface_distance
from recovery.fit.forward import hold_as_target
from recovery.fit.laying import OTHER_FOLDS_MM, Dressing, LaidDrape, Shown, laying_options
from recovery.fit.outcome import Recovered
from recovery.fit.starts import DrapeStart, sew_and_dress
from recovery.pattern.sewing_pattern import Pattern
from recovery.progress import Say
from recovery.run.target import shape_body
from recovery.run.task import Task

ANEW_MM = OTHER_FOLDS_MM  # more between the report's drape and the pattern sewn anew is a warning
BELT_M = 0.005  # a move of the belt that is worth a sentence
# Shapes of the shipped body: its first component is height, its second how narrow the chest is over the hips.
BODIES: dict[str, tuple[float, ...]] = {"a smaller body": (-0.7,), "a narrower chest": (0.0, 2.0)}
POSES = ("reach:110", "stretch:60")


class SewnAnew(NamedTuple):
    """A recovered pattern sewn anew: the drape ``draped`` and its ``distance`` from the search's drape, which the
    report shows, both in the wearer's pose.

    A garment that was sewn anew first comes to rest by itself; ``by_itself`` is its distance from the search's drape
    then. After that it may be put on as the search's drape is worn, by its belt or its folds. ``draped`` is the end of
    that; if nothing was done, both distances are the same. ``belt_moved_m`` [m]: how much higher the belt then lies,
    negative if lower, zero without one.
    """

    draped: Draped
    distance: SurfaceDistance
    by_itself: SurfaceDistance
    belt_moved_m: float


def sew_anew(recovered: Recovered, start: DrapeStart, pattern: Pattern | None = None) -> SewnAnew:
    """Returns the pattern of ``recovered`` meshed, placed and sewn from nothing as ``start`` says, and worn as the
    search's drape, which the report shows; its belt lies at that drape's waist.

    ``pattern`` is the same with style lines, if it has any.

    Without friction a belt closes where the body happens to be as wide as the waist, centimetres from where the wearer
    had it, and the whole garment hangs as much higher or lower. Closing threads can pull a sleeve past its arm, and a
    wide skirt falls into one set of folds or another, on one mesh and not on the next. If a part of the body is lost,
    the cloth does not come to rest, or it lies more than ``ANEW_MM`` from the report's garment, a little finer or
    coarser mesh is tried, and the nearest of those that are worn is taken. Raises ``InputError`` where the panels
    cannot be sewn.
    """
    shown, tried = recovered.shown, [recovered.sewn] if recovered.sewn is not None and pattern is None else []

    def off_mm(draped: Draped) -> float:
        return surface_distance(draped.surface, shown.surface).mean_mm

    def rank(draped: Draped) -> tuple[int, bool, float]:
        return len(start.lost(draped)), not draped.at_rest, off_mm(draped)

    if not tried or rank(tried[0].worn) > (0, False, ANEW_MM):
        dressing, start = _dressing(recovered, start, rank)
        try:
            tried.append(
                sew_and_dress(
                    pattern or recovered.fitted.pattern, start, dressing, shown, off_mm=off_mm, enough_mm=ANEW_MM
                )
            )
        except InputError:
            if not tried:
                raise
    best = min(tried, key=lambda pair: rank(pair.worn))
    return _beside(shown, best.loose, best.worn)


def _dressing(recovered: Recovered, start: DrapeStart, rank: Callable[[Draped], Any]) -> tuple[Dressing, DrapeStart]:
    """How the pattern of ``recovered`` is put on, its belt laid on the report's waist, and ``start`` in its cloth."""
    body, pose, cloth = start.body, start.pose, recovered.fitted.cloth
    laid = isinstance(recovered.search.forward, LaidDrape)
    start = replace(start, drape=laying_options(start.drape) if laid else start.drape, cloth=cloth)
    surface = body.v_template if pose is None else body.posed_vertices(pose[None])[0]
    skin = start.drape.skin(surface, body.faces)
    there, joints = open_contours(*recovered.shown.surface), posed_joints(body, pose)

    def held(draped: Draped) -> Draped:
        matches, _ = match_contours(open_contours(*draped.surface), there, joints)
        return hold_as_target(draped, matches, there, skin, cloth)

    return Dressing(skin, cloth, laid, held, start.lost, rank), start


def _beside(shown: Shown, loose: Draped, worn: Draped) -> SewnAnew:
    """The garment ``worn`` beside that of the report, ``shown``; ``loose`` is what it was before its belt was laid."""
    distance, by_itself = (surface_distance(draped.surface, shown.surface) for draped in (worn, loose))
    held = loose.rest.held
    moved = float((worn.nodes[held] - loose.nodes[held])[:, 1].mean()) if len(held) else 0.0
    return SewnAnew(worn, distance, by_itself, moved)


def anew_words(anew: SewnAnew) -> str:
    """Returns sentences on how far the pattern sewn anew lies from what the report shows, its belt, and its folds."""
    words = f"Sewn anew it lies {anew.distance.mean_mm:.1f} mm from the garment of this report on average"
    words += "." if anew.distance.mean_mm <= ANEW_MM else ": it fell into other folds."
    if abs(anew.belt_moved_m) > BELT_M:
        way = "above" if anew.belt_moved_m > 0.0 else "below"
        words += (
            f" Its waist is worn where the target's is, {100 * abs(anew.belt_moved_m):.1f} cm {way} where it would "
            f"close by itself; there it would lie {anew.by_itself.mean_mm:.1f} mm from this garment."
        )
    elif not len(anew.draped.rest.held) and anew.by_itself != anew.distance:
        words += (
            f" It is hung in this garment's folds, as hands arrange them; from flat panels it falls into others, "
            f"{anew.by_itself.mean_mm:.1f} mm away."
        )
    elif anew.by_itself.mean_mm > ANEW_MM:
        words += f" It is put on as this garment is; from flat panels it closes {anew.by_itself.mean_mm:.1f} mm away."
    return words


@dataclass(frozen=True, eq=False)
class WornElsewhere:
    """A garment on another body or in another pose: ``nodes`` [m] (N, 3) and ``faces`` (F, 3) on the body with ``skin``
    [m] (V, 3) and ``skin_faces``, with its ``drape_figures``; or empty ones and the ``refusal`` that says why not.

    ``what`` names body or pose. ``lost``: parts of the body that should go through an opening and do not, such as an
    arm beside its sleeve.
    """

    what: str
    skin: np.ndarray
    skin_faces: np.ndarray
    nodes: np.ndarray
    faces: np.ndarray
    figures: dict[str, Any]
    refusal: str = ""
    lost: tuple[str, ...] = ()


def drape_elsewhere(
    pattern: Pattern,
    sewn: Draped,
    body: BodyModel,
    standard: BodyModel,
    options: SewingOptions,
    parts: Sequence[str] = (),
    *,
    cloth: OrthotropicMaterial,
) -> Iterator[WornElsewhere]:
    """Yields ``pattern`` sewn and draped on two other shapes of the body ``standard``, and then carried to two poses of
    ``body``.

    ``sewn`` is its drape on ``body`` in the T-pose; ``parts`` of the body should go through its openings; ``cloth`` is
    what it is made of. A drape that is refused becomes a ``WornElsewhere`` that says why.
    """
    wearers = [(what, shape_body(standard, np.array(betas)), None) for what, betas in BODIES.items()]
    wearers += [(f"pose {text}", body, read_pose(text)) for text in POSES]
    for what, wearer, pose in wearers:
        skin = wearer.v_template if pose is None else wearer.posed_vertices(pose[None])[0]
        try:
            if pose is None:
                draped = drape_pattern(pattern, wearer, options, cloth=cloth)
                nodes, faces, figures = draped.rest.nodes, draped.mesh.faces, draped.figures["rest"]
            else:
                posed, figures = drape_in_pose(sewn.mesh, sewn.rest, wearer, pose, options, cloth=cloth)
                nodes, faces = posed.nodes, sewn.mesh.faces
        except InputError as error:
            nothing = np.zeros((0, 3))
            yield WornElsewhere(what, skin, wearer.faces, nothing, nothing.astype(np.int64), {}, refusal=str(error))
            continue
        lost = lost_parts(nodes, faces, posed_joints(wearer, pose), parts)
        yield WornElsewhere(what, skin, wearer.faces, nodes, faces, figures, lost=lost)


class SewnAndWorn(NamedTuple):
    """A recovered pattern sewn from flat panels, ``anew``, its ``distance`` from the target, the garment on other
    bodies and in other poses, ``worn``, and the ``files`` that were written of it.

    If it cannot be sewn, ``anew`` and ``distance`` are None, and the lists are empty.
    """

    anew: SewnAnew | None
    distance: SurfaceDistance | None
    worn: list[WornElsewhere]
    files: list[Path]


def sew_and_wear(task: Task, recovered: Recovered, pattern: Pattern, say: Say) -> SewnAndWorn:
    """Returns ``pattern``, with its style lines, sewn from flat panels and worn on other bodies and in other poses;
    writes the garment at rest.

    ``task.warnings`` get a sentence on what fails, ``say`` gets a line on each drape.
    """
    job, wearer = task.job, task.wearer
    parts = [match.place.part for match in recovered.matches if match.place.part is not None]
    options = replace(job.search.drape, edge_length_m=recovered.edge_length_m)
    with_lines = None if pattern is recovered.fitted.pattern else pattern
    try:
        with watch.stage("sewn anew"):
            anew = sew_anew(recovered, DrapeStart(wearer.shaped, options, wearer.pose, None, tuple(parts)), with_lines)
    except InputError as error:
        words = "The recovered pattern cannot be sewn from flat panels, so there is no garment cache"
        task.warnings.append(f"{words}: {error}")
        return SewnAndWorn(None, None, [], [])
    say(
        f"sewn anew {anew.distance.mean_mm:.2f} mm from the search's drape on average, {anew.distance.largest_mm:.1f} "
        f"largest; by itself {anew.by_itself.mean_mm:.2f}"
    )
    draped = anew.draped
    if lost := lost_parts(draped.rest.nodes, draped.mesh.faces, wearer.shaped.joints_template, parts):
        words = f"Sewn anew in the T-pose, {lost_words(lost)}"
        task.warnings.append(f"{words}: the garment cache is not worn as the target is.")
    worn = _worn_elsewhere(task, recovered, pattern, draped, parts, say)
    distance = surface_distance(draped.surface, task.surface, known=task.known)
    say(f"sewn      {distance.mean_mm:.2f} mm from the target on average")
    # In the cache the garment of a body of another shape is moved to the standard one.
    avatar = {"betas": wearer.betas.tolist()} if wearer.betas.any() else "standard"
    told = {"avatar": avatar, "garment": job.garment, "report": say}
    files = write_rest(job.out, task.name, draped, wearer.standard, recovered.fabric, **told)
    return SewnAndWorn(anew, distance, worn, files)


def _worn_elsewhere(
    task: Task, recovered: Recovered, pattern: Pattern, draped: Draped, parts: list[str], say: Say
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
    cloth = recovered.fitted.cloth
    for place in drape_elsewhere(pattern, draped, wearer.shaped, wearer.standard, job.search.drape, parts, cloth=cloth):
        say(f"worn      {place.what}: {place.refusal or describe_worn(place)}")
        worn.append(place)
    return worn


def describe_worn(place: WornElsewhere) -> str:
    """Returns a phrase on how the garment lies in ``place``, where it was not refused."""
    figures = place.figures
    end = "at rest" if figures["converged"] else f"not at rest ({figures['force_left_n']:.1e} N left)"
    lost = f"; {lost_words(place.lost)}" if place.lost else ""
    return (
        f"{end}{lost}; stretched by {figures['stretch_median_pct']:.1f} % (99th percentile "
        f"{figures['stretch_p99_pct']:.0f} %), {figures['edges_in_body_pct']:.1f} % of edges cut the body"
    )
