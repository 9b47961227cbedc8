"""Pushes are spread over the cloth as the linear system says, however few they are."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose

from drape.garment.clearance import FEW_HEAVY, REST_SHARE, _Smoothing
from drape.geometry import mesh_graphs
from tests.drape.cloth.cloth_shapes import grid


@pytest.mark.parametrize("count", [1, FEW_HEAVY, FEW_HEAVY + 1])
@pytest.mark.parametrize("strays", [False, True])
def test_few_pushes_are_spread_as_many_are(count: int, strays: bool, rng: np.random.Generator):
    points, faces = grid(9, 7, cell_m=0.02)
    laplacian = mesh_graphs.weighted_laplacian(mesh_graphs.adjacency(faces, len(points)) / 0.02**2)
    smoothing = _Smoothing(laplacian)
    for stiffness in (0.03**2, 0.03**2, 0.004**2):  # a factor serves for its own stiffness alone
        weight, wanted = np.full(len(points), REST_SHARE), np.zeros_like(points)
        pushed = rng.choice(len(points), count, replace=False)
        weight[pushed], wanted[pushed] = 1.0, 0.01 * rng.standard_normal((count, 3))
        if strays:
            wanted[np.setdiff1d(np.arange(len(points)), pushed)[0]] = 1e-3
        found = smoothing.solve(weight, wanted, stiffness)
        system = scipy.sparse.diags(weight) + stiffness * laplacian
        assert_allclose(system @ found, weight[:, None] * wanted, rtol=0, atol=1e-14)
