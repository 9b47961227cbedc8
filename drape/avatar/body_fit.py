"""The standard body laid on a character: each bone as long as its own, then drawn on to its surface.

First every bone of the body is moved and scaled on to the character's, and the skin follows by its weights.
Then the skin v is drawn to the nearest points p of the character's surface of the same part of the body that face the
same way, again and again (non-rigid ICP; Amberg et al. 2007, "Optimal step nonrigid ICP algorithms", CVPR), by

    minimise  sum_v t_v |v + d_v - p_v|^2 + s |L d|^2,

with trust t, the umbrella Laplacian L and a stiffness s that falls from round to round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from drape.avatar.parts import PARTS, faces_beside, parts_of, plain_part
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point, on_border
from drape.geometry.symmetric import symmetric_factor

STIFFNESS = (3e4, 1e4, 3e3, 1e3, 300.0, 100.0, 30.0, 10.0)
REACH_M = (0.25, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05)  # how far a point may be that draws, in those rounds
FACING = 0.4  # the least cosine between the normals of what draws and what is drawn
NECK = JOINT_NAMES.index("neck")
TRUST = {"neck": 0.5, "head": 0.0, "palm": 0.0, "sole": 0.3}  # hair, fingers and shoes are no body: they follow


@dataclass(frozen=True, eq=False)
class BodyFit:
    """``vertices`` [m] (Vb, 3) of the standard body on the character in T-pose, and its ``joints`` [m] (24, 3)."""

    vertices: np.ndarray
    joints: np.ndarray


def fit_to(pose: TPose, body: BodyModel) -> BodyFit:
    """``body`` on the character in ``pose``."""
    joints = target_joints(pose.joints, body.joints_template)
    vertices = _scaled(body, joints)
    own, theirs = parts_of(body.weights), parts_of(pose.weights)[pose.faces]
    normals = meshes.face_normals(pose.vertices, pose.faces)
    targets = {part: faces_beside(part, theirs) for part in PARTS}
    laplacian = mesh_graphs.umbrella_laplacian(body.faces, len(vertices))
    square = scipy.sparse.csr_matrix(laplacian.T @ laplacian)
    for stiffness, reach in zip(STIFFNESS, REACH_M, strict=True):
        near, trust = _drawn_to(vertices, own, body, pose, targets, normals, reach)
        system = scipy.sparse.diags(trust + 1e-5) + stiffness * square
        vertices = vertices + symmetric_factor(system).solve(trust[:, None] * (near - vertices))
    return BodyFit(vertices, joints)


def target_joints(found: np.ndarray, template: np.ndarray) -> np.ndarray:
    """The body's joints [m] (24, 3) on a character whose joints are ``found`` (24, 3), NaN where it has none.

    Rigs agree on hips, knees, ankles, shoulders, elbows, wrists and neck. The spine and the collars lie between them
    as those of ``template`` do: every rig has them elsewhere.
    """
    index = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    rows = {name: template[joint] for name, joint in index.items()}
    there = {name: found[joint] for name, joint in index.items() if np.isfinite(found[joint]).all()}
    hips, shoulders = (
        [0.5 * (side["left_" + name] + side["right_" + name]) for side in (rows, there)] for name in ("hip", "shoulder")
    )
    trunk = np.linalg.norm(shoulders[1] - hips[1]) / np.linalg.norm(shoulders[0] - hips[0])
    lean = shoulders[1] - hips[1] - trunk * (shoulders[0] - hips[0])
    joints = np.zeros((JOINT_COUNT, 3))
    for joint in range(JOINT_COUNT):
        way = template[joint] - hips[0]
        share = np.clip(way[1] / (shoulders[0] - hips[0])[1], 0.0, 1.2)
        joints[joint] = hips[1] + trunk * way + share * lean
    wide = abs(there["left_shoulder"][0] - there["right_shoulder"][0]) / abs(
        rows["left_shoulder"][0] - rows["right_shoulder"][0]
    )
    for side in ("left", "right"):
        joint = index[f"{side}_collar"]
        joints[joint, 0] = shoulders[1][0] + wide * (template[joint, 0] - shoulders[0][0])
    limbs = ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
    for name in ("neck", *(f"{side}_{limb}" for side in ("left", "right") for limb in limbs)):
        if name in there:
            joints[index[name]] = there[name]
    head = index["head"]  # rigs begin it anywhere between nape and ears: never so low that the chin lies on the chest
    joints[head] = joints[NECK] + trunk * (template[head] - template[NECK])
    joints[head, 1] = max(joints[head, 1], there.get("head", joints[head])[1])
    for side in ("left", "right"):
        fore = np.linalg.norm(there[f"{side}_wrist"] - there[f"{side}_elbow"])
        ours = np.linalg.norm(rows[f"{side}_wrist"] - rows[f"{side}_elbow"])
        hand, wrist = index[f"{side}_hand"], index[f"{side}_wrist"]
        joints[hand] = joints[wrist] + fore / ours * (template[hand] - template[wrist])
        if f"{side}_foot" not in there:
            foot, ankle = index[f"{side}_foot"], index[f"{side}_ankle"]
            joints[foot] = joints[ankle] + trunk * (template[foot] - template[ankle])
    return joints


def _scaled(body: BodyModel, joints: np.ndarray) -> np.ndarray:
    """The skin of ``body`` with each bone moved and scaled on to ``joints``."""
    rest, scales = body.joints_template, np.ones(JOINT_COUNT)
    trunk = np.linalg.norm(joints[NECK] - joints[0]) / np.linalg.norm(rest[NECK] - rest[0])
    moved = np.zeros_like(body.v_template)
    for joint, end in enumerate(BONE_ENDS):
        scales[joint] = scales[PARENTS[joint]] if PARENTS[joint] >= 0 else trunk
        if JOINT_NAMES[joint] in PARTS["trunk"] + PARTS["neck"] + PARTS["head"]:
            scales[joint] = trunk
        elif end >= 0:
            scales[joint] = np.linalg.norm(joints[end] - joints[joint]) / np.linalg.norm(rest[end] - rest[joint])
        moved += body.weights[:, joint, None] * (joints[joint] + scales[joint] * (body.v_template - rest[joint]))
    return moved


def _drawn_to(vertices, own, body, pose, targets, normals, reach):  # type: ignore[no-untyped-def]
    near, trust = vertices.copy(), np.zeros(len(vertices))
    facing = meshes.vertex_normals(vertices, body.faces)
    for number, (part, faces) in enumerate(targets.items()):
        rows, weight = np.flatnonzero(own == number), TRUST.get(plain_part(part), 1.0)
        if not len(rows) or len(faces) < 8 or weight == 0.0:
            continue
        found = closest_point(vertices[rows], pose.vertices, pose.faces[faces])
        agree = np.einsum("vc,vc->v", facing[rows], normals[faces][found.face]) > FACING
        close = found.distance < reach
        near[rows] = found.point
        trust[rows] = weight * (agree & close & ~on_border(found, pose.faces[faces]))
    return near, trust
