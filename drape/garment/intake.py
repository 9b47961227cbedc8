"""The intake: a mesh file modelled on any avatar becomes a garment at rest on the standard body.

    python -m drape.garment.intake FILE [--avatar AVATAR] [--out DIR] [--unit m] [--up y] [--patches 2]
        [--rest auto] [--fabric jersey]

Steps: read, check, move to the standard body in T-pose, subdivide, push clear of the body, fit
patches, find the cloth's rest state, store. The name of the cache file ends in a digest of everything
that went in, so a second intake of the same garment returns at once.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from drape import forked
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.fabric_table import DEFAULT_FABRIC
from drape.errors import InputError, refusing
from drape.files.pictures import remake_pictures
from drape.garment import avatars
from drape.garment.accessories import bones_that_carry
from drape.garment.body_pieces import without_bodies
from drape.garment.cache import FORMAT_VERSION, OWN_GARMENTS_DIR, Garment, load_garment, save_garment
from drape.garment.clearance import CLEARANCE_M
from drape.garment.cloth_layer import join_sheets
from drape.garment.files.mesh import GarmentMesh, read_mesh
from drape.garment.fitting import fit_garment
from drape.garment.grain import corner_uv
from drape.garment.intake_options import DEFAULT_OPTIONS, IntakeOptions, read_fabric
from drape.garment.mesh_checks import Unit, Up, check_arrays
from drape.garment.modelled_on import modelled_on
from drape.garment.outfit import garments_in, part_names, parted
from drape.garment.panels import with_sewn_panels
from drape.garment.rest_detail import Rest, RestCloth, doubled_faces, rest_of, subdivided_like
from drape.garment.rest_mesh import RestMesh, describe_rest, rest_mesh, with_unused
from drape.garment.sewing import Sewing, sewing_beside, sewn_hinges
from drape.garment.sheets import with_used_vertices
from drape.garment.strays import without_strays
from drape.garment.wearer_pictures import pictured

# Raised when garments change that were not modelled on the standard body, as when another wearer is found.
MOVED_VERSION = 11
INTAKE_VERSION = 5  # raised when a change here changes the garments that come out
_LATE_OPTIONS = ("patches", "rest", "fabric", "uv_unit_m")  # at their defaults they leave older digests unchanged

Report = Callable[[str], None]
STAGES = ("read", "rest", "fit", "cloth", "store")
"""The stages of an intake in order: the file and its avatar, the mesh at rest, its patches, the cloth's rest state,
the cache file."""


def garment_digest(
    payload: bytes,
    avatar: Any,
    body: BodyModel,
    options: IntakeOptions,
    name: str,
    sewn: Sewing | None = None,
    *,
    looks: str = "",
) -> str:
    """Returns the SHA-256, as hex, of all that decides what garment intake makes: the file's bytes ``payload`` and
    ``looks``, the digest of its looks, the avatar as ``parse_avatar`` returns it, the body, options, name and
    sewing."""
    if isinstance(avatar, Path):
        avatar = hashlib.sha256(avatar.read_bytes()).hexdigest()
    chosen, usual = (asdict(one.completed_by(sewn)) for one in (options, DEFAULT_OPTIONS))
    for late in _LATE_OPTIONS:
        if chosen[late] == usual[late]:
            del chosen[late]
    header = {
        "name": name,
        "avatar": avatar,
        "body": body.digest,
        "options": chosen | {"repair": False, "clearance_m": CLEARANCE_M},  # older digests hold a repair option
        "versions": [FORMAT_VERSION, INTAKE_VERSION],
    }
    if avatar != avatars.STANDARD:
        header["moved"] = MOVED_VERSION
    if looks:
        header["looks"] = looks
    if sewn is not None:
        header["sewing"] = replace(sewn, figures={}).to_json()  # figures of the making change no garment
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode() + b"\0" + payload).hexdigest()


def garment_name(text: str) -> str:
    """Returns ``text`` as a garment's name: at most 64 lower-case letters, digits and underscores. Raises
    ``InputError`` where none is left."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:64]
    if not name:
        raise InputError(
            "garment name", expected="letters or digits", got=repr(text), cure="Give the garment a name: --name."
        )
    return name


def intake(source: Path | bytes, **asked: Any) -> Garment:
    """Returns one garment made of all that a mesh file holds, at rest on the standard body. Arguments, what is stored
    and what is raised are those of ``intake_outfit``."""
    (garment,) = intake_outfit(source, whole=True, **asked)
    return garment


