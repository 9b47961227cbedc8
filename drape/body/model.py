"""The body: shape and pose -> joints, bone transforms and skinned vertices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, PARENTS
from drape.errors import BodyError, MotionError
from drape.geometry import meshes, rigid, skinning
from drape.geometry.rotations import rotvec_to_matrix


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body of SMPL's schema in its rest T-pose; lengths in metres, y up, facing +z.

    ``v_template`` (V, 3) is its mean shape, and ``shapedirs`` (V, 3, S) are the displacements of each shape
    coefficient. ``regressor`` (24, V), sparse, makes joints of vertices. ``weights`` (V, 24) are skinning weights,
    whose rows sum to one, ``faces`` is (F, 3), and ``posedirs`` (V, 3, 207) or None. ``digest`` is the sha256 of the
    file it came from. A body that was laid on a character has the ``standard_digest`` of the one that it was made of,
    whose topology it has.
    """

    name: str
    digest: str
    v_template: np.ndarray
    shapedirs: np.ndarray
    regressor: scipy.sparse.csr_matrix
    weights: np.ndarray
    faces: np.ndarray
    posedirs: np.ndarray | None = None
    standard_digest: str = ""

    @property
    def vertex_count(self) -> int:
        return len(self.v_template)

    @property
    def shape_count(self) -> int:
        return self.shapedirs.shape[2]

    @cached_property
    def face_table(self) -> np.ndarray:
        """The indices (V, D) of the faces around every vertex, padded as ``meshes.face_table`` does."""
        return meshes.face_table(self.faces, self.vertex_count)

    @cached_property
    def joints_template(self) -> np.ndarray:
        """The rest joints [m] (24, 3) of the mean shape."""
        return self.regressor @ self.v_template

    @cached_property
    def joint_shapedirs(self) -> np.ndarray:
        """The displacements (24, 3, S) [m] of the rest joints by each shape coefficient."""
        flat = self.shapedirs.reshape(self.vertex_count, -1)
        return (self.regressor @ flat).reshape(JOINT_COUNT, 3, self.shape_count)

    @cached_property
    def bone_directions(self) -> np.ndarray:
        """The unit directions (24, 3) of the joints' bones in the rest pose; leaves have their parent's."""
        joints = self.joints_template
        directions = np.zeros((JOINT_COUNT, 3))
        for joint, end in enumerate(BONE_ENDS):
            if end >= 0:
                difference = joints[end] - joints[joint]
                directions[joint] = difference / np.linalg.norm(difference)
            else:
                directions[joint] = directions[PARENTS[joint]]
        return directions

    def check_betas(self, betas: np.ndarray) -> np.ndarray:
        """Returns ``betas`` as float64 (S,), padded with zeros. Raises ``BodyError`` for NaN and for more entries than
        the body has."""
        betas = np.asarray(betas, dtype=np.float64)
        if betas.ndim != 1 or len(betas) > self.shape_count:
            raise BodyError(
                "betas",
                expected=f"at most {self.shape_count} numbers",
                got=f"shape {betas.shape}",
                cure="Drop the entries this body does not have.",
            )
        check_finite("betas", betas, error=BodyError)
        return np.concatenate([betas, np.zeros(self.shape_count - len(betas))])

    def rest_vertices(self, betas: np.ndarray | None = None) -> np.ndarray:
        """Returns the rest vertices [m] (V, 3) of the shape ``betas``, the mean shape by default."""
        if betas is None:
            return self.v_template
        return self.v_template + self.shapedirs @ self.check_betas(betas)

    def floor_m(self, betas: np.ndarray | None = None) -> float:
        """Returns the height [m] of the soles at rest, the least y of the shape ``betas``."""
        return float(self.rest_vertices(betas)[:, 1].min())

    def rest_joints(self, betas: np.ndarray | None = None) -> np.ndarray:
        """Returns the rest joints [m] (24, 3) of the shape ``betas`` (S,), the mean shape by default, or (F, 24, 3) of
        shapes (F, S)."""
        if betas is None:
            return self.joints_template
        if np.ndim(betas) == 2:
            check_shape("betas", betas, (None, self.shape_count), error=BodyError)
            return self.joints_template + np.einsum("jcs,fs->fjc", self.joint_shapedirs, betas)
        return self.joints_template + self.joint_shapedirs @ self.check_betas(betas)

    def bones(
        self, poses: np.ndarray, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns the transforms of the bones from the rest pose to the world: rotations (F, 24, 3, 3), and
        translations [m] (F, 24, 3).

        ``poses`` (F, 24, 3) are rotation vectors [rad] relative to the parent, and ``trans`` [m] (F, 3) displaces the
        root. Raises ``MotionError`` for arrays of other shapes or with NaN.
        """
        poses = np.asarray(poses, dtype=np.float64)
        check_shape("poses", poses, (None, JOINT_COUNT, 3), error=MotionError)
        check_finite("poses", poses, error=MotionError)
        joints = np.broadcast_to(self.rest_joints(betas), (len(poses), JOINT_COUNT, 3))
        rotations, translations = rigid.bone_transforms(rotvec_to_matrix(poses), joints, PARENTS)
        if trans is not None:
            trans = np.asarray(trans, dtype=np.float64)
            check_shape("trans", trans, (len(poses), 3), error=MotionError)
            check_finite("trans", trans, error=MotionError)
            translations = translations + trans[:, None, :]
        return rotations, translations

    def posed_joints(self, poses: np.ndarray, betas: np.ndarray | None = None) -> np.ndarray:
        """Returns the joints [m] (F, 24, 3) in ``poses`` (F, 24, 3) [rad] of the shape ``betas`` (S,), or of shapes
        (F, S). The root is not displaced."""
        rotations, translations = self.bones(poses, None, betas)
        return (rotations @ self.rest_joints(betas)[..., None])[..., 0] + translations

    def posed_vertices(
        self, poses: np.ndarray, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) in the world, in ``poses`` (F, 24, 3) [rad] with the root displaced by
        ``trans`` [m] (F, 3): by linear blend skinning, and by pose blend shapes where the body has them."""
        rotations, translations = self.bones(poses, trans, betas)
        rest = np.broadcast_to(self.rest_vertices(betas), (len(rotations), self.vertex_count, 3))
        if self.posedirs is not None:
            local = rotvec_to_matrix(np.asarray(poses, dtype=np.float64))[:, 1:] - np.eye(3)
            rest = rest + np.einsum("vcp,fp->fvc", self.posedirs, local.reshape(len(local), self.posedirs.shape[2]))
        return skinning.skin_points(rest, self.weights, rotations, translations)
