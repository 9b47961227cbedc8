"""The floor of a frame is linear blend skinning, and every tier stands beside it and the rival."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import rivals
from drape.engine.calls import call
from drape.geometry.skinning import skin_points
from drape.stages.tiers import NAMES


def test_the_engine_skins_by_four_bones_as_skinning_does(rng):
    count, bones = 37, 6
    weights = np.zeros((count, bones))
    bone = np.stack([rng.permutation(bones)[:4] for _ in range(count)]).astype(np.int32)
    share = rng.dirichlet(np.ones(4), count)
    np.put_along_axis(weights, bone.astype(np.int64), share, axis=1)
    matrices = rng.normal(size=(bones, 3, 4))
    points, moved = rng.normal(size=(count, 3)), np.empty((count, 3), np.float32)
    f32 = [np.ascontiguousarray(one, np.float32) for one in (points, share, matrices)]
    call("law_skin", np.float32, f32[0], f32[1], bone, f32[2], count, moved)
    assert_allclose(moved, skin_points(points, weights, matrices[..., :3], matrices[..., 3]), rtol=0, atol=1e-5)


@pytest.mark.long
def test_each_tier_has_its_ratios_over_the_rival_and_the_floor():
    rows = rivals.main(["--garments", "tshirt", "--frames", "2"])["rows"]
    took = {row["what"]: row for row in rows}
    assert list(took) == [*NAMES, rivals.RIVAL, rivals.FLOOR]
    assert took[rivals.RIVAL]["over_rival"] == took[rivals.FLOOR]["over_floor"] == 1.0
    for row in rows:
        assert row["over_rival"] == pytest.approx(row["cpu_ms"] / took[rivals.RIVAL]["cpu_ms"], rel=1e-4)  # six digits
