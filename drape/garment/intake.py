"""Takes in a garment: a mesh file modelled on any avatar becomes a garment at rest on the standard body.

    python -m drape.garment.intake FILE [--avatar AVATAR] [--out DIR] [--repair] [--unit m] [--up y] [--patches 2]
        [--rest auto] [--fabric jersey]

Steps: read, check, move to the standard body in T-pose, subdivide, push clear of the body, fit
patches, find the cloth's rest state, store. The cache file's name carries a digest of everything
that went in, so taking the same garment in again returns at once.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.fabric_table import DEFAULT_FABRIC, fabric
from drape.errors import InputError, refusing
from drape.garment import avatars
from drape.garment.cache import (
    FORMAT_VERSION,
    OWN_GARMENTS_DIR,
    Garment,
    load_garment,
    save_garment,
)
from drape.garment.clearance import CLEARANCE_M, clear_body
from drape.garment.files.mesh import GarmentMesh, read_mesh
from drape.garment.grain import texture
from drape.garment.mesh_checks import Unit, Up, check_mesh
from drape.garment.rest_detail import Cloth, Rest, doubled_faces, rest_of, subdivided_like
from drape.garment.rest_pose import refine, to_standard
from drape.garment.sewing import Sewing, beside, sewn_hinges
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices

INTAKE_VERSION = 2  # raised when a change here changes the garments that come out
PATCH_SHARE_RANGE = (0.75, 2.2)  # what the network is trained on
FINE_VERTEX_MINIMUM, FINE_VERTEX_LIMIT = 4_000, 40_000
FINE_EDGE_M = 0.021  # each round halves the edges: the mean ends near 15 mm
_VERTEX_ARRAYS = ("vertices", "chart_patch", "chart_uv", "chart_weight", "chart_residual", "skin_weights", "shapedirs")

Report = Callable[[str], None]
STAGES = ("read", "rest", "fit", "cloth", "store")
"""What an intake does, in order: the file and its avatar, the mesh at rest, its patches, the cloth's rest state."""


@dataclass(frozen=True)
class IntakeOptions:
    """``unit`` and ``up`` of the file ("auto": by its place on the avatar); ``repair`` drops bad faces.

    ``patches``: how many, over the number of ``patch_count_for``: more drape closer to physics, and slower
    (docs/reference/quality.md measures the trade). Raises ``InputError`` outside ``PATCH_SHARE_RANGE``.

    ``rest``: what the cloth remembers of its shape (``rest_detail.rest_of``); ``fabric``: what it is of, a name or
    numbers of ``fabric_table.fabric``, which refuses others, None for that of its sewing, or else jersey;
    ``uv_unit_m``: metres of cloth per unit of uv, where these are its panels.
    """

    unit: Unit = "auto"
    up: Up = "auto"
    repair: bool = False
    clearance_m: float = CLEARANCE_M
    patches: float = 1.0
    rest: Rest = "auto"
    fabric: str | Mapping[str, Any] | None = None
    uv_unit_m: float | None = None

    def __post_init__(self) -> None:
        if self.fabric is not None:
            fabric(self.fabric)
        if self.rest not in get_args(Rest):
            expected = "one of " + ", ".join(get_args(Rest))
            raise InputError("rest", expected=expected, got=str(self.rest), cure="Take auto.")
        if self.uv_unit_m is not None and not 0.0 < self.uv_unit_m < np.inf:
            raise InputError(
                "uv unit", expected="metres > 0", got=f"{self.uv_unit_m:g}", cure="Leave it out if uv are no panels."
            )
        low, high = PATCH_SHARE_RANGE
        if not low <= self.patches <= high:
            raise InputError(
                "patches",
                expected=f"a number from {low:g} to {high:g}, over the usual number",
                got=f"{self.patches:g}",
                cure="Take 1, or 2 for an accurate drape.",
            )

    def of(self, sewn: Sewing | None) -> IntakeOptions:
        """These, with what ``sewn`` says where they leave it open."""
        if sewn is None:
            return replace(self, fabric=self.fabric or DEFAULT_FABRIC)
        return replace(self, fabric=self.fabric or sewn.fabric, uv_unit_m=self.uv_unit_m or sewn.uv_unit_m)


_LATE_OPTIONS = ("patches", "rest", "fabric", "uv_unit_m")


