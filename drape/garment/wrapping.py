"""A coarse mesh around the finer cloth that was simulated in its place.

A delivered triangle is a chord: with corners on the fine cloth it cuts off what bulges between them, a knee and the
cloth over it. Of the fine cloth x with normals n, and W, which places every fine vertex in a delivered triangle, the
corners c start on the cloth and then go out until no triangle lies below it, by a few steps of

    r = max(0, n . (x - W c)),    c += 1.5 D^-1 W^T (r n),    D = diag(W^T W 1).

D is not below W^T W, so that each step is a bounded descent on r^2 / 2, and half of it more: what is far enough out
counts no longer, so that steps alone fall short. The rows of W sum to one, hence D is W's sums by column.
"""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.garment.cache import Garment
from drape.garment.fine import corner_weights

STEPS, RELAXATION = 5, 1.5


class Wrapping:
    """Wraps the delivered mesh of ``garment`` around its subdivided one."""

    def __init__(self, garment: Garment) -> None:
        placing = corner_weights(garment)
        self._stride = RELAXATION / np.asarray(placing.sum(axis=0)).ravel()
        added = placing[garment.vertex_count :]  # those before are corners
        row = np.repeat(np.arange(added.shape[0]), np.diff(added.indptr))
        column = np.arange(added.nnz) - added.indptr[row]
        self._corner, self._weight = np.zeros((added.shape[0], 3), np.int32), np.zeros((added.shape[0], 3))
        self._corner[row, column], self._weight[row, column] = added.indices, added.data
        self._faces = np.ascontiguousarray(garment.fine_faces, dtype=np.int32)

    def wrap(self, fine: np.ndarray) -> np.ndarray:
        """Delivered vertices [m] (V, 3) around the ``fine`` ones [m] (N, 3), of the same type."""
        fine, dtype = np.ascontiguousarray(fine), fine.dtype
        corners = np.empty((len(self._stride), 3), dtype)
        weight, stride = self._weight.astype(dtype), self._stride.astype(dtype)
        placed = self._corner, weight, stride, len(corners), STEPS, corners
        call_with_scratch("wrap", dtype, fine, len(fine), self._faces, len(self._faces), *placed)
        return corners
