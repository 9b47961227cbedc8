"""Grain and panels of a garment's cloth, read from texture coordinates that are a flattening of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.cloth.rest_state import UP, grain_along
from drape.errors import InputError
from drape.geometry import mesh_graphs, meshes

STRETCH_LIMIT = 1.15  # in a flattening both singular values of uv -> cloth are within this of the mesh's scale
FLAT_SHARE = 0.8  # share of an island's area on which they must; sleeves of a worn shirt have 0.85
TURNED = 0.2  # an island lies on its side if u runs more upright than v by this, on the mean
METRIC_LIMIT = 0.05  # uv whose scale differs from one metre by less are in metres
UNIT_LIMIT = 1.5  # worn cloth is at most this many times as large as its panels; the next unit is farther off
SAME_UV = 1e-6  # of the extent of uv: coordinates this near are the same
SMALLEST_AREA_SHARE = 1e-6  # of the mean triangle in uv; below it a triangle says nothing of the grain


@dataclass(frozen=True, eq=False)
class CornerUv:
    """The texture coordinates of G triangles: ``corners`` (G, 3, 2), and ``island`` (G,), the number of the connected
    piece of uv that each triangle lies in. ``grain_along_v``: the maker of the cloth says that the warp runs along v
    everywhere."""

    corners: np.ndarray
    island: np.ndarray
    grain_along_v: bool = False


@dataclass(frozen=True, eq=False)
class Grain:
    """The grain, the panels and the seams of cloth with G triangles and H hinges (edges between two triangles), as read
    from texture coordinates.

    ``warp`` (G, 3): the unit warp direction in the plane of each triangle. ``from_uv`` (G,) bool: False where uv are no
    flattening of the cloth; the warp there is the vertical laid into the triangle (``grain_along``). ``panel_edges``
    (G, 2, 2): the two edges from the first corner, along (warp, weft), in units of uv. ``seam`` (H,) bool: hinges at
    which panels end. ``scale_m``: metres of cloth per unit of uv, 0 where uv are no flattening. ``share``: the share of
    the area in [0, 1] on which uv are a flattening.
    """

    warp: np.ndarray
    from_uv: np.ndarray
    panel_edges: np.ndarray
    seam: np.ndarray
    scale_m: float
    share: float


def corner_uv(uv: np.ndarray, uv_faces: np.ndarray, face_count: int) -> CornerUv | None:
    """Returns the texture coordinates ``uv`` (T, 2), ``uv_faces`` (F, 3) at the corners of the ``face_count`` triangles
    into which the F delivered ones are subdivided, in the order of ``meshes.subdivide``. They are linear in every
    delivered triangle. None without texture coordinates, or where ``face_count`` is not F times a power of 4."""
    if not len(uv_faces):
        return None
    points, triangles = np.asarray(uv, dtype=np.float64), uv_faces.astype(np.int64)
    while len(triangles) < face_count:
        points, triangles, _ = meshes.subdivide(points, triangles)
    if len(triangles) != face_count:
        return None
    # A GLB splits vertices at hard edges too: an island ends where uv do.
    _, place = np.unique(uv, axis=0, return_inverse=True)
    welded = place.reshape(-1)[uv_faces]
    island = mesh_graphs.connected_components(welded, len(uv))[welded[:, 0]]
    island = np.unique(np.repeat(island, face_count // len(uv_faces)), return_inverse=True)[1].reshape(-1)
    return CornerUv(points[triangles], island)


def read_grain(
    vertices: np.ndarray,
    modelled: np.ndarray,
    faces: np.ndarray,
    on_corners: CornerUv | None,
    uv_unit_m: float | None = None,
) -> Grain:
    """Returns the grain of the cloth at rest, ``vertices`` [m] (N, 3) and ``faces`` (G, 3), in their frame, as its
    texture coordinates ``on_corners`` show it.

    Uv count as a flattening where they are one of ``modelled`` [m] (N, 3), the cloth as delivered: island by island,
    with one scale for all. Worn cloth stretches and shears, and knits do so by more than the limit. So with
    ``uv_unit_m``, metres of cloth per unit of uv, uv are panels without that check. Raises ``InputError`` if there are
    no uv then, or if their size is clearly another.

    The warp is uv's v, as patterns are laid out. It is u where an island lies on its side, so that a quarter turn
    brings the warp nearer to the vertical, unless the maker says that it is v. A panel cut on the bias stays so.
    """
    plain = grain_along(vertices, faces)
    hinges = meshes.hinge_faces(faces)
    nothing = Grain(
        plain, np.zeros(len(faces), bool), np.zeros((len(faces), 2, 2)), np.zeros(len(hinges), bool), 0.0, 0.0
    )
    if on_corners is None:
        if uv_unit_m is not None:
            raise InputError("uv unit", expected="panels as uv", got="no uv", cure="Leave the unit of uv out.")
        return nothing
    edges = on_corners.corners[:, 1:] - on_corners.corners[:, :1]  # (G, 2, 2)
    double = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    sound = np.abs(double) > SMALLEST_AREA_SHARE * np.abs(double).mean()
    if not sound.any():
        return nothing
    area = meshes.face_areas(modelled, faces)
    inverse = np.zeros_like(edges)
    inverse[sound] = np.linalg.inv(edges[sound])
    slope = _slope(modelled, faces, inverse)
    scale = weighted_median(np.sqrt(2.0 * area[sound] / np.abs(double[sound])), area[sound])
    large, small = _singular_values(slope)
    if uv_unit_m is not None and not 1.0 / UNIT_LIMIT < scale / uv_unit_m < UNIT_LIMIT:
        raise InputError(
            "uv unit",
            expected=f"about {scale:.3g} metres of cloth per unit of uv, as the mesh shows",
            got=f"{uv_unit_m:g}",
            cure="Correct the unit, or leave it out: lengths are then those of the mesh.",
        )
    true = sound & (large < STRETCH_LIMIT * scale) & (small * STRETCH_LIMIT > scale)
    whole = np.bincount(on_corners.island, area)
    flat = np.bincount(on_corners.island, area * true) >= FLAT_SHARE * whole
    flat |= uv_unit_m is not None
    good = sound & flat[on_corners.island]
    upright = slope @ np.array(UP) / scale  # (G, 2): how steeply u and v climb
    mean = np.stack([np.bincount(on_corners.island, area * upright[:, k]) for k in (0, 1)], axis=1) / whole[:, None]
    on_side = (np.abs(mean[:, 0]) > np.abs(mean[:, 1]) + TURNED) & (not on_corners.grain_along_v)
    axis = np.where(on_side, 0, 1)[on_corners.island]
    turned = _polar(_slope(vertices, faces, inverse))
    rows = np.arange(len(faces))
    warp = np.where(good[:, None], turned[rows, axis], plain)
    panel = np.stack([edges[rows, :, axis], edges[rows, :, 1 - axis]], axis=2)
    share = float((area * flat[on_corners.island]).sum() / area.sum())
    return Grain(warp, good, panel, _seams(on_corners, faces, good), scale if good.any() else 0.0, share)


def panel_unit(grain: Grain, uv_unit_m: float | None) -> float | None:
    """Returns the metres of cloth per unit of uv, if uv are panels of a known size: ``uv_unit_m`` if given, or 1 where
    the scale of ``grain`` is about one metre; otherwise None."""
    return 1.0 if uv_unit_m is None and abs(grain.scale_m - 1.0) < METRIC_LIMIT else uv_unit_m


def _slope(vertices: np.ndarray, faces: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Rows (G, 2, 3): the derivatives of the cloth's place along u and along v."""
    return inverse @ np.stack(meshes.corner_edges(vertices, faces), axis=1)