@dataclass(frozen=True, eq=False)
class RestMesh:
    """A garment at rest, clear of the body: delivered vertices first, then those of the subdivision.

    ``mesh`` is the checked mesh without unused vertices, ``kept`` (V,) the row in it of every
    delivered vertex and ``faces`` the delivered faces; ``resized``: it was moved from another body;
    ``figures`` are what intake prints.
    """

    mesh: GarmentMesh
    kept: np.ndarray
    faces: np.ndarray
    vertices: np.ndarray
    fine_faces: np.ndarray
    loose: np.ndarray
    resized: bool
    figures: dict[str, float]


def rest_mesh(
    mesh: GarmentMesh,
    avatar: avatars.Avatar,
    body: BodyModel,
    options: IntakeOptions = IntakeOptions(),
    *,
    named: bool = True,
) -> RestMesh:
    """The garment ``mesh`` as delivered, checked, moved to ``body`` in T-pose and pushed clear of it.

    ``named`` is False where the avatar is only assumed.
    """
    checked = check_mesh(mesh, avatar, unit=options.unit, up=options.up, repair=options.repair, named=named)
    compact, kept = without_unused(checked)
    moved = to_standard(compact.vertices, compact.faces, avatar, body)
    fine, fine_faces, origin = refine(
        moved.vertices, compact.faces, at_least=FINE_VERTEX_MINIMUM, at_most=FINE_VERTEX_LIMIT, edge_m=FINE_EDGE_M
    )
    cleared = clear_body(fine, fine_faces, body.v_template, body.faces, clearance_m=options.clearance_m)
    delivered, final = compact.vertices, cleared.vertices[: len(compact.vertices)]
    figures = {
        "avatar_residual_mm": avatar.residual_mm,
        "clearance_mm": 1e3 * cleared.clearance_m,
        "push_max_mm": 1e3 * cleared.push_m,
        **{f"move_{k}": v for k, v in edge_strain(delivered, moved.vertices, compact.faces).items()},
        **{f"push_{k}": v for k, v in edge_strain(fine, cleared.vertices, fine_faces).items()},
        **{f"total_{k}": v for k, v in edge_strain(delivered, final, compact.faces).items()},
        "loose_share": float((moved.loose > 0.5).mean()),
        "fine_vertex_count": len(fine),
    }
    return RestMesh(
        compact, kept, checked.faces, cleared.vertices, fine_faces, moved.loose[origin], avatar.moved, figures
    )


def edge_strain(before: np.ndarray, after: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Mean and 95th percentile of |length after / length before - 1| over the edges [%]."""
    edges = meshes.unique_edges(faces)
    strain = 100.0 * np.abs(
        meshes.edge_lengths(after, edges) / np.maximum(meshes.edge_lengths(before, edges), 1e-9) - 1.0
    )
    return {"strain_mean_pct": float(strain.mean()), "strain_p95_pct": float(np.quantile(strain, 0.95))}


def without_unused(mesh: GarmentMesh) -> tuple[GarmentMesh, np.ndarray]:
    """``mesh`` without vertices that no face uses, and for every vertex its row there: its own or the nearest one's."""
    used = np.unique(mesh.faces)
    if len(used) == len(mesh.vertices):
        return mesh, np.arange(len(used))
    _, kept = nearest_vertices(mesh.vertices, mesh.vertices[used])
    kept[used] = np.arange(len(used))
    return replace(mesh, vertices=mesh.vertices[used], faces=kept[mesh.faces]), kept


def with_unused(garment: Garment, faces: np.ndarray, kept: np.ndarray) -> Garment:
    """``garment`` of a mesh without unused vertices, with them back in place; ``faces`` are the delivered ones."""
    compact = garment.vertex_count
    if len(kept) == compact and (kept == np.arange(compact)).all():
        return garment
    row = np.concatenate([kept, np.arange(compact, len(garment.vertices))])
    place = np.empty(len(garment.vertices), dtype=np.int64)
    place[row[::-1]] = np.arange(len(row))[::-1]
    place[garment.faces.reshape(-1)] = faces.reshape(-1)  # a face's vertex is the delivered one, not a copy of it
    arrays = {name: getattr(garment, name)[row] for name in _VERTEX_ARRAYS}
    fine_faces = place[garment.fine_faces].astype(np.int32)
    return replace(garment, vertex_count=len(kept), faces=faces.astype(np.int32), fine_faces=fine_faces, **arrays)


def garment_digest(
    payload: bytes, avatar: Any, body: BodyModel, options: IntakeOptions, name: str, sewn: Sewing | None = None
) -> str:
    """Hex digest of everything a garment depends on."""
    if isinstance(avatar, Path):
        avatar = hashlib.sha256(avatar.read_bytes()).hexdigest()
    chosen = asdict(options.of(sewn))
    usual = asdict(IntakeOptions().of(sewn))
    for late in _LATE_OPTIONS:
        if chosen[late] == usual[late]:
            del chosen[late]  # garments taken in before there was a choice keep their digest
    header = {
        "name": name,
        "avatar": avatar,
        "body": body.digest,
        "options": chosen,
        "versions": [FORMAT_VERSION, INTAKE_VERSION],
    }
    if sewn is not None:
        header["sewing"] = replace(sewn, figures={}).to_json()  # how long it took makes no other garment
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode() + b"\0" + payload).hexdigest()


