"""Pushes are spread over the cloth as the linear system says, however few they are."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose

from drape.garment.clearance import CLEARANCE_M, FEW_HEAVY, REST_SHARE, _Smoothing, clear_body
from drape.geometry import mesh_graphs
from tests.drape.cloth.cloth_shapes import grid, round_tube
from tests.drape.geometry.geometry_shapes import icosphere


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


def test_a_cuff_that_is_turned_in_leaves_its_limb_as_it_came():
    """Its facing, a millimetre in the skin, looks into the limb: it was pushed through that, and drew a spike."""
    limb, limb_faces = icosphere(4, radius_m=0.025)
    limb[:, 1] += np.where(limb[:, 1] > 0.0, 0.3, -0.1)
    outside, inside = np.linspace(0.0, 0.2, 15), np.linspace(0.2, 0.16, 4)
    radii = [*np.full(15, 0.033), *np.full(4, 0.025)]
    cuff, faces = round_tube(radii, [*outside, *inside], 24)
    cuff[:, 0] += 0.001
    cleared = clear_body(cuff, faces, limb, limb_faces, through=True)
    assert cleared.clearance_m >= CLEARANCE_M
    assert cleared.push_m < 0.015
    assert np.hypot(cleared.vertices[:, 0], cleared.vertices[:, 2]).max() < 0.045
