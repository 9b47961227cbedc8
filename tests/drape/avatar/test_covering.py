"""A skin that is brought out to what stands out of it, at rest and where joints bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.covering import MARGIN_M, POSES, SQUAT, covering, rotvecs
from drape.avatar.parts import PARTS, beside, counted_vertices, parts_of
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.geometry import meshes
from drape.geometry.closest import signed_distance
from drape.geometry.skinning import skin_points

DEEP_M = 0.005


@pytest.fixture(scope="module")
def pose(body: BodyModel) -> TPose:
    """Our own body as a character."""
    return TPose(body.v_template, body.faces, body.weights, body.joints_template, 1.0, 1.7)


def test_a_skin_that_is_short_comes_out_in_every_pose(body: BodyModel, pose: TPose):
    short = body.v_template - DEEP_M * meshes.vertex_normals(body.v_template, body.faces)
    found = covering(short, body.weights, body.joints_template, pose, body)
    counted = counted_vertices(pose)
    for angles in (POSES[0], SQUAT):
        turned = rotvecs(angles)[None]
        seen = body.posed_vertices(turned)[0]
        skin = skin_points(found[None], body.weights, *body.bones(turned))[0]
        outside = signed_distance(seen[counted], skin, body.faces)
        # Five millimetres before; what is left lies in creases, where no normal is the right one.
        assert np.quantile(outside, 0.95) < 1e-3


def test_a_skin_that_holds_all_goes_out_by_no_more_than_the_margin(body: BodyModel, pose: TPose):
    wide = body.v_template + DEEP_M * meshes.vertex_normals(body.v_template, body.faces)
    found = covering(wide, body.weights, body.joints_template, pose, body)
    moved = np.linalg.norm(found - wide, axis=1)
    assert np.median(moved) < MARGIN_M and np.quantile(moved, 0.98) < DEEP_M


def test_a_piece_of_the_trunk_that_stays_where_the_thigh_goes_is_held(body: BodyModel, pose: TPose):
    thighs = [number for number, part in enumerate(PARTS) if part.endswith("thigh")]
    by_hip = np.abs(body.v_template[:, 1] - body.joints_template[1, 1]) < 0.05
    piece = np.flatnonzero(np.isin(parts_of(body.weights), thighs) & by_hip)
    weights = body.weights.copy()
    weights[piece] = np.eye(len(weights[0]))[0]
    stiff = replace(pose, weights=weights)
    found = covering(body.v_template, body.weights, body.joints_template, stiff, body)
    bones = body.bones(rotvecs(SQUAT)[None])
    seen = skin_points(body.v_template[None], weights, *bones)[0]
    before, after = (
        np.quantile(signed_distance(seen[piece], skin_points(skin[None], body.weights, *bones)[0], body.faces), 0.9)
        for skin in (body.v_template, found)
    )
    assert before > 0.01 and after < 0.4 * before, (before, after)


def test_parts_that_join_are_beside_each_other():
    own, other = np.array(
        [[list(PARTS).index(part) for part in pair] for pair in (("trunk", "left_thigh"), ("left_thigh", "trunk"),
         ("left_thigh", "left_shin"), ("neck", "neck"), ("left_thigh", "right_thigh"), ("trunk", "left_forearm"))]
    ).T  # fmt: skip
    assert beside(own, other).tolist() == [True, True, True, True, False, False]


def test_angles_are_told_in_degrees():
    assert_allclose(rotvecs({"left_knee": (90.0, 0.0, 0.0)})[4], [np.pi / 2, 0.0, 0.0])
