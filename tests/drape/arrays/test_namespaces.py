"""The checks at the boundary and the array-namespace helpers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal

from drape import arrays
from drape.errors import BodyError, InputError, MeshError


@pytest.mark.parametrize("shape", [(4, 3), (None, 3), (4, None), (None, None)])
def test_shapes_that_fit_pass(shape):
    arrays.check_shape("points", np.zeros((4, 3)), shape)
    arrays.check_shape("points", torch.zeros((4, 3)), shape)


@pytest.mark.parametrize("shape", [(3, 4), (4,), (4, 3, 1), (None, 4), ()])
def test_shapes_that_do_not_fit_are_refused_with_both_shapes(shape):
    with pytest.raises(InputError, match=r"points: expected shape .*got shape \(4, 3\)\. ") as caught:
        arrays.check_shape("points", np.zeros((4, 3)), shape)
    assert caught.value.expected.count("any") == shape.count(None)


def test_finite_numbers_pass():
    arrays.check_finite("points", np.zeros((0, 3)))
    arrays.check_finite("points", np.array([1e300, -1e-300]))
    arrays.check_finite("faces", np.arange(6).reshape(2, 3))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_first_number_that_is_not_finite_is_named(bad):
    points = np.zeros((4, 3))
    points[2, 1] = points[3, 0] = bad
    with pytest.raises(InputError, match=r"at index \(2, 1\) \(2 in all\)"):
        arrays.check_finite("points", points)
    with pytest.raises(InputError, match=r"at index \(\)"):
        arrays.check_finite("scale", np.array(bad))


@pytest.mark.parametrize("error", [BodyError, MeshError])
def test_checks_raise_the_error_they_are_asked_for(error):
    with pytest.raises(error):
        arrays.check_shape("points", np.zeros(3), (2,), error=error)
    with pytest.raises(error):
        arrays.check_finite("points", np.array([np.nan]), error=error)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_like_takes_namespace_and_dtype_of_its_reference(dtype):
    for have in (
        arrays.like(np.zeros(2, dtype=dtype), [1, 2]),
        arrays.like(torch.zeros(2, dtype=getattr(torch, dtype)), [1, 2]),
    ):
        assert str(have.dtype).endswith(dtype)
        assert_array_equal(np.asarray(have), [1.0, 2.0])


@pytest.mark.parametrize("shape", [(), (4,), (2, 5)])
def test_identity_has_the_leading_axes_of_its_reference(shape):
    want = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    assert_array_equal(arrays.identity3(np.full(shape, np.pi)), want)
    assert_array_equal(arrays.identity3(torch.full(shape, torch.pi)).numpy(), want)
