"""Bodies that are in a garment's file, as programs write them that simulate or pose a garment on one."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.errors import MeshError
from drape.files.notes import warning
from drape.garment.files.mesh import GarmentMesh
from drape.garment.jewellery import BULKY
from drape.garment.registration import posed_by
from drape.garment.sheets import pieces_of, with_used_vertices
from drape.garment.wearer_fields import KNOWN, cloth_points, known_parameters, thin_body
from drape.geometry import meshes
from drape.geometry.closest import signed_distance

LARGE = 0.2  # a piece with a smaller share of the whole area is no body
# A body's openings, as of its eyes, or of a neck without a head, are shorter than this share of the root of its area;
# those of garments are longer than the root.
OPEN = 0.7
COUNT = 400  # points on a piece, and on a known body
LIKE = 0.05  # mean distance to and from a known body, over its height, up to which a piece is a body; people have 0.02
SMALL, ALONE = 0.03, 0.01  # of the body's area: what lies inside, as eyes, has less; a garment has more


def without_bodies(mesh: GarmentMesh, body: BodyModel) -> GarmentMesh:
    """Returns ``mesh`` without the connected pieces that look like human bodies, and without small pieces inside these,
    with a note. If there are none, ``mesh`` itself is returned. Raises ``MeshError`` where hardly any area is left."""
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)  # seams of uv are no borders
    faces = place.reshape(-1)[mesh.faces]
    label, areas = pieces_of(points, faces)
    large = np.flatnonzero(areas > LARGE * areas.sum())
    own = [number for number in large if _is_body(points, faces[label == number], body)]
    if not own:
        return mesh
    keep = ~np.isin(label, own)
    for number in own:
        skin = meshes.in_use(faces[label == number])
        for other in np.flatnonzero(areas < SMALL * areas[number]):
            there, _ = cloth_points(points, faces[label == other], COUNT // 4)
            keep &= (label != other) | (np.median(signed_distance(there, points[skin[0]], skin[1])) > 0.0)
    if areas[np.unique(label[keep])].sum() < ALONE * areas[own].sum():
        raise MeshError(
            "garment",
            expected="cloth that a body wears",
            got="what looks like a body, and no garment on it",
            cure="Export the garment without the body. A character with bones is an avatar: POST /avatars.",
        )
    note = warning(f"what looks like a body is left out, {int((~keep).sum()):,} faces")
    return with_used_vertices(mesh.take_faces(keep)).noted(note)


def _is_body(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> bool:
    """Whether a piece is a solid, nearly closed, and in some reading of its axes as a known body is."""
    corners = vertices[faces] - vertices[faces].mean(axis=(0, 1))
    half = 0.5 * float(meshes.face_areas(vertices, faces).sum())
    volume = float(np.linalg.det(corners).sum()) / 6.0
    rim = float(meshes.edge_lengths(vertices, meshes.boundary_edges(faces)).sum())
    if rim > OPEN * (2.0 * half) ** 0.5 or half**3 > BULKY * volume**2:
        return False
    points, _ = cloth_points(vertices, faces, COUNT)
    points = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    for up, ahead in product((1, 2, 0, 4, 5, 3), range(6)):
        if up % 3 != ahead % 3:
            axes = np.concatenate([np.eye(3), -np.eye(3)])[[up, ahead]]
            at = points @ np.stack([np.cross(axes[0], axes[1]), *axes]).T
            at, tree = at / np.ptp(at[:, 1]), None
            for known, known_tree in _known_skins(body):
                if known_tree.query(at)[0].mean() < LIKE:
                    tree = tree or KDTree(at)
                    if tree.query(known)[0].mean() < LIKE:
                        return True
    return False


@lru_cache(maxsize=2)
def _known_skins(body: BodyModel) -> list[tuple[np.ndarray, KDTree]]:
    """Points on the skin of the known bodies and trees of them, in heights, the middle of their box at the origin."""
    thin = thin_body(body)
    skins = []
    for shape, lift_rad, bent_rad, _ in KNOWN:
        skin = posed_by(thin, known_parameters(body, shape, lift_rad, bent_rad))
        points, _ = cloth_points(skin, thin.faces, COUNT)
        points = (points - 0.5 * (skin.min(axis=0) + skin.max(axis=0))) / np.ptp(skin[:, 1])
        skins.append((points, KDTree(points)))
    return skins