def intake_outfit(
    source: Path | bytes,
    *,
    name: str | None = None,
    kind: str | None = None,
    avatar: str | Path | dict[str, Any] | None = None,
    body: BodyModel | None = None,
    options: IntakeOptions = DEFAULT_OPTIONS,
    folder: Path | None = None,
    quick: bool = False,
    report: Report | None = None,
    begun: Report | None = None,
    whole: bool = False,
) -> list[Garment]:
    """Returns the garments made of a mesh file, at rest on ``body``, the innermost first; with ``whole`` one garment of
    all.

    ``source``: the file, or its bytes of the format ``kind``. ``avatar``: the body that the garment was modelled on
    (``drape.garment.avatars``). Left out, the file avatars.json beside the mesh names it; without an entry there it is
    the standard body where the garment lies close on that, and else it is looked for (``wearer_search``). A JSON file
    of ``drape.garment.sewing`` beside the mesh says how the garment is sewn.

    With ``folder`` the garments are stored there, ``quick`` as in ``save_garment``, and the next intake of the same
    file loads them. ``report`` is called with each line of the log, ``begun`` with each of ``STAGES`` as it begins.
    Raises ``InputError``, and then writes nothing.
    """
    say, begins = report or (lambda line: None), begun or (lambda stage: None)
    begins("read")
    body = load_body() if body is None else body
    file = _opened(source, name, kind, avatar, body, options)
    if folder is not None and (stored := stored_outfit(folder, file.digest, whole=whole)):
        say(f"cached    {', '.join(one.file_name() for one in stored)}")
        return stored
    garments = _garments_of(file, body, say, begins, whole=whole)
    begins("store")
    if folder is not None:
        for garment in garments:
            say(f"stored    {save_garment(garment, folder, quick=quick)}")
    return garments


HERE = {"unit": "m", "up": "y", "facing": "z", "trans": [0.0, 0.0, 0.0]}  # for a mesh that lies on its body


def intake_mesh(mesh: GarmentMesh, body: BodyModel, *, digest: str) -> Garment:
    """Returns one garment made of ``mesh``, which lies on ``body`` in T-pose, in metres, y up; nothing is stored.
    ``digest`` becomes the garment's. Raises ``InputError``."""
    looks, notes = remake_pictures(mesh.looks)
    named = replace(mesh, name=garment_name(mesh.name), looks=looks).noted(*notes)
    file = _File(named, b"", HERE, None, digest, DEFAULT_OPTIONS.completed_by(None))
    (garment,) = _garments_of(file, body, lambda line: None, lambda stage: None, whole=True, counted=False)
    return garment


class _File(NamedTuple):
    """A mesh file as it is asked for: its bytes, what its avatar means, its sewing, and the digest of all of it."""

    mesh: GarmentMesh
    payload: bytes
    meaning: Any
    sewn: Sewing | None
    digest: str
    options: IntakeOptions


def _opened(
    source: Path | bytes,
    name: str | None,
    kind: str | None,
    avatar: str | Path | dict[str, Any] | None,
    body: BodyModel,
    options: IntakeOptions,
) -> _File:
    """The file of the arguments of ``intake_outfit``."""
    path = None if isinstance(source, (bytes, bytearray)) else Path(source)
    mesh = read_mesh(source, name=name or (path.stem if path else None), kind=kind)
    payload = bytes(source) if path is None else path.read_bytes()
    mesh = replace(mesh, name=garment_name(mesh.name))
    meaning = avatars.parse_avatar(avatar, beside=path, allow_paths=path is not None)
    sewn = sewing_beside(path) if path else None
    if sewn is not None:
        sewn.check(mesh)
    digest = garment_digest(payload, meaning, body, options, mesh.name, sewn, looks=mesh.looks.digest)
    return _File(mesh, payload, meaning, sewn, digest, options.completed_by(sewn))


