"""The disagreement of a posed garment's overlapping charts, before they are blended.

A chart moves the rest garment, given in its patch's frame, by ``x -> x + s j(u(x), v(x))`` with j the
jet that the network adds; its frame then carries it into the world. So each chart says where a vertex
lies, and by the gradient of that map along the rest surface which way the cloth faces there. Detail that
the rest jet leaves over moves with the map, so undisturbed charts agree exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import check_shape
from drape.garment.cache import Garment
from drape.garment.charts import ChartBlend
from drape.garment.unfold import chart_triangles
from drape.geometry import jets, meshes
from drape.geometry.rotations import cross

LEAST_WEIGHT = 0.02  # weight in the blend above which a chart counts


@dataclass(frozen=True, eq=False)
class Disagreement:
    """The disagreement of charts in F frames, at the n vertices that have at least two charts of a weight above
    ``LEAST_WEIGHT``.

    ``gap_m`` (F, m): for each of the m charts that these vertices have in all, the distance from the blended vertex to
    where the chart puts it. ``normal_rad`` (F, n): the largest angle between the normals of two charts of a vertex.
    """

    gap_m: np.ndarray
    normal_rad: np.ndarray


def chart_positions(garment: Garment, jet: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Returns the places [m] (F, V, 4, 3), float64, that each of its four charts alone gives each vertex of the
    subdivided mesh. They are relative to the same origin as ``centre``: the root joint in what the drape graph returns.

    ``jet`` (F, K, 27 or 45) [patch scales] is the change of the rest jets, ``rotation`` (F, K, 3, 3) and ``centre`` (F,
    K, 3) [m] are the posed frames. Raises ``InputError`` for other shapes.
    """
    _check(garment, jet, rotation, centre)
    patch, uv = garment.chart_patch, garment.chart_uv.astype(np.float64)
    scale = garment.patch_scale[patch].astype(np.float64)[..., None]
    local = garment.chart_local() + scale * jets.evaluate_jet(jet.astype(np.float64)[:, patch], uv)
    return (rotation.astype(np.float64)[:, patch] @ local[..., None])[..., 0] + centre.astype(np.float64)[:, patch]


def chart_normals(garment: Garment, jet: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Returns the unit normals (F, V, 4, 3), float64, of the cloth as each of its four charts alone bends it at each
    vertex. Arguments are those of ``chart_positions``.

    Two tangents t of the rest mesh at the vertex turn into ``t + s (j_u (grad u . t) + j_v (grad v . t))``, with
    the derivatives of the jet analytic; the normal is the unit vector of their cross product. NaN where a
    vertex is in no triangle of the chart, which then has no surface there.
    """
    _check(garment, jet, rotation, np.zeros((*jet.shape[:2], 3)))
    jet, patch, uv = jet.astype(np.float64), garment.chart_patch, garment.chart_uv.astype(np.float64)
    scale = garment.patch_scale[patch].astype(np.float64)[..., None]
    by_u, by_v = (scale * jets.evaluate_jet(jet[:, patch], uv, **d) for d in ({"u_times": 1}, {"v_times": 1}))
    normal = cross(*(own + along[..., 0:1] * by_u + along[..., 1:2] * by_v for own, along in rest_tangents(garment)))
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    return (rotation.astype(np.float64)[:, patch] @ normal[..., None])[..., 0]


def disagreement(garment: Garment, jet: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> Disagreement:
    """Returns the disagreement of the charts of a drape of ``garment``. Arguments are those of ``chart_positions``."""
    weight = garment.chart_weight.astype(np.float64)
    counted = weight > LEAST_WEIGHT
    overlap = counted.sum(axis=1) > 1
    counted, weight = counted[overlap], weight[overlap]
    places = chart_positions(garment, jet, rotation, centre)[:, overlap]
    blended = np.einsum("vk,fvka->fva", weight, places)
    gap = np.linalg.norm(places - blended[:, :, None], axis=-1)[:, counted]
    return Disagreement(gap, widest_angles(chart_normals(garment, jet, rotation)[:, overlap], counted))


def widest_angles(normals: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Returns the largest angle [rad] (F, n) between two of each point's unit ``normals`` (F, n, m, 3), of those alone
    for which ``counted`` (n, m) is true and that are not NaN; 0 where fewer than two are left."""
    widest = np.zeros(normals.shape[:2])
    for first in range(normals.shape[2]):
        for second in range(first):
            angle = np.nan_to_num(_angle(normals[:, :, first], normals[:, :, second]))
            widest = np.maximum(widest, angle * (counted[:, first] & counted[:, second]))
    return widest


def rest_tangents(garment: Garment) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns two pairs, one for each of two unit tangents of the rest mesh at every vertex: the tangent (V, 4, 3) in
    the frames of the vertex's patches, and the derivative [1/m] (V, 4, 2) of (u, v) along it, NaN where the chart has
    no triangle at the vertex."""
    gradient = _uv_gradients(garment)
    normals = meshes.vertex_normals(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64))
    tangents = []
    for tangent in _tangents(normals):
        own = np.einsum("vkba,vb->vka", garment.patch_rotation[garment.chart_patch].astype(np.float64), tangent)
        tangents.append((own, np.einsum("vkca,vka->vkc", gradient, own)))
    return tangents


def _uv_gradients(garment: Garment) -> np.ndarray:
    """Gradients [1/m] (V, 4, 2, 3) of (u, v) along the rest surface, in the patch frames.

    (u, v) is linear on every triangle of a chart; a vertex takes the mean round it, weighted by area.
    """
    local, uv = garment.chart_local().reshape(-1, 3), garment.chart_uv.astype(np.float64).reshape(-1, 2)
    blend = ChartBlend(garment.chart_patch, garment.chart_weight)
    _, corners = chart_triangles(blend, garment.fine_faces.astype(np.int64))
    first, second = (local[corners[:, k]] - local[corners[:, 0]] for k in (1, 2))
    by_first, by_second = (uv[corners[:, k]] - uv[corners[:, 0]] for k in (1, 2))
    area = cross(first, second)  # twice the area, along the normal
    size = np.linalg.norm(area, axis=-1)
    # The gradients of the barycentric coordinates are second x area / size^2 and area x first / size^2.
    weighted = by_first[:, :, None] * cross(second, area)[:, None] + by_second[:, :, None] * cross(area, first)[:, None]
    weighted = weighted / np.maximum(size, 1e-30)[:, None, None]
    total, weight = np.zeros((len(local), 2, 3)), np.zeros(len(local))
    for k in range(3):
        np.add.at(total, corners[:, k], weighted)
        np.add.at(weight, corners[:, k], size)
    gradient = total / np.where(weight > 0.0, weight, np.nan)[:, None, None]
    return gradient.reshape(*garment.chart_patch.shape, 2, 3)


def _tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (V, 3) that make a right-handed frame with ``normals`` (V, 3)."""
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(least, normals)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    return first, np.cross(normals, first)


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles [rad] between unit vectors; unlike the arc cosine exact where they are small."""
    return 2.0 * np.arctan2(np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1))


def _check(garment: Garment, jet: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> None:
    count, frames = garment.patch_count, len(jet)
    check_shape("jet", jet, (None, count, jets.FULL_COUNT if jet.shape[-1] == jets.FULL_COUNT else jets.JET_COUNT))
    check_shape("rotation", rotation, (frames, count, 3, 3))
    check_shape("centre", centre, (frames, count, 3))
