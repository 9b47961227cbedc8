"""Things that people wear and no cloth: hats, glasses, shoes, watches, which one bone carries."""

from __future__ import annotations

import numpy as np

from drape.body.skeleton import JOINT_NAMES
from drape.garment.contours import open_contours
from drape.garment.files.mesh import GarmentMesh
from drape.garment.registration import posed_by
from drape.garment.wearer_fields import joints_of
from drape.garment.wearer_reading import Wearer
from drape.geometry import meshes
from drape.geometry.closest import closest_point

# By the bone that carries: the bones whose skin all of the piece must be nearest to.
CARRIERS = {
    "head": ("head",),
    **{f"{side}_ankle": (f"{side}_ankle", f"{side}_foot") for side in ("left", "right")},
    **{f"{side}_wrist": (f"{side}_wrist", f"{side}_hand") for side in ("left", "right")},
}
WHOLLY = 0.97  # of the piece
# Area over that of the skin below: gloves and socks have one to one and a half; shoes have a sole and inner walls.
THICK = 1.8
NECK_M = 0.05  # an opening that reaches as far below the head's joint is round the neck: a hood is cloth


def accessory_of(wearer: Wearer, mesh: GarmentMesh) -> str | None:
    """The bone that carries ``mesh``, one piece, in metres in the frame of ``wearer`` (``worn_by``), or None for cloth.

    Pieces at one foot or hand are cloth, as socks and gloves, unless their walls are double or they are much smaller.
    """
    skin = posed_by(wearer.body, wearer.parameters)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    areas = meshes.face_areas(mesh.vertices, mesh.faces)
    nearest = closest_point(middles, skin, wearer.body.faces)
    bone = wearer.body.weights.argmax(axis=1)[wearer.body.faces[nearest.face, nearest.barycentric.argmax(axis=1)]]
    for carrier, names in CARRIERS.items():
        own = [JOINT_NAMES.index(name) for name in names]
        if areas[np.isin(bone, own)].sum() < WHOLLY * areas.sum():
            continue
        if carrier == "head":
            floor = joints_of(wearer.body, wearer.parameters)[own[0], 1] - NECK_M
            low = [one.points[:, 1].min() for one in open_contours(mesh.vertices, mesh.faces)]
            return None if min(low, default=np.inf) < floor else carrier
        limb = wearer.body.faces[np.isin(wearer.body.weights.argmax(axis=1), own)[wearer.body.faces].all(axis=1)]
        covered = np.isin(limb, wearer.body.faces[nearest.face]).any(axis=1)
        share = areas.sum() / meshes.face_areas(skin, limb[covered]).sum()
        return carrier if share > THICK else None
    return None
