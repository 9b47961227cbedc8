"""A distance to a posed body that has no steps: tangent planes of its skin, blended.

``drape/engine/source/blended_planes.hpp`` has the formula, that of implicit moving least squares. Planes are those of
the body's vertices and of the middles of its edges. The plane of the nearest vertex (``drape.cloth.contact``) is a
distance that jumps where another one becomes the nearest.

Vertices are 12 to 20 mm apart. The planes of vertices alone stand off the faces that are seen by 0.4 mm (0.9 mm on
thighs) in the median and by 1.5 to 2.4 mm in one place of twenty; with the middles it is 0.2 to 0.3 and 0.9 mm.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.cloth.contact import BodyContact
from drape.engine.calls import call_with_scratch

REACH_M = 0.04  # points of the skin within this distance are blended
REACH_GAPS = 1.25  # or within so many times the distance at which contact begins, if that is more
BEHIND = -0.2  # a point beyond reach is inside if the way to it and the plane's normal have a smaller cosine
FAR_M = 0.02  # a point that has moved so far looks for the nearest skin again
TINY = 1e-12  # keeps the sum of two opposite normals from dividing by zero


class BlendedPlanes:
    """A plane of a posed body for each of a number of moving points, the vertices of a cloth for example. Call it with
    the points to get the planes.

    The blended distance of a point is the mean of its distances from the tangent planes of the skin near it, in which
    nearer skin weighs more. The point's plane gives this distance and its gradient there. A point with no skin within
    reach takes the tangent plane of the nearest skin if it lies behind that. Otherwise it takes a plane that it does
    not touch: beside hands and feet a plane from decimetres away cuts through free space. A point that touches nothing
    is looked at again only when it may have come nearer. The distance depends on where a point is and not on its way
    there: a line search needs one energy for one state.
    """

    def __init__(self, point: np.ndarray, normal: np.ndarray, point_count: int, gap_m: float) -> None:
        self._reach, self._gap = max(REACH_M, REACH_GAPS * gap_m), gap_m
        self._skin = np.ascontiguousarray(point, dtype=np.float64), np.ascontiguousarray(normal, dtype=np.float64)
        self._tree = KDTree(point)
        self._asked = np.full((point_count, 3), np.inf)  # where the nearest point of the skin was looked up
        self._free = np.zeros(point_count, dtype=bool)  # it touches nothing within FAR_M of there
        self._beyond = np.zeros(point_count, dtype=bool)  # no skin is within reach
        self._blended = np.full((point_count, 3), np.inf)  # where the blend was
        self._clear = np.zeros(point_count)  # how far from there it can touch nothing
        self._point, self._normal = np.zeros((point_count, 3)), np.zeros((point_count, 3))
        self._bend = np.zeros((point_count, 3, 3))

    @classmethod
    def of_body(cls, contact: BodyContact, posed: np.ndarray, point_count: int, gap_m: float) -> BlendedPlanes:
        """Returns the planes of the body with the vertices ``posed`` [m] (Vb, 3) for ``point_count`` points, which are
        given with each call. Only the vertices that take part in ``contact`` count, and the edges between them.
        ``gap_m`` [m] is the distance from the skin below which a point is in contact."""
        chosen = slice(None) if contact.vertices is None else contact.vertices
        normal = np.asarray(contact.normals(posed))
        middle, across = posed[contact.edges].mean(axis=1), normal[contact.edges].sum(axis=1)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), TINY)
        points, normals = np.concatenate([posed[chosen], middle]), np.concatenate([normal[chosen], across])
        return cls(points, normals, point_count, gap_m)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the planes under ``x`` [m] (V, 3): a point [m] and a normal of each, (V, 3), and the second
        derivatives [1/m] (V, 3, 3) of the distance.

        A normal is the gradient of the distance, not quite of unit length.
        """
        skin = *self._skin, len(self._skin[0]), self._reach, self._gap
        last = self._blended, self._clear, self._beyond
        call_with_scratch("blend", np.float64, x, len(x), *skin, *last, self._point, self._normal, self._bend)
        still = self._free & (np.linalg.norm(x - self._asked, axis=1) < FAR_M)
        asking = np.flatnonzero(self._beyond & ~still)
        if len(asking):
            away, found = self._tree.query(x[asking])
            point, normal = (rows[found] for rows in self._skin)
            behind = ((x[asking] - point) * normal).sum(axis=1) < BEHIND * away
            self._asked[asking], self._free[asking] = x[asking], ~behind & (away >= self._reach + FAR_M)
            self._normal[asking] = normal
            self._point[asking] = np.where(behind[:, None], point, x[asking] - (self._gap + FAR_M) * normal)
        return self._point.copy(), self._normal.copy(), self._bend.copy()


def blended_distance(
    points: np.ndarray, contact: BodyContact, body_vertices: np.ndarray, *, gap_m: float
) -> np.ndarray:
    """Returns the blended distances [m] (F, V) of ``points`` [m] (F, V, 3) from the posed bodies ``body_vertices`` [m]
    (F, Vb, 3), positive outside.

    They are exact within a contact layer of ``gap_m`` [m]; a point farther outside has some distance past the gap.
    """
    distances = np.empty(points.shape[:2])
    for frame, posed in enumerate(body_vertices):
        x = np.ascontiguousarray(points[frame], dtype=np.float64)
        point, normal, _ = BlendedPlanes.of_body(contact, posed, len(x), gap_m)(x)
        distances[frame] = ((x - point) * normal).sum(axis=1)
    return distances
