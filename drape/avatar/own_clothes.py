"""The clothes that a character came in, and the body below: what garments of ours take off, and what is bare then.

A garment for the upper half of the body takes off tops and coats, one for the lower half trousers and skirts, and
either one a dress. Bags that stand far off the back go with a top. Clothes that are painted on the skin, or sewn to it,
are the body's own surface. Trousers that stay on lie under a top of ours, so there is a body with these on; a top that
stays on is tucked into trousers of ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drape.avatar.attire import Attire
from drape.avatar.parts import PARTS, parts_of, plain_part
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.garment.cache import Garment
from drape.geometry import meshes
from drape.geometry.closest import closest_point, nearest_vertices
from drape.geometry.mesh_graphs import connected_components

BONES = np.array([name.removeprefix("left_").removeprefix("right_") for name in JOINT_NAMES])
UPPER, LOWER = ("top", "outer", "dress"), ("trousers", "skirt", "dress")
SKIN = ("skin", "face", "gloves", "shoes", "underwear")
BULKY_M = 0.05  # What stands farther off the skin is no belt, and cloth does not lie over it.
ARMS = ["upper_arm", "forearm"]
INSET_M = 0.01  # Skin that was cut away below cloth lay so far below it.
LEAST_SHARE = 0.2  # A garment lies on a half of the body if a larger share of its vertices is there.
BELOW = 0.5  # Cloth lies on skin if the cosine between its normal and the way to the skin is larger.
BARE_M = 0.02  # The body is bare where the character's surface is farther away.
GONE_M = 0.12  # Clothes that were taken off lay nearer to the body than this.
# Parts where a fitted body is not the character's shape, from so far [m] from a joint on: chins hung below toys' heads.
ENDS = {"head": ("head", 0.0), "palm": ("wrist", 0.06), "sole": ("ankle", 0.06)}


class Halves(NamedTuple):
    """Whether garments lie on the ``upper`` and on the ``lower`` half of a body."""

    upper: bool
    lower: bool


NEITHER = Halves(False, False)


def joined_halves(halves: Sequence[Halves]) -> Halves:
    """Returns the halves on which garments lie by at least one of ``halves``."""
    return Halves(any(one.upper for one in halves), any(one.lower for one in halves))


def halves_of(garments: Iterable[Garment], body: BodyModel) -> Halves:
    """Returns on which halves of the standard ``body`` the ``garments`` lie, by the bones of the skin next to them."""
    return halves_by([skin_next_to(garment, body) for garment in garments], body)


def skin_next_to(garment: Garment, body: BodyModel) -> np.ndarray:
    """Returns the index (V,) of the vertex of ``body`` nearest to each of the V delivered vertices of ``garment`` at
    rest."""
    return nearest_vertices(garment.vertices[: garment.vertex_count].astype(np.float64), body.v_template)[1]


def halves_by(nearest: Iterable[np.ndarray], body: BodyModel) -> Halves:
    """Returns on which halves of ``body`` garments lie. ``nearest`` has of each garment the indices (V,) that
    ``skin_next_to`` returns."""
    bones = BONES[body.weights.argmax(axis=1)]
    upper = np.isin(bones, ["spine2", "spine3", "collar", "shoulder", "elbow", "neck"])
    lower = np.isin(bones, ["hip", "knee", "ankle", "foot"])
    covered = np.zeros(2, dtype=bool)
    for row in nearest:
        share = np.array([upper[row].mean(), lower[row].mean()])
        # A shirt's hem is on the hips.
        covered |= share > LEAST_SHARE * np.array([1.0, 1.0 + (share[0] > LEAST_SHARE)])
    return Halves(*map(bool, covered))


class Layers(NamedTuple):
    """The layers of a character, each a mask (F,) bool of its faces.

    ``body`` is its body, with clothes that are painted on it or lie flat on it. ``felt`` is the part of ``body`` that
    may lie under garments of ours: it has no painted sleeves, which any garment on the arms takes off. ``lower`` are
    trousers and skirts that are not part of the body. ``hollow`` are clothes without skin below, which stand for the
    skin. ``attire`` has the character's parts, in which bulky ones are marked.
    """

    body: np.ndarray
    felt: np.ndarray
    lower: np.ndarray
    hollow: np.ndarray
    attire: Attire


def layers_of(attire: Attire, pose: TPose) -> Layers:
    """Returns the layers of the character in ``pose``; ``attire`` has the kinds of its faces."""
    part = parts_of(pose.weights)[pose.faces[:, 0]]
    skin, clothes = attire.of_kinds(SKIN), attire.of_kinds(UPPER + LOWER)
    sewn = np.zeros(len(pose.vertices), dtype=bool)
    sewn[pose.faces[skin]] = True
    for number in range(len(attire.parts)):  # A region of one colour is sewn on as a whole.
        rows = attire.part == number
        if clothes[rows].all() and sewn[pose.faces[rows]].any(axis=1).sum() > 0.01 * rows.sum():
            skin |= rows
    clothes &= ~skin
    arms, legs = (np.isin([plain_part(name) for name in PARTS], limb) for limb in (ARMS, ["thigh", "shin"]))
    wide = attire.of_kinds(("skirt",)) | (attire.of_kinds(("dress",)) & legs[part])
    hollow = clothes & ~wide & ~attire.of_kinds(("outer",))
    hollow[hollow] = _without_skin(pose, np.flatnonzero(hollow), skin, attire.part * len(PARTS) + part)
    parts = list(attire.parts)
    under, thin = np.flatnonzero(skin | hollow), np.zeros(len(skin), dtype=bool)
    for number, held in enumerate(parts):
        rows = np.flatnonzero((attire.part == number) & (part == list(PARTS).index("trunk")))
        if held.kind != "carried" or not len(rows) or not len(under):
            continue
        middle = pose.vertices[pose.faces[rows]].mean(axis=1)
        off = closest_point(middle, pose.vertices, pose.faces[under]).distance
        parts[number] = held._replace(bulky=bool(np.quantile(off, 0.9) > BULKY_M))
        thin[rows] = not parts[number].bulky
    lower = clothes & attire.of_kinds(("trousers", "skirt"))
    own, sleeves = skin | thin, attire.of_kinds(UPPER) & arms[part]
    return Layers(own, own & ~sleeves, lower, hollow, attire._replace(parts=tuple(parts)))


def _without_skin(pose: TPose, rows: np.ndarray, skin: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Which faces ``rows`` (n,) of cloth have no ``skin`` (F,) before or behind them, by ``group`` (F,): as most of its
    area has none."""
    if not len(rows) or not skin.any():
        return np.ones(len(rows), dtype=bool)
    middle, normals = pose.vertices[pose.faces[rows]].mean(axis=1), meshes.face_normals(pose.vertices, pose.faces)[rows]
    found = closest_point(middle, pose.vertices, pose.faces[skin])
    below = np.abs(np.einsum("nc,nc->n", normals, middle - found.point)) > BELOW * found.distance
    gone = ~(below & (found.distance < GONE_M))
    area, index = meshes.face_areas(pose.vertices, pose.faces)[rows], np.unique(group[rows], return_inverse=True)[1]
    return (np.bincount(index, area * gone) > 0.5 * np.bincount(index, area))[index]


