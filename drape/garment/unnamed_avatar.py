"""The avatar of a garment for which none was named: the standard body where it lies close on that, else its wearer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drape.body.model import BodyModel
from drape.errors import MeshError
from drape.files.notes import warning
from drape.garment.accessory_search import accessory_wearer, seated
from drape.garment.avatars import Avatar, standard_avatar
from drape.garment.contours import pierced_parts
from drape.garment.files.mesh import GarmentMesh
from drape.garment.intake_options import IntakeOptions
from drape.garment.jewellery import check_cloth, jewellery_wearer
from drape.garment.mesh_checks import UNITS_M, place_on_avatar
from drape.garment.reading_hints import NO_HINTS, ReadingHints
from drape.garment.registration import posed_by
from drape.garment.wearer_fields import bones_of, cloth_points, enclosed
from drape.garment.wearer_reading import WearerCandidate
from drape.garment.wearer_search import the_wearer
from drape.geometry.closest import signed_distance

SAMPLE_COUNT = 800
# Garments on the standard body have no cloth deeper than 1 cm in it, 0 to 9 % of the way round its bones is bare, and
# no bone goes through them; of an outfit for arms that hang 2 to 45 % is in the skin, and arms pierce its sleeves.
DEEP_M, DEEP_SHARE, BARE_SHARE = 0.01, 0.01, 0.15
FLAT = 0.05  # its thickness over its length: what is worn has 0.2 or more, a sheet with waves of 3 cm in a metre 0.03


def on_standard(mesh: GarmentMesh, body: BodyModel, options: IntakeOptions) -> GarmentMesh | None:
    """Returns the checked ``mesh`` in metres, y up, if it was made for the standard body in T-pose: it lies close on
    it, no bone goes through it, hardly any of it is deep in the skin, and it goes nearly all round the bones that it is
    on. Otherwise None."""
    avatar = standard_avatar(body)
    try:
        placed = place_on_avatar(mesh, avatar, unit=options.unit, up=options.up, named=False)
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
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, hints: ReadingHints = NO_HINTS
) -> tuple[GarmentMesh, Avatar, WearerCandidate]:
    """Returns the checked ``mesh`` in metres, y up, facing +z; the avatar that was found in it, in the same frame; and
    how it was found. ``hints``: what was stated of the file. Raises ``MeshError`` where no human body fits and
    for a flat piece of cloth."""
    reading = ReadingHints(
        (options.unit, UNITS_M[options.unit]) if hints.unit is None and options.unit != "auto" else hints.unit,
        f"+{options.up}" if hints.up is None and options.up != "auto" else hints.up,
        hints.front,
    )
    wearer = jewellery_wearer(mesh, body, reading) or accessory_wearer(mesh, body, reading)
    if wearer is None:
        check_cloth(mesh)
        _check_shaped(mesh)
        wearer = seated(mesh, the_wearer(mesh, body, reading))
    vertices = posed_by(body, wearer.parameters)
    source = f"found in the cloth: {wearer.words}; sure {wearer.sure:.2f}"
    turned = replace(mesh, vertices=wearer.reading.apply(mesh.vertices))
    return (
        turned.noted(f"nobody named the avatar; it seems to be {wearer.words}", *map(warning, wearer.doubts)),
        Avatar(vertices, body.faces, 0.0, source),
        wearer,
    )


def _check_shaped(mesh: GarmentMesh) -> None:
    """Refuses (``MeshError``) flat cloth: it would be taken for whatever body it hangs on the least badly."""
    points, _ = cloth_points(mesh.vertices, mesh.faces, SAMPLE_COUNT)
    points = points - points.mean(axis=0)
    length, _, thickness = np.ptp(points @ np.linalg.svd(points, full_matrices=False)[2].T, axis=0)
    if thickness < FLAT * length:
        extent = " x ".join(f"{along:.4g}" for along in np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0))
        raise MeshError(
            "garment",
            expected="cloth in the shape in which it is worn",
            got=f"a flat piece, of an extent of {extent}",
            cure="Export it as it hangs on a body, its panels sewn, or say on which body it lies so (avatar).",
        )
