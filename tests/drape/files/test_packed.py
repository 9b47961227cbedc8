"""Arrays come back as they were, and the same arrays have the same bytes."""

from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.files.packed import pack


@pytest.mark.parametrize("quick", [False, True])
def test_arrays_come_back_and_bytes_are_the_same(quick: bool):
    arrays = {"few": np.arange(6, dtype=np.int16).reshape(2, 3), "none": np.zeros((0, 3)), "one": np.float32(2.5)}
    content = pack(arrays, quick=quick)
    assert content == pack(arrays, quick=quick)
    with np.load(io.BytesIO(content), allow_pickle=False) as found:
        assert set(found.files) == set(arrays)
        for name, array in arrays.items():
            assert_array_equal(found[name], array)
            assert found[name].dtype == array.dtype and found[name].shape == array.shape
