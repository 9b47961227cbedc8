"""Consensus: charts are blended, every patch is fitted again to the blended vertices, and the blend is taken again.

A fit to given vertices is a product with a matrix that only the partition decides, so a drape graph could do it.
As ``refit`` of a ``PatchSpace`` it stands between variables and vertices, so that what is minimised can know of it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from benchmarks.representation_space import CPU, PLACE, SIZE, Charts, PatchSpace
from drape.geometry import jets
from training.sparse import SparsePair, product

RIDGE = 1e-4  # on coefficients of unit-scaled coordinates, as of the rest jets


class Refit:
    """Fits the patches of ``found`` anew, ``rounds`` times, by least squares.

    Vertices count by the root of their weight in the blend: by the weight itself, charts agree less at their rims.
    The in-plane polynomials are of order ``plane_order``; with 4 a patch has 45 numbers instead of 27. Moved by the
    fit is what the polynomials add, so charts that agree stay as they are. For frames that bones move rigidly.
    """

    def __init__(self, found: Charts, *, rounds: int = 1, plane_order: int = jets.IN_PLANE_ORDER) -> None:
        self.rounds, self.number_count = rounds, 2 * jets.coefficient_count(plane_order) + SIZE
        self._weight = torch.from_numpy(found.weight).float()
        self._height = _pseudo_inverse(found, jets.HEIGHT_ORDER)
        self._plane = self._height if plane_order == jets.HEIGHT_ORDER else _pseudo_inverse(found, plane_order)

    def __call__(self, space: PatchSpace, rows: Tensor) -> Tensor:
        """World rows (18 K, 3) of the patches of ``space`` after the rounds, from those before."""
        for _ in range(self.rounds):
            said = space.chart_positions(rows)
            blended = (self._weight[..., None] * said).sum(dim=1, keepdim=True)
            rows = rows + self._added((blended - said).reshape(-1, 3), space.frame)
        return rows

    def _added(self, moved: Tensor, frame: Tensor) -> Tensor:
        """What chart entries that should move by ``moved`` [m] (4 V, 3) add to the world rows."""
        count = len(frame)
        coefficients = product(self._height, moved).reshape(count, SIZE, 3)
        if self._plane is not self._height:
            normal = frame[:, :, 2:]  # (K, 3, 1)
            plane = product(self._plane, moved).reshape(count, SIZE, 3)
            coefficients = plane + ((coefficients - plane) @ normal) @ normal.mT
        return torch.cat([torch.zeros(count, PLACE, 3), coefficients], dim=1).reshape(-1, 3)


def _pseudo_inverse(found: Charts, order: int) -> SparsePair:
    """(15 K, 4 V) [1/m]: from movements of the chart entries to the coefficients of the polynomial that fits best."""
    patch, weight = found.patch.ravel(), np.sqrt(found.weight.ravel())
    basis, fitted = found.basis.reshape(len(patch), -1), jets.coefficient_count(order)
    scale = basis[:, 0]  # the first polynomial is 1
    entries = np.flatnonzero(weight > 0.0)
    entries = entries[np.argsort(patch[entries], kind="stable")]
    bounds = np.searchsorted(patch[entries], np.arange(found.patch_count + 1))
    rows, columns, values = [], [], []
    for k in range(found.patch_count):
        own = entries[bounds[k] : bounds[k + 1]]
        a = basis[own, :fitted]
        pull = a.T * weight[own]
        inverse = np.linalg.solve(pull @ a + RIDGE * scale[own].max(initial=0.0) ** 2 * np.eye(fitted), pull)
        rows.append(np.repeat(SIZE * k + np.arange(fitted), len(own)))
        columns.append(np.tile(own, fitted))
        values.append(inverse.ravel())
    shape = (SIZE * found.patch_count, len(patch))
    entry = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return SparsePair.from_scipy(scipy.sparse.csr_matrix(entry, shape=shape), device=CPU)
