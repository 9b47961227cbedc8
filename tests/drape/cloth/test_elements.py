"""Membrane and bending of single elements: derivatives, symmetries and signs, in numpy and torch."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.cloth import bending, membrane

STIFFNESS = (60.0, 45.0, 11.0, 48.0)  # each different, so that a swap shows
COUNT = 200


class Element(NamedTuple):
    """A formula with its constants, at random ``corners`` (3 or 4, 3, n)."""

    formula: ModuleType
    corners: np.ndarray
    constants: tuple

    def __getattr__(self, name: str) -> Callable:
        function = getattr(self.formula, f"{self.formula.__name__.rpartition('.')[2]}_{name}")
        return lambda corners, *others, **options: function(corners, *self.constants, *others, **options)


def triangles(rng: np.random.Generator, count: int = COUNT) -> Element:
    """Deformed triangles over rest triangles of size 1."""
    panel = np.array([[0.0, 0.0], [1.0, 0.1], [0.2, 0.9]])[:, :, None] + 0.15 * rng.normal(size=(3, 2, count))
    rest = membrane.rest_triangles(panel[1] - panel[0], panel[2] - panel[0])
    return Element(membrane, rng.normal(size=(3, 3, count)), (rest, STIFFNESS))


def hinges(rng: np.random.Generator, count: int = COUNT) -> Element:
    """Hinges of size 1 with every fold and every fold at rest between -pi and pi."""
    fold = rng.uniform(-3.1, 3.1, size=count)
    zero, one = np.zeros(count), np.ones(count)
    flat = np.array([[zero, zero, zero], [one, zero, zero], [0.4 * one, one, zero]])
    folded = np.array([[0.6 * one, -0.9 * np.cos(fold), 0.9 * np.sin(fold)]])
    corners = np.concatenate([flat, folded]) + 0.05 * rng.normal(size=(4, 3, count))
    return Element(bending, corners, (rng.uniform(0.2, 0.6, size=count), rng.uniform(-3.1, 3.1, size=count)))


elements = pytest.mark.parametrize("element", [triangles, hinges])


def numeric(function, corners: np.ndarray, *, step: float = 1e-6) -> np.ndarray:
    """Central differences by every corner coordinate, (9 or 12, ...)."""
    slopes = []
    for place in np.ndindex(corners.shape[:2]):
        move = np.zeros_like(corners)
        move[place] = step
        slopes.append((function(corners + move) - function(corners - move)) / (2.0 * step))
    return np.array(slopes)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error over all elements, relative to each element's largest entry."""
    axes = tuple(range(expected.ndim - 1))
    return float((np.abs(found - expected).max(axis=axes) / np.abs(expected).max(axis=axes)).max())


@elements
def test_the_gradient_is_the_derivative_of_the_energy_and_a_wrong_sign_is_found(rng, element):
    one = element(rng)
    found = one.gradient(one.corners).reshape(-1, COUNT)
    slope = numeric(one.energy, one.corners)
    assert relative(found, slope) < 1e-7
    found[-1] *= -1.0
    assert relative(found, slope) > 1e-2


@elements
def test_the_hessian_is_the_derivative_of_the_gradient_and_symmetric(rng, element):
    one = element(rng)
    found = one.hessian(one.corners, definite=False)
    slope = numeric(lambda x: one.gradient(x).reshape(-1, COUNT), one.corners)
    assert relative(found, slope) < 1e-6
    assert_allclose(found, found.transpose(1, 0, 2), rtol=0, atol=1e-12 * np.abs(found).max())


@elements
def test_the_definite_hessian_has_no_negative_eigenvalue(rng, element):
    """1,000 random states: compression, inversion and folds up to nearly +-pi among them."""
    one = element(rng, 1000)
    one.corners[:, :, ::2] *= 0.2
    exact, definite = (
        np.linalg.eigvalsh(one.hessian(one.corners, definite=flag).transpose(2, 0, 1)) for flag in (False, True)
    )
    assert (definite[:, 0] > -1e-12 * definite[:, -1]).all()
    assert exact[:, 0].min() < -0.1  # else the line above shows nothing