def _garments_of(
    file: _File, body: BodyModel, say: Report, begins: Report, *, whole: bool, counted: bool = True
) -> list[Garment]:
    """The garments of ``file``, the innermost first; one of all where they are ``whole``, which says of how many if
    these are ``counted``."""
    mesh, sewn, options = file.mesh, file.sewn, file.options
    with_uv = "with uv" if len(mesh.uv) else "no uv"
    say(f"read      {len(mesh.vertices):,} vertices, {len(mesh.faces):,} triangles, {with_uv}")
    check_arrays(mesh)
    mesh = mesh if sewn is not None else without_bodies(without_strays(mesh), body)
    sheets, model, wearer = modelled_on(mesh if sewn is not None else join_sheets(mesh), body, options, file.meaning)
    unnamed = "" if file.meaning is not None else " (none was named)"
    carriers = () if sewn is not None else bones_that_carry(with_used_vertices(sheets), model.vertices, body)
    alone, outer = sewn is not None or bool(carriers), None
    if not alone:
        sheets, outer = with_sewn_panels(sheets, model.vertices)
    say(f"avatar    {model.source}; residual {model.residual_mm:.1f} mm{unnamed}")
    if sewn is not None:
        say(f"sewn      {len(sewn.panels)} panels, {len(sewn.seams)} seams, {sewn.fabric}")
    started = time.perf_counter()
    begins("rest")
    extra: dict[str, Any] = {} if wearer is None else {"wearer": pictured(wearer, mesh)}
    label = np.zeros(len(sheets.faces), dtype=int)
    if counted and not alone:
        label = garments_in(sheets, model.vertices, body)
    layers = int(label.max(initial=0)) + 1
    if layers > 1:
        extra |= {"layers": layers}
    parts = [(mesh, sheets)] if whole else parted(mesh, sheets, label)
    names = part_names(mesh, [delivered for delivered, _ in parts])
    cloth = {"sewn": sewn is not None, "carriers": carriers if len(parts) == 1 else None}
    sides = [outer] if outer is None or len(parts) == 1 else [outer[label == number] for number in range(layers)]
    rests = forked.each(
        lambda own: rest_mesh(*own[0], model, body, outer=own[1], **cloth), list(zip(parts, sides, strict=True))
    )
    begins("fit")

    def fitted(number: int) -> Garment:
        own = file.digest if len(rests) == 1 else part_digest(file.digest, number)
        manifest = _manifest(parts[number][0], file.payload, model, options, rests[number]) | extra
        return _fitted(rests[number], names[number], body, own, manifest, file)

    garments = forked.each(fitted, range(len(rests)))
    for rest, garment in zip(rests, garments, strict=True):
        for line in (*describe_rest(rest), *_describe_fit(garment, options)):
            say(line)
    begins("cloth")
    say(f"took      {time.perf_counter() - started:.1f} s")
    return garments


def _fitted(rest: RestMesh, name: str, body: BodyModel, digest: str, manifest: dict[str, Any], file: _File) -> Garment:
    """The garment ``name`` of the mesh at ``rest``, with its patches and its rest state."""
    if rest.carriers:
        manifest["carried_by"] = list(rest.carriers)
    compact = replace(rest.mesh, name=garment_name(name))
    fitted = fit_garment(
        compact, rest.vertices, rest.fine_faces, body, digest=digest, manifest=manifest, share=file.options.patches,
        arm=rest.arm, shapes=rest.shapes,
    )  # fmt: skip
    garment = with_rest_state(with_unused(fitted, rest.faces, rest.kept), rest, file.options, file.sewn)
    return replace(garment, drawn=rest.drawn)


def part_digest(digest: str, number: int) -> str:
    """Returns the hex digest of garment ``number``, counted from 0, in a file of several garments; ``digest`` is the
    file's."""
    return hashlib.sha256(f"layer {number} {digest}".encode()).hexdigest()


def stored_outfit(folder: Path, digest: str, *, whole: bool) -> list[Garment]:
    """Returns the garments that ``intake_outfit`` stored in ``folder`` for the file with ``digest``, the innermost
    first; with ``whole`` the one garment of all. The list is empty if one of them is missing."""

    def load(own: str) -> Garment | None:
        path = next(folder.glob(f"*-{own[:16]}.npz"), None)
        return None if path is None else load_garment(path)

    single = load(digest)
    if single is not None and (whole or "layers" not in single.manifest):
        return [single]
    first = None if whole else load(part_digest(digest, 0))
    if first is None:
        return []
    others = [load(part_digest(digest, number)) for number in range(1, first.manifest["layers"])]
    stored = [first, *(garment for garment in others if garment is not None)]
    return stored if len(stored) > len(others) else []


def _manifest(
    mesh: GarmentMesh, payload: bytes, model: avatars.Avatar, options: IntakeOptions, rest: RestMesh
) -> dict[str, Any]:
    """The record of an intake: what went in, and how far the mesh was moved."""
    return {
        "source": {
            "sha256": hashlib.sha256(payload).hexdigest(),
            "vertex_count": len(mesh.vertices),
            "face_count": len(mesh.faces),
        },
        "avatar": {"source": model.source, "residual_mm": model.residual_mm},
        "options": asdict(options),
        "notes": list(rest.mesh.notes),
        "intake": {key: round(float(value), 4) for key, value in rest.figures.items()},
    }


