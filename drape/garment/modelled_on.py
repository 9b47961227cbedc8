"""The avatar of a garment that came with none named: the standard body where it lies close on that, else its wearer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drape.body.model import BodyModel
from drape.errors import MeshError
from drape.garment.avatars import Avatar, read_avatar, standard_avatar
from drape.garment.contours import pierced_parts
from drape.garment.files.mesh import GarmentMesh
from drape.garment.intake_options import IntakeOptions
from drape.garment.mesh_checks import UNITS_M, check_options, check_surface, place
from drape.garment.told_reading import NOTHING_TOLD, ToldReading, told_reading
from drape.garment.wearer_fields import bones_of, cloth_points, enclosed
from drape.garment.wearer_reading import Wearer
from drape.garment.wearer_search import the_wearer
from drape.geometry.closest import signed_distance

SAMPLE_COUNT = 800
# Garments on the standard body have no cloth deeper than 1 cm in it, 0 to 9 % of the way round its bones is bare, and
# no bone goes through them; of an outfit for arms that hang 2 to 45 % is in the skin, and arms pierce its sleeves.
DEEP_M, DEEP_SHARE, BARE_SHARE = 0.01, 0.01, 0.15


def modelled_on(
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, meaning: Any = None
) -> tuple[GarmentMesh, Avatar, Wearer | None]:
    """``mesh``, checked, in metres on its avatar, that avatar, and its wearer where it was looked for.

    ``meaning`` as ``avatars.parse_avatar`` returns it, with what it tells of the file (``told_reading``). Raises
    ``MeshError`` where the mesh is no cloth or no human body fits in it, and ``BodyError`` for an avatar that is none.
    """
    check_options(options.unit, options.up)
    told, meaning = told_reading(meaning)
    checked = check_surface(mesh)
    if meaning is not None:
        return _on_named(checked, body, options, told, meaning)
    placed = on_standard(checked, body, options) if told == NOTHING_TOLD else None
    if placed is not None:
        return placed, standard_avatar(body), None
    return worn_by(checked, body, options, told)


def _on_named(
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, told: ToldReading, meaning: Any
) -> tuple[GarmentMesh, Avatar, None]:
    """The checked ``mesh`` on the avatar of that ``meaning``; where a body's place and all of the file's reading are
    told, there it stays."""
    avatar = read_avatar(meaning, body)
    if told.reading is not None and isinstance(meaning, dict) and "trans" in meaning:
        return replace(mesh, vertices=told.reading.apply(mesh.vertices)), avatar, None
    unit, up = options.unit, options.up
    if told.unit is not None:
        mesh, unit = replace(mesh, vertices=told.unit[1] * mesh.vertices), "m"
    if told.turned is not None:
        mesh, up = replace(mesh, vertices=told.turned.apply(mesh.vertices)), "y"
    return place(mesh, avatar, unit=unit, up=up), avatar, None


def on_standard(mesh: GarmentMesh, body: BodyModel, options: IntakeOptions) -> GarmentMesh | None:
    """The checked ``mesh`` in metres, if it lies close on the standard body in T-pose, every limb in its cloth."""
    avatar = standard_avatar(body)
    try:
        placed = place(mesh, avatar, unit=options.unit, up=options.up, named=False)
    except MeshError:
        return None
    if pierced_parts(placed.vertices, placed.faces, body.joints_template):
        return None
    points, _ = cloth_points(placed.vertices, placed.faces, SAMPLE_COUNT)
    if (signed_distance(points, avatar.vertices, avatar.faces) < -DEEP_M).mean() > DEEP_SHARE:
        return None
    share, _ = enclosed(points, bones_of(body.joints_template, avatar.vertices))
    return placed if float(share.mean()) > 1.0 - BARE_SHARE else None


def worn_by(
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, told: ToldReading = NOTHING_TOLD
) -> tuple[GarmentMesh, Avatar, Wearer]:
    """The checked ``mesh`` in metres, y up, facing +z, the avatar that was found in it, and what was found.

    Raises ``MeshError`` where no human body fits.
    """
    said = ToldReading(
        (options.unit, UNITS_M[options.unit]) if told.unit is None and options.unit != "auto" else told.unit,
        f"+{options.up}" if told.up is None and options.up != "auto" else told.up,
        told.front,
    )
    wearer = the_wearer(mesh, body, said)
    vertices = body.posed_vertices(wearer.pose[None], wearer.trans[None], wearer.betas)[0]
    source = f"found in the cloth: {wearer.words}; sure {wearer.sure:.2f}"
    turned = replace(mesh, vertices=wearer.reading.apply(mesh.vertices))
    return (
        turned.noted(f"nobody named the avatar; it seems to be {wearer.words}"),
        Avatar(vertices, body.faces, 0.0, source),
        wearer,
    )
