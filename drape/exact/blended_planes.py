"""A distance to a posed body that has no steps: tangent planes of its skin, blended.

    d(x) = sum w_i n_i . (x - b_i) / sum w_i,   w_i = exp(-|x - b_i|^2 / h^2)

over points b_i of the skin with normals n_i, the body's vertices and the middles of its edges: implicit moving least
squares (Kolluri 2008, "Provably good moving least squares", ACM Trans. Algorithms 4(2)). As h falls it comes near to
the plane of the nearest point (``drape.cloth.contact`` has that of the nearest vertex), a distance that jumps where
another one becomes the nearest.

Vertices are 12 to 20 mm apart. The planes of vertices alone stand off the faces that are seen by 0.4 mm (0.9 mm on
thighs) in the median and by 1.5 to 2.4 mm in one place of twenty; with the middles it is 0.2 to 0.3 and 0.9 mm.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from drape.cloth.contact import BodyContact
from drape.kernels.compiled import kernel
from drape.kernels.elements import add, at, sub
from drape.kernels.grid import cells_within, column, grid_of

WIDTH_M = 0.006  # h
FADED = 14.0  # exponent at which a weight counts as none: 1e-6 of the nearest one's
REACH_M = 0.04  # points of the skin farther away are not blended, unless contact reaches nearly as far
REACH_GAPS = 1.25  # then so many times as far as contact
BEHIND = -0.2  # cosine between a plane's normal and the way to a point beyond reach, below which that is inside
CLEAR_M = 0.005  # the most that a point which does not touch moves before it is looked at again
FAR_M = 0.02  # a point asks for what is nearest again when it has moved by so much
TINY = 1e-12  # the length of a normal that is none


class BlendedPlanes:
    """Planes under moving points. At its point a plane has the blended distance and its gradient.

    A point with no skin within reach takes the plane of what is nearest if it lies behind it. Otherwise it takes a
    plane that it does not touch: beside hands and feet a plane from decimetres away cuts through free space. A point
    farther from the body than ``gap_m`` is looked at again only when it may have come nearer. The distance of a point
    depends on its place and not on its way: a line search needs one energy for one place.
    """

    def __init__(self, point: np.ndarray, normal: np.ndarray, point_count: int, gap_m: float) -> None:
        self._reach, self._gap = max(REACH_M, REACH_GAPS * gap_m), gap_m
        self._skin = np.ascontiguousarray(point, dtype=np.float64), np.ascontiguousarray(normal, dtype=np.float64)
        self._grid, self._tree = grid_of(self._skin[0], 1.0 / self._reach), KDTree(point)
        self._asked = np.full((point_count, 3), np.inf)  # where the nearest point of the skin was looked up
        self._free = np.zeros(point_count, dtype=bool)  # so far outside there that nothing is touched within FAR_M
        self._beyond = np.zeros(point_count, dtype=bool)  # no skin is within reach
        self._blended = np.full((point_count, 3), np.inf)  # where the blend was
        self._clear = np.zeros(point_count)  # how far from there it cannot touch
        self._point, self._normal = np.zeros((point_count, 3)), np.zeros((point_count, 3))
        self._bend = np.zeros((point_count, 3, 3))

    @classmethod
    def of_body(cls, contact: BodyContact, posed: np.ndarray, point_count: int, gap_m: float) -> BlendedPlanes:
        """Those of the skin of the posed body (Vb, 3) [m] that takes part in ``contact``."""
        chosen = slice(None) if contact.vertices is None else contact.vertices
        normal = np.asarray(contact.normals(posed))
        middle, across = posed[contact.edges].mean(axis=1), normal[contact.edges].sum(axis=1)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), TINY)
        points, normals = np.concatenate([posed[chosen], middle]), np.concatenate([normal[chosen], across])
        return cls(points, normals, point_count, gap_m)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point [m], normal (V, 3) and second derivatives [1/m] (V, 3, 3) under ``x`` [m] (V, 3).

        A normal is the gradient of the distance, not quite of unit length.
        """
        planes = self._point, self._normal, self._bend
        blend(x, self._skin, self._grid, (self._reach, self._gap), (self._blended, self._clear, self._beyond), planes)
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
    """Blended distances [m] (F, V) of ``points`` (F, V, 3) to the posed bodies ``body_vertices`` (F, Vb, 3).

    They serve a contact layer of ``gap_m``: a point outside and beyond reach has some distance past the gap.
    """
    found = np.empty(points.shape[:2])
    for frame, posed in enumerate(body_vertices):
        x = np.ascontiguousarray(points[frame], dtype=np.float64)
        point, normal, _ = BlendedPlanes.of_body(contact, posed, len(x), gap_m)(x)
        found[frame] = ((x - point) * normal).sum(axis=1)
    return found


