"""Rings of cloth around a body of one or two upright cylinders."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.cloth.energies import ClothMesh
from drape.geometry.sections import closed_rings, level_section
from drape.live.swing_slack import LEAST, LOOSE, TIGHT, held_share
from tests.drape.cloth import cloth_shapes

AROUND, HIGH = 48, 21


def tube(top_m: float, hem_m: float, x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] and faces of a tube from y = 0, of radius ``top_m``, to y = -0.6, of radius ``hem_m``, around x."""
    vertices, faces = cloth_shapes.tube(AROUND, HIGH - 1, radius_m=1.0, height_m=-0.6)
    radius = top_m - vertices[:, 1:2] / 0.6 * (hem_m - top_m)
    return vertices * np.concatenate([radius, np.ones_like(radius), radius], axis=1) + [x, 0.0, 0.0], faces[:, ::-1]


def limbs(*x: float) -> np.ndarray:
    """Points [m] of cylinders of a radius of 0.1 m around ``x``."""
    return np.concatenate([tube(0.1, 0.1, one)[0] for one in x])


def share(top_m: float, hem_m: float) -> np.ndarray:
    rest, faces = tube(top_m, hem_m)
    return held_share(ClothMesh.from_rest(rest, faces), rest, limbs(0.0)).reshape(HIGH, AROUND)


def test_only_what_is_wide_is_let_go():
    assert_allclose(share(0.11, 0.15), 1.0)
    wide = share(0.11, 0.44)
    slack = np.linspace(1.1, 4.4, HIGH)
    assert_allclose(wide[slack < TIGHT - 0.1], 1.0, atol=0.02)
    assert_allclose(wide[slack > LOOSE + 0.2], LEAST, atol=0.02)
    assert (np.diff(wide.mean(axis=1)) <= 1e-9).all()


def test_two_tubes_go_with_a_limb_each():
    (left, faces), (right, _) = tube(0.25, 0.3, -0.4), tube(0.25, 0.3, 0.4)
    rest, both = np.concatenate([left, right]), np.concatenate([faces, faces + len(left)])
    assert len(closed_rings(level_section(both, rest, -0.31), rest)) == 2
    assert_allclose(held_share(ClothMesh.from_rest(rest, both), rest, limbs(-0.4, 0.4)), 1.0)
