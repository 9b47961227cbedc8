"""A fabric: its constants, what is refused, and the plate that its hinges make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from drape.arrays import like
from drape.cloth import bending
from drape.cloth.fabric import Fabric, bending_angle, hinge_rigidity, plate_rigidity
from drape.errors import InputError
from drape.geometry import meshes

# Every constant different, so that a swap shows.
WOVEN = Fabric("woven", 900.0, 400.0, 55.0, 120.0, 2.0e-5, 1.1e-5, 1.3e-5, 0.15)
ISOTROPIC = replace(WOVEN, bending_bias_j=2.0e-5, bending_weft_j=2.0e-5)
ANGLES = np.radians([0.0, 20.0, 45.0, 70.0, 90.0, 110.0])


def lattice(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (V, 2) and faces of equilateral triangles of 1 mm, their rows along x."""
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    points = 1e-3 * np.stack([i + 0.5 * j, np.sqrt(0.75) * j], axis=-1).reshape(-1, 2)
    a = (i * side + j)[:-1, :-1].reshape(-1)
    return points, np.concatenate([np.stack([a, a + side, a + 1], 1), np.stack([a + side, a + side + 1, a + 1], 1)])


def bent_energy(fabric: Fabric, angle_rad: float, radius_m: float, *, turn_rad: float) -> float:
    """Energy per area [J/m^2] of a lattice's hinges, bent on a cylinder along ``angle_rad`` to the warp.

    The lattice's rows lie at ``turn_rad`` to the weft.
    """
    panel, faces = lattice(41)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    panel = (panel - panel.mean(axis=0)) @ np.array([[c, s], [-s, c]])
    hinges, sides = meshes.hinges(faces), meshes.hinge_faces(faces)
    s = panel @ np.array([np.sin(angle_rad), np.cos(angle_rad)])  # x is the weft
    t = panel @ np.array([np.cos(angle_rad), -np.sin(angle_rad)])
    shape = np.stack([t, radius_m * np.sin(s / radius_m), radius_m * np.cos(s / radius_m)], axis=1)
    edge = panel[hinges[:, 1]] - panel[hinges[:, 0]]
    area = meshes.face_areas(np.pad(panel, ((0, 0), (0, 1))), faces)
    weight = (edge**2).sum(axis=1) / area[sides].sum(axis=1)
    stiffness = weight * hinge_rigidity(fabric, bending_angle(edge))
    energy = bending.bending_energy(shape[hinges.T].transpose(0, 2, 1), stiffness, np.zeros(len(hinges)))
    # Every hinge stands for a third of its two triangles.
    return float(energy.sum() / (area[sides].sum() / 3.0))


@pytest.mark.parametrize("angle", ANGLES)
def test_hinges_make_the_plate_that_bends_by_direction(angle: float):
    radius = 0.5
    # One lattice has hinges in three directions only; over its turns they take all, as on an uneven mesh.
    turns = np.radians(np.arange(0.0, 60.0, 5.0))
    found = np.mean([bent_energy(WOVEN, angle, radius, turn_rad=turn) for turn in turns])
    np.testing.assert_allclose(found, plate_rigidity(WOVEN, np.asarray(angle)) / (2.0 * radius**2), rtol=0.02, atol=0.0)


@pytest.mark.parametrize("turn", np.radians([0.0, 17.0]))
def test_an_isotropic_cloth_bends_alike_on_every_lattice(turn: float):
    found = bent_energy(ISOTROPIC, 0.3, 0.5, turn_rad=turn)
    np.testing.assert_allclose(found, 2.0e-5 / (2.0 * 0.5**2), rtol=0.02, atol=0.0)


def test_plate_passes_through_the_three_given_rigidities():
    found = plate_rigidity(WOVEN, np.radians([0.0, 45.0, 90.0, 135.0, 180.0]))
    np.testing.assert_allclose(found, [2.0e-5, 1.1e-5, 1.3e-5, 1.1e-5, 2.0e-5], rtol=1e-12, atol=0.0)


def test_hinges_of_an_isotropic_cloth_are_alike_in_torch_too():
    found = hinge_rigidity(ISOTROPIC, like(torch.ones(1, dtype=torch.float64), ANGLES))
    np.testing.assert_allclose(found.numpy(), 2.0e-5, rtol=1e-12, atol=0.0)


def test_softened_keeps_what_bends_shears_and_weighs():
    soft = WOVEN.softened(500.0)
    assert (soft.warp_n_per_m, soft.weft_n_per_m) == (500.0, 400.0)
    assert soft.cross_n_per_m**2 / (500.0 * 400.0) == pytest.approx(55.0**2 / (900.0 * 400.0))
    assert replace(soft, warp_n_per_m=900.0, cross_n_per_m=55.0) == WOVEN


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"warp_n_per_m": -1.0}, "warp_n_per_m: expected a number > 0"),
        ({"shear_n_per_m": 0.0}, "shear_n_per_m: expected a number > 0"),
        ({"bending_weft_j": float("nan")}, "bending_weft_j"),
        ({"density_kg_m2": float("inf")}, "density_kg_m2"),
        ({"friction": -0.1}, "friction and damping >= 0"),
        ({"cross_n_per_m": 601.0}, r"below sqrt\(warp weft\) = 600 N/m.*Take 60 N/m"),
        ({"cross_n_per_m": -600.0}, "cross_n_per_m"),
        ({"bending_bias_j": 1e-6}, "Take 1.32e-05 J for the bias"),
        ({"bending_weft_j": 1e-6}, "bending_bias_j"),
    ],
)
def test_impossible_fabrics_are_refused_with_the_cure(change: dict[str, float], match: str):
    with pytest.raises(InputError, match=match):
        replace(WOVEN, **change)
