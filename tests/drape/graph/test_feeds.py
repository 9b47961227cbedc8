"""What the drape graph is fed: relative to the root, blind to heading, padded, and true to the skinned body."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.features import feature_count
from drape.body.skeleton import JOINT_COUNT
from drape.errors import BodyError, MotionError
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_rotvec, quaternion_to_matrix, rotvec_to_matrix
from drape.geometry.skinning import skin_points
from drape.graph.feeds import BETA_COUNT, body_feed, garment_feed, kinematics
from tests.drape.garment.rest_garments import barrel_garment
from tests.fixtures.garments import default_body

FLOAT32 = 2e-6


@pytest.fixture
def poses(rng):
    return 0.5 * rng.normal(size=(3, JOINT_COUNT, 3))


@pytest.fixture
def trans(rng):
    return rng.normal(size=(3, 3))


@pytest.fixture
def betas(rng):
    return rng.normal(size=BETA_COUNT)


def test_translation_changes_only_the_root(poses, trans, betas):
    body = default_body()
    here, there = (body_feed(body, poses, where, betas) for where in (np.zeros((3, 3)), trans))
    for key, value in here.arrays.items():
        assert_array_equal(there.arrays[key], value)
    assert_allclose(there.root - here.root, trans, rtol=0.0, atol=1e-12)


def test_root_is_the_place_of_the_root_joint(poses, trans, betas):
    body = default_body()
    rotations, translations = body.bones(poses, trans, betas)
    joint = rotations[:, 0] @ body.rest_joints(betas)[0] + translations[:, 0]
    assert_allclose(body_feed(body, poses, trans, betas).root, joint, rtol=0.0, atol=1e-12)


def test_joints_are_where_the_bones_put_them(poses, trans, betas):
    body = default_body()
    rotations, translations = body.bones(poses, trans, betas)
    joints = (rotations @ body.rest_joints(betas)[..., None])[..., 0] + translations
    feed, at = body_feed(body, poses, trans, betas), kinematics(body, poses, trans, betas)
    assert_allclose(feed.arrays["body_joints"] + feed.root[:, None], joints, rtol=0.0, atol=1e-6)
    assert_allclose(at.joints, joints, rtol=0.0, atol=1e-12)
    assert_array_equal(at.rotations, rotations)
    flat = at.static.reshape(3, -1)
    assert_array_equal(flat.astype(np.float32), feed.arrays["body_features"][:, : feature_count()])


def test_feed_and_root_give_the_posed_body(poses, trans, betas):
    body = default_body()
    feed = body_feed(body, poses, 100.0 * trans, betas)
    bones = (feed.arrays[key].astype(float) for key in ("bone_rotation", "bone_translation"))
    placed = skin_points(np.broadcast_to(body.rest_vertices(betas), (3, body.vertex_count, 3)), body.weights, *bones)
    want = body.posed_vertices(poses, 100.0 * trans, betas)
    assert_allclose(placed + feed.root[:, None], want, rtol=0.0, atol=FLOAT32)


def test_quaternions_are_those_of_the_bones(poses, trans):
    arrays = body_feed(default_body(), poses, trans).arrays
    turned = quaternion_to_matrix(arrays["bone_quaternion"].astype(float))
    assert_allclose(turned, arrays["bone_rotation"], rtol=0.0, atol=FLOAT32)


def test_body_features_ignore_the_heading(poses, trans, betas):
    turned = poses.copy()
    heading = rotvec_to_matrix(np.array([0.0, 1.3, 0.0]))
    turned[:, 0] = matrix_to_rotvec(heading @ rotvec_to_matrix(poses[:, 0]))
    before, after = (body_feed(default_body(), p, trans, betas).arrays for p in (poses, turned))
    assert_allclose(after["body_features"], before["body_features"], rtol=0.0, atol=FLOAT32)
    assert_allclose(after["bone_translation"], before["bone_translation"] @ heading.T, rtol=0.0, atol=FLOAT32)


def test_shape_is_padded_with_zeros_and_stands_at_the_end_of_the_features(poses, trans, betas):
    few = body_feed(default_body(), poses, trans, betas[:3]).arrays
    want = np.where(np.arange(BETA_COUNT) < 3, betas, 0.0).astype(np.float32)
    assert_array_equal(few["betas"], np.tile(want, (3, 1)))
    assert_array_equal(few["body_features"][:, -BETA_COUNT:], few["betas"])
    assert_array_equal(body_feed(default_body(), poses, trans).arrays["betas"], np.zeros((3, BETA_COUNT)))


def test_body_of_few_shapes_is_padded_too(poses, trans, betas):
    body = dataclasses.replace(default_body(), shapedirs=default_body().shapedirs[..., :4])
    feed = body_feed(body, poses, trans, betas[:4]).arrays
    assert_array_equal(feed["betas"][0], np.where(np.arange(BETA_COUNT) < 4, betas, 0.0).astype(np.float32))
    with pytest.raises(BodyError, match="at most 4"):
        body_feed(body, poses, trans, betas)


def test_no_frames_make_an_empty_feed():
    feed = body_feed(default_body(), np.zeros((0, JOINT_COUNT, 3)), np.zeros((0, 3)))
    assert feed.arrays["body_features"].shape == (0, feature_count() + BETA_COUNT)
    assert feed.root.shape == (0, 3)


@pytest.mark.parametrize("bad", [np.zeros(3), np.zeros((1, 3)), np.zeros((3, 2))])
def test_translations_of_another_shape_are_refused(poses, bad):
    with pytest.raises(MotionError, match="trans: expected shape"):
        body_feed(default_body(), poses, bad)


def test_motion_that_is_not_finite_is_refused(poses, trans):
    with pytest.raises(MotionError, match="trans: expected finite"):
        body_feed(default_body(), poses, np.full((3, 3), np.nan))
    with pytest.raises(MotionError, match="poses: expected finite"):
        body_feed(default_body(), np.full_like(poses, np.inf), trans)


def test_delivered_vertices_are_the_beginning_of_the_fine_ones():
    garment = barrel_garment()
    fine = garment_feed(garment, fine=True)
    for key, value in garment_feed(garment).items():
        assert_array_equal(value, fine[key][: len(value)])


def test_garment_feed_rebuilds_the_rest_garment():
    garment = barrel_garment()
    feed = {key: value.astype(float) for key, value in garment_feed(garment, fine=True).items()}
    patch = feed["chart_patch"].astype(int)
    placed = (
        np.einsum("vkab,vkb->vka", feed["patch_rotation"][patch], feed["chart_local"]) + feed["patch_centre"][patch]
    )
    blended = np.einsum("vk,vka->va", feed["chart_weight"], placed)
    assert_allclose(blended, garment.vertices, rtol=0.0, atol=FLOAT32)


def test_chart_basis_and_patch_height_give_the_rest_height():
    garment = barrel_garment()
    feed = garment_feed(garment, fine=True)
    height = jets.unpack(garment.patch_jet)[2][garment.chart_patch]
    rest = (feed["chart_basis"] * height).sum(axis=-1) * garment.patch_scale[garment.chart_patch]
    assert_allclose(rest + garment.chart_residual[..., 2], feed["chart_local"][..., 2], rtol=0.0, atol=FLOAT32)


def test_shape_movement_is_padded_with_zeros():
    garment = barrel_garment()
    few = dataclasses.replace(garment, patch_shapedirs=garment.patch_shapedirs[..., :4])
    got = garment_feed(few)["patch_shapedirs"]
    assert_array_equal(got[..., :4], garment.patch_shapedirs[..., :4])
    assert_array_equal(got[..., 4:], np.zeros((garment.patch_count, 3, BETA_COUNT - 4)))
