"""The cloth as an unknown: constants and logarithms, fabrics by name, gradients through the drape, and a recovery."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from benchmarks.recovery.compare import pattern_error
from drape.cloth.material import FABRICS, MEASURED
from drape.errors import InputError
from recovery.fit.cloth import LOG_M, FreeCloth, logarithms, named, nearest_fabric
from recovery.fit.contours import open_contours
from recovery.fit.objective import Objective, Target, Weights
from recovery.fit.optimise import FitOptions, PatternSearch
from recovery.pattern.coordinates import with_controls
from tests.recovery.sim_setup import WOVEN as CLOTH
from tests.recovery.test_fit_optimise import scene, search, slope, wider_below


def test_constants_and_logarithms_are_inverse():
    free = FreeCloth(CLOTH)
    assert_allclose(list(vars(free.cloth(np.zeros(5))).values()), list(vars(CLOTH).values()), rtol=1e-12)
    rng = np.random.default_rng(0)
    for values in 0.03 * rng.normal(size=(20, 5)):  # any values are a cloth that resists every strain
        found = free.cloth(values)
        assert_allclose(free.values_of(found), values, atol=1e-14)
        assert found.density_kg_m2 == CLOTH.density_kg_m2
    doubled = free.cloth(LOG_M * np.log(2.0) * np.eye(5)[4])
    assert_allclose([doubled.bending_j, doubled.h00], [2.0 * CLOTH.bending_j, CLOTH.h00], rtol=1e-12)
    for field in ("h01", "bending_j"):
        with pytest.raises(InputError, match="cloth to be freed"):
            logarithms(replace(CLOTH, **{field: 0.0}))


def test_slopes_of_the_constants_agree_with_differences():
    free, values, step = FreeCloth(CLOTH), np.array([0.003, -0.002, 0.004, 0.001, -0.005]), 1e-7
    stretch, bending = free.slopes(values)
    for k, way in enumerate(step * np.eye(5)):
        ends = [free.tensors(torch.from_numpy(values + sign * way)) for sign in (1.0, -1.0)]
        numeric = (ends[0].stretch - ends[1].stretch).numpy() / (2.0 * step)
        assert_allclose(stretch[:, k], numeric, rtol=1e-6, atol=1e-6 * CLOTH.h00)
        assert_allclose(bending[k], float(ends[0].bending_j - ends[1].bending_j) / (2.0 * step), rtol=1e-6, atol=1e-9)


def test_what_lies_outside_the_library_costs_its_squared_way():
    free = FreeCloth(named("jersey"))
    inside = [free.values_of(named(name)) for name in FABRICS]
    assert [float(free.implausible(torch.from_numpy(values))) for values in inside] == [0.0] * len(FABRICS)
    crisp = free.values_of(named("crisp"))
    beyond = torch.from_numpy(crisp + 0.02 * np.eye(5)[4])
    assert_allclose(float(free.implausible(beyond)), 0.02**2, rtol=1e-9)


def test_the_nearest_fabric_and_its_distance_in_words():
    for name in (*FABRICS, "rib", "twill"):
        found = nearest_fabric(named(name))
        assert found.name == name and found.describe() == f"{name}, within 5 % in everything"
        heavy = named(name)
        heavy = replace(heavy, **{key: 1.5 * value for key, value in vars(heavy).items()})  # all over the weight
        assert nearest_fabric(heavy).name == name and "within" in nearest_fabric(heavy).describe()
    stiff = replace(named("crisp"), bending_j=1.4 * named("crisp").bending_j)
    assert nearest_fabric(stiff).describe() == "crisp, but bending 1.40 times as stiff"


def free_search(true_bending: float) -> tuple[PatternSearch, np.ndarray]:
    """The scene's search with its cloth free; the target has another bending as well as another pattern."""
    mesh, forward, nodes, _, contours, matches = scene()
    free = FreeCloth(CLOTH)
    values = torch.from_numpy(free.values_of(replace(CLOTH, bending_j=true_bending)))
    there, report = forward(torch.from_numpy(mesh.rest_at(wider_below(mesh))), nodes, free.tensors(values))
    assert report.converged
    target = Target.from_mesh(there.numpy(), mesh.faces, open_contours(there.numpy(), mesh.faces), folds=0.0)
    found, _ = search()
    objective = Objective(mesh, target, contours, matches, Weights())
    return PatternSearch(mesh, found.free, forward, objective, cloth=free), nodes


def test_gradients_to_the_cloth_agree_with_differences_through_the_drape():
    finder, nodes = free_search(3.0 * CLOTH.bending_j)
    rng = np.random.default_rng(1)
    values = 0.002 * rng.normal(size=finder.count)
    at = finder.evaluate(values, nodes)
    assert at is not None
    for direction in (*np.eye(finder.count)[finder.free.count :], rng.normal(size=finder.count)):
        numeric = slope(finder, at, direction)
        assert_allclose(at.gradient @ direction, numeric, rtol=1e-4, atol=1e-6 * np.abs(at.gradient).max())


def test_the_drape_moves_with_the_cloth_as_its_sensitivity_says():
    finder, nodes = free_search(CLOTH.bending_j)
    mesh, forward, free = finder.mesh, finder.forward, finder.cloth
    assert free is not None
    rest, values = torch.from_numpy(mesh.rest), np.zeros(5)
    start, _ = forward(rest, nodes)
    none = np.zeros((*mesh.rest.shape, 0))
    found = forward.sensitivity(rest, start.numpy(), none, free.tensors(torch.zeros(5)), free.slopes(values))
    step = 1e-5
    for k, way in enumerate(step * np.eye(5)):
        ends = [forward(rest, start.numpy(), free.tensors(torch.from_numpy(s * way)))[0] for s in (1.0, -1.0)]
        numeric = (ends[0] - ends[1]).numpy() / (2.0 * step)
        assert_allclose(found[:, :, k], numeric, atol=1e-3 * np.abs(numeric).max())


def test_pattern_and_bending_are_found_together():
    """Three times the base's bending: the pattern within a tenth of a millimetre, the bending within a percent."""
    finder, nodes = free_search(3.0 * CLOTH.bending_j)
    mesh = finder.mesh
    given = PatternSearch(mesh, finder.free, finder.forward, finder.objective)
    with_it, without = (one.run(nodes, FitOptions(iterations=0, closing=12)) for one in (finder, given))
    true = with_controls(mesh.pattern, mesh.controls, wider_below(mesh))
    far = [pattern_error(found.pattern, true).controls_m.max() for found in (with_it, without)]
    assert far[0] < 1e-4 < 1e-3 < far[1]
    assert_allclose(with_it.cloth.bending_j, 3.0 * CLOTH.bending_j, rtol=0.01)
    assert without.cloth == CLOTH


def test_a_stiff_cloth_is_draped_no_stiffer_than_its_weight_asks_for():
    """A metre of satin hangs 1 % longer, its coupling and bending as they were; jersey is soft enough as it is."""
    satin, hung = MEASURED["satin"].woven, named("satin")
    assert hung.h00 == hung.h11 == satin.density_kg_m2 * 9.81 / 0.01 < min(satin.h00, satin.h11)
    assert_allclose(hung.h01 / np.sqrt(hung.h00 * hung.h11), satin.h01 / np.sqrt(satin.h00 * satin.h11))
    assert replace(hung, h00=satin.h00, h01=satin.h01, h11=satin.h11) == satin
    assert all(named(name) == FABRICS[name].woven for name in FABRICS)
