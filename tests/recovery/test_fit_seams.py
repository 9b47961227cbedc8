"""Seams as a constraint: its derivative against differences, the way back to it, and a search that never leaves it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError
from recovery.fit.objective import SeamConstraint, ease_left, sewable, wanted_ratios
from recovery.fit.optimise import FitOptions, PatternSearch
from recovery.pattern import geometry
from recovery.pattern.bases import tshirt
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.symmetry import find_symmetries, free_controls, symmetrised
from tests.recovery.pattern_setup import default_measurements, tube
from tests.recovery.test_fit_optimise import search


def shirt() -> Pattern:
    """The T-shirt: curved armholes, sleeve caps with ease, mirrored halves."""
    pattern = tshirt(default_measurements())
    return symmetrised(pattern, find_symmetries(pattern))


def constraint_of(pattern: Pattern, base: Pattern | None = None) -> SeamConstraint:
    """The constraint of ``pattern`` with its own symmetries."""
    return SeamConstraint(pattern, free_controls(pattern, find_symmetries(pattern)), base or pattern)


def moved(pattern: Pattern, size_m: float, seed: int = 3) -> Pattern:
    """``pattern`` with its free corners moved at random by about ``size_m``."""
    free = free_controls(pattern, find_symmetries(pattern))
    values = size_m * np.random.default_rng(seed).normal(size=free.count)
    return with_controls(pattern, free.controls, free.positions(values))


def test_the_constraint_is_the_logarithm_of_lengths_over_what_is_asked_for(rng):
    pattern = shirt()
    constraint = constraint_of(pattern)
    values = 0.01 * rng.normal(size=constraint.free.count)
    there = with_controls(pattern, constraint.free.controls, constraint.free.positions(values))
    assert_allclose(constraint.apart(values), np.log1p(ease_left(there, pattern)), atol=1e-13)
    assert np.abs(constraint.apart(values)).max() > 0.005


def test_the_slopes_of_seams_agree_with_differences(rng):
    constraint = constraint_of(shirt())
    values, way = 0.01 * rng.normal(size=(2, constraint.free.count))
    step = 1e-5
    numeric = (constraint.apart(values + step * way) - constraint.apart(values - step * way)) / (2.0 * step)
    assert_allclose(constraint.slopes(values) @ way, numeric, atol=1e-9)
    ways = constraint.along(values)
    assert_allclose(constraint.slopes(values) @ ways, 0.0, atol=1e-10)
    assert_allclose(ways.T @ ways, np.eye(ways.shape[1]), atol=1e-12)


def test_newton_comes_back_by_the_shortest_way(rng):
    """The correction is at right angles to all that keeps the seams, up to the curvature of the constraint."""
    constraint = constraint_of(shirt())
    values = 1e-3 * rng.normal(size=constraint.free.count)
    kept = constraint.kept(values)
    assert kept is not None and np.abs(constraint.apart(kept)).max() <= 1e-10
    correction = kept - values
    assert np.linalg.norm(correction) > 1e-4
    assert np.linalg.norm(constraint.along(kept).T @ correction) < 0.01 * np.linalg.norm(correction)
    again = constraint.kept(kept)
    assert again is not None and (again == kept).all()


def test_a_pattern_is_made_sewable_and_keeps_symmetry_and_ease():
    base = shirt()
    spoilt = moved(base, 0.006)
    assert np.abs(ease_left(spoilt, base)).max() > 0.01
    found = sewable(spoilt, base, find_symmetries(base))
    assert np.abs(ease_left(found, base)).max() < 1e-9
    assert np.abs(control_points(found).positions - control_points(spoilt).positions).max() < 0.02
    assert len(find_symmetries(found, tolerance_m=1e-9).between) == len(find_symmetries(base).between)
    caps = np.array([seam.first_m / seam.second_m for seam in geometry.seams(found)])
    assert_allclose(np.sort(caps), np.sort(wanted_ratios(base)), rtol=1e-9)
    assert (np.abs(caps - 1.0) > 0.01).sum() == 4  # both halves of both sleeve caps are eased in


def test_ease_below_half_a_percent_is_none():
    for taller, wanted in ((1.004, 1.0), (1.02, 1.0 / 1.02)):
        back = replace(tube().panels[1], vertices=tube().panels[1].vertices * [1.0, taller])
        assert_allclose(wanted_ratios(tube(back=back)), wanted, rtol=1e-12)


def test_what_cannot_be_sewn_is_refused():
    # Front and back are one by symmetry, and one is asked to be a tenth taller.
    taller = tube(front=replace(tube().panels[0], vertices=tube().panels[0].vertices * [1.0, 1.1]))
    with pytest.raises(InputError, match="can be made as long"):
        sewable(tube(), taller, find_symmetries(tube()))


def test_a_search_never_leaves_the_seams():
    """Adam's and closing steps alike, with the closing ones still going down."""
    loose, nodes = search()
    seams = SeamConstraint(loose.mesh.pattern, loose.free, loose.mesh.pattern)
    finder = PatternSearch(loose.mesh, loose.free, loose.forward, loose.objective, seams=seams)
    seen = []
    evaluate = finder.evaluate

    def watched(values, near):
        seen.append(float(np.abs(seams.apart(values)).max()))
        return evaluate(values, near)

    finder.evaluate = watched  # type: ignore[method-assign]
    found = finder.run(nodes, FitOptions(iterations=4, closing=4, rate_m=2e-3))
    assert len(seen) >= 9 and max(seen) <= 1e-10
    assert np.abs(ease_left(found.pattern, loose.mesh.pattern)).max() < 1e-9
    assert found.history[:, 0].min() < 0.01 * found.history[0, 0]
