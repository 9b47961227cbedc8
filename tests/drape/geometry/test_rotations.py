"""Laws of rotation vectors, matrices, quaternions and the 6D form, in numpy and torch."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from drape.geometry.rotations import (
    cross,
    cross_columns,
    dot_columns,
    matrix_to_quaternion,
    matrix_to_rotvec,
    matrix_to_sixd,
    quaternion_multiply,
    quaternion_slerp,
    quaternion_to_matrix,
    quaternion_to_rotvec,
    rotvec_to_matrix,
    rotvec_to_quaternion,
    sixd_to_matrix,
)
from tests.fixtures.laws import each

# A few roundings of float64; square roots near half turns cost the rest.
EXACT = 1e-13
ROUND_TRIP = 2e-12
FLOAT32 = 3e-6

NEAR_TURNS = [
    middle + sign * away for middle in (0.0, np.pi, 2.0 * np.pi) for sign in (-1, 1)
    for away in (0.0, 1e-300, 1e-40, 1e-15, 1e-8, 1e-5, 1e-4, 1e-3)
]  # fmt: skip
NO_ROTATION = {
    "none": np.zeros(6),
    "parallel": [1, 0, 0, 1, 0, 0],
    "against": [1, 0, 0, -2, 0, 0],
    "no first": [0, 0, 0, 0, 1, 0],
    "subnormal": np.full(6, 1e-40),
    "huge": np.full(6, 1e30),
}
ANGLES = (0.0, 1e-12, 1e-7, 0.999e-4, 1.001e-4, 1e-3, 0.3, 1.7, np.pi - 1e-3, np.pi - 1e-7)


def unit_vectors(rng, count):
    axes = rng.normal(size=(count, 3))
    return axes / np.linalg.norm(axes, axis=-1, keepdims=True)


@pytest.fixture
def rotvecs(rng):
    """Rotation vectors of every magnitude, from none to nearly a half turn, also about the axes."""
    axes = np.concatenate([unit_vectors(rng, 20), np.eye(3), -np.eye(3)])
    return (np.array(ANGLES)[:, None, None] * axes).reshape(-1, 3)


@pytest.fixture
def quaternions(rotvecs, rng):
    return rotvec_to_quaternion(rotvecs) * rng.choice([-1.0, 1.0], size=(len(rotvecs), 1))


def test_rotvec_to_matrix_is_the_matrix_exponential(rotvecs):
    x, y, z = rotvecs.T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    assert_allclose(rotvec_to_matrix(rotvecs), expm(skew), rtol=0.0, atol=EXACT)


def test_rotvec_returns_through_matrix_and_quaternion(rotvecs):
    assert_allclose(matrix_to_rotvec(rotvec_to_matrix(rotvecs)), rotvecs, rtol=0.0, atol=ROUND_TRIP)
    assert_allclose(quaternion_to_rotvec(rotvec_to_quaternion(rotvecs)), rotvecs, rtol=0.0, atol=ROUND_TRIP)


def test_tiny_rotvecs_keep_their_relative_accuracy(rng):
    tiny = 1e-7 * unit_vectors(rng, 50)
    assert_allclose(quaternion_to_rotvec(rotvec_to_quaternion(tiny)), tiny, rtol=1e-12, atol=0.0)
    assert_allclose(matrix_to_rotvec(rotvec_to_matrix(tiny)), tiny, rtol=1e-8, atol=1e-22)


def test_long_rotvecs_come_back_as_the_short_one_of_the_same_rotation(rng):
    axes = unit_vectors(rng, 20)
    assert_allclose(
        quaternion_to_rotvec(rotvec_to_quaternion(axes * (0.4 + 2.0 * np.pi))), 0.4 * axes, rtol=0.0, atol=ROUND_TRIP
    )
    assert_allclose(
        matrix_to_rotvec(rotvec_to_matrix(axes * (2.0 * np.pi - 0.4))), -0.4 * axes, rtol=0.0, atol=ROUND_TRIP
    )


@pytest.mark.parametrize(("dtype", "limit"), [(np.float64, 1e-14), (np.float32, 2e-6)])
def test_turns_next_to_none_half_and_whole_are_rotations(dtype: type, limit: float):
    """Guards against sin(x) / x of a subnormal, and against the jump of the axis at a half turn."""
    rotvec = (
        (np.array(NEAR_TURNS)[:, None, None] * unit_vectors(np.random.default_rng(3), 50)).reshape(-1, 3).astype(dtype)
    )
    wanted = Rotation.from_rotvec(rotvec.astype(np.float64)).as_matrix()
    for found in (rotvec_to_matrix(rotvec), quaternion_to_matrix(rotvec_to_quaternion(rotvec))):
        assert_allclose(found, wanted, rtol=0.0, atol=limit)
        assert_allclose(rotvec_to_matrix(matrix_to_rotvec(found)), wanted, rtol=0.0, atol=8.0 * limit)


@each(sixd=NO_ROTATION, dtype=[np.float64, np.float32])
def test_a_degenerate_6d_descriptor_gives_finite_numbers(sixd: list[float], dtype: type):
    """Guards against NaN that spreads from one joint to the drape: such a descriptor names no rotation."""
    with np.errstate(over="ignore", under="ignore"):
        found = sixd_to_matrix(np.asarray(sixd, dtype=dtype))
    assert np.isfinite(found).all() and np.abs(found).max() <= 1.0 + 1e-6


def test_degenerate_quaternions_give_finite_numbers():
    """Guards against the division by the length of a quaternion that has none, or by the sine of no angle."""
    ends = np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 1e-9, 0, 0], [np.cos(1e-8), 1e-8, 0, 0]])
    for start in ends:
        between = quaternion_slerp(np.broadcast_to(start, ends.shape), ends, np.full(len(ends), 0.5))
        assert_allclose(np.linalg.norm(between, axis=1), 1.0, rtol=0.0, atol=1e-12)
    assert_allclose(quaternion_to_rotvec(np.zeros(4)), np.zeros(3))
    assert_allclose(quaternion_to_matrix(np.zeros(4)), np.eye(3))
    assert_allclose(matrix_to_quaternion(np.zeros((3, 3))), [1.0, 0.0, 0.0, 0.0])


def test_quaternion_and_its_opposite_are_one_rotation(quaternions):
    assert_allclose(quaternion_to_matrix(quaternions), quaternion_to_matrix(-quaternions), rtol=0.0, atol=EXACT)
    assert_allclose(quaternion_to_rotvec(quaternions), quaternion_to_rotvec(-quaternions), rtol=0.0, atol=EXACT)


def test_quaternion_returns_through_matrix_with_positive_real_part(quaternions):
    back = matrix_to_quaternion(quaternion_to_matrix(quaternions))
    assert (back[:, 0] >= 0.0).all()
    sign = np.sign(np.sum(back * quaternions, axis=-1, keepdims=True))
    assert_allclose(sign * back, quaternions, rtol=0.0, atol=ROUND_TRIP)


def test_quaternion_product_is_the_matrix_product(quaternions, rng):
    other = quaternions[rng.permutation(len(quaternions))]
    product = quaternion_multiply(quaternions, other)
    assert_allclose(
        quaternion_to_matrix(product),
        quaternion_to_matrix(quaternions) @ quaternion_to_matrix(other),
        rtol=0.0,
        atol=EXACT,
    )


def test_quaternions_form_a_group(quaternions, rng):
    b, c = quaternions[rng.permutation(len(quaternions))], quaternions[rng.permutation(len(quaternions))]
    left = quaternion_multiply(quaternion_multiply(quaternions, b), c)
    assert_allclose(left, quaternion_multiply(quaternions, quaternion_multiply(b, c)), rtol=0.0, atol=EXACT)
    inverse = quaternions * np.array([1.0, -1.0, -1.0, -1.0])
    one = np.broadcast_to([1.0, 0.0, 0.0, 0.0], quaternions.shape)
    assert_allclose(quaternion_multiply(quaternions, inverse), one, rtol=0.0, atol=EXACT)


def test_slerp_ends_at_its_ends_and_is_uniform_in_between(rng):
    start = rotvec_to_quaternion(rng.normal(size=(40, 3)))
    step = 0.9 * np.pi * unit_vectors(rng, 40) * rng.random((40, 1))
    end = quaternion_multiply(start, rotvec_to_quaternion(step))
    for fraction in (0.0, 0.25, 0.5, 1.0):
        got = quaternion_slerp(start, end, np.full(40, fraction))
        want = quaternion_multiply(start, rotvec_to_quaternion(fraction * step))
        assert_allclose(quaternion_to_matrix(got), quaternion_to_matrix(want), rtol=0.0, atol=ROUND_TRIP)


def test_slerp_takes_the_shorter_arc_and_survives_equal_and_opposite_ends(quaternions):
    half = np.full(len(quaternions), 0.3)
    for end in (quaternions, -quaternions):
        got = quaternion_slerp(quaternions, end, half)
        assert_allclose(quaternion_to_matrix(got), quaternion_to_matrix(quaternions), rtol=0.0, atol=ROUND_TRIP)


def test_slerp_of_nearly_equal_ends_is_accurate(rng):
    step = np.geomspace(1e-9, 1e-2, 40)[:, None] * unit_vectors(rng, 40)
    got = quaternion_slerp(rotvec_to_quaternion(0.0 * step), rotvec_to_quaternion(step), np.full(40, 0.3))
    assert_allclose(quaternion_to_rotvec(got), 0.3 * step, rtol=1e-6, atol=1e-14)


def test_sixd_returns_the_matrix_and_ignores_scale_and_shear(rotvecs, rng):
    matrices = rotvec_to_matrix(rotvecs)
    sixd = matrix_to_sixd(matrices)
    assert_allclose(sixd_to_matrix(sixd), matrices, rtol=0.0, atol=EXACT)
    scale, shear = rng.uniform(0.5, 2.0, (2, len(rotvecs), 1))
    bent = np.concatenate([scale * sixd[:, :3], scale * sixd[:, 3:] + shear * sixd[:, :3]], axis=-1)
    assert_allclose(sixd_to_matrix(bent), matrices, rtol=0.0, atol=ROUND_TRIP)


def test_cross_agrees_with_numpy_and_broadcasts(rng):
    a, b = rng.normal(size=(5, 1, 3)), rng.normal(size=(4, 3))
    assert_allclose(cross(a, b), np.cross(a, b), rtol=0.0, atol=EXACT)


FUNCTIONS = {
    "rotvec_to_quaternion": (rotvec_to_quaternion, lambda v: v),
    "rotvec_to_matrix": (rotvec_to_matrix, lambda v: v),
    "quaternion_to_matrix": (quaternion_to_matrix, rotvec_to_quaternion),
    "quaternion_to_rotvec": (quaternion_to_rotvec, rotvec_to_quaternion),
    "matrix_to_quaternion": (matrix_to_quaternion, rotvec_to_matrix),
    "matrix_to_rotvec": (matrix_to_rotvec, rotvec_to_matrix),
    "matrix_to_sixd": (matrix_to_sixd, rotvec_to_matrix),
    "sixd_to_matrix": (sixd_to_matrix, lambda v: matrix_to_sixd(rotvec_to_matrix(v))),
}


@each(case=FUNCTIONS)
def test_numpy_and_torch_agree(case, rotvecs):
    function, prepare = case
    value = prepare(rotvecs)
    assert_allclose(function(torch.from_numpy(value)).numpy(), function(value), rtol=0.0, atol=1e-14)


@each(case=FUNCTIONS)
def test_float32_stays_float32_and_close(case, rotvecs):
    function, prepare = case
    away = rotvecs[np.linalg.norm(rotvecs, axis=-1) < 3.0]  # at a half turn the axis' sign is rounding
    got = function(prepare(away).astype(np.float32))
    assert got.dtype == np.float32
    assert_allclose(got, function(prepare(away)), rtol=0.0, atol=FLOAT32)


@each(case=FUNCTIONS, scale=[0.0, 1e-7, 0.5, 2.5])
def test_gradient_is_right_also_at_no_rotation(case, scale, rng):
    function, prepare = case
    rotvec = torch.tensor(scale * unit_vectors(rng, 3), requires_grad=True)
    # The whole chain from the rotation vector: matrices and quaternions move on their manifolds only.
    assert torch.autograd.gradcheck(lambda v: function(prepare(v)), (rotvec,))


@each(fraction=[0.0, 0.3, 1.0])
def test_gradient_of_slerp_is_right(fraction, rng):
    start, end = (torch.tensor(rng.normal(size=(3, 3)), requires_grad=True) for _ in range(2))
    t = torch.full((3,), fraction, dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda a, b: quaternion_slerp(rotvec_to_quaternion(a), rotvec_to_quaternion(b), t), (start, end)
    )


def test_gradient_of_slerp_between_equal_ends_is_finite():
    start = torch.tensor([[0.3, -0.2, 0.1]], dtype=torch.float64, requires_grad=True)
    end = start.detach().clone().requires_grad_()
    t = torch.tensor([0.4], dtype=torch.float64)
    between = quaternion_slerp(rotvec_to_quaternion(start), rotvec_to_quaternion(end), t)
    for gradient in torch.autograd.grad(between.sum(), (start, end)):
        assert torch.isfinite(gradient).all()


@each(rows=[1, 3, 4])
def test_products_of_columns_are_those_of_rows(rows: int):
    first, second = np.random.default_rng(3).normal(size=(2, 2, 5, rows))
    a, b = first.swapaxes(-1, -2), second.swapaxes(-1, -2)
    assert_allclose(dot_columns(a, b), (first * second).sum(axis=-1)[:, None], rtol=0, atol=1e-15)
    if rows == 3:
        assert_allclose(cross_columns(a, b).swapaxes(-1, -2), np.cross(first, second), rtol=0, atol=1e-15)
