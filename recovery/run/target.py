"""Puts a target on its wearer, in metres on the body it was draped on, with openings told from holes; or refuses it.

The wearer is a named body, a file in SMPL's schema, a surface, or a body fitted inside the garment. Where a garment
came without a body, its openings tell how it stands in its file. The longest one, a hem or a waist, lies below or above
the middle of the others. The two that lie farthest apart across that axis are cuffs or legs, so their line goes from
side to side. The body that is fitted inside tells to which of both sides the wearer looks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.errors import BodyError, InputError, MeshError
from drape.files.formats import MESH_SUFFIXES
from drape.garment.avatars import Avatar
from drape.garment.contours import (
    TRUNK,
    Contour,
    Loop,
    bone_chains,
    borders,
    open_contours,
    part_round,
    place_of,
    plainly_hole,
    plainly_opening,
)
from drape.garment.files.mesh import AVATAR_VERTEX_LIMIT, GarmentMesh, read_mesh, weld
from drape.garment.inside import STEPS, fit_from
from drape.garment.mesh_checks import UNITS_M, Unit, Up, check_area, orient_outward, place_on_avatar
from drape.garment.reading_hints import ReadingHints
from drape.garment.registration import body_units, fit_body, posed_by, unpack_parameters
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.wearer_reading import Reading
from drape.garment.wearer_search import find_wearers
from drape.geometry import closest, meshes
from recovery import progress
from recovery.scan.holes import close_holes
from recovery.sim.skin_contact import SkinContact, check_closed

# Ratios of the cost of the body that looks the other way: below UNSURE the report says that front and back are not
# plain, and below KEPT the garment is not turned. Of 14 garments the right way fits better by 1.26 to 7.8, one by 0.96.
KEPT, UNSURE = 1.1, 1.1
Front = Literal["auto", "kept", "turned"]
CUFF_SHARE = 0.12  # least length over that of the longest opening: cuffs have 0.2, and holes that were not closed less
TURNED_RAD = 0.6  # a garment may look aside by this: the body's fit finds that by itself
FAR_M = 0.12  # median distance from the skin: the loosest garment hangs nearer
DEEP_M, DEEP_SHARE = 0.02, 0.2  # the target goes through the body where more than this share lies deeper than that
LYING_SHARE = 0.05  # share of the cloth, that nearest to the skin, which lies on it
LEAST_OFF_M, MOST_OFF_M = 0.001, 0.006  # limits beyond our own gap: less is the same, and cloth with more lies nowhere
# Openings round each part of the body, by base.
OF_TOPS = {TRUNK: 2, "left_arm": 1, "right_arm": 1}
OF_TUBES = {TRUNK: 2}
OPENINGS = {
    **dict.fromkeys(("tshirt", "tank", "dress", "sleeved_dress"), OF_TOPS),
    "trousers": {TRUNK: 1, "left_leg": 1, "right_leg": 1},
    **dict.fromkeys(("skirt", "tube", "strapless_dress"), OF_TUBES),
}


@dataclass(frozen=True, eq=False)
class TargetWearer:
    """The wearer of a target: the body ``standard`` in the shape ``betas`` (S,) and in ``pose`` [rad] (24, 3), None for
    the T-pose.

    ``trans`` [m] (3,) moves the posed body into the frame of the target. ``source`` says in words where the body is
    from; ``residual_mm`` is the mean distance of a fitted body from the surface that it was fitted to, 0 for a body
    that was given.
    """

    standard: BodyModel
    betas: np.ndarray
    pose: np.ndarray | None
    trans: np.ndarray
    source: str
    residual_mm: float = 0.0

    @cached_property
    def shaped(self) -> BodyModel:
        """The body ``standard`` with the shape ``betas`` in its template."""
        return shape_body(self.standard, self.betas)

    @property
    def skin(self) -> Avatar:
        """The surface of the body in its shape and pose, [m] in the target's frame."""
        pose = np.zeros((JOINT_COUNT, 3)) if self.pose is None else self.pose
        vertices = self.shaped.posed_vertices(pose[None])[0] + self.trans
        return Avatar(vertices, self.shaped.faces, self.residual_mm, self.source)


def shape_body(body: BodyModel, betas: np.ndarray) -> BodyModel:
    """Returns ``body`` whose template has the shape ``betas`` (S,); ``body`` itself where they are zero."""
    betas = body.check_betas(betas)
    if not betas.any():
        return body
    return replace(body, name=f"{body.name}_shaped", v_template=body.rest_vertices(betas))


