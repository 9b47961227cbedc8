"""The clothes that a character came in as garments that drape on it.

All that it wears of one kind is one garment, taken in as any mesh file (``drape.garment.intake``) on the body that lies
below it, so that no wearer is sought. Other clothes stay on the skin, and a sentence says why: they are painted on the
skin or sewn to it, have few faces, are moved by one bone as armour is, or an intake refuses them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from drape.avatar.covered import covered_faces, ranges_of
from drape.avatar.face_colours import texture_of
from drape.avatar.own_clothes import (
    LOWER,
    UPPER,
    Halves,
    bare_faces,
    doubled_ends,
    halves_of,
    joined_halves,
    removed_faces,
    sewn_to_ends,
    tucked_faces,
)  # fmt: skip
from drape.avatar.tucked import TuckedTop, tucked_top
from drape.avatar.wearer import Wearer
from drape.avatar.wears import reach_of, why_not
from drape.body.model import BodyModel
from drape.errors import DrapeError
from drape.files.gltf import GltfFile
from drape.forked import each
from drape.garment.cache import Garment
from drape.garment.files.gltf_looks import gltf_looks
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake import intake_mesh
from drape.garment.sheets import pieces_of
from drape.geometry.closest import signed_distance
from drape.geometry.mesh_graphs import connected_components

VERSION = 3  # It is raised when a change here changes the garments that come out.
KINDS = ("trousers", "skirt", "top", "dress", "outer")  # The innermost come first.
LEAST_FACES = 40
PAINTED_SHARE = 0.5  # A part is painted on if a larger share of its faces is the skin's own mesh.
# A piece of cloth that lies inside the body, deeper than the second, is not seen if it goes deeper than the first.
BURIED_M, INSIDE_M = 0.03, 0.005
PIECE_SHARE = 0.3  # Pieces with a smaller share of the area of a kind's largest one are no cloth.
SEEN_SHARE = 0.4  # Clothes of a kind become a garment if at least this share of their faces is seen.
STIFF = 0.99  # A part is stiff if one bone has more of the weights of each of its vertices.
OWN = "own"  # In a garment's manifest it names the entry with its kind and the parts that it was.
MARK = "~"  # It stands between a character and the kind in the name of a garment.


@dataclass(frozen=True, eq=False)
class OwnGarments:
    """The ``garments`` that a character came in, the innermost first. ``stiff`` says why its other clothes stay on its
    skin, by the names of the parts."""

    garments: tuple[Garment, ...]
    stiff: dict[str, str]


class OwnCloth(NamedTuple):
    """Clothes of one ``kind`` that become one garment. ``numbers`` are the indices of their parts in ``Attire.parts``,
    and ``rows`` (n,) those of the character's faces that become cloth.

    The other faces of these parts stay on the skin: ``stays`` has the first face and the length of each run of them,
    run after run.
    """

    kind: str
    numbers: tuple[int, ...]
    stays: tuple[int, ...]
    rows: np.ndarray


def own_garments(payload: bytes, wearer: Wearer) -> OwnGarments:
    """Returns the clothes of the character in the file ``payload`` as garments on its body. ``wearer`` was made of this
    file.

    A garment's ``body_digest`` is that of the body of ``wearer`` on which it lies. Raises ``MeshError`` for another
    file.
    """
    stiff = _stiff(wearer)
    attire, parts = wearer.attire, wearer.attire.parts
    loose = {number for number, part in enumerate(parts) if part.kind in KINDS and part.name not in stiff}
    kinds = [kind for kind in KINDS if any(parts[number].kind == kind for number in loose)]
    halves = Halves(any(kind in UPPER for kind in kinds), any(kind in LOWER for kind in kinds))
    numbers = {kind: sorted(number for number in loose if parts[number].kind == kind) for kind in kinds}
    file, body = GltfFile(payload, label=wearer.name), wearer.body_under(halves)
    buried = _buried(wearer, body, kinds)
    worn = []
    for kind, own in numbers.items():
        whole = np.isin(attire.part, own)
        rows = _large_pieces(wearer, np.flatnonzero(whole & ~buried))
        if len(rows) < max(LEAST_FACES, SEEN_SHARE * whole.sum()):
            stiff |= {parts[number].name: "It lies inside of the body that we lay below it." for number in own}
            continue
        whole[rows] = False
        worn.append(OwnCloth(kind, tuple(own), tuple(ranges_of(whole).reshape(-1).tolist()), rows))
    garments = each(partial(_garment_or_why, file, wearer, body), worn)
    for one, why in zip(worn, garments, strict=True):
        if isinstance(why, str):
            stiff |= {parts[number].name: why for number in one.numbers}
    return OwnGarments(tuple(one for one in garments if not isinstance(one, str)), stiff)


def own_faces(wearer: Wearer, garments: Iterable[Garment]) -> np.ndarray:
    """Returns the mask (F,) bool of the faces of ``wearer`` that became cloth of one of ``garments``, and are drawn as
    cloth."""
    own = np.zeros(len(wearer.faces), dtype=bool)
    for garment in garments:
        about = garment.manifest.get(OWN, {})
        own |= np.isin(wearer.attire.part, about.get("parts", ()))
        stays = about.get("stays", [])
        for first, count in zip(stays[::2], stays[1::2], strict=True):
            own[first : first + count] = False
    return own


def halves_on(wearer: Wearer, garments: Sequence[Garment], standard: BodyModel) -> Halves:
    """Returns on which halves of a body the ``garments`` lie. Some are made for the ``standard`` body, others are the
    ``wearer``'s own."""
    own = [garment for garment in garments if OWN in garment.manifest]
    others = [garment for garment in garments if OWN not in garment.manifest]
    return joined_halves([halves_of(others, standard), halves_of(own, wearer.body)])