def garment_name(text: str) -> str:
    """``text`` as a garment's name: lower-case letters, digits and underscores."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:64]
    if not name:
        raise InputError(
            "garment name", expected="letters or digits", got=repr(text), cure="Give the garment a name: --name."
        )
    return name


def intake(
    source: Path | bytes,
    *,
    name: str | None = None,
    kind: str | None = None,
    avatar: str | Path | dict[str, Any] | None = None,
    body: BodyModel | None = None,
    options: IntakeOptions = IntakeOptions(),
    folder: Path | None = None,
    report: Report | None = None,
    begun: Report | None = None,
) -> Garment:
    """The garment in a mesh file (or its bytes, of ``kind``), at rest on ``body``.

    ``avatar`` says what it was modelled on (``drape.garment.avatars``); None asks the table
    beside the file and then takes the standard body, if the garment lies on it. A JSON of ``drape.garment.sewing``
    beside the file says what it is sewn of. With ``folder``
    the result is stored there, and found there the next time. ``begun`` is told each of ``STAGES`` as it begins. Raises
    ``InputError``; nothing is written then.
    """
    say, begins = report or (lambda line: None), begun or (lambda stage: None)
    begins("read")
    body = load_body() if body is None else body
    path = None if isinstance(source, (bytes, bytearray)) else Path(source)
    mesh = read_mesh(source, name=name or (path.stem if path else None), kind=kind)
    payload = bytes(source) if path is None else path.read_bytes()
    name = garment_name(mesh.name)
    meaning = avatars.parse_avatar(avatar, beside=path, allow_paths=path is not None)
    sewn = beside(path) if path else None
    if sewn is not None:
        sewn.check(mesh)
    digest = garment_digest(payload, meaning, body, options, name, sewn)
    options = options.of(sewn)
    if folder is not None and (stored := folder / f"{name}-{digest[:16]}.npz").is_file():
        say(f"cached    {stored.name}")
        return load_garment(stored)

    texture = "with uv" if len(mesh.uv) else "no uv"
    say(f"read      {len(mesh.vertices):,} vertices, {len(mesh.faces):,} triangles, {texture}")
    model = avatars.read_avatar(meaning, body)
    say(
        f"avatar    {model.source}; residual {model.residual_mm:.1f} mm"
        + ("" if meaning is not None else " (none was named)")
    )
    if sewn is not None:
        say(f"sewn      {len(sewn.panels)} panels, {len(sewn.seams)} seams, {sewn.fabric}")
    started = time.perf_counter()
    begins("rest")
    rest = rest_mesh(mesh, model, body, options, named=meaning is not None)
    for line in describe_rest(rest):
        say(line)
    manifest = {
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
    begins("fit")
    fitted = _fit(rest, name, body, digest, manifest, options.patches)
    begins("cloth")
    garment = with_rest_state(fitted, rest, options, sewn)
    error, cloth = garment.manifest["fit"], garment.manifest["rest"]
    say(f"fitted    {garment.patch_count} patches on {len(garment.vertices):,} vertices")
    say(f"fit error {error['point_rmse_m']:.2e} m point RMSE, {error['normal_error_deg']:.2f} deg normal error")
    say(
        f"cloth     rest {options.rest}: {100 * cloth['kept_share']:.1f} % of the hinges keep an angle, "
        f"{100 * cloth['hem_share']:.1f} % lie double; grain {cloth['grain']}, lengths of the {cloth['lengths']}"
    )
    say(f"took      {time.perf_counter() - started:.1f} s")
    begins("store")
    if folder is not None:
        say(f"stored    {save_garment(garment, folder)}")
    return garment


def describe_rest(rest: RestMesh) -> list[str]:
    """The lines that say what was done to a garment and how far it moved."""
    figures = rest.figures
    lines = [f"note      {note}" for note in rest.mesh.notes]
    for step, what in (("move", "moved"), ("push", "cleared"), ("total", "in all")):
        mean, most = figures[f"{step}_strain_mean_pct"], figures[f"{step}_strain_p95_pct"]
        lines.append(f"{what:9s} edge strain {mean:.1f} % (95th percentile {most:.1f} %)")
    lines.append(
        f"clearance {figures['clearance_mm']:.2f} mm at least; pushed by {figures['push_max_mm']:.1f} mm at most"
    )
    return lines


def _fit(
    rest: RestMesh,
    name: str,
    body: BodyModel,
    digest: str,
    manifest: dict[str, Any],
    patches: float,
) -> Garment:
    from drape.garment.fitting import fit_garment

    mesh = rest.mesh
    garment = fit_garment(
        name=name,
        vertices=rest.vertices,
        vertex_count=len(mesh.vertices),
        faces=mesh.faces,
        fine_faces=rest.fine_faces,
        uv=mesh.uv,
        uv_faces=mesh.uv_faces,
        material_names=mesh.material_names,
        face_material=mesh.face_material,
        body=body,
        digest=digest,
        manifest=manifest,
        share=patches,
    )
    return with_unused(garment, rest.faces, rest.kept)


def with_rest_state(garment: Garment, rest: RestMesh, options: IntakeOptions, sewn: Sewing | None = None) -> Garment:
    """``garment``, taken in of ``rest``, with the rest state and the fabric of ``options``, and what ``sewn`` says of
    its hinges; figures in the manifest."""
    compact = rest.mesh
    row = np.concatenate([rest.kept, np.arange(len(compact.vertices), len(rest.vertices))])
    faces = garment.fine_faces.astype(np.int64)
    modelled = subdivided_like(compact.vertices, compact.faces, len(faces))[row]
    painted = texture(compact.uv, compact.uv_faces, len(faces))
    doubled = doubled_faces(compact.material_names, compact.face_material, len(faces))
    points = garment.vertices.astype(np.float64)
    hinges = None
    if sewn is not None and painted is not None:
        painted = replace(painted, grain_along_v=True)
        hinges = sewn_hinges(sewn, compact, rest.kept, faces, painted)
    cloth = Cloth(points, faces, modelled, painted, doubled, options.uv_unit_m, rest.resized, hinges)
    state, figures = rest_of(cloth, options.rest)
    arrays = {"rest_edges": state.edges, "rest_angle": state.hinge_angle, "rest_stiffening": state.stiffening}
    return replace(
        garment,
        **{name: array.astype(np.float32) for name, array in arrays.items()},
        fabric=options.of(sewn).fabric or DEFAULT_FABRIC,
        manifest=garment.manifest | {"rest": asdict(figures)},
    )


def read_fabric(text: str) -> str | dict[str, Any]:
    """A fabric as a command line gives it: a name, or its numbers as JSON."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            "fabric", expected="a name or a JSON object", got=str(error), cure="Correct the JSON."
        ) from error


@refusing
def main(arguments: list[str] | None = None) -> int:
    """Command line entry; 0 when the garment was taken in, 2 when it was refused."""
    parser = argparse.ArgumentParser(prog="python -m drape.garment.intake", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("file", type=Path, help="OBJ, GLB, PLY or STL")
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
    parser.add_argument("--repair", action="store_true", help="drop degenerate and duplicated faces")
    parser.add_argument(
        "--patches", type=float, default=1.0, help="over the usual number: 2 drapes closer to physics, and slower"
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
    intake(
        given.file,
        name=given.name,
        avatar=given.avatar,
        body=load_body(given.body) if given.body else None,
        options=IntakeOptions(
            unit=given.unit,
            up=given.up,
            repair=given.repair,
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