def read_target_wearer(source: str, *, betas: np.ndarray | None = None, pose: np.ndarray | None = None) -> TargetWearer:
    """Returns the wearer at ``source``: a shipped body's name, a body's file .npz or .pkl, or the file of a surface
    that the shipped body is fitted to.

    ``betas`` (S,) and ``pose`` [rad] (24, 3) are those of a body in SMPL's schema. Raises ``BodyError`` where a surface
    comes with these, ``MeshError`` for an open surface.
    """
    path = Path(source)
    if path.suffix.lower() in MESH_SUFFIXES:
        if betas is not None or pose is not None:
            raise BodyError(
                "--body",
                expected="a surface alone, which has its own shape and pose",
                got=f"{path.name} with --betas or --pose",
                cure="Leave them out.",
            )
        return fit_wearer(path, load_body())
    body = load_body(source)
    check_closed(body.v_template, body.faces, f"body {body.name}")
    betas = body.check_betas(np.zeros(0) if betas is None else betas)
    return TargetWearer(body, betas, pose, np.zeros(3), f"body {body.name}")


def fit_wearer(path: Path, body: BodyModel) -> TargetWearer:
    """Returns ``body`` fitted to the closed surface in the file at ``path``. Raises ``MeshError`` for an open one."""
    mesh = weld(read_mesh(path, vertex_limit=AVATAR_VERTEX_LIMIT))
    check_closed(mesh.vertices, mesh.faces, f"body {path.name}")
    scale, vertices = body_units(mesh.vertices, name=path.name)
    fit = fit_body(vertices, mesh.faces, body, name=path.name)
    unit = "" if scale == 1.0 else f", scaled by {scale:g}"
    source = f"body {body.name} fitted to {path.name}{unit}, {fit.residual_mm:.1f} mm from it on average"
    return TargetWearer(body, fit.betas, fit.pose, fit.trans, source, fit.residual_mm)


def inside_wearer(
    mesh: GarmentMesh, *, unit: str = "auto", up: str = "auto", front: Front = "auto"
) -> tuple[GarmentMesh, TargetWearer]:
    """Returns ``mesh`` in metres, y up, and the shipped body that fits inside it, looking along +z.

    The openings tell the axis ``up`` and turn the limbs to the sides; unit and body are found by how cloth lies on
    skin. With ``front`` "auto" the body is fitted looking both ways along z, except in a skirt; "kept" keeps +z as in
    the file, "turned" takes the other way. Raises ``MeshError`` where no body fits.
    """
    if (up_axis(mesh) if up == "auto" else up) == "z":
        turned = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1)
        mesh = replace(mesh, vertices=turned).noted("turned from z up to y up")
    mesh = facing(mesh)
    two_ended = len(long_contours(mesh)) < 3  # a skirt has no front that its body tells
    ahead = {"auto": "+z" if two_ended else None, "kept": "+z", "turned": "-z"}[front]
    known = ReadingHints(None if unit == "auto" else (unit, UNITS_M[unit]), "+y", ahead)
    with progress.stage("a body is fitted inside"):
        fits = _fitted_inside(mesh, load_body(), known)
    fit = min(fits, key=lambda inside: inside.cost_m2 * (KEPT if inside.reading.front == "-z" else 1.0))
    reading, notes = fit.reading, []
    if reading.unit != "m":
        notes.append(f"converted from {reading.unit if reading.unit in UNITS_M else f'{reading.scale:.3g} m'} to m")
    if about := reading.front == "-z":
        notes.append("turned by 180 degrees to look along +z")
    if any(other is not fit and other.cost_m2 < UNSURE * fit.cost_m2 for other in fits):
        words = (
            f"front and back are not plain: pass --front {'kept' if about else 'turned'} if it is worn back to front"
        )
        notes.append(words)
    mesh = replace(mesh, vertices=reading.apply(mesh.vertices)).noted(*notes)
    distance = closest.signed_distance(mesh.vertices, posed_by(fit.body, fit.parameters), fit.body.faces)
    mean_mm, inside = 1e3 * float(np.abs(distance).mean()), float((distance < 0.0).mean())
    source = (
        f"body {fit.body.name} fitted inside the target: cloth {mean_mm:.0f} mm from the skin on average, "
        f"{100.0 * inside:.1f} % of it inside"
    )
    return mesh, TargetWearer(fit.body, *unpack_parameters(fit.body, fit.parameters), source, mean_mm)


