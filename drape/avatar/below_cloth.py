"""A character's covered skin moved below the cloth, frame by frame, for files that hold every frame of it.

Skin stands through the cloth where the body that garments lie on is not the character's own. Clients draw such skin
deeper than it is (``drape.avatar.covered``); what draws nothing deeper needs it in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drape.avatar.covered import DEEPER_M, covered_faces
from drape.export.surface import MovingGarment
from drape.geometry.closest import closest_point, on_border
from drape.geometry.meshes import face_normals
from drape.wanted import go_on

BELOW_M = 0.002


def keep_below(
    parts: Sequence[MovingGarment], cloth: Sequence[tuple[np.ndarray, np.ndarray]], worn: Sequence[MovingGarment]
) -> list[MovingGarment]:
    """Returns ``parts`` of a character over the F frames of a clip, with their covered skin below the cloth. Positions
    are [m] in the world.

    Frame 0 of ``parts`` is the T-pose, which is left out of the result. ``cloth`` has vertices [m] (V, 3) and faces
    (F, 3) of each garment in the T-pose, which say what skin is covered. ``worn`` are the garments in the F frames:
    covered skin that is less than ``BELOW_M`` below them, or stands out of them by less than ``DEEPER_M``, is moved to
    ``BELOW_M`` below.
    """
    starts = np.cumsum([0, *(part.surface.vertex_count for part in parts)])
    faces = np.concatenate([part.surface.faces + start for part, start in zip(parts, starts, strict=False)])
    whole = np.concatenate([part.vertices for part in parts], axis=1)
    rows, frames = np.unique(faces[covered_faces(whole[0], faces, cloth)]), whole[1:]
    for frame, points in enumerate(frames):
        go_on()
        for garment in worn:
            points[rows] = _below(points[rows], garment.vertices[frame].astype(np.float64), garment.surface.faces)
    split = np.split(frames, starts[1:-1], axis=1)
    return [replace(part, vertices=own) for part, own in zip(parts, split, strict=True)]


def _below(points: np.ndarray, cloth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``points`` (n, 3), those that stand out of ``cloth`` moved below it."""
    nearest = closest_point(points.astype(np.float64), cloth, faces)
    normals = face_normals(cloth, faces)[nearest.face]
    depth = np.einsum("nc,nc->n", normals, nearest.point - points)
    out = (nearest.distance < DEEPER_M) & (depth < BELOW_M) & ~on_border(nearest, faces)
    return np.where(out[:, None], nearest.point - BELOW_M * normals, points)
