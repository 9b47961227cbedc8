"""A garment cut anew for another body: moved, kept clear of the skin, its cloth as strained as it was.

A triangle whose cloth has the edges D (2, 2) without stress has F = E D^-1 with its edges E (3, 2) on the body, and
C = F^T F. Moved to another body it has C'. The cloth that is as strained there as it was here has the edges S D with

    S C S = C',    S = C^-1/2 (C^1/2 C' C^1/2)^1/2 C^-1/2,

the geometric mean of C^-1 and C': longer where the new body is larger, and no tighter. Its patches and charts are those
that it had, laid anew where they would fold or fit clearly worse.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from drape.body.model import BodyModel
from drape.garment.avatars import Avatar
from drape.garment.cache import Garment
from drape.garment.clearance import clear_body
from drape.garment.files.mesh import GarmentMesh
from drape.garment.fitting import fit_garment
from drape.garment.rest_pose import to_standard
from drape.garment.trouser_legs import above_shoes, apart
from drape.geometry import meshes

ROUNDS = 12
ANY_M = np.inf  # thighs of characters may touch or overlap: no depth is a fault of the cloth, frames lift what is left
VERSION = 4  # raised when a change here changes the garments that come out


def tailored_digest(garment: Garment, wearer: BodyModel, shoes_m: float = -np.inf) -> str:
    """Returns the hex digest of what ``tailored`` makes of ``garment`` for ``wearer`` with shoes up to ``shoes_m``
    [m]."""
    return hashlib.sha256(f"tailored {VERSION} {garment.digest} {wearer.digest} {shoes_m:.4f}".encode()).hexdigest()


def tailored(garment: Garment, body: BodyModel, wearer: BodyModel, *, shoes_m: float = -np.inf) -> Garment:
    """Returns ``garment``, which was made for ``body``, cut for ``wearer``, a body of the same topology; the garment
    itself if both are one body. Legs of trousers end above ``shoes_m`` [m], the height in the wearer's frame that its
    shoes reach; by default there are no shoes. Raises ``MeshError`` as ``clear_body`` does."""
    if body.digest == wearer.digest:
        return garment
    faces, standing = garment.fine_faces.astype(np.int64), garment.vertices.astype(np.float64)
    source = Avatar(body.v_template, body.faces, 0.0, body.name)
    # What is a sleeve, a leg or a skirt is asked of the body that it was made for: a wearer's own regressor and weights
    # say nothing about another shape, and took trousers for skirts.
    shorter = above_shoes(standing, faces, body, wearer, shoes_m)
    moved = to_standard(shorter, faces, source, replace(body, v_template=wearer.v_template)).vertices
    moved = apart(moved, standing, body, wearer)
    cleared = clear_body(
        moved, faces, wearer.v_template, wearer.faces, rounds=ROUNDS, least_m=-ANY_M, give_up_m=ANY_M
    ).vertices
    count = garment.vertex_count
    mesh = GarmentMesh(
        garment.name, cleared[:count], garment.faces.astype(np.int64), garment.uv, garment.uv_faces.astype(np.int64),
        garment.material_names, garment.face_material, looks=garment.looks,
    )  # fmt: skip
    bound = fit_garment(
        mesh, cleared, faces, wearer, digest=tailored_digest(garment, wearer, shoes_m),
        manifest=dict(garment.manifest), count=garment.patch_count, like=garment, arm=garment.arm_share,
    )  # fmt: skip
    rest = garment.rest_state()
    edges = stretched(rest.edges, standing, cleared, faces)
    return replace(
        bound,
        fabric=garment.fabric,
        rest_edges=edges.astype(np.float32),
        rest_angle=rest.hinge_angle.astype(np.float32),
        rest_stiffening=rest.stiffening.astype(np.float32),
        drawn=garment.drawn,
        arm_ways=garment.arm_ways,
    )


def stretched(edges: np.ndarray, before: np.ndarray, after: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the unstressed edges [m] (G, 2, 2) that give triangles ``faces`` (G, 3) at ``after`` [m] (N, 3) the
    strain that they have at ``before`` [m] (N, 3) with the unstressed ``edges``. A row is an edge, along (warp, weft),
    as in ``RestState``."""
    columns = np.swapaxes(edges, -1, -2)
    own, other = (_metric(points, faces, columns) for points in (before, after))
    root = _root(own)
    inverse = np.linalg.inv(root)
    return np.swapaxes(inverse @ _root(root @ other @ root) @ inverse @ columns, -1, -2)


def _metric(points: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """C (G, 2, 2) of each triangle; columns of ``edges`` are edges."""
    deformation = np.stack(meshes.corner_edges(points, faces), axis=-1) @ np.linalg.inv(edges)
    return np.swapaxes(deformation, -1, -2) @ deformation


def _root(matrix: np.ndarray) -> np.ndarray:
    """The root of symmetric positive matrices (G, 2, 2): (M + sqrt(det M) I) / sqrt(tr M + 2 sqrt(det M))."""
    determinant = np.sqrt(np.maximum(np.linalg.det(matrix), 0.0))
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    total = matrix + determinant[:, None, None] * np.eye(2)
    return total / np.sqrt(np.maximum(trace + 2.0 * determinant, 1e-24))[:, None, None]