class Undressed(NamedTuple):
    """The faces of a character in garments that are not drawn, and what is drawn instead.

    ``off`` (F,) bool are the character's faces that are not drawn, and ``bare`` (Fb,) bool the faces of its bare body
    that are. ``tucked`` is a top of its own that is tucked in, None where there is none. ``deep`` (Fb,) bool are those
    of ``bare`` that lie under the garments, up to their hems; None where none does.
    """

    off: np.ndarray
    bare: np.ndarray
    tucked: TuckedTop | None = None
    deep: np.ndarray | None = None

    @property
    def added(self) -> int:
        """The number of faces that are drawn instead, of the bare body and of the tucked top."""
        return int(self.bare.sum()) + (0 if self.tucked is None else len(self.tucked.faces))


def undress(
    wearer: Wearer, own: np.ndarray, cloth: Sequence[tuple[np.ndarray, np.ndarray]], halves: Halves
) -> Undressed:
    """Returns what is not drawn of ``wearer`` in garments, and what is drawn instead.

    ``own`` (F,) bool are its faces that are drawn as cloth. ``cloth`` has vertices [m] (V, 3) and faces (F, 3) of each
    garment in the T-pose. ``halves`` are those on which garments of ours lie: they take off what lies there, and tops
    that stay on are tucked into trousers of ours.
    """
    if not wearer.attire.parts:
        return Undressed(np.zeros(len(wearer.faces), dtype=bool), np.zeros(len(wearer.body.faces), dtype=bool))
    body, surface = wearer.body, (wearer.vertices.astype(np.float64), wearer.faces.astype(np.int64))
    off = removed_faces(wearer.attire, halves)
    off &= ~sewn_to_ends(wearer.weights, surface[1], off)
    off |= own
    tops = tucked_faces(wearer.attire, halves) & ~off
    top = tucked_top(wearer, tops, cloth) if tops.any() else None
    if top is not None:
        off |= top.off & tops
    bare = bare_faces(body, *surface, off)
    bare &= ~doubled_ends(body, wearer.weights, wearer.faces[~off])
    if top is not None:
        off, bare = off | top.off, bare & ~top.hidden
    deep = bare.copy()
    if bare.any():
        deep[bare] = covered_faces(body.v_template, body.faces[bare], cloth, margin_m=0.0)
    return Undressed(off, bare, top, deep)


def split_own(own: Sequence[Garment], halves: Halves) -> tuple[list[Garment], list[Garment]]:
    """Returns two lists of those of a character's ``own`` garments that stay on under other garments on these
    ``halves``: the ones worn below the others, and the ones worn over them."""
    off = (UPPER if halves.upper else ()) + (LOWER if halves.lower else ())
    left = [garment for garment in own if garment.manifest[OWN]["kind"] not in off]
    lower = [garment for garment in left if garment.manifest[OWN]["kind"] in LOWER]
    return lower, [garment for garment in left if garment not in lower]


def body_of(garment: Garment, wearer: Wearer, standard: BodyModel) -> BodyModel:
    """Returns the body that ``garment`` was made for: the bare body of ``wearer``, the one with its trousers on, or the
    ``standard`` body."""
    if garment.body_digest in (standard.digest, wearer.body.digest):
        return wearer.body if garment.body_digest == wearer.body.digest else standard
    return wearer.upper if garment.body_digest == wearer.upper.digest else standard


def _large_pieces(wearer: Wearer, rows: np.ndarray) -> np.ndarray:
    """Those of the faces ``rows`` (n,) of clothes that are in no piece much smaller than the largest one, such as what
    has the colour of trousers round the hem of a coat."""
    if not len(rows):
        return rows
    piece, area = pieces_of(wearer.vertices.astype(np.float64), wearer.faces[rows])
    return rows[area[piece] > PIECE_SHARE * area[0]]


