"""What a target tells of a pattern: against closed forms; against a drape in test_run_command."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recovery.pattern.coordinates import control_points
from recovery.pattern.symmetry import find_symmetries, free_controls
from recovery.run.identify import (
    CAP_M,
    Identifiability,
    corner_names,
    from_curvature,
    shape_basis,
    weak_words,
)
from tests.recovery.pattern_setup import tube


def test_shapes_are_what_is_left_without_rigid_moves():
    """Two free quadrilaterals have 8 coordinates each and 3 rigid moves each; no shape contains one of them."""
    pattern = tube()
    controls = control_points(pattern)
    across, back = shape_basis(np.eye(16), controls.panel, controls.positions)
    assert across.shape == (16, 10) and back.shape == (16, 10)
    assert_allclose(across.T @ across, np.eye(10), atol=1e-12)
    for panel in (0, 1):
        mine = controls.panel == panel
        arm = controls.positions - controls.positions[mine].mean(axis=0)
        for way in (np.array([1.0, 0.0]) + 0.0 * arm, np.stack([-arm[:, 1], arm[:, 0]], axis=1)):
            assert_allclose(across.T @ np.where(mine[:, None], way, 0.0).reshape(-1), 0.0, atol=1e-12)


def test_free_values_of_a_shape_move_the_corners_by_it_up_to_rigid_moves():
    pattern = tube()
    free = free_controls(pattern, find_symmetries(pattern))
    across, back = shape_basis(free.basis, free.controls.panel, free.origin)
    left = free.basis @ back - across
    again, _ = shape_basis(np.concatenate([left, np.eye(16)], axis=1), free.controls.panel, free.origin)
    assert_allclose(again.T @ left, 0.0, atol=1e-10)


def test_slack_is_the_farthest_move_within_the_tolerance(rng):
    """Sampled moves y with y^T C y / 4 = tolerance^2 never go beyond it, and come near."""
    across = np.linalg.qr(rng.normal(size=(8, 3)))[0]
    root = rng.normal(size=(3, 3))
    found = from_curvature(np.ones(3), root @ root.T, across, 1e-4)
    y = rng.normal(size=(20000, 3))
    y *= 2e-4 / np.sqrt(np.einsum("ni,ij,nj->n", y, root @ root.T, y))[:, None]
    far = np.linalg.norm((y @ across.T).reshape(-1, 4, 2), axis=2).max(axis=0)
    assert (far <= found.slack_m + 1e-12).all()
    assert_allclose(far, found.slack_m, rtol=0.02)
    assert_allclose(found.seen, 0.5 * np.sqrt(np.linalg.eigvalsh(root @ root.T)))


def test_what_nothing_tells_is_capped():
    found = from_curvature(np.ones(2), np.diag([0.0, 1.0]), np.eye(4)[:, :2], 1e-3)
    assert_allclose(found.slack_m, [CAP_M, 0.0], atol=1e-12)
    assert found.seen[0] < 1e-3 * found.seen[1]


def test_corners_and_weak_shapes_have_names():
    names = corner_names(tube())
    assert len(names) == 8 and len(set(names)) == 8
    assert names[0] == "front, bottom left (seam to back, open edge)"
    modes = np.zeros((2, 8, 2))
    modes[0, 2, 0] = 1.0
    modes[1, :, 1] = 8.0**-0.5
    told = Identifiability(np.ones(2), np.array([0.02, 0.5]), modes, np.zeros(8), 1e-3)
    first, second = weak_words(told, tube())
    assert first.startswith("10 mm at front, top right") and "by 0.20 mm" in first
    assert "7 other corners" in second
