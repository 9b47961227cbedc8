"""Shapes of cloth that covers arms, by where these point: what skinning of one rest shape cannot tell.

A mantle over spread arms is no skinned image of the same mantle over hanging ones. So it is known over a few
directions of the upper arms, each as its way from rest before it is skinned. Between these directions d_k a side of the
cloth is their mean by the shares p of its own arm's direction d,

    sum_k p_k |d_j - d_k| + m = |d_j - d| for all j,    sum_k p_k = 1,

which is one at its own direction and linear in distance between (a polyharmonic spline of order one).
"""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.garment.skin import BodyBinding
from drape.geometry.skinning import skin_points

COLLAR = 0.2  # the collar bone's share of an arm's turn
MIDDLE_M = 0.15  # within this distance of the middle plane a vertex follows both arms
SIDES = {"left": 1.0, "right": -1.0}


def _along(down_deg: float, forward_deg: float) -> tuple[float, float, float]:
    down, forward = np.radians([down_deg, forward_deg])
    return (np.cos(down) * np.cos(forward), -np.sin(down), np.cos(down) * np.sin(forward))


# Directions (left, up, forward) of the left upper arm: hanging, in A-pose, spread, up, and in front, low and high.
DIRECTIONS = np.array([_along(75, 0), _along(40, 0), _along(0, 0), _along(-50, 0), _along(45, 70), _along(0, 75)])
SPREAD = 2  # the row of DIRECTIONS that is the rest pose


def pose_of(direction: np.ndarray) -> np.ndarray:
    """Returns the pose (24, 3) [rad] whose left upper arm points along ``direction`` (3,), a unit vector, and whose
    right one is its mirror image; other joints are at rest."""
    axis = np.cross([1.0, 0.0, 0.0], direction)
    turn = np.arccos(np.clip(direction[0], -1.0, 1.0)) * axis / max(float(np.linalg.norm(axis)), 1e-12)
    pose = np.zeros((JOINT_COUNT, 3))
    for side, sign in SIDES.items():
        pose[JOINT_NAMES.index(f"{side}_collar")] = COLLAR * turn * [1.0, sign, sign]
        pose[JOINT_NAMES.index(f"{side}_shoulder")] = (1.0 - COLLAR) * turn * [1.0, sign, sign]
    return pose


def shares_of(rotations: np.ndarray) -> np.ndarray:
    """Returns the weights (F, 2, K) of the K ``DIRECTIONS`` that interpolate between them for the left and the right
    upper arm in F frames; they sum to one. ``rotations`` (F, 24, 3, 3): those of the bones in the world."""
    trunk = rotations[:, JOINT_NAMES.index("spine3")]
    directions = []
    for side, sign in SIDES.items():
        arm = sign * rotations[:, JOINT_NAMES.index(f"{side}_shoulder"), :, 0]
        directions.append(np.einsum("fba,fb->fa", trunk, arm) * [sign, 1.0, 1.0])
    count = len(DIRECTIONS)
    system = np.ones((count + 1, count + 1))
    system[:count, :count] = np.linalg.norm(DIRECTIONS[:, None] - DIRECTIONS, axis=-1)
    system[count, count] = 0.0
    far = np.linalg.norm(np.stack(directions, axis=1)[:, :, None] - DIRECTIONS, axis=-1)
    sides = np.concatenate([far, np.ones((*far.shape[:2], 1))], axis=-1)
    return np.linalg.solve(system, sides.reshape(-1, count + 1).T).T.reshape(sides.shape)[..., :count]


def shaped(rest: np.ndarray, ways: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Returns the vertices [m] (F, N, 3) of a mantle in T-pose before skinning, for F frames with bone rotations
    ``rotations`` (F, 24, 3, 3). ``rest`` [m] (N, 3): its vertices at rest. ``ways`` [m] (N, K, 3): their displacements
    from there for arms along each of the K ``DIRECTIONS``."""
    shares = shares_of(rotations)
    across = np.clip(0.5 + 0.5 * rest[:, 0] / MIDDLE_M, 0.0, 1.0)
    left = across * across * (3.0 - 2.0 * across)
    flat = ways.transpose(1, 0, 2).reshape(ways.shape[1], -1)
    own = [(shares[:, side] @ flat).reshape(len(shares), -1, 3) for side in range(2)]
    return rest + left[:, None] * own[0] + (1.0 - left)[:, None] * own[1]


def ways_to(shapes: np.ndarray, rest: np.ndarray, binding: BodyBinding, body: BodyModel) -> np.ndarray:
    """Returns the displacements [m] (N, K, 3) from ``rest`` (N, 3) after which skinning by ``binding`` gives ``shapes``
    [m] (K, N, 3): the mantle over arms along each of the K ``DIRECTIONS``."""
    rotations, translations = body.bones(np.stack([pose_of(direction) for direction in DIRECTIONS]))
    turn = np.einsum("vj,kjab->kvab", binding.weights, rotations, optimize=True)
    back = np.linalg.solve(turn, (shapes - binding.weights @ translations)[..., None])[..., 0]
    return (back - rest).transpose(1, 0, 2)


def worn(
    rest: np.ndarray, ways: np.ndarray, binding: BodyBinding, body: BodyModel, poses: np.ndarray, betas: np.ndarray
) -> np.ndarray:
    """Returns the vertices [m] (F, N, 3) of a mantle on ``body`` of the shape ``betas`` (S,) in ``poses`` (F, 24, 3)
    [rad], along the world's axes and counted from the pelvis; ``rest`` and ``ways`` as in ``shaped``."""
    rotations, translations = body.bones(poses, None, betas)
    place = shaped(rest, ways, rotations) + binding.shapedirs @ betas
    return np.asarray(skin_points(place, binding.weights, rotations, translations)) - body.rest_joints(betas)[0]
