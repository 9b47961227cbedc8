"""Where patches should be smaller: a density for the partition, from the curvature of the cloth.

Weighted clusters of density rho are about rho^(-1/4) wide, so a density that grows with the cube of the
curvature makes patches about as wide as its inverse to the power 3/4. Curvature is the rate at which the
mesh's normals turn; it is spread over two centimetres, since a patch has to shrink before it comes to a
crease, not on it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

SPREAD_M = 0.02
REFERENCE_PER_M = 10.0  # a wrist's: flatter cloth gains nothing from smaller patches
EXPONENT = 1.5  # of the squared curvature
DENSITY_LIMIT = 300.0  # patches differ in width by at most about four
COTANGENT_RANGE = (0.05, 20.0)


def curvature_squared(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Squared curvature |grad n|^2 = k1^2 + k2^2 [1/m^2] (N,) of each vertex, from the turn of its unit ``normals``.

    Bounded by what a triangle can show, a turn of two over its longest side, so slivers do not count.
    """
    corners = vertices[faces]
    sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite each corner
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    turn = np.einsum("fka,fkb->fab", normals[faces], sides) / np.maximum(double_area, 1e-15)[:, None, None]
    longest = np.max(np.sum(sides**2, axis=2), axis=1)
    squared = np.minimum(np.sum(turn**2, axis=(1, 2)), 4.0 / np.maximum(longest, 1e-15))
    total = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(total, faces[:, k], double_area / 6.0 * squared)
    return total / areas


def spread(
    values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, areas: np.ndarray, *, width_m: float
) -> np.ndarray:
    """``values`` (N,) after one implicit step of heat flow over ``width_m``: the area-weighted total stays."""
    count = len(vertices)
    rows, columns, entries = [], [], []
    for k in range(3):
        i, j, o = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        a, b = vertices[i] - vertices[o], vertices[j] - vertices[o]
        cotangent = np.sum(a * b, axis=1) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-15)
        half = 0.5 * np.clip(cotangent, *COTANGENT_RANGE)  # clipped: the matrix keeps its maximum principle
        rows += [i, j]
        columns += [j, i]
        entries += [half, half]
    shape = (count, count)
    graph = scipy.sparse.coo_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    )
    laplacian = scipy.sparse.diags(np.asarray(graph.sum(axis=1)).reshape(-1)) - graph
    matrix = scipy.sparse.diags(areas) + width_m**2 * laplacian
    return np.asarray(scipy.sparse.linalg.spsolve(matrix.tocsc(), areas * values))


def smoothed_normals(
    normals: np.ndarray, vertices: np.ndarray, faces: np.ndarray, areas: np.ndarray, *, width_m: float
) -> np.ndarray:
    """Unit ``normals`` (N, 3) after heat flow over ``width_m``: the turns of single triangles are gone from them."""
    flowed = np.stack([spread(normals[:, k], vertices, faces, areas, width_m=width_m) for k in range(3)], axis=1)
    return flowed / np.maximum(np.linalg.norm(flowed, axis=1, keepdims=True), 1e-12)


def curvature_density(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Density (N,) in [1, ``DENSITY_LIMIT``]: (1 + (curvature / ``REFERENCE_PER_M``)^2)^``EXPONENT``."""
    squared = spread(curvature_squared(vertices, faces, normals, areas), vertices, faces, areas, width_m=SPREAD_M)
    return np.clip((1.0 + np.maximum(squared, 0.0) / REFERENCE_PER_M**2) ** EXPONENT, 1.0, DENSITY_LIMIT)
