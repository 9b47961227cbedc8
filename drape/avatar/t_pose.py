"""A character in the T-pose of the standard body: its surface, its joints, and which joints move each vertex.

The alignment A of ``drape.motion.alignment`` brings the T-pose onto the character's rest pose, joint by joint. Its
inverse moves the surface: with p the joints at rest and p' those of the T-pose, a vertex x with the joints' weights w
goes to sum_j w_j (A_j^T (x - p_j) + p'_j).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse

from drape.avatar.character import Character
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.garment.registration import UNIT_SCALES
from drape.motion.rig_poses import Rig

HEIGHTS_M = (1.0, 2.3)  # Characters of these heights are taken as they are.
ADULT_HEIGHT_M = 1.7  # A character that is no person's height in any unit is made as high as this.


@dataclass(frozen=True, eq=False)
class TPose:
    """A character in T-pose, y up, facing +z, its pelvis at x = z = 0 and the lowest point of its skin at y = 0.

    Its surface has ``vertices`` [m] (V, 3), ``faces`` (F, 3) and ``weights`` (V, 24) on SMPL's joints. ``joints`` [m]
    (24, 3) are NaN where the character has none. ``scale``: metres per unit of its file. ``height_m``: that of its
    skinned surface.
    """

    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    joints: np.ndarray
    scale: float
    height_m: float

    def only(self, chosen: np.ndarray) -> TPose:
        """Returns the pose with the faces ``chosen`` (F,) bool alone; it keeps all vertices."""
        return replace(self, faces=self.faces[chosen])


def to_t_pose(character: Character, rig: Rig) -> TPose:
    """Returns ``character`` in T-pose. ``rig`` says which of its nodes are its joints."""
    undone = np.swapaxes(rig.alignment, -1, -2)
    number = {rig.sources[name]: joint for joint, name in enumerate(JOINT_NAMES) if name in rig.sources}
    owner = np.zeros(len(character.names), dtype=np.int64)
    for node, parent in enumerate(character.parents):
        owner[node] = number.get(node, owner[parent] if parent >= 0 else 0)
    onto = scipy.sparse.csr_matrix((np.ones(len(owner)), (np.arange(len(owner)), owner)), (len(owner), JOINT_COUNT))
    weights = scipy.sparse.csr_matrix(character.weights @ onto).toarray()
    rest, placed = _joints(character, rig, undone)
    moves = placed - np.einsum("jab,jb->ja", undone, rest)
    moved = np.einsum("vj,jab,vb->va", weights, undone, character.vertices, optimize=True) + weights @ moves
    known = np.array([name in rig.sources for name in JOINT_NAMES])
    own = _measured(character, moved, placed[known])
    height = max(float(np.ptp(moved[own, 1])), 1e-9)
    fitting = [scale for scale in UNIT_SCALES if HEIGHTS_M[0] <= height * scale <= HEIGHTS_M[1]]
    scale = fitting[0] if fitting else ADULT_HEIGHT_M / height
    floor = np.array([0.0, scale * moved[own, 1].min(), 0.0])
    placed = np.where(known[:, None], scale * placed - floor, np.nan)
    return TPose(scale * moved - floor, character.faces, weights, placed, scale, scale * height)


def _measured(character: Character, moved: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The rows (n,) of the ``moved`` vertices that tell a height: those that are skinned, without hats and the like;
    all where these do not reach from the lowest of the ``joints`` to the highest, as of a robot of plates."""
    own = np.arange(len(moved))
    if character.hung is None or not character.hung.any():
        return own
    skinned = np.setdiff1d(own, character.faces[character.hung])
    height, ends = moved[skinned, 1], (joints[:, 1].min(), joints[:, 1].max())
    return skinned if len(skinned) and height.min() < ends[0] and height.max() > ends[1] else own


def _joints(character: Character, rig: Rig, undone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The joints (24, 3) at rest and in T-pose, in the file's unit; one that is missing lies on its parent."""
    rest, placed = np.zeros((JOINT_COUNT, 3)), np.zeros((JOINT_COUNT, 3))
    for joint, name in enumerate(JOINT_NAMES):
        parent = PARENTS[joint]
        rest[joint] = character.places[rig.sources[name]] if name in rig.sources else rest[parent]
        if parent >= 0:
            placed[joint] = placed[parent] + undone[parent] @ (rest[joint] - rest[parent])
    return rest, placed
