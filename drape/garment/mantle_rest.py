"""Mantles: cloth that covers arms without going round them, as capes, ponchos and shawls do.

Nearest skin says nothing of how it moves: what lies on a hanging arm does not go up with it, it slides over it. So the
body itself raises and lowers its arms in small steps, and the cloth hangs over it in each (``cloth.hanging``). What
lies over spread arms is its rest; the others are its shapes (``mantle_shapes``). Trunk and arm carry it by shares with
which skinning of the rest comes nearest to them all.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.cloth.hanging import HangingCloth, HoldingSkin
from drape.garment.avatars import Avatar
from drape.garment.mantle_shapes import DIRECTIONS, SPREAD, pose_of
from drape.garment.rest_pose import (
    WEIGHT_SMOOTHING_M,
    MovedGarment,
    bone_motions,
    moved_with_skin,
    smoother,
    surface_weights,
)
from drape.garment.skin import trunk_and_arm_kernels
from drape.geometry import mesh_graphs
from drape.geometry.rotations import matrix_to_rotvec
from drape.geometry.skinning import skin_points
from drape.geometry.symmetric import symmetric_factor

STEP_RAD, STEPS, LAST_STEPS = 0.17, 15, 50  # most that a joint turns at once; steps of the cloth after it
HOLDING = [JOINT_NAMES.index(name) for name in ("spine3", "neck", "head")]
SHARE_STIFFNESS_M2 = 0.01  # smoothness of arm shares: cost of a share's change along an edge
LEAST_M2 = 1e-4


def spread(vertices: np.ndarray, faces: np.ndarray, avatar: Avatar, body: BodyModel) -> MovedGarment:
    """Returns a mantle moved to the standard body in T-pose [m], with its shapes over arms in other directions and its
    arm shares. ``vertices`` [m] (V, 3) and ``faces`` (F, 3) lie on ``avatar``."""
    pose, lay = np.zeros((JOINT_COUNT, 3)), vertices
    if avatar.moved:
        pose = _pose_of(bone_motions(avatar.vertices, body.v_template, body.weights)[0])
        skin = body.posed_vertices(pose[None])[0]
        lay = moved_with_skin(vertices, faces, surface_weights(vertices, avatar), avatar, body, skin)
    cloth, known = HangingCloth(lay, faces), [(pose, lay)]
    poses = [pose_of(direction) for direction in DIRECTIONS]
    if not avatar.moved:
        known = [(poses[SPREAD], vertices)]
    shapes = []
    for end in poses:
        before, x = min(known, key=lambda one: float(np.abs(one[0] - end).max()))
        shapes.append(x if before is end else _led(cloth, x, body, before, end))
        known.append((end, shapes[-1]))
    rest, shaped = shapes[SPREAD], np.stack(shapes)
    return MovedGarment(rest, np.zeros(len(rest)), _arm_shares(rest, faces, body, np.stack(poses), shaped), lay, shaped)


def _pose_of(rotations: np.ndarray) -> np.ndarray:
    """The pose (24, 3) [rad] from which bones come to the T-pose by ``rotations`` (24, 3, 3)."""
    turned = np.swapaxes(rotations, -1, -2)
    above = np.concatenate([turned, np.eye(3)[None]])[list(PARENTS)]
    return np.asarray(matrix_to_rotvec(np.swapaxes(above, -1, -2) @ turned))


def _led(cloth: HangingCloth, x: np.ndarray, body: BodyModel, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The cloth at ``x`` [m] (V, 3) over ``body`` in the pose ``before`` (24, 3), led to the pose ``after``."""
    count = max(1, int(np.ceil(np.abs(after - before).max() / STEP_RAD)))
    firm, smooth = body.weights[:, HOLDING].sum(axis=1), smoother(x, cloth.faces, WEIGHT_SMOOTHING_M)
    skins = body.posed_vertices(np.linspace(before, after, count + 1))
    for number in range(1, count + 1):
        near = KDTree(skins[number - 1]).query(x)[1]
        x = x + smooth((skins[number] - skins[number - 1])[near])
        x = cloth.hang(x, HoldingSkin(skins[number], body.faces, firm), STEPS if number < count else LAST_STEPS)
    return x


def _arm_shares(
    rest: np.ndarray, faces: np.ndarray, body: BodyModel, poses: np.ndarray, frames: np.ndarray
) -> np.ndarray:
    """Shares (V,) of the arms by which ``rest`` [m] (V, 3) comes nearest to ``frames`` (P, V, 3) in ``poses``."""
    bones = body.bones(poses)
    trunk, arm = (skin_points(rest, kernel @ body.weights, *bones) for kernel in trunk_and_arm_kernels(rest, body))
    way, wanted = arm - trunk, frames - trunk
    square = (way**2).sum(axis=(0, 2)) / len(poses) + LEAST_M2
    laplacian = mesh_graphs.weighted_laplacian(mesh_graphs.adjacency(faces, len(rest)))
    system = scipy.sparse.diags(square) + SHARE_STIFFNESS_M2 * laplacian
    share = symmetric_factor(system).solve((way * wanted).sum(axis=(0, 2)) / len(poses))
    return np.clip(share, 0.0, 1.0)
