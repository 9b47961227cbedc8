"""Jets: order of the basis, derivatives, metric, normal and curvature against closed forms; numpy against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.geometry import jets
from tests.fixtures.laws import each

EXACT = 1e-12
ORDERS = (0, 1, 2, 3, 4)
STEP = 1e-5
DIFFERENCE = 1e-8  # error of central differences at STEP


def monge(height: np.ndarray) -> np.ndarray:
    """The jet (27,) of the surface (u, v, h) with height coefficients (15,)."""
    p, q = np.zeros(jets.IN_PLANE_COUNT), np.zeros(jets.IN_PLANE_COUNT)
    p[1] = q[2] = 1.0
    return jets.pack(p, q, height)


def height_of(**coefficients: float) -> np.ndarray:
    """Height coefficients (15,) by name: ``uu`` is the coefficient of u^2, ``uuvv`` that of u^2 v^2."""
    height = np.zeros(jets.HEIGHT_COUNT)
    for name, value in coefficients.items():
        height[jets.exponents(jets.HEIGHT_ORDER).index((name.count("u"), name.count("v")))] = value
    return height


@pytest.fixture
def uv(rng):
    return rng.uniform(-1.0, 1.0, (50, 2))


@pytest.fixture
def jet(rng):
    """Fifty jets near the identity, with every coefficient in use."""
    return monge(np.zeros(jets.HEIGHT_COUNT)) + 0.1 * rng.normal(size=(50, jets.JET_COUNT))


def slopes(height: np.ndarray, uv: np.ndarray) -> dict[str, np.ndarray]:
    """First and second derivatives of the height, by the basis."""
    times = {"u": (1, 0), "v": (0, 1), "uu": (2, 0), "uv": (1, 1), "vv": (0, 2)}
    return {
        name: jets.basis_derivative(uv, jets.HEIGHT_ORDER, u_times=a, v_times=b) @ height
        for name, (a, b) in times.items()
    }


@pytest.mark.parametrize("order", ORDERS)
def test_basis_has_as_many_monomials_as_it_says(order):
    assert jets.coefficient_count(order) == len(jets.exponents(order)) == (order + 1) * (order + 2) // 2


def test_basis_is_in_the_order_of_the_paper(uv):
    u, v = uv[:, 0], uv[:, 1]
    assert_allclose(jets.basis(uv, 2).T, [np.ones(50), u, v, u * u, u * v, v * v], rtol=EXACT, atol=0.0)
    assert jets.exponents(3)[6:] == [(3, 0), (2, 1), (1, 2), (0, 3)]


def test_lower_orders_are_the_beginning_of_higher_ones(uv):
    highest = jets.basis(uv, 4)
    for order in ORDERS:
        assert_array_equal(jets.basis(uv, order), highest[:, : jets.coefficient_count(order)])


@pytest.mark.parametrize("times", [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 1)])
def test_derivatives_of_the_basis_agree_with_differences(times, uv):
    a, b = times
    for axis in range(2):
        step = STEP * np.eye(2)[axis]
        ahead, behind = (jets.basis_derivative(uv + sign * step, 4, u_times=a, v_times=b) for sign in (1.0, -1.0))
        got = jets.basis_derivative(uv, 4, u_times=a + (axis == 0), v_times=b + (axis == 1))
        assert_allclose(got, (ahead - behind) / (2.0 * STEP), rtol=0.0, atol=DIFFERENCE)


def test_derivatives_vanish_beyond_the_order(uv):
    assert_array_equal(jets.basis_derivative(uv, 4, u_times=5), np.zeros((50, 15)))
    assert_array_equal(jets.basis_derivative(uv, 4, u_times=2, v_times=3), np.zeros((50, 15)))


def test_pack_and_unpack_are_inverse(jet, rng):
    assert_array_equal(jets.pack(*jets.unpack(jet)), jet)
    parts = [rng.normal(size=(3, 7, count)) for count in (jets.IN_PLANE_COUNT, jets.IN_PLANE_COUNT, jets.HEIGHT_COUNT)]
    for have, want in zip(jets.unpack(jets.pack(*parts)), parts, strict=True):
        assert_array_equal(have, want)
    assert jet.shape[-1] == jets.JET_COUNT


def test_full_jets_are_the_same_surface(jet, uv):
    full = jets.full(jet)
    assert full.shape[-1] == jets.FULL_COUNT
    assert_array_equal(jets.full(full), full)
    for derivative in ({}, {"u_times": 1}, {"v_times": 2}):
        assert_allclose(
            jets.evaluate_jet(full, uv, **derivative), jets.evaluate_jet(jet, uv, **derivative), rtol=0, atol=EXACT
        )
    assert_array_equal(jets.pack(*jets.unpack(full)), full)


def test_identity_jet_is_the_parameter_plane(uv):
    flat = monge(np.zeros(jets.HEIGHT_COUNT))
    assert_allclose(jets.evaluate_jet(flat, uv), np.c_[uv, np.zeros(50)], rtol=0.0, atol=EXACT)
    assert_allclose(jets.normal(flat, uv), np.tile([0.0, 0.0, 1.0], (50, 1)), rtol=0.0, atol=EXACT)


def test_evaluation_is_linear_in_the_coefficients(jet, uv, rng):
    other = rng.normal(size=jet.shape)
    want = 2.0 * jets.evaluate_jet(jet, uv) - 3.0 * jets.evaluate_jet(other, uv)
    assert_allclose(jets.evaluate_jet(2.0 * jet - 3.0 * other, uv), want, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("shape", [(2,), (1, 2), (4, 3, 2), (0, 2)])
def test_batch_axes_broadcast(shape, rng):
    where, coefficients = rng.normal(size=shape), rng.normal(size=jets.JET_COUNT)
    scale = np.array(0.3)
    assert jets.evaluate_jet(coefficients, where).shape == (*shape[:-1], 3)
    assert jets.normal(coefficients, where).shape == (*shape[:-1], 3)
    assert jets.curvature(coefficients, where, scale)[0].shape == shape[:-1]


def test_curvature_of_a_graph_is_its_closed_form(uv, rng):
    height, scale = 0.3 * rng.normal(size=jets.HEIGHT_COUNT), 0.07
    d = slopes(height, uv)
    area = 1.0 + d["u"] ** 2 + d["v"] ** 2
    top = (1.0 + d["v"] ** 2) * d["uu"] - 2.0 * d["u"] * d["v"] * d["uv"] + (1.0 + d["u"] ** 2) * d["vv"]
    mean, gaussian = jets.curvature(monge(height), uv, np.array(scale))
    assert_allclose(mean, top / (2.0 * area**1.5) / scale, rtol=1e-9, atol=1e-9)
    assert_allclose(gaussian, (d["uu"] * d["vv"] - d["uv"] ** 2) / area**2 / scale**2, rtol=1e-9, atol=1e-9)


def sphere_jet(radius: float, scale: float) -> np.ndarray:
    """Fourth-order expansion of the top of a sphere: z = -r^2 / 2R - r^4 / 8R^3."""
    quadratic, quartic = -scale / (2.0 * radius), -(scale**3) / (8.0 * radius**3)
    return monge(height_of(uu=quadratic, vv=quadratic, uuuu=quartic, uuvv=2.0 * quartic, vvvv=quartic))


@pytest.mark.parametrize(("quantity", "order"), [("normal", 5), ("mean", 4), ("gaussian", 4)])
def test_sphere_is_approached_at_the_order_of_the_jet(quantity, order):
    radius, scale = 0.3, 0.1
    jet, errors = sphere_jet(radius, scale), []
    for reach in (0.4, 0.2):
        where = reach * np.array([np.cos(0.4), np.sin(0.4)])
        x = scale * where
        z = np.sqrt(radius**2 - x @ x)
        mean, gaussian = jets.curvature(jet, where, np.array(scale))
        off = {
            "normal": jets.normal(jet, where) - np.array([*x, z]) / radius,
            "mean": mean + 1.0 / radius,
            "gaussian": gaussian - 1.0 / radius**2,
        }
        errors.append(np.abs(off[quantity]).max())
    assert_allclose(np.log2(errors[0] / errors[1]), order, rtol=0.0, atol=0.15)


def test_normals_are_unit_and_orthogonal_to_the_surface(jet, uv):
    n = jets.normal(jet, uv)
    assert_allclose(np.linalg.norm(n, axis=-1), 1.0, rtol=EXACT, atol=0.0)
    for times in ({"u_times": 1}, {"v_times": 1}):
        assert_allclose((n * jets.evaluate_jet(jet, uv, **times)).sum(-1), 0.0, rtol=0.0, atol=EXACT)


def test_curvature_ignores_the_parameters_and_scales_with_the_inverse_length(jet, uv):
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    p, q, h = jets.unpack(monge(height_of(uu=0.3, uv=0.2, vvv=0.1, uuvv=-0.2)))
    turned = jets.pack(turn[0, 0] * p + turn[0, 1] * q, turn[1, 0] * p + turn[1, 1] * q, h)
    want = jets.curvature(jets.pack(p, q, h), uv, np.array(0.1))
    assert_allclose(jets.curvature(turned, uv, np.array(0.1)), want, rtol=1e-10, atol=EXACT)
    small, large = jets.curvature(jet, uv, np.array(0.1)), jets.curvature(jet, uv, np.array(0.3))
    assert_allclose(small[0], 3.0 * large[0], rtol=1e-10, atol=0.0)
    assert_allclose(small[1], 9.0 * large[1], rtol=1e-10, atol=0.0)


FUNCTIONS = {
    "evaluate": lambda jet, uv, scale: jets.evaluate_jet(jet, uv),
    "second derivative": lambda jet, uv, scale: jets.evaluate_jet(jet, uv, u_times=1, v_times=1),
    "normal": lambda jet, uv, scale: jets.normal(jet, uv),
    "mean curvature": lambda jet, uv, scale: jets.curvature(jet, uv, scale)[0],
    "gaussian curvature": lambda jet, uv, scale: jets.curvature(jet, uv, scale)[1],
}


@each(function=FUNCTIONS)
def test_numpy_and_torch_agree(function, jet, uv, rng):
    scale = rng.uniform(0.1, 0.3, 50)
    got = function(*(torch.from_numpy(x) for x in (jet, uv, scale)))
    assert_allclose(got.numpy(), function(jet, uv, scale), rtol=1e-10, atol=EXACT)


@each(function=FUNCTIONS)
def test_gradients_are_right(function, jet, uv, rng):
    inputs = [torch.tensor(x, requires_grad=True) for x in (jet[:3], uv[:3], rng.uniform(0.5, 1.0, 3))]
    assert torch.autograd.gradcheck(function, inputs)
