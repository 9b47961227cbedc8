"""Arrays come back as they were, and the same arrays have the same bytes."""

from __future__ import annotations

import io

import numpy as np
from numpy.testing import assert_array_equal

from drape.files.packed import packed


def test_arrays_come_back_and_bytes_are_the_same():
    arrays = {"few": np.arange(6, dtype=np.int16).reshape(2, 3), "none": np.zeros((0, 3)), "one": np.float32(2.5)}
    content = packed(arrays)
    assert content == packed(arrays)
    with np.load(io.BytesIO(content), allow_pickle=False) as found:
        assert set(found.files) == set(arrays)
        for name, array in arrays.items():
            assert_array_equal(found[name], array)
            assert found[name].dtype == array.dtype and found[name].shape == array.shape
