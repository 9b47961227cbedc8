"""A skin brought out to all of a character that stands out of it, in its T-pose and where joints bend.

Garments lie on this skin, so nothing that is seen may stand out of it. In each of ``POSES`` some of the character's
vertices stand out of the posed skin. Those of the same part, or of one that joins it, that face the same way say by how
much the skin is short there. In rounds the skin goes out by that, smoothly, along its normal in T-pose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import cg

from drape.avatar.parts import PARTS, beside, counted_vertices, parts_of
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.forked import each
from drape.geometry import mesh_graphs, meshes, rigid, skinning
from drape.geometry.closest import closest_point
from drape.geometry.rotations import rotvec_to_matrix

ROUNDS, MOST_M, MARGIN_M = 3, 0.03, 0.001  # A round brings the skin out by ``MOST_M`` at most, and by a margin more.
FACING = 0.4  # What stands out counts if the cosine between its normal and the skin's is larger.
SMOOTHING, PLAIN = 0.5, 0.05  # The stiffness of the way out, and how much skin that is not short resists it.
REST: dict[str, tuple[float, float, float]] = {}
ARMS_DOWN = {"left_shoulder": (0, 0, -70), "right_shoulder": (0, 0, 70)}
SQUAT = {
    **ARMS_DOWN, "left_hip": (-95, 0, 8), "right_hip": (-95, 0, -8), "left_knee": (105, 0, 0),
    "right_knee": (105, 0, 0), "spine1": (20, 0, 0),
}  # fmt: skip
STRIDE = {
    "left_shoulder": (0, 30, -60), "right_shoulder": (0, 30, 60), "left_elbow": (0, -60, 0), "right_elbow": (0, 60, 0),
    "left_hip": (-40, 0, 0), "right_hip": (25, 0, 0), "right_knee": (45, 0, 0),
}  # fmt: skip
REACH = {"left_shoulder": (0, -80, 0), "right_shoulder": (0, 80, 0)}
POSES = (REST, ARMS_DOWN, SQUAT, STRIDE, REACH)


def covering(vertices: np.ndarray, weights: np.ndarray, joints: np.ndarray, pose: TPose, body: BodyModel) -> np.ndarray:
    """Returns the ``vertices`` [m] (Vb, 3) of a skin, moved out along its normals by how far the character in ``pose``
    stands out of it, in the T-pose and in the other ``POSES``, in ``ROUNDS`` rounds. Heads, hands and feet do not
    count.

    The skin has the faces of ``body``, and ``weights`` (Vb, 24) on ``joints`` [m] (24, 3), in the frame of ``pose``.
    """
    counted, own, theirs = counted_vertices(pose), parts_of(body.weights), parts_of(pose.weights)
    umbrella = mesh_graphs.umbrella_laplacian(body.faces, len(vertices))
    square = scipy.sparse.csr_matrix(SMOOTHING * (umbrella.T @ umbrella))
    faces = body.faces[(own != list(PARTS).index("head"))[body.faces].any(axis=1)]  # No part that counts joins a head.
    turned = [rotvec_to_matrix(rotvecs(one))[None] for one in POSES]
    bones = [rigid.bone_transforms(one, joints[None], PARENTS) for one in turned]
    posed = [skinning.skin_points(pose.vertices[None], pose.weights, *one)[0] for one in bones]
    around = meshes.face_table(pose.faces, len(pose.vertices))
    theirs_out = [meshes.vertex_normals(seen, pose.faces, table=around)[counted] for seen in posed]
    around = meshes.face_table(body.faces, len(vertices))

    def short(number: int) -> np.ndarray:
        """How much [m] (Vb,) the skin is short in the pose of this ``number``."""
        skin, height = skinning.skin_points(vertices[None], weights, *bones[number])[0], np.zeros(len(vertices))
        nearest = closest_point(posed[number][counted], skin, faces)
        corners = faces[nearest.face]
        normals = meshes.vertex_normals(skin, body.faces, table=around)
        facing = np.einsum("vk,vkc->vc", nearest.barycentric, normals[corners])
        above = np.einsum("vc,vc->v", facing, posed[number][counted] - nearest.point)
        agree = np.einsum("vc,vc->v", facing, theirs_out[number]) > FACING
        joined = beside(own[corners[:, 0]], theirs[counted])
        lacking = np.where(agree & joined & (above > 0.0), above + MARGIN_M, 0.0)
        np.maximum.at(height, corners.reshape(-1), np.repeat(np.minimum(lacking, MOST_M), 3))
        return height

    for _ in range(ROUNDS):
        height = np.max(each(short, range(len(POSES))), axis=0)
        trust = np.where(height > 0.0, 1.0, PLAIN)
        # No skin is free, so the system is well conditioned: some forty products solve it without a factor.
        way, _ = cg(scipy.sparse.diags(trust) + square, trust * height, rtol=1e-7)
        vertices = vertices + way[:, None] * meshes.vertex_normals(vertices, body.faces, table=around)
    return vertices


def rotvecs(angles_deg: Mapping[str, tuple[float, float, float]]) -> np.ndarray:
    """Returns the pose, rotation vectors [rad] (24, 3), whose joints have the rotation vectors ``angles_deg`` [degrees]
    by their names. The other joints do not turn."""
    found = np.zeros((JOINT_COUNT, 3))
    for name, angles in angles_deg.items():
        found[JOINT_NAMES.index(name)] = np.radians(angles)
    return found
