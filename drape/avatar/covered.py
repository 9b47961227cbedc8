"""Which faces of a character lie under its garments at rest, so that a client can draw them behind the cloth.

A character of separate pieces comes apart where joints bend, and a piece then stands through the cloth that lies on our
body. What a garment covers is known beforehand: in T-pose, points are spread over the character's faces, and the
nearest point of the cloth is found for each.

Drawn ``DEEPER_M`` further from the viewer than they are, such faces lie behind cloth that they stand through. If they
were left out, they would be missing where a hem has moved on.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drape.avatar.character import Primitive
from drape.avatar.file_skeleton import load_file_rig
from drape.geometry.closest import closest_point, nearest_vertices, on_border
from drape.geometry.meshes import boundary_vertices, face_normals

SPACING_M = 0.02  # Points on a face lie at most so far apart.
REACH_M = 0.1  # Cloth farther away covers nothing, since one looks into a wide skirt.
INSIDE_M = 0.02  # What stands out of the cloth by more at rest lies over it.
DEEPER_M = 0.05
UNSEEN_M = 0.15  # So far from hems nobody sees a face. Players, which draw no face deeper, need not have it.
MARGIN_M = 0.03  # Covered faces keep this distance from all that is bare, and from hems, since cloth moves by so much.


class PrimitiveFaces(NamedTuple):
    """Triangles of one ``primitive`` of a character's file: those that garments cover, and those that are taken off.

    ``ranges`` (n, 2) are runs of covered triangles, and ``hidden`` (n, 2) runs of triangles taken off. A run is the
    index of its first triangle in the primitive, and their number.
    """

    primitive: Primitive
    ranges: np.ndarray
    hidden: np.ndarray


def covered_faces(
    vertices: np.ndarray,
    faces: np.ndarray,
    garments: Iterable[tuple[np.ndarray, np.ndarray]],
    *,
    margin_m: float = MARGIN_M,
) -> np.ndarray:
    """Returns the mask (F,) bool of the ``faces`` (F, 3) of a character that lie wholly under one of its garments.

    ``vertices`` [m] (V, 3) are the character's. ``garments`` has vertices [m] (Vg, 3) and faces (Fg, 3) of each garment
    in the same pose and frame. A covered face lies below the cloth, or stands out of it by less than ``INSIDE_M``. It
    is more than ``margin_m`` [m] away from the cloth's borders and from all of the character that is not under the
    cloth.
    """
    points, owner = points_on(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    covered = np.zeros(len(faces), dtype=bool)
    for cloth, triangles in garments:
        mesh = np.asarray(cloth, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
        good = _under(points, *mesh, margin_m)
        covered |= np.bincount(owner[~good], minlength=len(faces)) == 0
    return covered


def covered_in_file(
    stored: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    garments: Iterable[tuple[np.ndarray, np.ndarray]],
    off: np.ndarray,
    margin_m: float,
) -> tuple[np.ndarray, list[PrimitiveFaces]]:
    """Returns the mask (F,) bool of a wearer's covered faces, and of each primitive of its file the triangles that are
    covered and those that are taken off.

    ``stored`` is the wearer's stored file. ``vertices``, ``faces``, ``garments`` and ``margin_m`` are those of
    ``covered_faces``. ``off`` (F,) bool marks the faces that are taken off; they do not count as
    covered. Raises ``BodyError`` as ``load_file_rig`` does.
    """
    rig = load_file_rig(stored)
    covered = covered_faces(vertices, faces, garments, margin_m=margin_m) & ~off
    ends = np.cumsum([primitive.triangles for primitive in rig.primitives])
    own = []
    for chosen in (covered, off):
        of_file = np.zeros(ends[-1], dtype=bool)
        of_file[rig.triangle[chosen]] = True
        own.append([ranges_of(part) for part in np.split(of_file, ends[:-1])])
    return covered, [PrimitiveFaces(*one) for one in zip(rig.primitives, *own, strict=True)]


def ranges_of(chosen: np.ndarray) -> np.ndarray:
    """Returns the runs (n, 2) of consecutive True in ``chosen`` (F,) bool: the index at which each begins, and its
    length."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    return np.stack([steps[::2], steps[1::2] - steps[::2]], axis=1)


def _under(points: np.ndarray, cloth: np.ndarray, faces: np.ndarray, margin_m: float) -> np.ndarray:
    """Which ``points`` (n,) lie under ``cloth``, off everything that does not and off its hems."""
    found = closest_point(points, cloth, faces)
    height = np.einsum("nc,nc->n", face_normals(cloth, faces)[found.face], found.point - points)
    under = (found.distance < REACH_M) & (height > -INSIDE_M) & ~on_border(found, faces)
    for ends in (points[~under], cloth[boundary_vertices(faces)]):
        if margin_m and len(ends) and under.any():
            under[under] = nearest_vertices(points[under], ends)[0] > margin_m
    return under


def points_on(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns points (n, 3) on ``faces`` (F, 3), at most ``SPACING_M`` apart, and the index (n,) of each one's face.
    ``vertices`` are [m] (V, 3).

    The points are corners and middles of triangles that are cut in four until they are small.
    """
    corners, owner = vertices[faces], np.arange(len(faces))
    points, owners = [], []
    while len(corners):
        small = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1) <= SPACING_M
        points += [corners[small].reshape(-1, 3), corners[small].mean(axis=1)]
        owners += [np.repeat(owner[small], 3), owner[small]]
        corners, owner = corners[~small], np.tile(owner[~small], 4)
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corners = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return np.concatenate(points), np.concatenate(owners)
