"""Things that people wear and no cloth: hats, glasses, shoes, watches, which one bone carries."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_NAMES
from drape.garment.contours import open_contours
from drape.garment.files.mesh import GarmentMesh
from drape.garment.jewellery import jewellery_on
from drape.garment.sheets import pieces_of
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import ClosestPoints, SearchedMesh

# By the bone that carries a piece: the bones whose skin all of the piece must be nearest to. A heel may be nearest to
# the shank, which is the knee's.
CARRIERS = {
    "head": ("head",),
    **{f"{side}_ankle": (f"{side}_ankle", f"{side}_foot", f"{side}_knee") for side in ("left", "right")},
    **{f"{side}_wrist": (f"{side}_wrist", f"{side}_hand") for side in ("left", "right")},
}
SHANK = ("left_knee", "right_knee")
SOLID_SHARE = 0.2  # solids, as soles, have this share of an accessory's area; the rest are uppers, insoles, laces
WHOLLY = 0.97  # this share of a piece must be nearest to its bones
# Area over that of the skin below: gloves and socks have one to one and a half; shoes have a sole and inner walls.
THICK = 1.8
STANDS_OFF_M = 0.009  # median distance from the skin: socks and gloves lie on it, shoes do not
IN_SKIN = 0.1  # this share of a shoe may lie in the skin: more is a sock on another foot
SHAFT = 0.4  # a boot with a larger share of its area at the shank bends at the ankle, so it is cloth
SAMPLED = 8  # one of so many faces is looked at first
NECK_M = 0.05  # an opening that reaches as far below the head's joint is round the neck: a hood is cloth


def bones_that_carry(mesh: GarmentMesh, skin: np.ndarray, body: BodyModel) -> tuple[str, ...]:
    """Returns the names of the bones that carry ``mesh`` [m] rigidly, as an accessory (``carriers_of``) or else as
    jewellery (``jewellery_on``). It is empty where ``mesh`` is cloth. ``skin`` (V, 3) [m]: the vertices of ``body`` in
    the pose in which it wears ``mesh``."""
    return carriers_of(mesh, skin, body) or jewellery_on(mesh, skin, body)


def carriers_of(mesh: GarmentMesh, skin: np.ndarray, body: BodyModel) -> tuple[str, ...]:
    """Returns the names of the bones that carry the pieces of the accessory ``mesh`` [m], each once, that of the
    largest piece first. It is empty where ``mesh`` is cloth. ``skin`` (V, 3) [m]: the vertices of the posed
    ``body``."""
    label, area = pieces_of(mesh.vertices, mesh.faces)
    bones, solid = [], 0.0
    for number in range(len(area)):
        bone, cloth = _carried_by(mesh.take_faces(label == number), skin, body)
        if bone is None:
            return ()
        bones.append(bone)
        solid += 0.0 if cloth else float(area[number])
    return tuple(dict.fromkeys(bones)) if solid > SOLID_SHARE * float(area.sum()) else ()


def carried_rows(vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, bones: Sequence[str]) -> np.ndarray:
    """Returns for each vertex the joint number (V,) int of the bone that carries it: of the named ``bones`` the one
    nearest to the middle of the vertex's connected piece. ``vertices`` (V, 3) and ``joints`` (24, 3) [m] are in one
    pose."""
    piece = mesh_graphs.connected_components(faces, len(vertices))
    count = np.bincount(piece)
    middle = np.stack([np.bincount(piece, column) for column in vertices.T], axis=1) / np.maximum(count, 1)[:, None]
    numbers = np.array([JOINT_NAMES.index(bone) for bone in bones])
    ends = np.array(BONE_ENDS)[numbers]
    start = joints[numbers]
    way = np.where(ends[:, None] < 0, 0.0, joints[ends] - start)
    length = np.maximum(np.einsum("bc,bc->b", way, way), 1e-12)
    share = np.clip(np.einsum("nbc,bc->nb", middle[:, None] - start, way) / length, 0.0, 1.0)
    nearest = np.linalg.norm(middle[:, None] - start - share[..., None] * way, axis=2).argmin(axis=1)
    return numbers[nearest][piece]


def accessory_of(mesh: GarmentMesh, skin: np.ndarray, body: BodyModel) -> str | None:
    """Returns the name of the bone that carries ``mesh`` [m], a single piece, rigidly; None if the piece is cloth.
    ``skin`` (V, 3) [m]: the vertices of the posed ``body``."""
    bone, cloth = _carried_by(mesh, skin, body)
    return None if cloth else bone


def _carried_by(mesh: GarmentMesh, skin: np.ndarray, body: BodyModel) -> tuple[str | None, bool]:
    """The bone at whose skin all of a piece lies, None where there is none, and whether the piece is cloth.

    At a foot or hand it is cloth, as socks and gloves, unless its walls are double or stand off the skin. What goes up
    the shank, as a boot or a heel does, must stand off at the foot, and be no more of a shaft than of a shoe.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    areas = meshes.face_areas(mesh.vertices, mesh.faces)
    asked, skinned = SearchedMesh(skin, body.faces), body.weights.argmax(axis=1)
    some = slice(None, None, SAMPLED)
    bone = _bones_at(asked.closest(middles[some]), skinned, body)
    apart = [areas[some][~np.isin(bone, [JOINT_NAMES.index(name) for name in own])].sum() for own in CARRIERS.values()]
    if min(apart) > (1.0 - WHOLLY) * areas.sum():  # a few faces show of most garments that no bone carries them
        return None, True
    nearest = asked.closest(middles)
    bone = _bones_at(nearest, skinned, body)
    for carrier, names in CARRIERS.items():
        own = [JOINT_NAMES.index(name) for name in names]
        if areas[np.isin(bone, own)].sum() < WHOLLY * areas.sum():
            continue
        if carrier == "head":
            floor = (body.regressor @ skin)[own[0], 1] - NECK_M
            low = [one.points[:, 1].min() for one in open_contours(mesh.vertices, mesh.faces)]
            return carrier, min(low, default=np.inf) < floor
        limb = body.faces[np.isin(skinned, own)[body.faces].all(axis=1)]
        covered = np.isin(limb, body.faces[nearest.face]).any(axis=1)
        share = areas.sum() / meshes.face_areas(skin, limb[covered]).sum()
        shank = np.isin(bone, [JOINT_NAMES.index(name) for name in SHANK])
        shaft = areas[shank].sum() / areas.sum()
        out = meshes.face_normals(skin, body.faces)[nearest.face]
        off = nearest.distance * np.sign(np.einsum("fc,fc->f", out, middles - nearest.point))
        off = np.repeat(off, np.ceil(1e4 * areas / areas.sum() * ~shank).astype(int))
        stands_off = len(off) > 0 and np.median(off) > STANDS_OFF_M and (off < 0.0).mean() < IN_SKIN
        if shaft < 1.0 - WHOLLY:
            return carrier, share <= THICK and not stands_off
        return carrier, shaft > SHAFT or not stands_off
    return None, True


def _bones_at(there: ClosestPoints, skinned: np.ndarray, body: BodyModel) -> np.ndarray:
    """The bone (n,) that moves each of the points ``there`` of the skin, whose vertices the bones ``skinned`` (Vb,)
    move."""
    return skinned[body.faces[there.face, there.barycentric.argmax(axis=1)]]
