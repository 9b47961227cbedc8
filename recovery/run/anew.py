"""The recovered pattern sewn anew from its flat panels and worn as the report shows it: what a sewer will get."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drape.body.model import BodyModel
from drape.errors import InputError
from drape.garment.contours import lost_parts, match_contours, open_contours
from recovery import progress as watch
from recovery.drape.pattern_drape import Draped, DrapeOptions, drape_pattern
from recovery.drape.posing import posed_joints
from recovery.fit.belt import held_as_target
from recovery.fit.chamfer import SurfaceDistance, surface_distance
from recovery.fit.laying import OTHER_FOLDS_MM, LaidDrape, hung_as, hung_at_rest, in_other_folds, laying_options, put_on
from recovery.fit.recovered import Recovered
from recovery.fit.starts import LENGTHS_TRIED
from recovery.pattern.model import Pattern

ANEW_MM = OTHER_FOLDS_MM  # more between the report's drape and the pattern sewn anew is a warning
BELT_M = 0.005


class SewnAnew(NamedTuple):
    """The pattern sewn anew: the drape ``draped`` and its ``distance`` from that of the report, both in the wearer's
    pose.

    ``by_itself``: the distance at which it came to rest by itself, before its belt was laid on the report's waist or
    before it was hung or put on as the report shows it; the same as ``distance`` if nothing was done. ``belt_moved_m``
    [m]: by how much the belt was moved up, zero without one.
    """

    draped: Draped
    distance: SurfaceDistance
    by_itself: SurfaceDistance
    belt_moved_m: float


def sewn_anew(
    found: Recovered,
    body: BodyModel,
    options: DrapeOptions,
    pose: np.ndarray | None,
    parts: Sequence[str] = (),
    pattern: Pattern | None = None,
) -> SewnAnew:
    """The pattern of ``found`` meshed, placed and sewn from nothing round ``body``, its belt at the report's waist.

    ``pattern`` is the same with style lines, if it has any.

    Without friction a belt closes where the body happens to be as wide as the waist, centimetres from where the wearer
    had it, and the whole garment hangs as much higher or lower. Closing threads can pull a sleeve past its arm, and a
    wide skirt falls into one set of folds or another, on one mesh and not on the next. If one of the body's ``parts``
    is lost, the cloth does not come to rest, or it lies more than ``ANEW_MM`` from the report's garment, a little finer
    or coarser mesh is tried, and the nearest of those that are worn is taken. Raises ``InputError`` where the panels
    cannot be sewn.
    """
    own = found.fitted.pattern
    pattern = pattern or own
    tried: list[tuple[tuple[bool, float], SewnAnew]] = []
    refused: list[InputError] = []
    for number, share in enumerate(LENGTHS_TRIED):
        length = share * options.edge_length_m
        try:
            if number == 0 and found.sewn is not None and pattern is own:
                candidate = _beside(found, *found.sewn)
            else:
                candidate = _sewn(found, body, replace(options, edge_length_m=length), pose, pattern, parts)
        except InputError as error:
            refused.append(error)
            continue
        draped = candidate.draped
        lost = lost_parts(draped.nodes, draped.mesh.faces, posed_joints(body, pose), parts)
        rank = (bool(lost) or not draped.at_rest, candidate.distance.mean_mm)
        tried.append((rank, candidate))
        if rank <= (False, ANEW_MM) or watch.over():
            break
    if not tried:
        raise refused[0]
    return min(tried, key=lambda pair: pair[0])[1]


def _sewn(
    found: Recovered,
    body: BodyModel,
    options: DrapeOptions,
    pose: np.ndarray | None,
    pattern: Pattern,
    parts: Sequence[str],
) -> SewnAnew:
    cloth = found.fitted.cloth
    surface = body.v_template if pose is None else body.posed_vertices(pose[None])[0]
    laid = isinstance(found.search.forward, LaidDrape)
    options = laying_options(options) if laid else options
    loose = drape_pattern(pattern, body, options, pose=pose, cloth=cloth)
    mesh, skin = found.search.mesh_of(found.fitted), options.skin(surface, body.faces)
    if laid:
        return _beside(found, loose, hung_as(loose, mesh, found.fitted.nodes, skin, cloth))
    if in_other_folds(loose, mesh, found.fitted.nodes):
        hung = hung_at_rest(loose, mesh, found.fitted.nodes, skin, cloth)
        ways = [_beside(found, loose, one) for one in (loose, hung)]
        return min(ways, key=lambda one: (not one.draped.at_rest, one.distance.mean_mm))
    if not len(loose.rest.held):
        return _beside(found, loose, loose)
    there, joints = open_contours(found.fitted.nodes, found.search.mesh.faces), posed_joints(body, pose)

    def held(one: Draped) -> Draped:
        matches, _ = match_contours(open_contours(one.nodes, one.mesh.faces), there, joints)
        return held_as_target(one, matches, there, skin, cloth)

    lost = lost_parts(loose.nodes, loose.mesh.faces, joints, parts)
    return _beside(found, loose, put_on(loose, mesh, found.fitted.nodes, held) if lost else held(loose))


def _beside(found: Recovered, loose: Draped, worn: Draped) -> SewnAnew:
    """The garment ``worn`` beside that of the report; ``loose`` is what it was before its belt was laid."""
    shown = (found.fitted.nodes, found.search.mesh.faces)
    distance, by_itself = (surface_distance((one.nodes, one.mesh.faces), shown) for one in (worn, loose))
    held = loose.rest.held
    moved = float((worn.nodes[held] - loose.nodes[held])[:, 1].mean()) if len(held) else 0.0
    return SewnAnew(worn, distance, by_itself, moved)


def anew_words(anew: SewnAnew) -> str:
    """Sentences on how far the pattern sewn anew lies from what the report shows, its belt, and its folds."""
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
