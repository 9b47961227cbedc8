"""What kernels are given: arrays that may be written, copied only where they are not such."""

from __future__ import annotations

import numpy as np

from drape.live.clock import Frame, writable


def test_an_array_is_copied_only_where_kernels_could_not_take_it():
    array = np.arange(12.0).reshape(4, 3)
    assert writable(array, array.dtype) is array
    fixed = array.copy()
    fixed.flags.writeable = False
    for other, dtype in ((array.T, np.float64), (fixed, np.float64), (array, np.float32)):
        made = writable(other, np.dtype(dtype))
        assert made.flags.writeable and made.flags.c_contiguous and made.dtype == dtype
        assert np.array_equal(made, other) and not np.shares_memory(made, other)


def test_a_frame_reads_the_skin_where_it_lies():
    skin = np.zeros((1, 8), np.float32)
    frame = Frame(np.zeros((1, 3), np.float32), skin, 0.0)
    assert frame.around(skin.dtype).skin is skin
    assert frame.around(np.dtype(np.float64)).skin.dtype == np.float64
