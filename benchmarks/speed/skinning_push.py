"""The rival of the packed graph: linear blend skinning, then the nearest vertex of the posed body by a k-d tree."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.body.model import BodyModel
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.garment.cache import Garment
from drape.geometry import skinning

CLEARANCE_M = 0.002


class Collider:
    """The surface of ``body`` in any pose and shape, which pushes vertices of garments out of it."""

    def __init__(self, body: BodyModel) -> None:
        self._body, self._contact = body, BodyContact.of_body(body)
        # 1.6 bones per vertex on average: the sparse product is ten times faster than the dense one.
        self._weights = scipy.sparse.csr_matrix(body.weights)
        self._weights.eliminate_zeros()

    def posed(self, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Returns the vertices [m] (F, Vb, 3) float32, relative to the root joint, of the body of shape ``betas`` (S,)
        at ``poses`` (F, 24, 3) [rad]."""
        root, rest = self._body.rest_joints(betas)[0], self._body.rest_vertices(betas)
        bones = zip(*self._body.bones(poses, None, betas), strict=True)
        posed = [skinning.skin_points(rest, self._weights, turn, shift - root) for turn, shift in bones]
        return np.stack(posed).astype(np.float32)

    def push(self, vertices: np.ndarray, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Returns ``vertices`` [m] (F, V, 3), relative to the root joint, moved in two passes to ``CLEARANCE_M`` from
        the body of shape ``betas`` (S,) at ``poses`` (F, 24, 3) [rad]; float32."""
        body_vertices, colliders = self.posed(poses, betas), self._contact.vertices
        normals = self._contact.normals(body_vertices)
        pushed = nearest_vertex_push(vertices, body_vertices, normals, CLEARANCE_M, colliders=colliders, passes=1)
        way = np.linalg.norm(pushed - vertices, axis=-1)
        # The second pass can only change what the first one moved: whatever stayed keeps its nearest vertex.
        for frame in range(len(vertices)):
            moved = np.flatnonzero(way[frame] > 0.0)
            if len(moved):
                at = slice(frame, frame + 1)
                pushed[frame, moved] = nearest_vertex_push(
                    pushed[at, moved], body_vertices[at], normals[at], CLEARANCE_M, colliders=colliders, passes=1
                )[0]
        return pushed.astype(np.float32)


class SkinningPush:
    """Linear blend skinning of the delivered vertices of ``garment`` on ``body`` of mean shape, and their push out of
    it, for one pose at a time."""

    def __init__(self, garment: Garment, body: BodyModel) -> None:
        self.body, self.collider = body, Collider(body)
        self.rest = garment.vertices[: garment.vertex_count].astype(np.float64)
        self.weights = scipy.sparse.csr_matrix(garment.skin_weights(body)[: garment.vertex_count].astype(np.float64))
        self.betas = np.zeros(body.shape_count)

    def skin(self, pose: np.ndarray) -> np.ndarray:
        """Returns the skinned vertices [m] (1, V, 3) float32, relative to the root joint, at ``pose`` (1, 24, 3)
        [rad]."""
        rotations, translations = self.body.bones(pose)
        translations = translations - self.body.joints_template[0]
        return skinning.skin_points(self.rest, self.weights, rotations[0], translations[0])[None].astype(np.float32)

    def push(self, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Returns ``vertices`` [m] (1, V, 3), relative to the root joint, pushed out of the body at ``pose`` (1, 24, 3)
        [rad]; float32."""
        return self.collider.push(vertices, pose, self.betas)
