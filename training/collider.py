"""The body as training collides with it: posed vertices and their normals."""

from __future__ import annotations

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.contact import DETAIL_JOINTS
from drape.geometry import meshes


class BodySurface:
    """The body's surface without head, hands and toes: C vertices, linearly skinned.

    Arrays within have coordinates first: products of few rows and many columns are nine times as fast as
    ``drape.geometry.skinning``.
    """

    def __init__(self, body: BodyModel) -> None:
        self.index, self.faces = _surface(body)
        count = len(self.index)
        self._rest = np.ascontiguousarray(body.v_template[self.index].T.astype(np.float32))  # (3, C)
        self._shapedirs = body.shapedirs[self.index].transpose(1, 0, 2).reshape(3 * count, -1).astype(np.float32)
        self._weights = np.ascontiguousarray(body.weights[self.index].T.astype(np.float32))  # (J, C)
        self._table = meshes.face_table(self.faces, count)

    def posed(self, rotations: np.ndarray, translations: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Vertices [m] (F, C, 3), float32, of bones (F, J, 3, 3) and (F, J, 3) [m] and shapes (F, S)."""
        stacked = np.concatenate([rotations, translations[..., None]], axis=-1).astype(np.float32)  # (F, J, 3, 4)
        out = np.empty((len(stacked), self._rest.shape[1], 3), dtype=np.float32)
        for frame, (bones, shape) in enumerate(zip(stacked, betas.astype(np.float32), strict=True)):
            blended = (bones.reshape(len(bones), 12).T @ self._weights).reshape(3, 4, -1)
            x, y, z = self._rest + (self._shapedirs @ shape).reshape(3, -1) if np.any(shape) else self._rest
            for axis, (by_x, by_y, by_z, moved) in enumerate(blended):
                out[frame, :, axis] = by_x * x + by_y * y + by_z * z + moved
        return out

    def normals(self, posed: np.ndarray) -> np.ndarray:
        """Area-weighted unit normals (F, C, 3) of ``posed`` (F, C, 3)."""
        return meshes.vertex_normals(posed, self.faces, table=self._table)


def _surface(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Body vertices (C,) that training collides with and their faces (T, 3): all but head, hands and toes."""
    kept = body.weights[:, DETAIL_JOINTS].sum(axis=1) <= 0.5
    return meshes.in_use(body.faces[kept[body.faces].all(axis=1)])
