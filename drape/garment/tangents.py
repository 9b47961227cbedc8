"""Rows that give a garment's surface tangents, and so its normals, from posed jets without its triangles.

A draped vertex is ``sum_k w_k C_k [y_k / s_k, basis(u_k, v_k)]`` over its charts, C (3, 18) the posed
jets of a patch (``drape.graph.packing``). Along a direction e of the rest surface its derivative has the same form,
with the derivatives of the columns. Those of rest place and jets are analytic; those of the weights, and of
parameters that are no projection (charts laid flat), are least squares over the neighbours on the mesh (Meyer et al.
2003 give other choices; this one is exact for linear functions). The normal is the cross product of two such tangents.
"""

from __future__ import annotations

import numpy as np

from drape.garment.cache import Garment
from drape.geometry import jets, meshes

PROJECTED = 1e-4  # chart parameters this near those of the projection [patch scales] are its own


def tangent_columns(garment: Garment) -> np.ndarray:
    """Columns (V, 4, 18, 2) of the delivered vertices, along two rest directions [1/m] that span the tangent plane.

    ``C_k`` times these, summed over the charts, are the tangents t and t' with t x t' along the outward normal.
    """
    count = garment.vertex_count
    points = garment.vertices[:count].astype(np.float64)
    directions = _tangent_plane(meshes.vertex_normals(points, garment.faces))  # (V, 3, 2)
    patch, uv = garment.chart_patch[:count], garment.chart_uv[:count].astype(np.float64)
    weight = garment.chart_weight[:count].astype(np.float64)
    scale = garment.patch_scale[patch].astype(np.float64)[..., None]
    local = garment.chart_local()[:count]

    turned = np.swapaxes(garment.patch_rotation[patch].astype(np.float64), -1, -2) @ directions[:, None]  # (V, 4, 3, 2)
    place_slope = turned / scale[..., None]
    slopes = _Slopes(points, garment.faces, directions)
    uv_slope = place_slope[..., :2, :].copy()
    off = np.abs(uv - local[..., :2] / scale).max(axis=-1) > PROJECTED
    # A chart is laid flat as a whole, also where its parameters happen to be those of the projection.
    flat = np.isin(patch, patch[off & (weight > 0)])
    if flat.any():
        found, usable = slopes.of_charts(patch, uv)
        uv_slope = np.where((flat & usable)[..., None, None], found, uv_slope)
    weight_slope = slopes.of_weights(patch, weight)  # (V, 4, 2)

    basis = jets.basis(uv, jets.HEIGHT_ORDER)
    along_u = jets.basis_derivative(uv, jets.HEIGHT_ORDER, u_times=1)
    along_v = jets.basis_derivative(uv, jets.HEIGHT_ORDER, v_times=1)
    basis_slope = along_u[..., None] * uv_slope[..., :1, :] + along_v[..., None] * uv_slope[..., 1:, :]
    column = np.concatenate([local / scale, basis], axis=-1)
    slope = np.concatenate([place_slope, basis_slope], axis=-2)
    return weight[..., None, None] * slope + weight_slope[..., None, :] * column[..., None]


def _tangent_plane(normals: np.ndarray) -> np.ndarray:
    """Two unit directions (V, 3, 2) that form a right-handed frame with each normal."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(axis, normals)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    return np.stack([first, np.cross(normals, first)], axis=-1)


class _Slopes:
    """Least-squares slopes of functions on the mesh along the two directions of every vertex."""

    def __init__(self, points: np.ndarray, faces: np.ndarray, directions: np.ndarray) -> None:
        edges = meshes.unique_edges(faces)
        self.start = np.concatenate([edges[:, 0], edges[:, 1]])
        self.end = np.concatenate([edges[:, 1], edges[:, 0]])
        self.count = len(points)
        way = points[self.end] - points[self.start]
        flat = np.einsum("ea,eab->eb", way, directions[self.start])
        # Near neighbours say more about the slope than far ones.
        self.flat = flat / np.maximum(np.sum(way * way, axis=1, keepdims=True), 1e-30)
        self.moment = flat[:, :, None] * self.flat[:, None, :]

    def of_weights(self, patch: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Slopes (V, 4, 2) of the blending weights (V, 4); those of a vertex sum to zero, as the weights sum to one."""
        same = patch[self.end][:, None, :] == patch[self.start][:, :, None]  # (E, 4, 4)
        there = np.sum(np.where(same, weight[self.end][:, None, :], 0.0), axis=-1)  # 0 where the chart has ended
        right = self._collected((there - weight[self.start])[..., None] * self.flat[:, None, :])
        slope, _ = _solved(self._collected(self.moment)[:, None], right)
        slope[_repeated(patch)] = 0.0
        return slope - weight[..., None] * slope.sum(axis=1, keepdims=True)

    def of_charts(self, patch: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (V, 4, 2, 2) of chart parameters (V, 4, 2), and where (V, 4) there are neighbours enough for them."""
        same = patch[self.end][:, None, :] == patch[self.start][:, :, None]
        there = np.take_along_axis(uv[self.end], same.argmax(axis=-1)[..., None], axis=1)  # (E, 4, 2)
        known = same.any(axis=-1)
        change = np.where(known[..., None], there - uv[self.start], 0.0)
        moment = self._collected(known[..., None, None] * self.moment[:, None])  # (V, 4, 2, 2)
        right = self._collected(change[..., None] * self.flat[:, None, None, :])  # (V, 4, 2 of uv, 2)
        slopes = [_solved(moment, right[:, :, i]) for i in (0, 1)]
        return np.stack([slope for slope, _ in slopes], axis=-2), slopes[0][1]

    def _collected(self, values: np.ndarray) -> np.ndarray:
        """Sums over the edges that start at each vertex."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(self.start, column, minlength=self.count) for column in flat.T]
        return np.stack(sums, axis=1).reshape(self.count, *values.shape[1:])


def _repeated(patch: np.ndarray) -> np.ndarray:
    """Entries (V, 4) whose patch an earlier entry of the vertex names: they fill up and weigh nothing."""
    earlier = np.tril(np.ones((patch.shape[1], patch.shape[1]), dtype=bool), -1)
    return ((patch[:, :, None] == patch[:, None, :]) & earlier).any(axis=-1)


def _solved(moment: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solutions of the symmetric systems (..., 2, 2), zero where they are singular, and where (...) they are not."""
    a, b, d = moment[..., 0, 0], moment[..., 0, 1], moment[..., 1, 1]
    determinant = a * d - b * b
    usable = determinant > 1e-6 * np.maximum(a * d, 1e-300)
    inverse = np.where(usable, 1.0 / np.where(usable, determinant, 1.0), 0.0)
    x = (d * right[..., 0] - b * right[..., 1]) * inverse
    y = (a * right[..., 1] - b * right[..., 0]) * inverse
    return np.stack([x, y], axis=-1), np.broadcast_to(usable, x.shape)
