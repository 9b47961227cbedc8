"""A coarse mesh around the finer cloth that was simulated in its place.

A delivered triangle is a chord: with corners on the fine cloth it cuts off what bulges between them, a knee and the
cloth over it. Of the fine cloth x with normals n, and W, which places every fine vertex in a delivered triangle, the
corners c start on the cloth and then go out until no triangle lies below it, by a few steps of

    r = max(0, n . (x - W c)),    c += s D^-1 W^T (q r n),    D = diag(W^T q).

The first steps have q = 1 and s = 1.5: the rows of W sum to one, hence D is not below W^T W and each step is a bounded
descent on r^2 / 2, and half of it more. What is far enough out counts there too, so that a corner of large triangles,
of which a few places lie below, hardly goes. So in the last steps q = r and s = 1: a corner goes by the mean of what is
still missing, in which the most counts most. More of these leave nothing below, and let corners jump from frame to
frame.
"""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.garment.cache import Garment
from drape.garment.fine import corner_weights

STEPS, DEEP_STEPS, RELAXATION = 5, 2, 1.5


class Wrapping:
    """Wraps the delivered mesh of ``garment`` around its subdivided one: moves its vertices out until hardly any of the
    fine cloth lies outside of it."""

    def __init__(self, garment: Garment) -> None:
        placing = corner_weights(garment)
        self._counted = np.asarray(placing.sum(axis=0)).ravel() / RELAXATION
        added = placing[garment.vertex_count :]  # the vertices before these are corners
        row = np.repeat(np.arange(added.shape[0]), np.diff(added.indptr))
        column = np.arange(added.nnz) - added.indptr[row]
        self._corner, self._weight = np.zeros((added.shape[0], 3), np.int32), np.zeros((added.shape[0], 3))
        self._corner[row, column], self._weight[row, column] = added.indices, added.data
        self._faces = np.ascontiguousarray(garment.fine_faces, dtype=np.int32)

    def wrap(self, fine: np.ndarray) -> np.ndarray:
        """Returns the delivered vertices [m] (V, 3) that lie around the subdivided mesh with vertices ``fine`` [m] (N,
        3), in the same frame and dtype."""
        fine, dtype = np.ascontiguousarray(fine), fine.dtype
        corners = np.empty((len(self._counted), 3), dtype)
        placed = self._corner, self._weight.astype(dtype), self._counted.astype(dtype), len(corners)
        steps = STEPS, DEEP_STEPS, corners
        call_with_scratch("wrap", dtype, fine, len(fine), self._faces, len(self._faces), *placed, *steps)
        return corners