class _Inside(NamedTuple):
    """A body fitted inside a garment that is read so: its ``parameters`` (``unpack_parameters``), and its cost."""

    body: BodyModel
    reading: Reading
    parameters: np.ndarray
    cost_m2: float


def _fitted_inside(mesh: GarmentMesh, body: BodyModel, known: ReadingHints) -> list[_Inside]:
    """The body inside ``mesh``, for each way along z that it may look. Raises ``MeshError`` where none fits.

    Where garments are looked for on a person cloth that hangs away pulls little. Here the body goes on to where the
    cloth is, since a pattern makes up for what it lacks.
    """
    wearers = find_wearers(mesh, body, known)
    fitting = [wearer for wearer in wearers if not wearer.fault and wearer.reading.front in ("+z", "-z")]
    if not fitting:
        raise MeshError(
            "body in the target",
            expected="cloth that a human body fits in, in some unit",
            got=wearers[0].fault if wearers else "no unit makes that a garment",
            cure="Say the unit (--unit) and the up axis (--up), or give the body (--body FILE).",
        )
    cloth, fits = SearchedCloth(mesh), []
    for reading in dict.fromkeys(
        wearer.reading for wearer in fitting if wearer.reading.unit == fitting[0].reading.unit
    ):
        first = next(wearer for wearer in fitting if wearer.reading == reading)
        points, normals = reading.apply(cloth.points), cloth.normals @ reading.turn.T
        ends = cloth.contours(reading)
        fits.append(_Inside(body, reading, *fit_from(body, points, normals, ends, first.parameters, STEPS)))
    return fits


# --- how a garment stands --------------------------------------------------------------------------------------------


def long_contours(mesh: GarmentMesh) -> list[Contour]:
    """Returns the open contours of ``mesh`` that are longer than ``CUFF_SHARE`` of the longest, the longest first."""
    contours = sorted(open_contours(mesh.vertices, mesh.faces), key=lambda contour: -contour.length_m)
    return [contour for contour in contours if contour.length_m > CUFF_SHARE * contours[0].length_m]


def up_axis(mesh: GarmentMesh) -> str:
    """Returns the axis, "y" or "z", along which the longest opening of ``mesh`` lies farther from the middle of the
    others; "y" where there are none."""
    first, *others = long_contours(mesh)
    if not others:
        return "y"
    way = np.abs(first.centre - np.mean([other.centre for other in others], axis=0))
    return "z" if way[2] > way[1] else "y"


