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

from drape.avatar.parts import PARTS, faces_beside, parts_of, plain_part
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.forked import each
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import SearchedMesh, on_border
from drape.geometry.symmetric import ShiftedSystems

STIFFNESS = (3e4, 1e4, 3e3, 1e3, 300.0, 100.0, 30.0, 10.0)
REACH_M = (0.25, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05)  # A point draws the skin within this distance, round by round.
FACING = 0.4  # A point draws skin only if the cosine between their normals is larger.
FEW_FACES = 8  # A part of fewer faces draws nothing.
NECK, HEAD = JOINT_NAMES.index("neck"), JOINT_NAMES.index("head")
SHOULDERS, COLLARS, HANDS = (
    [JOINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right")] for joint in ("shoulder", "collar", "hand")
)
LIMB_JOINTS = tuple(
    [JOINT_NAMES.index(f"{side}_{joint}") for joint in limb]
    for side in ("left", "right")
    for limb in (("hip", "knee", "ankle", "foot"), ("shoulder", "elbow", "wrist", "hand"))
)
# Skin that nothing draws is held where it is by this trust: else a bent neck swung the head round behind it.
STILL = 0.001
# Hair, fingers and shoes are no body: there the skin follows the rest.
TRUST = {"neck": 0.5, "head": 0.0, "palm": 0.0, "sole": 0.3}


@dataclass(frozen=True, eq=False)
class BodyFit:
    """The standard body laid on a character in T-pose: its ``vertices`` [m] (Vb, 3) and its ``joints`` [m] (24, 3), in
    the frame of the character's ``TPose``."""

    vertices: np.ndarray
    joints: np.ndarray


def fit_to(pose: TPose, body: BodyModel) -> BodyFit:
    """Returns ``body`` laid on the character whose T-pose is ``pose``: its bones as long as the character's, its skin
    drawn to the character's surface."""
    joints = target_joints(pose.joints, body.joints_template)
    vertices = _scaled(body, joints)
    target = _Target(pose, body)
    umbrella = mesh_graphs.umbrella_laplacian(body.faces, len(vertices))
    systems = ShiftedSystems(umbrella.T @ umbrella)
    for stiffness, reach_m in zip(STIFFNESS, REACH_M, strict=True):
        near, trust = target.near(vertices, reach_m)
        vertices = vertices + systems.solve(trust + target.still, stiffness, trust[:, None] * (near - vertices))
    return BodyFit(vertices, joints)


class _Target:
    """The character's surface, in parts, to which the skin of ``body`` is drawn."""

    def __init__(self, pose: TPose, body: BodyModel) -> None:
        self._body, own = body, parts_of(body.weights)
        self._normals = meshes.face_normals(pose.vertices, pose.faces)
        corners = parts_of(pose.weights)[pose.faces]
        self._faces = [faces_beside(part, corners) for part in PARTS]
        self._weights = [TRUST.get(plain_part(part), 1.0) for part in PARTS]
        self._rows = [np.flatnonzero(own == part) for part in range(len(PARTS))]
        known = [part for part in range(len(PARTS)) if len(self._rows[part]) and self._weights[part] > 0.0]
        self.still = np.where(np.isin(own, known), 1e-5, STILL)
        self._parts = [part for part in known if len(self._faces[part]) >= FEW_FACES]
        self._surfaces = {part: SearchedMesh(pose.vertices, pose.faces[self._faces[part]]) for part in self._parts}

    def near(self, vertices: np.ndarray, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """The point [m] (Vb, 3) that draws each of the skin's ``vertices``, and the trust (Vb,) in it: 0 where none
        within ``reach_m`` faces the same way."""
        near, trust = vertices.copy(), np.zeros(len(vertices))
        facing = meshes.vertex_normals(vertices, self._body.faces)

        def drawn(part: int) -> tuple[np.ndarray, np.ndarray]:
            """Those of the vertices of this ``part``."""
            faces, rows = self._faces[part], self._rows[part]
            surface = self._surfaces[part]
            found = surface.closest(vertices[rows])
            agree = np.einsum("vc,vc->v", facing[rows], self._normals[faces][found.face]) > FACING
            drawing = agree & (found.distance < reach_m) & ~on_border(found, surface.faces)
            return found.point, self._weights[part] * drawing

        for part, (points, drawing) in zip(self._parts, each(drawn, self._parts), strict=True):
            near[self._rows[part]], trust[self._rows[part]] = points, drawing
        return near, trust


def target_joints(known: np.ndarray, template: np.ndarray) -> np.ndarray:
    """Returns where the body's joints [m] (24, 3) lie on a character whose joints are ``known`` [m] (24, 3), NaN where
    it has none, in the frame of these. ``template`` [m] (24, 3) are the body's own joints at rest.

    Rigs agree on hips, knees, ankles, shoulders, elbows, wrists and neck. The spine and the collars lie between them as
    in ``template``, because every rig has them elsewhere. A limb that ends early goes on in the scale of its last bone.
    """
    there: np.ndarray = np.asarray(np.isfinite(known).all(axis=1))
    hips, shoulders = (_middles(known, template, joint) for joint in ("hip", "shoulder"))
    size = float(np.linalg.norm(shoulders[1] - hips[1]) / np.linalg.norm(shoulders[0] - hips[0]))
    lean = shoulders[1] - hips[1] - size * (shoulders[0] - hips[0])
    share = np.clip((template - hips[0])[:, 1] / (shoulders[0] - hips[0])[1], 0.0, 1.2)
    joints = hips[1] + size * (template - hips[0]) + share[:, None] * lean
    wide = np.diff(known[SHOULDERS, 0]) / np.diff(template[SHOULDERS, 0])
    joints[COLLARS, 0] = shoulders[1][0] + wide * (template[COLLARS, 0] - shoulders[0][0])
    if there[NECK]:
        joints[NECK] = known[NECK]
    # Rigs begin the head anywhere between nape and ears: never so low that the chin lies on the chest.
    joints[HEAD] = joints[NECK] + size * (template[HEAD] - template[NECK])
    if there[HEAD]:
        joints[HEAD, 1] = max(joints[HEAD, 1], known[HEAD, 1])
    for limb in LIMB_JOINTS:
        scale = size
        for joint in limb:
            parent = PARENTS[joint]
            if there[joint] and joint not in HANDS:
                joints[joint] = known[joint]
                if parent in limb:
                    own = np.linalg.norm(template[joint] - template[parent])
                    scale = float(np.linalg.norm(joints[joint] - joints[parent]) / own)
            else:
                joints[joint] = joints[parent] + scale * (template[joint] - template[parent])
    return joints


def _middles(known: np.ndarray, template: np.ndarray, joint: str) -> list[np.ndarray]:
    """The point between the left and the right ``joint`` in ``template``, and in ``known``."""
    pair = [JOINT_NAMES.index(f"{side}_{joint}") for side in ("left", "right")]
    return [rows[pair].mean(axis=0) for rows in (template, known)]


def _scaled(body: BodyModel, joints: np.ndarray) -> np.ndarray:
    """The skin of ``body`` with each bone moved and scaled on to ``joints``."""
    rest, scales = body.joints_template, np.ones(JOINT_COUNT)
    size = np.linalg.norm(joints[NECK] - joints[0]) / np.linalg.norm(rest[NECK] - rest[0])
    moved = np.zeros_like(body.v_template)
    for joint, end in enumerate(BONE_ENDS):
        scales[joint] = scales[PARENTS[joint]] if PARENTS[joint] >= 0 else size
        if JOINT_NAMES[joint] in PARTS["trunk"] + PARTS["neck"] + PARTS["head"]:
            scales[joint] = size
        elif end >= 0:
            scales[joint] = np.linalg.norm(joints[end] - joints[joint]) / np.linalg.norm(rest[end] - rest[joint])
        moved += body.weights[:, joint, None] * (joints[joint] + scales[joint] * (body.v_template - rest[joint]))
    return moved
