"""Forward kinematics against a plain loop over 4x4 matrices, and its invariances."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.geometry.rigid import apply, bone_transforms, forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.t_pose import CANONICAL_JOINTS

EXACT = 1e-13


@pytest.fixture
def local(rng):
    return rotvec_to_matrix(rng.normal(size=(4, JOINT_COUNT, 3)))


def chained(local_rotations, joints):
    """World matrices (J, 4, 4) of one pose, one joint after the other."""
    world = []
    for joint, parent in enumerate(PARENTS):
        matrix = np.eye(4)
        matrix[:3, :3] = local_rotations[joint]
        matrix[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0.0)
        world.append(matrix if parent < 0 else world[parent] @ matrix)
    return np.stack(world)


def test_forward_kinematics_is_the_product_of_4x4_matrices(local, rng):
    joints = CANONICAL_JOINTS + 0.02 * rng.normal(size=CANONICAL_JOINTS.shape)
    rotations, positions = forward_kinematics(local, joints, PARENTS)
    want = np.stack([chained(pose, joints) for pose in local])
    assert_allclose(rotations, want[..., :3, :3], rtol=0.0, atol=EXACT)
    assert_allclose(positions, want[..., :3, 3], rtol=0.0, atol=EXACT)


def test_forward_kinematics_broadcasts_joints_over_poses_and_poses_over_joints(local, rng):
    joints = CANONICAL_JOINTS + 0.02 * rng.normal(size=(4, *CANONICAL_JOINTS.shape))
    for poses, rest in ((local, joints[0]), (local[0], joints), (local, joints)):
        rotations, positions = forward_kinematics(poses, rest, PARENTS)
        assert rotations.shape[-3:] == (JOINT_COUNT, 3, 3)
        assert positions.shape == (4, JOINT_COUNT, 3)
    assert_allclose(positions[2], forward_kinematics(local[2], joints[2], PARENTS)[1], rtol=0.0, atol=EXACT)


def test_bones_turn_as_their_joints_and_carry_them_from_rest_to_their_posed_places(local):
    rotations, translations = bone_transforms(local, CANONICAL_JOINTS, PARENTS)
    turned, positions = forward_kinematics(local, CANONICAL_JOINTS, PARENTS)
    assert_allclose(rotations, turned, rtol=0.0, atol=EXACT)
    assert_allclose((rotations @ CANONICAL_JOINTS[..., None])[..., 0] + translations, positions, rtol=0.0, atol=EXACT)


def test_apply_composes_and_inverts(rng):
    points = rng.normal(size=(3, 7, 3))
    first, second = rotvec_to_matrix(rng.normal(size=(2, 3, 3)))
    a, b = rng.normal(size=(2, 3, 3))
    both = apply(second, b, apply(first, a, points))
    assert_allclose(both, apply(second @ first, (second @ a[..., None])[..., 0] + b, points), rtol=0.0, atol=EXACT)
    inverse = np.swapaxes(first, -1, -2)
    assert_allclose(
        apply(inverse, -(inverse @ a[..., None])[..., 0], apply(first, a, points)), points, rtol=0.0, atol=EXACT
    )


def test_numpy_and_torch_agree(local):
    got = bone_transforms(torch.from_numpy(local), torch.from_numpy(CANONICAL_JOINTS.copy()), PARENTS)
    for have, want in zip(got, bone_transforms(local, CANONICAL_JOINTS, PARENTS), strict=True):
        assert_allclose(have.numpy(), want, rtol=0.0, atol=EXACT)


def test_gradient_is_right_in_the_rest_pose(rng):
    parents = (-1, 0, 1, 0)
    joints = torch.tensor(rng.normal(size=(4, 3)), requires_grad=True)
    rotvec = torch.zeros((2, 4, 3), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v, j: bone_transforms(rotvec_to_matrix(v), j, parents), (rotvec, joints))
