"""Things in a garment's file that lie far away from it: buttons of another unit, a lamp, a forgotten copy."""

from __future__ import annotations

import numpy as np

from drape.files.notes import warning
from drape.garment.files.mesh import GarmentMesh
from drape.garment.sheets import pieces_of, with_used_vertices

FAR = 2.0  # over the extent of the piece with the most faces
MOST_SHARE = 0.2  # what has a larger share of the faces is no stray


def without_strays(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` without pieces far from the garment, with a note; ``mesh`` itself if there are none, or if they
    are more than ``MOST_SHARE`` of the faces. The piece with the most faces stays. So does, again and again, each piece
    whose box is nearer to that of all that stays than ``FAR`` times the extent of that first piece."""
    label, areas = pieces_of(mesh.vertices, mesh.faces)
    count = len(areas)
    if count == 1:
        return mesh
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    corners = mesh.vertices[mesh.faces]
    np.minimum.at(low, label, corners.min(axis=1))
    np.maximum.at(high, label, corners.max(axis=1))
    near = np.arange(count) == np.bincount(label).argmax()
    reach = FAR * float((high - low)[near].max())
    while True:
        gap = np.maximum(low - high[near].max(axis=0), low[near].min(axis=0) - high)
        joined = near | (gap.max(axis=1) < reach)
        if (joined == near).all():
            break
        near = joined
    keep = near[label]
    if keep.all() or (~keep).mean() > MOST_SHARE:
        return mesh
    far = float(np.linalg.norm(corners[~keep].mean(axis=(0, 1)) - corners[keep].mean(axis=(0, 1))))
    note = warning(f"what lies {far:.3g} units away is left out, {int((~keep).sum()):,} faces")
    return with_used_vertices(mesh.take_faces(keep)).noted(note)
