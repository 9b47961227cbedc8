"""The distance of two surfaces by points drawn on both: the Chamfer distance of the papers, and its floor.

Two drawings of one surface lie millimetres apart. Below that floor a Chamfer distance says nothing. Distances from
points to triangles have no floor (docs/decisions/0004-pattern-recovery.md, point 2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.geometry import closest
from drape.geometry.drawing import draw_points

POINT_COUNT = 100_000


class Chamfer(NamedTuple):
    """The Chamfer distance of two sets of points: ``squared_cm2`` [cm^2], the mean squared distances of both
    directions, summed, and ``mean_mm`` [mm], the mean of both directions' mean distances."""

    squared_cm2: float
    mean_mm: float

    @classmethod
    def of(cls, forth: np.ndarray, back: np.ndarray) -> Chamfer:
        """Returns the Chamfer distance from the distances [m] ``forth`` (N,) and ``back`` (M,) of each set's points to
        the nearest point of the other set."""
        squared = float((forth**2).mean() + (back**2).mean())
        return cls(1e4 * squared, 0.5e3 * float(forth.mean() + back.mean()))


class SurfaceDistance(NamedTuple):
    """The distances [mm] from points on each of two meshes to the other mesh, both directions together: mean, root mean
    square, 95th percentile and largest."""

    mean_mm: float
    rms_mm: float
    p95_mm: float
    largest_mm: float


def chamfer(first: np.ndarray, second: np.ndarray) -> Chamfer:
    """Returns the Chamfer distance of two sets of points [m] (N, 3) and (M, 3)."""
    forth, back = (np.asarray(KDTree(there).query(here)[0]) for here, there in ((first, second), (second, first)))
    return Chamfer.of(forth, back)


def surface_chamfer(
    first: tuple[np.ndarray, np.ndarray],
    second: tuple[np.ndarray, np.ndarray],
    *,
    count: int = POINT_COUNT,
    known: np.ndarray | None = None,
) -> tuple[Chamfer, Chamfer]:
    """Returns the Chamfer distance of two meshes (vertices [m] (V, 3), faces (F, 3)) by ``count`` points drawn on each,
    and its floor: that of two such sets of points on the second.

    Faces of the second that are not ``known``, bool (F,), close holes: what lies nearest to them does not count.
    """
    own = _opposite_known(draw_points(*first, count, 0), second, known)
    there, anew = (draw_points(*_known_part(second, known), count, seed) for seed in (1, 2))
    return chamfer(own, there), chamfer(anew, there)


def surface_distance(
    first: tuple[np.ndarray, np.ndarray],
    second: tuple[np.ndarray, np.ndarray],
    *,
    count: int = 20_000,
    known: np.ndarray | None = None,
) -> SurfaceDistance:
    """Returns the distances from ``count`` points on each mesh (vertices [m] (V, 3), faces (F, 3)) to the nearest point
    of the other.

    Faces of the second that are not ``known``, bool (F,), close holes: what lies nearest to them does not count.
    """
    own, there = draw_points(*first, count, 0), draw_points(*_known_part(second, known), count, 1)
    own = _opposite_known(own, second, known)
    pairs = ((own, second), (there, first))
    off_mm = 1e3 * np.concatenate([closest.closest_point(points, *mesh).distance for points, mesh in pairs])
    rms = float(np.sqrt((off_mm**2).mean()))
    return SurfaceDistance(float(off_mm.mean()), rms, float(np.quantile(off_mm, 0.95)), float(off_mm.max()))


def _known_part(mesh: tuple[np.ndarray, np.ndarray], known: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    return mesh if known is None else (mesh[0], mesh[1][known])


def _opposite_known(points: np.ndarray, mesh: tuple[np.ndarray, np.ndarray], known: np.ndarray | None) -> np.ndarray:
    """Those of ``points`` [m] (N, 3) whose nearest face of ``mesh`` is known."""
    if known is None or known.all():
        return points
    return points[known[closest.closest_point(points, *mesh).face]]
