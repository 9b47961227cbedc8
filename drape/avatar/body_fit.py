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
import scipy.sparse.linalg

from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point, on_border

STIFFNESS = (3e4, 1e4, 3e3, 1e3, 300.0, 100.0, 30.0, 10.0)
REACH_M = (0.25, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05)  # how far a point may be that draws, in those rounds
FACING = 0.4  # the least cosine between the normals of what draws and what is drawn
COVER_ROUNDS, COVER_M = 4, 0.03  # rounds that bring the skin out to what stands out of it, by this at most in each
PARTS = {
    "trunk": ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar"),
    "neck": ("neck",),
    "head": ("head",),
    **{f"{side}_{part}": tuple(f"{side}_{joint}" for joint in joints)
       for side in ("left", "right") for part, joints in (("upper_arm", ("shoulder",)), ("forearm", ("elbow",)),
       ("palm", ("wrist", "hand")), ("thigh", ("hip",)), ("shin", ("knee",)), ("sole", ("ankle", "foot")))},
}  # fmt: skip
NECK = JOINT_NAMES.index("neck")
CHAINS = (("upper_arm", "forearm", "palm"), ("thigh", "shin", "sole"))
TRUST = {"neck": 0.5, "head": 0.0, "palm": 0.0, "sole": 0.3}  # hair, fingers and shoes are no body: they follow
LIMBS = ("trunk", "upper_arm", "forearm", "thigh", "shin")  # where the fit is measured: what garments lie on


@dataclass(frozen=True, eq=False)
class BodyFit:
    """``vertices`` [m] (Vb, 3) of the standard body on the character in T-pose, its ``joints`` [m] (24, 3), and how far
    the character's trunk and limbs are from it [mm]: median and 95th percentile."""

    vertices: np.ndarray
    joints: np.ndarray
    median_mm: float
    p95_mm: float


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
        vertices = vertices + _factor(system).solve(trust[:, None] * (near - vertices))
    counted = _measured(pose)
    for _ in range(COVER_ROUNDS):
        vertices = _covering(vertices, body, pose, counted, square)
    distance = 1e3 * closest_point(pose.vertices[counted], vertices, body.faces).distance
    return BodyFit(vertices, joints, float(np.median(distance)), float(np.quantile(distance, 0.95)))


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


def parts_of(weights: np.ndarray) -> np.ndarray:
    """Which of ``PARTS`` each row of ``weights`` (V, 24) belongs to most."""
    index = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    return np.argmax([weights[:, [index[name] for name in names]].sum(axis=1) for names in PARTS.values()], axis=0)


def _plain(part: str) -> str:
    return part.removeprefix("left_").removeprefix("right_")


def _beside(part: str) -> set[str]:
    """``part`` and those that join it."""
    found, plain = {part}, _plain(part)
    side = part.removesuffix(plain)
    for chain in CHAINS:
        if plain in chain:
            place = chain.index(plain)
            found |= {side + other for other in chain[max(0, place - 1) : place + 2]}
            found |= {"trunk"} if place == 0 else set()
    if part in ("trunk", "neck", "head"):
        found |= {"neck"} | {"trunk": {f"{s}_{chain[0]}" for s in ("left", "right") for chain in CHAINS}}.get(
            part, set()
        )
        found |= {"trunk", "head"} if part == "neck" else set()
    return found


def faces_beside(part: str, corners: np.ndarray) -> np.ndarray:
    """The character's faces (n,) of ``part`` and of those that join it; ``corners`` (F, 3) are the corners' parts."""
    names = list(PARTS)
    return np.flatnonzero(np.isin(corners, [names.index(one) for one in _beside(part)]).all(axis=1))


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
        rows, weight = np.flatnonzero(own == number), TRUST.get(_plain(part), 1.0)
        if not len(rows) or len(faces) < 8 or weight == 0.0:
            continue
        found = closest_point(vertices[rows], pose.vertices, pose.faces[faces])
        agree = np.einsum("vc,vc->v", facing[rows], normals[faces][found.face]) > FACING
        close = found.distance < reach
        near[rows] = found.point
        trust[rows] = weight * (agree & close & ~on_border(found, pose.faces[faces]))
    return near, trust


def _factor(system: scipy.sparse.spmatrix) -> scipy.sparse.linalg.SuperLU:
    """The factor of a symmetric positive matrix, ordered as such: a third of the time."""
    options = {"SymmetricMode": True}
    csc = scipy.sparse.csc_matrix(system)
    return scipy.sparse.linalg.splu(csc, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _measured(pose: TPose) -> np.ndarray:
    """The character's vertices (n,) of trunk and limbs."""
    wanted = [number for number, part in enumerate(PARTS) if _plain(part) in LIMBS]
    return np.intersect1d(np.flatnonzero(np.isin(parts_of(pose.weights), wanted)), pose.faces)


def _covering(
    vertices: np.ndarray, body: BodyModel, pose: TPose, counted: np.ndarray, square: scipy.sparse.csr_matrix
) -> np.ndarray:
    """``vertices`` brought out to those of the character, ``counted``, that stand out of them and face the same way:
    what garments lie on must hold everything that is seen."""
    found = closest_point(pose.vertices[counted], vertices, body.faces)
    skin, theirs = meshes.vertex_normals(vertices, body.faces), meshes.vertex_normals(pose.vertices, pose.faces)
    corners = body.faces[found.face]
    facing = np.einsum("vk,vkc->vc", found.barycentric, skin[corners])
    above = np.einsum("vc,vc->v", facing, pose.vertices[counted] - found.point)
    agree = np.einsum("vc,vc->v", facing, theirs[counted]) > FACING
    out = np.where(agree & (parts_of(body.weights)[corners[:, 0]] == parts_of(pose.weights)[counted]), above, 0.0)
    height = np.zeros(len(vertices))
    np.maximum.at(height, corners.reshape(-1), np.repeat(np.clip(out, 0.0, COVER_M), 3))
    trust = np.where(height > 0.0, 1.0, 0.05)
    system = scipy.sparse.diags(trust) + 0.5 * square
    return vertices + _factor(system).solve(trust * height)[:, None] * skin
