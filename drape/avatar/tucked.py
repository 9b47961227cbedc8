"""Tops that stay on a character, worn in trousers or a skirt of ours.

From ``BAND_M`` above the waistband on, a top is drawn in to the skin and moves with it; it ends ``BELOW_M`` below the
waistband. Vertices of a user's file stay where they are, so these faces are taken off and drawn anew on the character's
own nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drape.avatar.covered import MARGIN_M, covered_faces
from drape.avatar.own_clothes import SKIN
from drape.avatar.wearer import Wearer
from drape.geometry import meshes
from drape.geometry.closest import closest_point, nearest_vertices

BAND_M, BELOW_M = 0.2, 0.06
OFF_SKIN_M = 0.001  # A tucked top lies nearer to the skin than trousers do.


class TuckedTop(NamedTuple):
    """A top of a character's own that is drawn in to the skin, as a mesh of its own.

    ``rows`` (n,) are the indices of the character's faces that it is made of. Its mesh has ``vertices`` [m] (V, 3),
    ``faces`` (n, 3) and ``weights`` (V, 24), in the frame of the character's body. ``off`` (F,) bool are the
    character's faces that are not drawn, since they are the top's or lie below it. ``hidden`` (Fb,) bool are the faces
    of its bare body that lie below.
    """

    rows: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    off: np.ndarray
    hidden: np.ndarray


def tucked_top(wearer: Wearer, tops: np.ndarray, cloth: Sequence[tuple[np.ndarray, np.ndarray]]) -> TuckedTop | None:
    """Returns the top of ``wearer`` with the faces ``tops`` (F,) bool, tucked into ``cloth``; None where it ends above
    that.

    ``cloth`` has vertices [m] (V, 3) and faces (F, 3) of each garment of the lower half, in the T-pose.
    """
    waist, body = _waistband(cloth), wearer.body
    used, faces = np.unique(wearer.faces[tops], return_inverse=True)
    at, faces = wearer.vertices[used].astype(np.float64), faces.reshape(-1, 3)
    height = _above(at, waist)
    if not (height < 0.0).any():
        return None
    nearest = closest_point(at, body.v_template, body.faces)
    corners = body.faces[nearest.face]
    out = np.einsum("vk,vkc->vc", nearest.barycentric, meshes.vertex_normals(body.v_template, body.faces)[corners])
    skin = np.einsum("vk,vkj->vj", nearest.barycentric, body.weights[corners])
    share = np.clip(height / BAND_M, 0.0, 1.0)[:, None]
    share = share * share * (3.0 - 2.0 * share)
    weights = share * wearer.weights[used] + (1.0 - share) * skin
    at = share * at + (1.0 - share) * (nearest.point + OFF_SKIN_M * out)
    moved = height[faces].min(axis=1) < BAND_M
    upper = float(height[faces[moved]].max()) + MARGIN_M  # Coarse faces reach far above the band.
    off, bare = wearer.attire.of_kinds(SKIN), np.ones(len(body.faces), dtype=bool)
    for there, vertices, own in ((off, wearer.vertices, wearer.faces), (bare, body.v_template, body.faces)):
        there &= _above(vertices, waist)[own].min(axis=1) < upper
        there[there] = covered_faces(vertices, own[there], [(at, faces)], margin_m=0.0)
    off[np.flatnonzero(tops)[moved]] = True
    drawn = moved & (height[faces].max(axis=1) > -BELOW_M)
    left, faces = np.unique(faces[drawn], return_inverse=True)
    return TuckedTop(np.flatnonzero(tops)[drawn], at[left], faces.reshape(-1, 3), weights[left], off, bare)


def _waistband(cloth: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The vertices [m] (n, 3) at the upper ends of ``cloth``."""
    ends = [vertices[meshes.boundary_vertices(faces)] for vertices, faces in cloth]
    return np.concatenate([end[end[:, 1] > one[0][:, 1].mean()] for end, one in zip(ends, cloth, strict=True)])


def _above(points: np.ndarray, waist: np.ndarray) -> np.ndarray:
    """How far [m] (n,) ``points`` (n, 3) are above the nearest of ``waist`` (m, 3)."""
    return points[:, 1] - waist[nearest_vertices(points, waist)[1], 1] if len(waist) else np.full(len(points), np.inf)
