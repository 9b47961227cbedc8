"""Skin that shows through cloth, counted in pictures: what a viewer sees, where other measures count triangles.

A body and a garment are drawn from four sides. A pixel shows skin where the body is nearest, on a face that the rest
pose covers, and cloth lies less than 3 cm behind it. Pictures of the rest pose from eight sides tell which faces it
covers: those that always have cloth before them, and lie 3 cm from bare ones, because a hem may move so far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from drape.geometry.raster import ZBuffer, z_buffer

PIXEL_M = 0.003
VIEWS_DEG, REST_VIEWS_DEG = (0.0, 90.0, 180.0, 270.0), tuple(45.0 * view for view in range(8))
HEM_M, BEHIND_M = 0.03, 0.03
MARGIN_M = 0.1  # around the body: cloth stands off it


@dataclass(frozen=True, eq=False)
class Camera:
    """A picture that holds a body, of ``size`` (height, width) in pixels, around ``centre`` [m] (3,)."""

    size: tuple[int, int]
    centre: np.ndarray

    @classmethod
    def around(cls, vertices: np.ndarray) -> Camera:
        """The picture of ``vertices`` [m] (V, 3), from whatever side."""
        low, high = vertices.min(axis=0) - MARGIN_M, vertices.max(axis=0) + MARGIN_M
        side = float(np.linalg.norm((high - low)[[0, 2]]))
        height = float(high[1] - low[1]) + 0.15 * side  # the view looks down a little
        return cls((int(np.ceil(height / PIXEL_M)), int(np.ceil(side / PIXEL_M))), 0.5 * (low + high))

    def see(self, vertices: np.ndarray, faces: np.ndarray, azimuth_deg: float) -> ZBuffer:
        """The nearest face in every pixel of a mesh [m] (V, 3), (F, 3), and its depth."""
        extent_m = self.size[0] * PIXEL_M
        return z_buffer(vertices, faces, size=self.size, azimuth_deg=azimuth_deg, centre=self.centre, extent_m=extent_m)


def covered_faces(
    body_vertices: np.ndarray, body_faces: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Which ``body_faces`` (Fb,) the garment ``vertices`` [m] (V, 3), ``faces`` (F, 3) covers at rest, off its hems."""
    camera = Camera.around(body_vertices)
    hidden, bare = np.zeros(len(body_faces), bool), np.zeros(len(body_faces), bool)
    for azimuth_deg in REST_VIEWS_DEG:
        skin, cloth = (camera.see(*mesh, azimuth_deg) for mesh in ((body_vertices, body_faces), (vertices, faces)))
        behind = cloth.depth > skin.depth
        hidden[skin.face[behind & (skin.face >= 0)]] = True
        bare[skin.face[~behind & (skin.face >= 0)]] = True
    centre = body_vertices[body_faces].mean(axis=1)
    near_bare = KDTree(centre[bare]).query(centre)[0] < HEM_M if bare.any() else np.zeros(len(centre), bool)
    return hidden & ~bare & ~near_bare


@dataclass(frozen=True, eq=False)
class PosedBody:
    """A body that garments are looked at on: ``vertices`` [m] (Vb, 3), ``faces`` (Fb, 3), and what is seen of it."""

    vertices: np.ndarray
    faces: np.ndarray
    camera: Camera
    views: tuple[ZBuffer, ...]

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> PosedBody:
        """The body and its pictures, which all garments share."""
        camera = Camera.around(vertices)
        return cls(
            vertices, faces, camera, tuple(camera.see(vertices, faces, azimuth_deg) for azimuth_deg in VIEWS_DEG)
        )


def skin_pixels_pct(body: PosedBody, covered: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Share [%] (4,) of skin in the pixels of the cloth ``vertices`` [m] (V, 3), ``faces`` (F, 3), from four sides.

    ``covered`` (Fb,): the body's faces of ``covered_faces``. The share is of the pixels that show cloth or such faces;
    those count that show such a face with cloth less than 3 cm behind. NaN where neither is seen.
    """
    found = []
    for skin, azimuth_deg in zip(body.views, VIEWS_DEG, strict=True):
        cloth = body.camera.see(vertices, faces, azimuth_deg)
        in_front = skin.depth > cloth.depth
        bare = in_front & (skin.face >= 0) & covered[np.maximum(skin.face, 0)]
        shown = bare & (cloth.depth > skin.depth - BEHIND_M)
        seen = np.count_nonzero(bare) + np.count_nonzero(~in_front & (cloth.face >= 0))
        found.append(100.0 * np.count_nonzero(shown) / seen if seen else np.nan)
    return np.array(found)
