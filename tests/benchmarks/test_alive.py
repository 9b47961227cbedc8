"""The benchmark of own clothes, and its rival: chains of spring bones."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.alive import COLUMNS, main, posing
from benchmarks.measure.skirt_springs import CHAINS, LEVELS, SkirtSprings, legs_of
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment


@pytest.mark.long
def test_a_row_has_a_skirt_in_its_ways():
    record = main(["--quick", "--threads", "1"])
    (row,) = record["rows"]
    assert set(COLUMNS) <= set(row)
    assert row["alive_poses_pct"] < 0.1 and row["alive_walk_pct"] < 0.1 * row["springs_walk_pct"]


def test_springs_at_rest_leave_a_skirt_where_it_is_and_turn_with_the_body(body: BodyModel):
    garment = open_garment(find_garments(["skirt"])[0], body)
    rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    springs = SkirtSprings(rest, body.joints_template)
    assert springs.share.shape == (len(rest), LEVELS, CHAINS) and springs.share.sum(axis=(1, 2)).max() < 1.0 + 1e-9
    legs = legs_of(body.v_template, body.weights, body.joints_template)
    thin = legs._replace(radii=np.zeros(4))
    poses = np.zeros((40, 24, 3))
    poses[20:, 0, 1] = np.pi / 2
    bones = body.bones(poses, np.zeros((40, 3)))
    carried = np.einsum("fab,vb->fva", bones[0][:, 0], rest) + bones[1][:, None, 0]
    found = springs.over(carried, *bones, thin, 60.0)
    assert np.abs(found[19] - rest).max() < 1e-9
    lag = np.linalg.norm(found - carried, axis=2).max(axis=1)
    assert lag[20] > 0.02 and lag[39] < lag[20]


def test_poses_are_held_where_they_are_looked_at():
    clip, rows = posing()
    assert len(rows) == 5 and rows[-1] == len(clip.poses) - 1
    for row in rows[1:]:
        assert np.abs(clip.poses[row] - clip.poses[row - 20]).max() == 0.0