def facing(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh``, y up, turned about y by at most a right angle until its limbs lie side by side along x.

    It is returned as it is where they nearly do, where it has two openings, and where its limbs lie together.
    """
    contours = long_contours(mesh)
    if len(contours) < 3:
        return mesh
    limbs = max(
        combinations(contours[1:], 2), key=lambda pair: np.linalg.norm((pair[1].centre - pair[0].centre)[[0, 2]])
    )
    across = (limbs[1].centre - limbs[0].centre)[[0, 2]] * (1.0 if limbs[1].centre[0] >= limbs[0].centre[0] else -1.0)
    together = np.linalg.norm(across) < (limbs[0].length_m + limbs[1].length_m) / (2.0 * np.pi)
    turn = float(np.arctan2(across[1], across[0]))
    return mesh if together or abs(turn) < TURNED_RAD else turn_about(mesh, turn)


def turn_about(mesh: GarmentMesh, turn_rad: float) -> GarmentMesh:
    """Returns ``mesh`` turned by ``turn_rad`` [rad] about a vertical line (along y) through the mean of its vertices,
    with a note on that."""
    middle = mesh.vertices.mean(axis=0)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    vertices = (mesh.vertices - middle) @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + middle
    return replace(mesh, vertices=vertices).noted(f"turned by {np.degrees(turn_rad):.0f} degrees to look along +z")


def placed_target(mesh: GarmentMesh, skin: Avatar, *, unit: Unit = "auto", up: Up = "auto") -> GarmentMesh:
    """Returns ``mesh`` in metres, y up, on ``skin``, with normals outward. ``unit`` and ``up`` are those of ``mesh``.

    Raises ``InputError`` for a mesh that does not lie on the skin.
    """
    if not len(mesh.uv):
        mesh = replace(mesh, uv_faces=np.zeros((0, 3), dtype=np.int64))
    mesh = orient_outward(place_on_avatar(mesh, skin, unit=unit, up=up), skin)
    check_near(mesh, skin)
    check_area(mesh, "target area")
    return mesh


def check_near(mesh: GarmentMesh, skin: Avatar) -> None:
    """Raises ``InputError`` for a target that hangs in the air beside the body, or that goes through it."""
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
    """Returns ``mesh`` with all borders closed that are no openings, and with the bites of the openings filled; and how
    many openings each part of the body has, by its name.

    ``joints`` [m] (24, 3) are the body's. An opening is a border that bones pass through, or a folded cuff beside them.
    Of a part with more of them than ``wanted``, 0 if it is not named there, those beyond that number that lie flattest
    in the cloth are taken for holes, unless the cloth there looks sideways as at a cuff: the body's fit may have put a
    leg behind a hole. None sets no limit.
    """
    chains = bone_chains(joints)
    loops = {border.loop.tobytes(): border for border in borders(mesh)}
    openings: dict[str, list[Loop]] = {}
    for contour in open_contours(mesh.vertices, mesh.faces):
        border, passed = loops[contour.loop.tobytes()], part_round(contour, chains)
        part = passed or place_of(contour, chains).part
        if part is not None and (passed or (plainly_opening(border) and not plainly_hole(border, mesh))):
            openings.setdefault(part, []).append(border)
    open_loops = set()
    for part, around in openings.items():
        around.sort(key=lambda border: border.flatness)
        enough = len(around) if wanted is None else wanted.get(part, 0)
        open_loops |= {
            border.loop.tobytes() for n, border in enumerate(around) if n < enough or plainly_opening(border)
        }
    closing = close_holes(mesh, lambda border: border.loop.tobytes() not in open_loops, lambda border: True)
    there: dict[str, int] = {}
    for contour in open_contours(closing.mesh.vertices, closing.mesh.faces):
        if (part := place_of(contour, chains).part) is not None:
            there[part] = there.get(part, 0) + 1
    return (mesh if closing.mesh is mesh else closing.mesh.noted(*closing.words(len(mesh.faces)))), there


def check_base(base: str, counts: dict[str, int]) -> None:
    """Raises ``InputError`` for a target whose numbers of openings, ``counts`` by part of the body, are not those of
    the base called ``base``. A base of a user's file passes."""
    wanted = OPENINGS.get(base)
    if wanted is None:
        return
    missing = {part for part, count in wanted.items() if counts.get(part, 0) < count}
    foreign = set(counts) - set(wanted)
    if missing or foreign:
        fitting = [name for name, kind in OPENINGS.items() if kind == counts]
        raise InputError(
            "target",
            expected=f"the openings of a {base}: {describe_openings(wanted)}",
            got=describe_openings(counts) or "no opening that the body goes through",
            cure=f"Take --base {' or '.join(fitting)}."
            if fitting
            else "Take a base of the target's kind, and open what is shut.",
        )


def describe_openings(counts: dict[str, int]) -> str:
    """Returns a phrase such as "2 round the trunk, 1 round the left arm" on the numbers of openings, ``counts`` by part
    of the body."""
    return ", ".join(f"{count} round the {part.replace('_', ' ')}" for part, count in sorted(counts.items()))


def off_skin(mesh: GarmentMesh, skin: Avatar, known: np.ndarray) -> float:
    """Returns how much farther [m] off the ``skin`` the cloth of ``mesh`` rests than cloth that is draped here, at most
    ``MOST_OFF_M``; 0 if that is less than ``LEAST_OFF_M``.

    Cloth has a thickness, or its simulator kept a gap. The share ``LYING_SHARE`` of the area of the ``known`` faces
    (F,), bool, lies below a distance. The result is that distance less ``SkinContact.gap_m``.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    distance = closest.signed_distance(middles, skin.vertices, skin.faces)
    order = np.argsort(distance)
    area = (meshes.face_areas(mesh.vertices, mesh.faces) * known)[order]
    lies = float(distance[order][np.searchsorted(np.cumsum(area), LYING_SHARE * area.sum())])
    more = lies - SkinContact.gap_m
    return min(more, MOST_OFF_M) if more >= LEAST_OFF_M else 0.0
