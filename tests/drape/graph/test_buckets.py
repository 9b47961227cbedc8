"""The ladder of sizes, and batches filled up to it."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.graph.buckets import AXES, bucket_size, filled, filled_rows
from drape.graph.packing import Composition


def test_rungs_rise_by_at_most_a_half_and_hold_what_is_asked():
    rungs = sorted({bucket_size(count) for count in range(1, 5000)})
    assert rungs[:6] == [8, 12, 16, 24, 32, 48]
    for count in range(1, 5000):
        assert count <= bucket_size(count) <= max(8, 1.5 * count)
        assert bucket_size(bucket_size(count)) == bucket_size(count)


@pytest.fixture
def composition(rng: np.random.Generator) -> Composition:
    sizes = {
        "patch_stored": (9,), "patch_body": (9,), "patch_bone": (9,), "member_anchor": (9, 5), "tile_stored": (13,),
        "tile_patch": (13,), "vertex_charts": (4, 17, 6), "anchor_charts": (4, 25, 6),
    }  # fmt: skip
    arrays = {name: rng.integers(0, 99, size=size).astype(np.int32) for name, size in sizes.items()}
    return Composition(arrays, (slice(0, 9),), (slice(0, 17),))


def test_what_is_filled_in_repeats_the_first_and_the_rest_stays(composition: Composition):
    found = filled(composition)
    assert found.patches == composition.patches and found.vertices == composition.vertices
    assert set(found.arrays) == set(AXES) == set(composition.arrays)
    for name, array in found.arrays.items():
        before = composition.arrays[name]
        assert array.dtype == before.dtype and array.flags.c_contiguous
        assert_array_equal(array[tuple(slice(size) for size in before.shape)], before)
        for axis in AXES[name]:
            assert array.shape[axis] == bucket_size(before.shape[axis])
            first, more = (
                array.take([0], axis=axis),
                array.take(range(before.shape[axis], array.shape[axis]), axis=axis),
            )
            assert_array_equal(more, np.broadcast_to(first, more.shape))
    assert found.arrays["anchor_charts"].shape == (4, 32, 6)


def test_rows_of_bodies_are_filled_alike(rng: np.random.Generator):
    bodies = {"betas": rng.normal(size=(9, 10)), "joint_rest": rng.normal(size=(9, 24, 3))}
    found = filled_rows(bodies)
    for name, rows in bodies.items():
        assert found[name].shape == (12, *rows.shape[1:])
        assert_array_equal(found[name][:9], rows)
        assert_array_equal(found[name][9:], np.repeat(rows[:1], 3, axis=0))