def _singular_values(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The larger and the smaller one (G,) of ``slope`` (G, 2, 3)."""
    a, b, c = _gram(slope)
    middle, spread = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    return np.sqrt(middle + spread), np.sqrt(np.maximum(middle - spread, 0.0))


def _polar(slope: np.ndarray) -> np.ndarray:
    """The orthonormal rows (G, 2, 3) nearest to ``slope`` (Higham 1986): S^-1 slope, S the root of slope slope^T."""
    a, b, c = _gram(slope)
    root = np.sqrt(np.maximum(a * c - b * b, 0.0))
    trace = np.sqrt(a + c + 2.0 * root)
    scale = 1.0 / np.maximum(root * trace, 1e-30)
    # S = (M + root I) / trace with det S = root, by Cayley and Hamilton.
    inverse = np.stack([np.stack([c + root, -b], axis=1), np.stack([-b, a + root], axis=1)], axis=1)
    return scale[:, None, None] * inverse @ slope


def _gram(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u, v = slope[:, 0], slope[:, 1]
    return (u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)


def weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    """Returns the least of ``values`` (n,) up to which half of the sum of ``weights`` (n,) is reached."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _seams(on_corners: CornerUv, faces: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Hinges (H,) bool between flattenings at which uv are split."""
    ends, sides = meshes.hinges(faces)[:, :2], meshes.hinge_faces(faces)
    tolerance = SAME_UV * np.ptp(on_corners.corners.reshape(-1, 2), axis=0).max()
    split = np.zeros(len(ends), bool)
    for k in (0, 1):
        first, second = (on_corners.corners[side, (faces[side] == ends[:, k, None]).argmax(axis=1)] for side in sides.T)
        split |= np.abs(first - second).max(axis=1) > tolerance
    return split & good[sides].all(axis=1)