def shrink(pose: TPose, hollow: np.ndarray) -> TPose:
    """Returns ``pose`` with the vertices of its ``hollow`` faces (F,) bool moved in by ``INSET_M``, where a skin would
    be."""
    normals = meshes.vertex_normals(pose.vertices, pose.faces)
    rows = np.unique(pose.faces[hollow])
    vertices = pose.vertices.copy()
    vertices[rows] -= INSET_M * normals[rows]
    return replace(pose, vertices=vertices)


def removed_faces(attire: Attire, halves: Halves) -> np.ndarray:
    """Returns the mask (F,) bool of a character's faces that garments on these ``halves`` take off. Bulky parts go with
    clothes of the upper half."""
    kinds = (UPPER if halves.upper else ()) + (LOWER if halves.lower else ())
    off = [part.kind in kinds or (part.bulky and halves.upper) for part in attire.parts]
    return np.array(off, dtype=bool)[attire.part]


def tucked_faces(attire: Attire, halves: Halves) -> np.ndarray:
    """Returns the mask (F,) bool of a character's faces that are tucked into garments on these ``halves``: those of its
    tops, if the garments lie on the lower half alone, otherwise none."""
    return attire.of_kinds(("top",)) & (halves.lower and not halves.upper)


def bare_faces(body: BodyModel, vertices: np.ndarray, faces: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Returns the mask (Fb,) bool of the faces of a character's bare ``body`` that are seen where the faces ``off``
    (F,) bool of its surface are gone.

    ``vertices`` [m] (V, 3) and ``faces`` (F, 3) are that surface, in the frame of ``body``. A face of the body is seen
    if it lay below faces that are gone, and no other face of the surface lies there.
    """
    middle = body.v_template[body.faces].mean(axis=1)
    if not off.any():
        return np.zeros(len(middle), dtype=bool)
    gone = closest_point(middle, vertices, faces[off]).distance
    left = faces[~off]
    stays = closest_point(middle, vertices, left).distance if len(left) else np.full(len(middle), np.inf)
    return (gone < GONE_M) & (stays > np.minimum(BARE_M, gone))


def doubled_ends(body: BodyModel, weights: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the mask (Fb,) bool of the faces of a character's bare ``body`` on a head, a hand or a foot that the
    character still has itself. The fitted body's would be seen beside these, in another size.

    ``weights`` (V, 24) are those of the character's surface, ``faces`` (F, 3) the faces of it that stay.
    """
    middle, own = body.v_template[body.faces].mean(axis=1), parts_of(body.weights)[body.faces[:, 0]]
    there = np.unique(parts_of(weights)[faces])
    doubled = np.zeros(len(middle), dtype=bool)
    for number, part in enumerate(PARTS):
        plain = plain_part(part)
        if plain in ENDS and number in there:
            joint, behind_m = ENDS[plain]
            at = body.joints_template[JOINT_NAMES.index(part.removesuffix(plain) + joint)]
            doubled |= (own == number) & (np.linalg.norm(middle - at, axis=1) > behind_m)
    return doubled


def sewn_to_ends(weights: np.ndarray, faces: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Returns the mask (F,) bool of those faces ``off`` (F,) bool of a character that are one piece of its mesh with
    faces of the same head, hand or foot that stay. They are painted on it, and the bare body is not drawn in their
    place.

    ``weights`` (V, 24) are those of the character's surface, whose ``faces`` are (F, 3).
    """
    part, sewn = parts_of(weights)[faces[:, 0]], np.zeros(len(faces), dtype=bool)
    for number, name in enumerate(PARTS):
        rows = np.flatnonzero(part == number)
        if plain_part(name) in ENDS and off[rows].any():
            piece = connected_components(faces[rows], len(weights))[faces[rows][:, 0]]
            sewn[rows] = off[rows] & np.isin(piece, piece[~off[rows]])
    return sewn


def bare_colours(
    body: BodyModel, attire: Attire, vertices: np.ndarray, faces: np.ndarray, off: np.ndarray
) -> np.ndarray:
    """Returns the colours (Vb, 3), sRGB in [0, 1], of the vertices of a character's bare ``body``: the mean colour of
    its skin, and at the hips the colours of trousers that stay on. A coat may have hidden these up to there.

    ``vertices`` [m] (V, 3) and ``faces`` (F, 3) are the character's surface, in the frame of ``body``. Its faces
    ``off`` (F,) bool are gone.
    """
    colours = np.tile(np.asarray(attire.skin_colour), (body.vertex_count, 1))
    stay = np.flatnonzero(attire.of_kinds(("trousers",)) & ~off)
    hips = np.flatnonzero(np.isin(BONES[body.weights.argmax(axis=1)], ["pelvis", "hip"]))
    if len(stay):
        colours[hips] = attire.colours[stay[closest_point(body.v_template[hips], vertices, faces[stay]).face]]
    return colours
