"""Tables of the chart consensus: what a fit must reproduce, where anchors lie, and the unit vectors of strain."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.garment import consensus as module
from drape.garment.consensus import ANCHORS_PER_PATCH, FIT_COUNT, MEMBERS, Consensus, consensus, strain_points
from drape.geometry import jets
from tests.fixtures.garments import shipped


@cache
def tables() -> Consensus:
    g = shipped("tank")
    return consensus(g.chart_patch, g.chart_uv, g.chart_weight, g.chart_local(), g.patch_jet, g.patch_scale)


def held() -> np.ndarray:
    return np.any(tables().fit != 0.0, axis=1)


def test_members_are_the_charts_of_the_anchors():
    g, t = shipped("tank"), tables()
    patch, weight = g.chart_patch[t.anchor], g.chart_weight[t.anchor]
    found = {(int(a), int(s), k) for k in range(g.patch_count) for a, s in zip(t.member[k], t.slot[k], strict=True)}
    rows, slots = np.nonzero(weight > 0.0)
    for a, s in zip(rows, slots, strict=True):
        assert (a, s, patch[a, s]) in found
    assert held().sum() == len(rows)
    assert not held()[:, -1].any()  # the packed graph points charts of no weight there
    # Every patch has its share of anchors, none twice.
    assert len(np.unique(t.anchor)) == len(t.anchor) <= ANCHORS_PER_PATCH * g.patch_count
    assert np.bincount(patch[np.arange(len(patch)), weight.argmax(axis=1)], minlength=g.patch_count).min() >= 4


def test_fit_returns_the_polynomial_it_is_given():
    """Up to the ridge: a thousandth of the coefficients, in both orders."""
    g, t = shipped("tank"), tables()
    rng = np.random.default_rng(0)
    uv = g.chart_uv.astype(np.float64)[t.anchor[t.member], t.slot]  # (K, 56, 2)
    for order, rows in ((jets.HEIGHT_ORDER, slice(0, 15)), (jets.IN_PLANE_ORDER, slice(15, FIT_COUNT))):
        wanted = rng.normal(size=(g.patch_count, jets.coefficient_count(order)))
        values = np.einsum("kmn,kn->km", jets.basis(uv, order), wanted)
        got = np.einsum("knm,km->kn", t.fit[:, rows], values)
        # A weak direction of the normal equations is pulled to zero; the surface it leaves is the same.
        said = np.einsum("kmn,kn->km", jets.basis(uv, order), got)
        scale = np.abs(values[held()]).mean()
        assert np.percentile(np.abs(said - values)[held()], 99) < 0.05 * scale
        assert np.abs(said - values)[held()].mean() < 0.005 * scale


def test_rest_is_the_fit_of_the_rest_places():
    g, t = shipped("tank"), tables()
    local = g.chart_local()[t.anchor[t.member], t.slot] / g.patch_scale[:, None, None]
    assert_allclose(t.rest, np.einsum("knm,kmc->knc", t.fit, local), rtol=0, atol=1e-12)
    # In the plane it is the identity: x = u, y = v.
    identity = np.zeros((6, 2))
    identity[1, 0] = identity[2, 1] = 1.0
    assert np.abs(t.rest[:, 15:, :2] - identity).mean() < 0.02


def test_orthonormal_triangles_make_unit_vectors_of_the_rest_tangents():
    t = tables()
    unit = t.tangent @ t.orthonormal
    assert_allclose(unit.swapaxes(-1, -2) @ unit, np.broadcast_to(np.eye(2), t.orthonormal.shape), rtol=0, atol=1e-9)
    assert_array_equal(t.orthonormal[..., 1, 0], 0.0)


def test_tangents_are_derivatives_of_the_rest_jet():
    g, t = shipped("tank"), tables()
    step, jet = 1e-6, g.patch_jet.astype(np.float64)[:, None]
    for axis in range(2):
        moved = np.zeros(2)
        moved[axis] = step
        points = np.broadcast_to(strain_points(), (g.patch_count, 7, 2))
        difference = (jets.evaluate_jet(jet, points + moved) - jets.evaluate_jet(jet, points - moved)) / (2.0 * step)
        assert_allclose(t.tangent[..., axis], difference, rtol=0, atol=1e-7)


def test_crowded_charts_lose_their_faintest_anchors(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "ANCHORS_PER_PATCH", 16)
    g = shipped("tank")
    t = consensus(g.chart_patch, g.chart_uv, g.chart_weight, g.chart_local(), g.patch_jet, g.patch_scale)
    sizes = np.any(t.fit != 0.0, axis=1).sum(axis=1)
    assert sizes.max() == MEMBERS - 1
    assert sizes.min() > 15  # still enough for the fifteen coefficients
