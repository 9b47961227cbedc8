"""Nodes carry cloth as rigid pieces: turns are exact, and folds keep their area where cloth tilts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from drape.engine.calls import call, call_with_scratch
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.geometry import meshes
from tests.drape.live.swing_setup import WIDTH_M, hanging, strip


def carried(x: np.ndarray, still: np.ndarray, swung: np.ndarray, share: float = 1.0) -> np.ndarray:
    out, mesh = np.empty_like(x), Record("SwingMesh", hanging()[1])
    call_with_scratch("law_move_vertices", np.float64, x, len(x), still, swung, mesh, share, out)
    return out


@pytest.mark.parametrize("angle_rad", [0.1, 1.0, 2.0])
def test_a_rigid_way_of_the_nodes_is_that_of_the_cloth(rng, angle_rad: float):
    rest, mesh = hanging()
    folded = rest + 0.01 * rng.normal(size=rest.shape)
    turn = Rotation.from_rotvec(angle_rad * np.array([0.6, 0.0, 0.8])).as_matrix()
    still = folded[mesh.vertex]
    found = carried(folded, still, still @ turn.T + [0.2, -0.1, 0.3])
    has_node = mesh.weight.any(axis=1)
    assert_allclose(found[has_node], (folded @ turn.T + [0.2, -0.1, 0.3])[has_node], rtol=0.0, atol=2e-3 * angle_rad)


def test_folds_keep_their_area_where_cloth_tilts():
    """Pleats of a hanging strip that swings up to the level would be flat if nodes only moved them."""
    rest, faces = strip()
    _, mesh = hanging()
    pleated = rest + 0.02 * np.cos(6.0 * np.pi * rest[:, :1] / WIDTH_M) * [0.0, 0.0, 1.0]
    level = np.stack([rest[:, 0], 0.0 * rest[:, 0], -rest[:, 1]], axis=-1)  # down becomes forward
    found = carried(pleated, rest[mesh.vertex], level[mesh.vertex])
    moved = pleated + (level - rest)
    before, after, plain = (meshes.face_areas(x, faces).sum() for x in (pleated, found, moved))
    assert_allclose(after, before, rtol=5e-3)
    assert plain < 0.9 * before


def test_nodes_that_part_leave_the_cloth_between_them_smooth(rng):
    rest, mesh = hanging()
    still = rest[mesh.vertex]
    noise = 0.01 * rng.normal(size=still.shape)
    noise[np.setdiff1d(np.arange(len(still)), mesh.order)] = 0.0
    way = carried(rest, still, still + noise)[mesh.vertex[mesh.order]] - still[mesh.order]
    assert 0.0 < np.sqrt((way**2).mean()) < 0.005


def test_what_hangs_from_does_not_move(rng):
    rest, mesh = hanging()
    still = rest[mesh.vertex]
    swung = still.copy()
    swung[mesh.order] += 0.05
    held = rest[:, 1] > -1e-9
    assert_allclose(carried(rest, still, swung)[held], rest[held], atol=1e-3)


def test_a_share_of_nothing_moves_nothing(rng):
    rest, mesh = hanging()
    still = rest[mesh.vertex]
    assert_array_equal(carried(rest, still, still + 0.1 * rng.normal(size=still.shape), share=0.0), rest)


def rotations(m: np.ndarray, least: float) -> np.ndarray:
    """Those nearest to matrices ``m`` (``LANES``, 3, 3)."""
    found = np.empty((3, 3, LANES))
    call("law_rotations", np.float64, np.ascontiguousarray(m.transpose(2, 1, 0)), least, found)
    return found.transpose(2, 1, 0)


def test_the_rotation_is_the_polar_factor(rng):
    turn = Rotation.from_rotvec(rng.uniform(-0.9, 0.9, (LANES, 3))).as_matrix()
    stretch = 0.5 * rng.normal(size=(LANES, 3, 3))
    found = rotations(turn @ (stretch @ stretch.transpose(0, 2, 1) + np.eye(3)), 0.0)
    assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (LANES, 1, 1)), rtol=0.0, atol=1e-12)
    assert_allclose(found, turn, rtol=0.0, atol=5e-3)
    assert_array_equal(rotations(np.zeros((LANES, 3, 3)), 0.0), np.tile(np.eye(3), (LANES, 1, 1)))


def test_a_reflection_has_a_rotation_too(rng):
    found = rotations(np.diag([1.0, 2.0, -0.5]) + 0.01 * rng.normal(size=(LANES, 3, 3)), 1e-3)
    assert_allclose(np.linalg.det(found), 1.0, atol=1e-12)
