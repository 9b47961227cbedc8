"""Capes and ponchos: told from sleeves, spread by arms that go up, and laid by where arms point."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.garment.avatars import Avatar
from drape.garment.mantle_rest import spread
from drape.garment.mantle_shapes import DIRECTIONS, SPREAD, pose_of, shares_of, ways_to, worn
from drape.garment.rest_pose import MovedGarment
from drape.garment.skin import bind_to_body
from drape.garment.sleeves import covers_arms
from drape.garment.wearer_fields import bones_of, cloth_points
from drape.geometry import meshes
from drape.geometry.closest import signed_distance
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import shirt
from tests.fixtures.mantles import Sheet, cape, poncho, standing

BODY = load_body()
HANGING_DEG = 70.0
NO_SHAPE = np.zeros(BODY.shape_count)


@cache
def a_cape() -> Sheet:
    return cape(BODY, HANGING_DEG, length_m=0.75, open_deg=20.0, clasp=True, edge_m=0.05)


@cache
def spread_cape() -> MovedGarment:
    return spread(*a_cape(), Avatar(standing(BODY, HANGING_DEG), BODY.faces, 0.0, "hanging"), BODY)


def covers(sheet: Sheet, skin: np.ndarray) -> bool:
    return covers_arms(cloth_points(*sheet, 4000)[0], bones_of(BODY.regressor @ skin, skin))


@pytest.mark.parametrize("down_deg", [20.0, 50.0, 75.0])
def test_capes_cover_arms_and_sleeves_go_round_them(down_deg: float):
    skin = standing(BODY, down_deg)
    assert covers(cape(BODY, down_deg, length_m=0.7), skin)
    assert not covers(shirt(BODY, skin), skin)


def test_a_poncho_covers_spread_arms():
    assert covers(poncho(BODY, width_m=0.6, front_m=0.5, back_m=0.5), BODY.v_template)


def test_a_cape_on_hanging_arms_is_spread_by_them_with_its_area():
    """Its hem goes up with the arms, none of it is cut by the skin, and its cloth is that which was delivered."""
    (vertices, faces), moved = a_cape(), spread_cape()
    area = float(meshes.face_areas(vertices, faces).sum())
    assert abs(meshes.face_areas(moved.vertices, faces).sum() / area - 1.0) < 0.05
    assert signed_distance(moved.vertices, BODY.v_template, BODY.faces).min() > -0.003
    assert np.ptp(moved.vertices[:, 0]) > 1.25 * np.ptp(vertices[:, 0])


def test_over_hanging_arms_a_cape_is_as_it_was_delivered():
    (vertices, _), moved = a_cape(), spread_cape()
    assert moved.shapes is not None
    assert np.linalg.norm(moved.shapes[0] - vertices, axis=1).mean() < 0.04


def test_skinned_by_its_ways_a_mantle_has_its_shapes():
    """x_k = skin_k(rest + w_k) where arms point along d_k, to rounding."""
    faces, moved = a_cape()[1], spread_cape()
    assert moved.shapes is not None
    binding = bind_to_body(moved.vertices, faces, BODY, arm=moved.arm)
    ways = ways_to(moved.shapes, moved.vertices, binding, BODY)
    assert np.abs(ways[:, SPREAD]).max() < 1e-12
    poses = np.stack([pose_of(direction) for direction in DIRECTIONS])
    found = worn(moved.vertices, ways, binding, BODY, poses, NO_SHAPE)
    assert_allclose(found, moved.shapes - BODY.joints_template[0], rtol=0, atol=1e-9)


def test_shares_are_those_of_each_arm_and_do_not_see_how_the_body_turns(rng):
    poses = np.stack([pose_of(direction) for direction in DIRECTIONS])
    shares = shares_of(BODY.bones(poses)[0])
    assert_allclose(shares, np.tile(np.eye(len(DIRECTIONS))[:, None], (1, 2, 1)), rtol=0, atol=1e-9)
    mixed = poses[:2].copy()
    mixed[0, 17], mixed[0, 14] = poses[1, 17], poses[1, 14]  # the right arm of the second pose
    mixed[0, 0] = rng.normal(size=3)
    found = shares_of(BODY.bones(mixed)[0])[0]
    assert_allclose(found, np.eye(len(DIRECTIONS))[:2], rtol=0, atol=1e-9)
    assert_allclose(shares_of(BODY.bones(rng.normal(size=(5, 24, 3)))[0]).sum(axis=-1), 1.0, rtol=0, atol=1e-9)


def test_a_tube_round_hips_and_hands_is_no_cape():
    """It covers hands that hang in it, and no upper arm."""
    unit, faces = tube(48, 14, radius_m=1.0, height_m=1.0)
    hanging = standing(BODY, 85.0)
    assert not covers((unit * [0.45, 0.35, 0.25] - [0.0, 0.35, 0.0], faces), hanging)
