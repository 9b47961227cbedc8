"""A target on its wearer: in metres on the body it was draped on, its openings told from holes; or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drape.errors import InputError
from drape.garment.avatars import Avatar
from drape.garment.borders import Loop, borders, plainly_hole, plainly_opening
from drape.garment.contours import TRUNK, bone_chains, open_contours, part_round, place_of
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import Unit, Up, check_area, orient_outward, place_on_avatar
from drape.geometry import closest, meshes
from recovery.scan.holes import close_holes
from recovery.sim.skin_contact import SkinContact

FAR_M = 0.12  # median distance from the skin: the loosest garment hangs nearer
DEEP_M, DEEP_SHARE = 0.02, 0.2  # the target goes through the body where more than this share lies deeper than that
LYING_SHARE = 0.05  # of the cloth, nearest to the skin, lies on it
LEAST_OFF_M, MOST_OFF_M = 0.001, 0.006  # beyond our own gap: less is the same, more is a garment that lies nowhere
# Openings round each part of the body, by base.
OF_TOPS = {TRUNK: 2, "left_arm": 1, "right_arm": 1}
OF_TUBES = {TRUNK: 2}
OPENINGS = {
    **dict.fromkeys(("tshirt", "tank", "dress", "sleeved_dress"), OF_TOPS),
    "trousers": {TRUNK: 1, "left_leg": 1, "right_leg": 1},
    **dict.fromkeys(("skirt", "tube", "strapless_dress"), OF_TUBES),
}


def placed_target(mesh: GarmentMesh, skin: Avatar, *, unit: Unit = "auto", up: Up = "auto") -> GarmentMesh:
    """Returns ``mesh`` in metres, y up, on ``skin``, with normals outward; refuses one that does not lie on it."""
    if not len(mesh.uv):
        mesh = replace(mesh, uv_faces=np.zeros((0, 3), dtype=np.int64))
    mesh = orient_outward(place_on_avatar(mesh, skin, unit=unit, up=up), skin)
    check_near(mesh, skin)
    check_area(mesh, "target area")
    return mesh


def check_near(mesh: GarmentMesh, skin: Avatar) -> None:
    """Refuses a target that hangs in the air beside the body, or that goes through it."""
    step = max(1, len(mesh.vertices) // 2000)
    distance = closest.signed_distance(mesh.vertices[::step], skin.vertices, skin.faces)
    cure = "Move the target onto the body it was draped on, name its pose (--pose), or fit a body in it (--body fit)."
    if (middle := float(np.median(distance))) > FAR_M:
        raise InputError(
            "target",
            expected=f"cloth on the body, half of it within {100 * FAR_M:.0f} cm of the skin",
            got=f"half of it more than {100 * middle:.0f} cm away",
            cure=cure,
        )
    if (deep := float((distance < -DEEP_M).mean())) > DEEP_SHARE:
        raise InputError(
            "target",
            expected="cloth outside the body",
            got=f"{100 * deep:.0f} % of it more than {100 * DEEP_M:.0f} cm inside",
            cure=cure,
        )


def close_but_openings(
    mesh: GarmentMesh, joints: np.ndarray, wanted: dict[str, int] | None = None
) -> tuple[GarmentMesh, dict[str, int]]:
    """Returns ``mesh`` with all borders closed that are no openings, and how many openings each part of the body has.

    ``joints`` [m] (24, 3) are the body's. An opening is a border that bones pass through, or a folded cuff beside them.
    If a part has more than ``wanted``, those that lie in the cloth are taken for holes: the body's fit may have put a
    leg behind a hole.
    """
    chains = bone_chains(joints)
    loops = {one.loop.tobytes(): one for one in borders(mesh)}
    openings: dict[str, list[Loop]] = {}
    for contour in open_contours(mesh.vertices, mesh.faces):
        one, passed = loops[contour.loop.tobytes()], part_round(contour, chains)
        part = passed or place_of(contour, chains).part
        if part is not None and (passed or (plainly_opening(one) and not plainly_hole(one, mesh))):
            openings.setdefault(part, []).append(one)
    kept = set()
    for part, found in openings.items():
        found.sort(key=lambda one: one.flatness)
        enough = len(found) if wanted is None else wanted.get(part, 0)
        kept |= {one.loop.tobytes() for n, one in enumerate(found) if n < enough or plainly_opening(one)}
    done = close_holes(mesh, lambda one: one.loop.tobytes() not in kept, lambda one: True)
    there: dict[str, int] = {}
    for contour in open_contours(done.mesh.vertices, done.mesh.faces):
        if (part := place_of(contour, chains).part) is not None:
            there[part] = there.get(part, 0) + 1
    return (mesh if done.mesh is mesh else done.mesh.noted(*done.words(len(mesh.faces)))), there


def check_base(base: str, found: dict[str, int]) -> None:
    """Refuses (``InputError``) a target whose openings, ``found`` by part of the body, are not those of the base called
    ``base``. A base that is no name of ours passes."""
    wanted = OPENINGS.get(base)
    if wanted is None:
        return
    missing = {part for part, count in wanted.items() if found.get(part, 0) < count}
    foreign = set(found) - set(wanted)
    if missing or foreign:
        fitting = [name for name, kind in OPENINGS.items() if kind == found]
        raise InputError(
            "target",
            expected=f"the openings of a {base}: {describe_openings(wanted)}",
            got=describe_openings(found) or "no opening that the body goes through",
            cure=f"Take --base {' or '.join(fitting)}."
            if fitting
            else "Take a base of the target's kind, and open what is shut.",
        )


def describe_openings(found: dict[str, int]) -> str:
    """A phrase such as "2 round the trunk, 1 round the left arm"."""
    return ", ".join(f"{count} round the {part.replace('_', ' ')}" for part, count in sorted(found.items()))


def off_skin(mesh: GarmentMesh, skin: Avatar, known: np.ndarray) -> float:
    """Returns how much farther [m] off the skin the cloth of ``mesh`` rests than ours, since it has a thickness, or its
    simulator kept a gap. 0 if that is less than a millimetre.

    It is the distance below which the share ``LYING_SHARE`` of the area of the ``known`` faces (F,) lies, less the gap
    of our contact.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    distance = closest.signed_distance(middles, skin.vertices, skin.faces)
    order = np.argsort(distance)
    area = (meshes.face_areas(mesh.vertices, mesh.faces) * known)[order]
    lies = float(distance[order][np.searchsorted(np.cumsum(area), LYING_SHARE * area.sum())])
    more = lies - SkinContact.gap_m
    return min(more, MOST_OFF_M) if more >= LEAST_OFF_M else 0.0
