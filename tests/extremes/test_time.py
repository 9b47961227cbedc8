"""Time steps from none to an age, and state over many frames."""

from __future__ import annotations

import numpy as np
import pytest

from drape.cloth.fabric_table import FABRICS
from drape.live.fold_constants import FoldConstants
from drape.live.fold_step import FoldEffort, fold
from service.compute.drape_runtime import DrapeRuntime
from tests.drape.live.folds_setup import FAR_M, frame, sleeve
from tests.extremes.frames import check_bounded, draped
from tests.fixtures.poses import random_motion

SOFT, *_, STIFF = sorted(FABRICS, key=lambda name: FABRICS[name].warp_n_per_m)


@pytest.mark.parametrize("step_s", [0.0, 1e-300, 1e-9, 1.0 / 240.0, 0.25, 2.0, -1.0, 1e300])
def test_steps_of_any_length(runtime: DrapeRuntime, step_s: float):
    """Guards against a velocity or an acceleration over no time, and against inertia over an age."""
    poses, trans = random_motion(5)
    check_bounded(runtime, draped(runtime, poses, trans=trans, times_s=step_s * np.arange(5)))


@pytest.mark.parametrize("fabric", [SOFT, STIFF])
@pytest.mark.parametrize("fps", [4.1, 1.0])
def test_folds_of_the_stiffest_and_the_softest_fabric_at_the_lowest_rate(
    runtime: DrapeRuntime, fabric: str, fps: float
):
    """Guards against steps of the solver that grow: 4.1 a second is the slowest that still has a past, 1 has none."""
    poses = np.cumsum(np.random.default_rng(9).uniform(-0.1, 0.1, (6, 24, 3)), axis=0)
    check_bounded(runtime, draped(runtime, poses, times_s=np.arange(6) / fps, fabric=None, folds=1))
    rest, dressed = sleeve("denim" if fabric == STIFF else "rib")
    constants, memory = FoldConstants.of(dressed), None
    for number in range(8):
        one = frame(rest, number)
        at = type(one)(one.vertices, one.skin, number / fps)
        x, memory, _ = fold(constants, memory, at, FoldEffort(steps=1, settle=1))
        assert np.isfinite(x).all() and np.linalg.norm(x - one.vertices, axis=1).max() <= FAR_M


def test_many_frames_of_state_do_not_drift():
    """Guards against a memory that gains a little each time round: a motion that repeats has folds that do.

    Folds of this rough drape come to their size in about a hundred laps. ``make soak`` goes on for as many frames as
    are asked for.
    """
    rest, dressed = sleeve()
    constants, memory = FoldConstants.of(dressed), None
    period = [frame(rest, number) for number in (*range(12), *range(12, 0, -1))]
    off_m = []
    for lap in range(200):
        farthest_m = 0.0
        for number, one in enumerate(period):
            at = type(one)(one.vertices, one.skin, (lap * len(period) + number) / 30.0)
            x, memory, report = fold(constants, memory, at, FoldEffort(steps=1, settle=2))
            farthest_m = max(farthest_m, float(np.linalg.norm(x - one.vertices, axis=1).max()))
            assert not report.reset and np.isfinite(x).all()
        off_m.append(farthest_m)
    assert np.mean(off_m[150:]) <= 1.05 * np.mean(off_m[100:150]), "it grows"
