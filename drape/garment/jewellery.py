"""Necklaces, rings, bracelets, watches: too little to be cloth, and carried by the bone whose skin they lie on.

They tell neither height nor pose, but mostly lie in their file where they are worn, over its root or its floor. So a
reading of the file is theirs in which all of a thing lies on the skin of a known body.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import AREA_MINIMUM, UNITS_M, consistent_turn
from drape.garment.reading_hints import NO_HINTS, ReadingHints
from drape.garment.registration import posed_by
from drape.garment.sheets import pieces_of
from drape.garment.wearer_fields import BENT_RAD, SHAPES, cloth_points, known_parameters
from drape.garment.wearer_reading import USUAL_FRONTS, Reading, WearerCandidate, readings_of
from drape.geometry import mesh_graphs, meshes

COUNT = 400  # points on a piece of jewellery
EXTENT_M, ON_HAND_M = (0.04, 0.35), 0.012  # extents of jewellery; a ring is smaller
ON_SKIN_M, NEAR_SKIN_M = 0.015, 0.08  # largest mean distance from the skin, and while the arms' pose is not known
TOGETHER_M = 0.02  # points this near to each other are one thing
# Bones that carry what lies on the skin of another. The neck, which turns, carries what lies on it with NECK_SHARE.
CARRIED_BY = {f"{side}_{bone}": by for side in ("left", "right") for bone, by in (
    ("collar", "spine3"), ("hand", f"{side}_wrist"), ("foot", f"{side}_ankle"))}  # fmt: skip
NECK_SHARE = 0.8
ARMS_M = 0.12  # what is nearer to the body's middle plane is on no arm
LIFTS_RAD, BENDS_RAD = np.arange(0.0, 1.5, 0.25), (0.0, BENT_RAD)  # poses of the arms that are tried
FINER_RAD = np.arange(-0.12, 0.121, 0.04)
INSIDE, FREE_M = 3.0, 0.003  # factor on the distance of points in the skin; distance that counts as none
BULKY = 1000.0  # area of one side over thickness squared: cloth has thousands, bulky solids have less than this
SURE, TRIED = 0.7, 4


def jewellery_on(mesh: GarmentMesh, skin: np.ndarray, body: BodyModel) -> tuple[str, ...]:
    """Returns the names of the bones that carry the things in ``mesh`` [m] as jewellery, each once. It is empty
    where the mesh is as large as cloth, or does not lie on the skin. ``skin`` [m] (V, 3): the vertices of the posed
    ``body``."""
    if len(mesh.faces) == 0 or cloth_area(mesh) > AREA_MINIMUM:
        return ()
    points, _ = cloth_points(mesh.vertices, mesh.faces, COUNT)
    away, near = KDTree(skin).query(points)
    if away.mean() > ON_SKIN_M:
        return ()
    pairs = KDTree(points).query_pairs(TOGETHER_M, output_type="ndarray")
    thing = mesh_graphs.joined_parts(COUNT, pairs[:, 0], pairs[:, 1])
    bone = body.weights.argmax(axis=1)[near]
    return tuple(dict.fromkeys(_carrier(bone[thing == number]) for number in range(thing.max() + 1)))


def cloth_area(mesh: GarmentMesh) -> float:
    """Returns the area of ``mesh`` in its unit squared; closed pieces count half, as cloth with two sides."""
    solid, sheet = _areas(mesh)
    return 0.5 * solid + sheet


def _areas(mesh: GarmentMesh) -> tuple[float, float]:
    """The areas of the closed pieces of ``mesh`` and of the open ones."""
    label, area = pieces_of(mesh.vertices, mesh.faces)
    piece = np.empty(len(mesh.vertices), dtype=np.int64)
    piece[mesh.faces.reshape(-1)] = np.repeat(label, 3)
    is_open = np.isin(np.arange(len(area)), piece[meshes.boundary_edges(mesh.faces)])
    return float(area[~is_open].sum()), float(area[is_open].sum())


def check_cloth(mesh: GarmentMesh) -> None:
    """Raises ``MeshError`` if ``mesh`` consists of bulky solids, as rings, chains and figures do: they show neither
    their size nor where they are worn."""
    (solid, sheet), label = _areas(mesh), pieces_of(mesh.vertices, mesh.faces)[0]
    if sheet:
        return
    faces = np.where(consistent_turn(mesh.faces)[:, None], mesh.faces[:, ::-1], mesh.faces)
    a, b, c = np.moveaxis(mesh.vertices[faces] - mesh.vertices[faces[0, 0]], 1, 0)
    volume = np.abs(np.bincount(label, np.einsum("fc,fc->f", a, np.cross(b, c)))).sum() / 6.0
    if (0.5 * solid) ** 3 < BULKY * volume**2:
        raise MeshError(
            "garment",
            expected="cloth, or jewellery in its place on a body whose root or feet are at the origin",
            got="solids that lie on no skin, as a ring, a chain or a bangle elsewhere, or a figure",
            cure="Of a figure send the garment alone. Move jewellery to where it is worn, or say whose body it lies on "
            "(avatar) and its unit (unit).",
        )


def _carrier(bone: np.ndarray) -> str:
    """The bone that carries a thing of which points lie on the skin of the bones numbered ``bone`` (n,)."""
    names = [CARRIED_BY.get(name, name) for name in JOINT_NAMES]
    votes = {name: sum(int((bone == k).sum()) for k, own in enumerate(names) if own == name) for name in names}
    if votes["neck"] > NECK_SHARE * len(bone):
        return "neck"
    votes["spine3"] += votes.pop("neck")
    return max(votes, key=lambda name: votes[name])


class _Try(NamedTuple):
    """How ``far`` [m] a thing is from the skin of a known body, whose ``shape`` and arms are told, in a ``reading``.

    The smaller a reading, the nearer is all to the skin, so readings are ranked by that over the extent.
    """

    rank: float
    far: float
    reading: Reading
    origin: str
    shape: str
    arms_rad: tuple[float, float]


def jewellery_wearer(mesh: GarmentMesh, body: BodyModel, hints: ReadingHints = NO_HINTS) -> WearerCandidate | None:
    """Returns the known body that has all of ``mesh`` on its skin, as jewellery. None where none has, or where ``mesh``
    may be cloth. The mesh is checked, in the frame of its file; ``hints``: what was stated of the file."""
    (solid, sheet), points = _areas(mesh), cloth_points(mesh.vertices, mesh.faces, COUNT)[0]
    if sheet > solid:
        return None
    extent, area = float(np.ptp(points, axis=0).max()), 0.5 * solid + sheet
    units = UNITS_M.items() if hints.unit is None else (hints.unit,)
    tries: list[_Try] = []
    for reading in readings_of(units, hints.up, hints.front):
        small = ON_HAND_M < extent * reading.scale < EXTENT_M[1] and area * reading.scale**2 < AREA_MINIMUM
        usual = hints.front is not None or reading.front in USUAL_FRONTS.get(reading.up, ())
        usual &= hints.up is not None or reading.up in ("+y", "+z")
        if small and usual:
            at = reading.apply(points)
            tries += [_tried(at, body, reading, origin, shape) for shape in SHAPES for origin in ("root", "floor")]
    on_skin = sorted(one for one in tries if one.far < ON_SKIN_M)
    likely = (_worn(mesh, body, one) for one in on_skin[:TRIED])
    return next((one for one in likely if one is not None), None)


def _worn(mesh: GarmentMesh, body: BodyModel, best: _Try) -> WearerCandidate | None:
    """The body of a try, where bones carry ``mesh`` on it that have seats for no such things, as a head has."""
    parameters = known_parameters(body, best.shape, *best.arms_rad)
    parameters[-2] -= _floor(body, best.shape) if best.origin == "floor" else 0.0
    placed = replace(mesh, vertices=best.reading.apply(mesh.vertices))
    bones = jewellery_on(placed, posed_by(body, parameters), body)
    extent = float(np.ptp(placed.vertices[mesh.faces], axis=(0, 1)).max())
    hands = all(bone.endswith("wrist") for bone in bones)
    if not bones or bones == ("head",) or (extent < EXTENT_M[0] and not hands):
        return None
    shown = any(bone.endswith(("elbow", "wrist")) for bone in bones)
    return WearerCandidate(
        best.reading, body, parameters, best.far, 0.0, 0.0, best.far, sleeved=shown, origin=best.origin, sure=SURE
    )


def _tried(points: np.ndarray, body: BodyModel, reading: Reading, origin: str, shape: str) -> _Try:
    """The arms of a ``shape`` that have ``points`` [m] (N, 3) nearest to their skin; level where these are on none."""
    at = points + np.array([0.0, _floor(body, shape) if origin == "floor" else 0.0, 0.0])

    extent = float(np.ptp(at, axis=0).max())

    def tried(arms_rad: tuple[float, float]) -> _Try:
        skin = _skin(body, shape, arms_rad)
        away, near = skin.tree.query(at)
        inside = np.einsum("nc,nc->n", at - skin.tree.data[near], skin.normals[near]) < 0.0
        far = float((away * np.where(inside, INSIDE, 1.0)).mean())
        return _Try((far + FREE_M) / extent, far, reading, origin, shape, arms_rad)

    best = tried((0.0, 0.0))
    if best.far < ON_SKIN_M or np.abs(at[:, 0]).min() < ARMS_M:
        return best
    box = _skin(body, shape, (0.0, 0.0)).tree.data
    if np.abs(at[:, 0]).max() > np.abs(box[:, 0]).max() + NEAR_SKIN_M or at[:, 1].max() > box[:, 1].max() + 0.5:
        return best
    best = min((tried((lift, bend)) for lift in LIFTS_RAD for bend in BENDS_RAD), key=lambda one: one.far)
    if best.far < NEAR_SKIN_M:
        finer = [tried((best.arms_rad[0] + step, best.arms_rad[1])) for step in FINER_RAD]
        best = min(finer, key=lambda one: one.far)
    return best


class _Skin(NamedTuple):
    """A tree of the vertices of a skin, and their normals (V, 3)."""

    tree: KDTree
    normals: np.ndarray


@lru_cache(maxsize=128)
def _skin(body: BodyModel, shape: str, arms_rad: tuple[float, float]) -> _Skin:
    """The skin of a known body, its arms so far below the horizontal and so far bent."""
    skin = posed_by(body, known_parameters(body, shape, *arms_rad))
    return _Skin(KDTree(skin), meshes.vertex_normals(skin, body.faces, table=body.face_table))


def _floor(body: BodyModel, shape: str) -> float:
    """How far [m] below its root a known body stands, as a negative number."""
    return float(_skin(body, shape, (0.0, 0.0)).tree.data[:, 1].min())