@kernel
def blend(x, skin, grid, ranges, last, planes):
    """Writes the ``planes``, point and normal (V, 3) and bend (V, 3, 3), of the points ``x`` [m] (V, 3).

    ``skin`` are points of the skin and their normals in their ``grid``, ``ranges`` the reach of the blend and of
    contact [m]. ``last`` are three records. A point keeps its plane while it is less than ``clear`` [m] (V,) from where
    it was last ``blended`` (V, 3); otherwise both are renewed. A point with no skin within reach keeps its plane too,
    and is marked in ``beyond`` (V,).
    """
    (corner, skin_normal), (blended, clear, beyond) = skin, last
    point, normal, bend = planes
    wide_m, gap = ranges
    reach, sharp = wide_m * wide_m, 1.0 / (WIDTH_M * WIDTH_M)
    around = (wide_m, wide_m, wide_m)
    mean, slope = np.empty(3), np.empty(3)
    for v in range(len(x)):
        beyond[v] = False
        p, q, r = x[v, 0] - blended[v, 0], x[v, 1] - blended[v, 1], x[v, 2] - blended[v, 2]
        if p * p + q * q + r * r < clear[v] * clear[v]:
            continue
        blended[v, 0], blended[v, 1], blended[v, 2] = x[v, 0], x[v, 1], x[v, 2]
        clear[v] = 0.0
        bend[v] = 0.0
        own = at(x, v)
        first, end = cells_within(grid, sub(own, around), add(own, around))
        least = reach
        for a in range(first[0], end[0]):
            for b in range(first[1], end[1]):
                start, stop = column(grid, a, b, first, end)
                for entry in range(start, stop):
                    p, q, r = sub(own, at(corner, grid.member[entry]))
                    least = min(least, p * p + q * q + r * r)
        if least >= reach:
            beyond[v] = True
            continue
        most = min(least + FADED / sharp, reach)
        # After a move by c what is blended is nearer than ``wide``, and so within reach: no plane of those may be met.
        near = np.sqrt(least)
        c = min(CLEAR_M, max((reach - FADED / sharp - least) / (2.0 * (near + wide_m)), 0.0))
        wide = (np.sqrt((near + c) * (near + c) + FADED / sharp) + c) ** 2
        lowest = np.inf
        total = distance = 0.0
        mean[:] = 0.0
        slope[:] = 0.0
        for derivatives in range(2):
            if derivatives:
                distance /= total
                for i in range(3):
                    mean[i] /= total
            for a in range(first[0], end[0]):
                for b in range(first[1], end[1]):
                    start, stop = column(grid, a, b, first, end)
                    for entry in range(start, stop):
                        k = grid.member[entry]
                        p, q, r = sub(own, at(corner, k))
                        square = p * p + q * q + r * r
                        if square >= most and (derivatives or square >= wide):
                            continue
                        n = at(skin_normal, k)
                        height = p * n[0] + q * n[1] + r * n[2]
                        lowest = min(lowest, height)
                        if square >= most:
                            continue
                        weight = np.exp((least - square) * sharp)
                        if not derivatives:
                            total += weight
                            distance += weight * height
                            mean[0] += weight * p
                            mean[1] += weight * q
                            mean[2] += weight * r
                            continue
                        weight /= total
                        # The derivative of log w_i less that of log sum w: towards b_i from the mean of all b.
                        g = (2.0 * sharp * (mean[0] - p), 2.0 * sharp * (mean[1] - q), 2.0 * sharp * (mean[2] - r))
                        more = height - distance
                        for i in range(3):
                            slope[i] += weight * (n[i] + more * g[i])
                            for j in range(3):
                                bend[v, i, j] += weight * (g[i] * n[j] + n[i] * g[j] + more * g[i] * g[j])
        # Where planes of several sides are blended the distance falls faster than the way, each of them does not.
        clear[v] = min(c, max(lowest - gap, 0.0))
        size = slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2]
        for i in range(3):
            normal[v, i] = slope[i]
            point[v, i] = x[v, i] - distance / size * slope[i]
