"""Laws of linear blend skinning and of blended patch frames."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.geometry.rigid import bone_transforms
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.geometry.skinning import blend_frames, skin_points
from drape.motion.t_pose import CANONICAL_JOINTS

EXACT = 1e-13
BLENDED = 1e-12
PATCH_COUNT = 30


@pytest.fixture
def points(rng):
    return rng.uniform(-0.8, 0.8, (PATCH_COUNT, 3))


@pytest.fixture
def weights(rng):
    """Weights on four bones each; they sum to one."""
    dense = np.zeros((PATCH_COUNT, JOINT_COUNT))
    for row in dense:
        row[rng.choice(JOINT_COUNT, 4, replace=False)] = rng.dirichlet(np.ones(4))
    return dense


@pytest.fixture
def bones(rng):
    local = rotvec_to_matrix(0.7 * rng.normal(size=(3, JOINT_COUNT, 3)))
    return bone_transforms(local, CANONICAL_JOINTS, PARENTS)


def blended(points, weights, rotations, translations):
    return blend_frames(
        points, weights, weights.argmax(axis=-1), rotations, translations, matrix_to_quaternion(rotations)
    )


def test_skinning_is_the_weighted_sum_of_the_bones(points, weights, bones):
    rotations, translations = bones
    want = np.zeros((3, PATCH_COUNT, 3))
    for bone in range(JOINT_COUNT):
        moved = points @ np.swapaxes(rotations[:, bone], -1, -2) + translations[:, bone, None]
        want += weights[:, bone, None] * moved
    assert_allclose(skin_points(points, weights, rotations, translations), want, rtol=0.0, atol=EXACT)


def moved_bones(bones, turn, shift):
    rotations, translations = bones
    return turn @ rotations, translations @ turn.T + shift


def test_frames_commute_with_rigid_motion(points, weights, bones, rng):
    turn, shift = rotvec_to_matrix(2.0 * rng.normal(size=3)), rng.normal(size=3)
    before, centres = blended(points, weights, *bones)
    after, moved = blended(points, weights, *moved_bones(bones, turn, shift))
    assert_allclose(after, turn @ before, rtol=0.0, atol=BLENDED)
    assert_allclose(moved, centres @ turn.T + shift, rtol=0.0, atol=BLENDED)


def test_frame_of_one_bone_moves_rigidly_with_it(points, bones, rng):
    rotations, translations = bones
    bone = rng.integers(0, JOINT_COUNT, PATCH_COUNT)
    got, centres = blended(points, np.eye(JOINT_COUNT)[bone], rotations, translations)
    assert_allclose(got, rotations[:, bone], rtol=0.0, atol=BLENDED)
    want = (rotations[:, bone] @ points[..., None])[..., 0] + translations[:, bone]
    assert_allclose(centres, want, rtol=0.0, atol=EXACT)


def test_frames_are_rotations(points, weights, bones):
    frames, _ = blended(points, weights, *bones)
    assert_allclose(
        frames @ np.swapaxes(frames, -1, -2), np.broadcast_to(np.eye(3), frames.shape), rtol=0.0, atol=BLENDED
    )
    assert_allclose(np.linalg.det(frames), np.ones(frames.shape[:-2]), rtol=0.0, atol=BLENDED)


def test_frames_ignore_the_signs_of_the_bones_quaternions(points, weights, bones, rng):
    rotations, translations = bones
    quaternions = matrix_to_quaternion(rotations)
    flipped = quaternions * rng.choice([-1.0, 1.0], quaternions.shape[:-1])[..., None]
    heaviest = weights.argmax(axis=-1)
    want, _ = blend_frames(points, weights, heaviest, rotations, translations, quaternions)
    got, _ = blend_frames(points, weights, heaviest, rotations, translations, flipped)
    assert_allclose(got, want, rtol=0.0, atol=BLENDED)


@pytest.mark.parametrize("angle", [np.pi, 2.0 * np.pi, 1.999999 * np.pi])
def test_frames_of_two_bones_a_turn_apart_are_finite_rotations(angle):
    rotations = rotvec_to_matrix(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, angle]]))
    quaternions = np.array([[1.0, 0.0, 0.0, 0.0], [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]])
    weights = np.array([[0.5, 0.5]])
    frames, centres = blend_frames(np.ones((1, 3)), weights, np.array([0]), rotations, np.zeros((2, 3)), quaternions)
    assert np.isfinite(centres).all()
    assert_allclose(frames[0] @ frames[0].T, np.eye(3), rtol=0.0, atol=BLENDED)


def test_frames_are_finite_when_the_others_cancel_the_heaviest():
    # -1 and +1 of one rotation: agreement is exact and negative, the blend must not vanish.
    quaternions = np.array([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]])
    still = np.tile(np.eye(3), (2, 1, 1))
    frames, _ = blend_frames(
        np.ones((1, 3)), np.array([[0.5, 0.5]]), np.array([0]), still, np.zeros((2, 3)), quaternions
    )
    assert_allclose(frames[0], np.eye(3), rtol=0.0, atol=EXACT)


def test_numpy_and_torch_agree(points, weights, bones):

    def frames(array):
        rotations = array(bones[0])
        heaviest, quaternions = array(weights.argmax(axis=-1)), matrix_to_quaternion(rotations)
        return blend_frames(array(points), array(weights), heaviest, rotations, array(bones[1]), quaternions)

    for have, want in zip(frames(torch.from_numpy), frames(np.asarray), strict=True):
        assert_allclose(have.numpy(), want, rtol=0.0, atol=EXACT)


def test_gradient_of_frames_is_right(rng):
    points, weights = torch.tensor(rng.normal(size=(3, 3))), torch.tensor(rng.dirichlet(np.ones(2), 3))
    rotvec = torch.tensor(0.5 * rng.normal(size=(2, 3)), requires_grad=True)
    shift = torch.tensor(rng.normal(size=(2, 3)), requires_grad=True)

    def frames(v, t):
        rotations = rotvec_to_matrix(v)
        return blend_frames(points, weights, weights.argmax(-1), rotations, t, matrix_to_quaternion(rotations))

    assert torch.autograd.gradcheck(frames, (rotvec, shift))
