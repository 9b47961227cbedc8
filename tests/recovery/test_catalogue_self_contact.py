"""Cloth that meets itself: equal and opposite forces that end at the thickness and keep layers apart."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from recovery.catalogue.fall import SelfContact
from tests.recovery.sim_setup import strip


def layers(gap_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Two square sheets over each other, the upper one shifted and turned a little."""
    points, faces = strip(6, 6, length_m=0.06, width_m=0.06)
    turned = points @ np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]) + 0.004
    low = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    high = np.column_stack([turned[:, 0], np.full(len(points), gap_m), turned[:, 1]])
    return np.concatenate([low, high]), np.concatenate([faces, faces + len(points)])


def test_near_layers_push_each_other_apart_and_far_ones_do_not():
    x, faces = layers(0.002)
    found = SelfContact(faces, np.zeros(len(x), dtype=bool), thickness_m=0.003).springs(x)
    force = found.force.numpy()
    half = len(x) // 2
    assert force[half:, 1].sum() > 0.0
    assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)
    far, _ = layers(0.0031)
    assert len(SelfContact(faces, np.zeros(len(x), dtype=bool), thickness_m=0.003).near(far).gap_m) == 0


def test_the_stiffness_is_symmetric_and_pushes_against_approach():
    x, faces = layers(0.002)
    contact = SelfContact(faces, np.zeros(len(x), dtype=bool), thickness_m=0.003, stiffness_n_per_m=30.0)
    found = contact.springs(x)
    matrix = found.stiffness
    assert abs(matrix - matrix.T).max() < 1e-12
    down = np.zeros_like(x)
    down[len(x) // 2 :, 1] = -1e-6
    moved = contact.springs(x + down).force.numpy() - found.force.numpy()
    wanted = -(matrix @ down.reshape(-1)).reshape(-1, 3)
    # Where the nearest points slide along, or edges are parallel, the gap's own curvature is left out.
    assert_allclose(moved[len(x) // 2 :, 1].sum(), wanted[len(x) // 2 :, 1].sum(), rtol=0.05)
    assert wanted[len(x) // 2 :, 1].sum() > 0.0


def test_neighbours_and_fixed_nodes_are_left_alone():
    x, faces = layers(0.002)
    half = len(x) // 2
    alone = faces[: len(faces) // 2]
    assert len(SelfContact(alone, np.zeros(half, dtype=bool), thickness_m=0.003).near(x[:half]).gap_m) == 0
    fixed = np.zeros(len(x), dtype=bool)
    fixed[half:] = True
    found = SelfContact(faces, fixed, thickness_m=0.003).springs(x)
    assert not found.force.numpy()[half:].any() and found.force.numpy()[:half].any()
    assert abs(found.stiffness[3 * half :]).sum() == 0.0
