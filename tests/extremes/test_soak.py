"""A few hundred of the fuzzed frames and rows that ``make soak`` runs for longer, and that it tells of a failure."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from benchmarks import soak
from benchmarks.soak import SHAPE_EVERY, Fuzz, soak_frames, soak_rows
from service.compute.drape_runtime import DrapeRuntime

SOON_S = 100.0


def test_fuzzed_frames_through_the_whole_engine(runtime: DrapeRuntime):
    """Guards against a mixture of extremes that no test thought of: state, time, shape, place and pose at once."""
    count = 3 * SHAPE_EVERY
    assert soak_frames(runtime, count=count, until_s=time.monotonic() + SOON_S, seed=11, folds=1) == (count, None)


def test_rows_through_elementary_stages():
    """Guards against sizes between 1e-45 and 1e3 at which a rotation is none or a step too wide."""
    assert soak_rows(count=20_000, until_s=time.monotonic() + SOON_S, seed=11) == (20_000, None)


def test_a_failure_is_told_with_its_seed_and_number(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(soak, "REACH_M", -1.0)
    done, failed = soak_frames(runtime, count=5, until_s=time.monotonic() + SOON_S, seed=3, folds=1)
    assert done == 0 and failed is not None and failed.startswith("frame 0 of seed 3: ")
    monkeypatch.setattr(soak, "sixd_to_matrix", lambda rows: np.full((len(rows), 3, 3), np.nan))
    done, failed = soak_rows(count=5, until_s=time.monotonic() + SOON_S, seed=3)
    assert done == 0 and failed is not None and failed.startswith("rows from 0 of seed 3: ")


def test_the_time_ends_a_run_and_a_seed_repeats_it(runtime: DrapeRuntime):
    assert soak_frames(runtime, count=5, until_s=0.0, seed=0) == (0, None)
    assert soak_rows(count=5, until_s=0.0, seed=0) == (0, None)
    first, second = Fuzz(4, 10), Fuzz(4, 10)
    for _ in range(5):
        (a, _), (b, _) = first.next(), second.next()
        assert_array_equal(a.poses, b.poses)
        assert_array_equal(a.times_s, b.times_s)
