"""The avatar of a garment, and the garment in metres on it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.garment.avatars import Avatar, read_avatar, standard_avatar
from drape.garment.caps import without_pits
from drape.garment.files.mesh import GarmentMesh
from drape.garment.intake_options import IntakeOptions
from drape.garment.mesh_checks import check_options, check_surface, place_on_avatar
from drape.garment.reading_hints import NO_HINTS, ReadingHints, reading_hints
from drape.garment.sheets import with_used_vertices
from drape.garment.unnamed_avatar import on_standard, worn_by
from drape.garment.wearer_reading import WearerCandidate


def modelled_on(
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, meaning: Any = None
) -> tuple[GarmentMesh, Avatar, WearerCandidate | None]:
    """Returns ``mesh``, checked, in metres in the coordinates of its avatar; that avatar; and the body that was found
    in the cloth, None where the avatar was named or is the standard body. ``meaning``: what ``avatars.parse_avatar``
    returns, whose dictionary may also state unit and axes of the file (``reading_hints``). Raises ``MeshError`` where
    the mesh is no cloth or no human body fits in it, and ``BodyError`` for an avatar that is not a body."""
    check_options(options.unit, options.up)
    hints, meaning = reading_hints(meaning)
    checked = check_surface(mesh)
    if meaning is not None:
        worn = _on_named(checked, body, options, hints, meaning)
    elif hints == NO_HINTS and (placed := on_standard(checked, body, options)) is not None:
        return placed, standard_avatar(body), None
    else:
        worn = worn_by(checked, body, options, hints)
    placed, avatar, wearer = worn
    keep = without_pits(placed.vertices, placed.faces, body.regressor @ avatar.vertices)
    if not keep.all():  # delivered vertices stay in their rows, as in ``join_sheets``
        cut, count = with_used_vertices(placed.take_faces(keep)), len(placed.vertices)
        placed = replace(cut, vertices=np.concatenate([placed.vertices, cut.vertices]), faces=cut.faces + count)
        placed = placed.noted(f"{int((~keep).sum())} faces close ends of tubes in pits")
    return placed, avatar, wearer


def _on_named(
    mesh: GarmentMesh, body: BodyModel, options: IntakeOptions, hints: ReadingHints, meaning: Any
) -> tuple[GarmentMesh, Avatar, None]:
    """The checked ``mesh`` on the avatar of that ``meaning``; where a body's place and all of the file's reading are
    told, there it stays."""
    avatar = read_avatar(meaning, body)
    if hints.reading is not None and isinstance(meaning, dict) and "trans" in meaning:
        return replace(mesh, vertices=hints.reading.apply(mesh.vertices)), avatar, None
    unit, up = options.unit, options.up
    if hints.unit is not None:
        mesh, unit = replace(mesh, vertices=hints.unit[1] * mesh.vertices), "m"
    if hints.turned is not None:
        mesh, up = replace(mesh, vertices=hints.turned.apply(mesh.vertices)), "y"
    return place_on_avatar(mesh, avatar, unit=unit, up=up), avatar, None