@elements
def test_the_contraction_equals_the_stored_definite_hessian(rng, element):
    one = element(rng)
    left, right = rng.normal(size=(2, *one.corners.shape))
    hessian = one.hessian(one.corners, definite=True)
    expected = np.einsum("in,ijn,jn->n", left.reshape(-1, COUNT), hessian, right.reshape(-1, COUNT))
    if element is hinges:  # unbent or not, they are alike
        one = one._replace(constants=one.constants[:1])
    assert_allclose(one.bilinear(one.corners, left, right), expected, rtol=1e-10, atol=1e-10)


@elements
def test_numpy_and_torch_agree(rng, element):
    one = element(rng)
    first, second = one.constants
    rest = type(first)(*map(torch.from_numpy, first)) if isinstance(first, tuple) else torch.from_numpy(first)
    other = one._replace(constants=(rest, second if isinstance(second, tuple) else torch.from_numpy(second)))
    for part in (lambda e, x: e.energy(x), lambda e, x: e.hessian(x, definite=False)):
        expected = part(one, one.corners)
        found = part(other, torch.from_numpy(one.corners)).numpy()
        assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("axis", "place"), [("warp", 0), ("weft", 1), ("shear", 3)])
def test_each_strain_costs_its_own_stiffness(axis, place):
    strain = {"warp": (0.02, 0.0, 0.0), "weft": (0.0, 0.02, 0.0), "shear": (0.0, 0.0, 0.02)}[axis]
    pp, tt, pt = membrane.stress([np.array(value) for value in strain], STIFFNESS)
    found = 0.5 * (pp * strain[0] + tt * strain[1] + 2.0 * pt * strain[2])
    assert_allclose(found, 0.5 * STIFFNESS[place] * 0.02**2, rtol=1e-12)


def test_the_definite_hessian_is_the_exact_one_in_tension(rng):
    one = triangles(rng)
    corners = 4.0 * one.corners
    pp, tt, pt = membrane.stress(
        membrane.green_strain(*membrane.deformation_columns(corners, one.constants[0].inverse)), STIFFNESS
    )
    taut = 0.5 * (pp + tt) - np.hypot(0.5 * (pp - tt), pt) > 1.0
    assert taut.sum() > 20
    exact, definite = (one.hessian(corners, definite=flag)[:, :, taut] for flag in (False, True))
    assert_allclose(definite, exact, rtol=0, atol=1e-3 * np.abs(exact).max())


def test_tension_is_positive_smooth_and_leaves_large_tension_alone(rng):
    values = rng.normal(size=(3, 1000))
    pp, tt, pt = membrane.tension(values, 1e-3)
    centre, radius = 0.5 * (values[0] + values[1]), np.hypot(0.5 * (values[0] - values[1]), values[2])
    expected = [0.5 * (p + np.sqrt(p * p + 1e-6)) for p in (centre + radius, centre - radius)]
    matrices = np.stack([[pp, pt], [pt, tt]]).transpose(2, 0, 1)
    assert_allclose(np.linalg.eigvalsh(matrices).T[::-1], expected, rtol=1e-6, atol=1e-9)
    at_zero = torch.zeros(3, 1, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: torch.stack(membrane.tension(s, 1e-3)), at_zero, eps=1e-9)


def test_the_angle_has_the_sign_of_the_normals_and_its_moment_is_a_sine():
    fold = np.linspace(-3.1, 3.1, 31)
    zero, one = np.zeros_like(fold), np.ones_like(fold)
    flat = np.array([[zero, zero, zero], [one, zero, zero], [zero, one, zero]])
    corners = np.concatenate([flat, [[zero, -np.cos(fold), -np.sin(fold)]]])
    found = bending.hinge(corners)
    assert_allclose(np.arctan2(found.sine, found.cosine), fold, rtol=1e-12, atol=1e-12)
    moment = np.linalg.norm(bending.bending_gradient(corners, one, 0.2 * one)[3], axis=0)
    assert_allclose(moment, np.abs(np.sin(fold - 0.2)), rtol=1e-10, atol=1e-15)


def test_a_collapsed_hinge_has_no_force():
    at_one_place = np.zeros((4, 3, 1))
    assert_allclose(bending.bending_gradient(at_one_place, np.ones(1), np.zeros(1)), 0.0)
    assert np.isfinite(bending.bending_hessian(at_one_place, np.ones(1), np.zeros(1), definite=False)).all()