def _describe_fit(garment: Garment, options: IntakeOptions) -> list[str]:
    """Lines for the log: the patches, how well they fit, and the cloth's rest state."""
    error, cloth = garment.manifest["fit"], garment.manifest["rest"]
    return [
        f"fitted    {garment.patch_count} patches on {len(garment.vertices):,} vertices",
        f"fit error {error['point_rmse_m']:.2e} m point RMSE, {error['normal_error_deg']:.2f} deg normal error",
        f"cloth     rest {options.rest}: {100 * cloth['kept_share']:.1f} % of the hinges keep an angle, "
        f"{100 * cloth['hem_share']:.1f} % lie double; grain {cloth['grain']}, lengths of the {cloth['lengths']}",
    ]


def with_rest_state(garment: Garment, rest: RestMesh, options: IntakeOptions, sewn: Sewing | None = None) -> Garment:
    """Returns ``garment``, which was fitted to ``rest``, with its rest state, with the fabric of ``options``, and with
    the ``RestFigures`` in the manifest under "rest". ``sewn`` says the angles and the stiffening of its hinges, if it
    is known."""
    compact = rest.mesh
    row = np.concatenate([rest.kept, np.arange(len(compact.vertices), len(rest.vertices))])
    faces = garment.fine_faces.astype(np.int64)
    modelled = subdivided_like(compact.vertices, compact.faces, len(faces))[row]
    on_corners = corner_uv(compact.uv, compact.uv_faces, len(faces))
    doubled = doubled_faces(compact.material_names, compact.face_material, len(faces))
    points = garment.vertices.astype(np.float64) if rest.lay is None else rest.lay[row]
    hinges = None
    if sewn is not None and on_corners is not None:
        on_corners = replace(on_corners, grain_along_v=True)
        hinges = sewn_hinges(sewn, compact, rest.kept, faces, on_corners)
    cloth = RestCloth(points, faces, modelled, on_corners, doubled, options.uv_unit_m, rest.resized, hinges)
    state, figures = rest_of(cloth, options.rest)
    arrays = {"rest_edges": state.edges, "rest_angle": state.hinge_angle, "rest_stiffening": state.stiffening}
    return replace(
        garment,
        **{name: array.astype(np.float32) for name, array in arrays.items()},
        fabric=options.completed_by(sewn).fabric or DEFAULT_FABRIC,
        manifest=garment.manifest | {"rest": asdict(figures)},
    )


@refusing
def main(arguments: list[str] | None = None) -> int:
    """Runs the intake's command line. Returns the exit status: 0 if the garments were made, 2 if the file was
    refused."""
    parser = argparse.ArgumentParser(prog="python -m drape.garment.intake", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("file", type=Path, help="OBJ, GLB, glTF, PLY, STL, USD, or a zip of one with its pictures")
    parser.add_argument("--name", help="default: the file's name")
    parser.add_argument(
        "--avatar", help="JSON, a mesh file, a name in avatars.json, or 'standard'; default: avatars.json beside FILE"
    )
    parser.add_argument("--body", default=None, help="standard body: a shipped name or an SMPL file")
    parser.add_argument("--out", type=Path, default=OWN_GARMENTS_DIR, help="folder of the cache file (%(default)s)")
    parser.add_argument(
        "--unit", default="auto", choices=get_args(Unit), help="of the file; auto: by its place on the avatar"
    )
    parser.add_argument(
        "--up", default="auto", choices=get_args(Up), help="axis of the file; auto: by its place on the avatar"
    )
    parser.add_argument(
        "--patches",
        type=float,
        default=1.0,
        help="over the usual number: with 2 charts agree better, and frames take longer",
    )
    parser.add_argument(
        "--rest",
        default="auto",
        choices=get_args(Rest),
        help="what the cloth remembers of its shape (%(default)s: creases)",
    )
    parser.add_argument("--fabric", help=f"a name, or numbers as JSON (that of its sewing, or {DEFAULT_FABRIC})")
    parser.add_argument("--uv-unit", type=float, help="metres of cloth per unit of uv, where uv are its panels")
    given = parser.parse_args(arguments)
    intake_outfit(
        given.file,
        name=given.name,
        avatar=given.avatar,
        body=load_body(given.body) if given.body else None,
        options=IntakeOptions(
            unit=given.unit,
            up=given.up,
            patches=given.patches,
            rest=given.rest,
            fabric=read_fabric(given.fabric) if given.fabric else None,
            uv_unit_m=given.uv_unit,
        ),
        folder=given.out,
        report=print,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