def _buried(wearer: Wearer, body: BodyModel, kinds: Sequence[str]) -> np.ndarray:
    """Which faces (F,) of clothes of these ``kinds`` lie so deep in the ``body`` that nobody sees them, as the upper
    end of leggings under a jacket that is one mesh with the skin: nothing tells the body below both."""
    rows = np.flatnonzero(wearer.attire.of_kinds(kinds))
    used, faces = np.unique(wearer.faces[rows], return_inverse=True)
    depth = -signed_distance(wearer.vertices[used].astype(np.float64), body.v_template, body.faces)
    faces = faces.reshape(-1, 3)
    inside = np.flatnonzero((depth[faces] > INSIDE_M).any(axis=1))
    piece = connected_components(faces[inside], len(used))[faces[inside][:, 0]]
    deepest = np.zeros(len(used))
    np.maximum.at(deepest, piece, depth[faces[inside]].max(axis=1))
    found = np.zeros(len(wearer.faces), dtype=bool)
    found[rows[inside[deepest[piece] > BURIED_M]]] = True
    return found


def _stiff(wearer: Wearer) -> dict[str, str]:
    """Why clothes stay on the skin, by the names of parts, as far as it is seen before an intake."""
    assert wearer.painted is not None
    reasons = {}
    for number, part in enumerate(wearer.attire.parts):
        rows = np.flatnonzero(wearer.attire.part == number)
        if part.kind not in KINDS or not len(rows):
            continue
        weights = wearer.weights[np.unique(wearer.faces[rows])]
        if len(rows) < LEAST_FACES:
            reasons[part.name] = f"It has {len(rows)} faces, too few to fold."
        elif wearer.painted[rows].mean() > PAINTED_SHARE:
            reasons[part.name] = "It is painted on the skin, or one mesh with it."
        elif (weights > STIFF).all(axis=0).any():
            reasons[part.name] = "One bone moves all of it, as armour."
    return reasons


def _garment_or_why(file: GltfFile, wearer: Wearer, body: BodyModel, own: OwnCloth) -> Garment | str:
    """The garment of ``own`` clothes of the ``wearer`` in ``file`` on its ``body``, or why no cloth can be made of
    them."""
    try:
        return _garment(file, wearer, body, own)
    except DrapeError as error:
        return f"No cloth can be made of it: expected {error.expected}, got {error.got}."


def _garment(file: GltfFile, wearer: Wearer, body: BodyModel, own: OwnCloth) -> Garment:
    kind, numbers = own.kind, list(own.numbers)
    made_of = f"own {VERSION} {kind} {numbers} {wearer.digest} {body.digest}"
    mesh = _mesh(file, wearer, f"{wearer.name}_{kind}", own.rows)
    garment = intake_mesh(mesh, body, digest=hashlib.sha256(made_of.encode()).hexdigest())
    refusal = why_not(body, reach_of(garment, body), garment=kind)
    if refusal is not None:
        raise refusal
    about = {"kind": kind, "parts": numbers, "stays": list(own.stays)}
    called = f"{wearer.name}{MARK}{kind}"
    drawn = None if garment.drawn is None else replace(garment.drawn, name=called)
    return replace(garment, name=called, drawn=drawn, manifest=garment.manifest | {OWN: about})


def _mesh(file: GltfFile, wearer: Wearer, name: str, rows: np.ndarray) -> GarmentMesh:
    """The faces ``rows`` of ``wearer`` with their materials, pictures and texture coordinates."""
    assert wearer.file is not None
    used, faces = np.unique(wearer.faces[rows], return_inverse=True)
    textured = [texture_of(file, primitive) for primitive in wearer.file.primitives]
    triangle = wearer.file.triangle[rows]
    numbers = [-1 if number is None else number for _, number in textured]
    material = np.repeat(numbers, [len(uv) for uv, _ in textured])[triangle]
    there, face_material = np.unique(material, return_inverse=True)
    materials = [None if number < 0 else int(number) for number in there]
    looks, notes = gltf_looks(file, materials)
    fields = [{} if number is None else file.item("materials", number, "primitives.material") for number in materials]
    names = [field.get("name") for field in fields]
    corners = np.concatenate([uv for uv, _ in textured])[triangle].reshape(-1, 2)
    uv, uv_faces = np.unique(corners, axis=0, return_inverse=True)  # Corners that meet are one. Files split the others.
    mesh = plain_mesh(name, wearer.vertices[used], faces.reshape(-1, 3))
    return replace(
        mesh,
        uv=np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]),  # glTF has the origin at the upper left.
        uv_faces=uv_faces.reshape(-1, 3),
        material_names=tuple(name if isinstance(name, str) else f"material {i}" for i, name in enumerate(names)),
        face_material=face_material.reshape(-1),
        looks=looks,
    ).noted(*notes)
