"""Groups of tensors: what their declaration says is what a graph takes, and arrays go in and out by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.arrays import Array
from drape.arrays.tensors import Tensors, group, tensor


@dataclass(frozen=True, eq=False)
class Inner(Tensors):
    place: Array = tensor("inner_place", "rows", 3, unit="m")
    index: Array = tensor("inner_index", "rows", dtype="int32")


@dataclass(frozen=True, eq=False)
class Outer(Tensors):
    code: Array = tensor("code", "frames", "width")
    inner: Inner = group(Inner, rows="frames")
    late: Array | None = tensor("late", "frames", part="second")
    early: Array | None = tensor("early", "frames", part="first")
    felt: Inner | None = group(Inner, part="second")


@dataclass(frozen=True, eq=False)
class Optional(Tensors):
    code: Array = tensor("code", "frames")
    inner: Inner | None = group(Inner, part="first")


def test_every_network_has_the_plain_tensors_and_parts_come_in_their_order():
    assert [spec.name for spec in Outer.specs()] == ["code", "inner_place", "inner_index"]
    both = [spec.name for spec in Outer.specs(("first", "second"))]
    assert both == ["code", "inner_place", "inner_index", "early", "late", "inner_place", "inner_index"]


def test_axes_are_bound_and_renamed_where_a_group_lies():
    code, place, index = Outer.specs(width=7)
    assert code.shape == ("frames", 7)
    assert (place.shape, place.dtype, place.unit) == (("frames", 3), "float32", "m")
    assert (index.shape, index.dtype) == (("frames",), "int32")


def test_a_group_comes_from_a_flat_mapping_and_goes_back():
    arrays = {"code": np.ones(2), "inner_place": np.zeros((2, 3)), "inner_index": np.arange(2)}
    for there in (arrays, {"code": arrays["code"]}):
        made = Optional.from_flat(there | {"other": np.zeros(1)})
        assert set(made.flat()) == set(there)
        assert (made.inner is None) == ("inner_place" not in there)
        for name, array in made.each(lambda array: array + 1).flat().items():
            assert_array_equal(array, there[name] + 1)


def test_what_every_network_takes_must_be_there_and_so_must_all_of_a_part():
    with pytest.raises(KeyError, match="code"):
        Optional.from_flat({})
    with pytest.raises(KeyError, match="inner_index"):
        Optional.from_flat({"code": np.ones(2), "inner_place": np.zeros((2, 3))})
