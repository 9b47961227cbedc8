"""A residual carried by a moving surface, and patches that move as wholes."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.solver import descent
from drape.solver.coarse import CLAMP_M, coarse, coarse_step
from drape.solver.frames import surface_frames, to_local, to_world
from drape.solver.problem import surroundings
from tests.drape.cloth.cloth_shapes import random_rotation
from tests.drape.solver.solver_setup import crumpled
from tests.drape.solver.test_hessian import charts_of


def frames_of(x, scene):
    frames = np.empty((len(x), 3, 3), x.dtype)
    surface_frames(x, scene.problem.triangles, frames)
    return frames


def test_frames_are_orthonormal_and_turn_with_the_surface(rng):
    scene, rotation = crumpled(), random_rotation(rng)
    frames = frames_of(scene.x, scene)
    assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(frames), 1, 1)), rtol=0.0, atol=1e-12)
    assert_allclose(np.linalg.det(frames), 1.0, rtol=1e-12, atol=0.0)
    turned = frames_of(np.ascontiguousarray(scene.x @ rotation.T + 0.3), scene)
    assert_allclose(turned, frames @ rotation.T, rtol=0.0, atol=1e-10)


def test_a_residual_follows_a_rigid_motion(rng):
    scene, rotation = crumpled(), random_rotation(rng)
    residual = 0.01 * rng.normal(size=scene.x.shape)
    carried = residual.copy()
    to_local(frames_of(scene.x, scene), carried, carried)
    to_world(frames_of(np.ascontiguousarray(scene.x @ rotation.T), scene), carried, carried)
    assert_allclose(carried, residual @ rotation.T, rtol=0.0, atol=1e-12)


def pressed(dtype, depth_m):
    """A sheet without weight, pressed as a whole into a plane."""
    scene = crumpled("rib", flat_rest=True, dtype=dtype, springs=False, noise_m=0.0)
    scene = scene._replace(problem=scene.problem._replace(weight_n=0.0 * scene.problem.weight_n))
    up = np.tile(np.array([0.0, 0.0, 1.0]), (len(scene.x), 1))
    around = surroundings(scene.problem, scene.x + depth_m * up, up)
    gradient = np.empty_like(scene.x)
    energy = descent.energy_and_gradient(scene.x, scene.problem, around, gradient)
    charts = charts_of(scene)
    charts = charts._replace(weight=charts.weight.astype(dtype))
    return scene, around, gradient, energy, coarse(scene.cloth, scene.material, charts)


def test_a_coarse_step_lifts_what_is_pressed_and_lowers_the_energy():
    for dtype in (np.float32, np.float64):
        scene, around, gradient, energy, level = pressed(dtype, 0.004)
        x = scene.x.copy()
        coarse_step(x, level, scene.problem, around, gradient)
        assert x.dtype == dtype
        assert descent.energy_and_gradient(x, scene.problem, around, np.empty_like(x)) < 0.3 * energy


def test_a_coarse_step_is_clamped():
    scene, around, gradient, _, level = pressed(np.float64, 0.2)
    x = scene.x.copy()
    coarse_step(x, level, scene.problem, around, gradient)
    moved = np.linalg.norm(x - scene.x, axis=1)
    assert 0.3 * CLAMP_M < moved.max() < 2.0 * CLAMP_M


def test_a_matrix_without_a_factor_moves_nothing():
    scene, around, gradient, _, level = pressed(np.float64, 0.004)
    x = scene.x.copy()
    coarse_step(
        x, level._replace(matrix=-level.matrix), scene.problem, around._replace(normal=0.0 * around.normal), gradient
    )
    assert (x == scene.x).all()
