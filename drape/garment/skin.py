"""Binds a garment at rest to the body: skin weights and shape movement of every vertex.

A vertex takes the weights of the body points near it, by a Gaussian kernel whose width
grows with its distance from the body: next to the skin that is the nearest triangle, on
a loose skirt it blends radially over both legs. Then the weights are smoothed over the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from drape.body.model import BodyModel
from drape.geometry import mesh_graphs
from drape.geometry.closest import nearest_vertices

KERNEL_BASE_M = 0.006
KERNEL_GROWTH = 0.5
NEIGHBOURS = 96
SAMPLE_SPACING_M = 0.012
SMOOTHING_PASSES = 12


@dataclass(frozen=True)
class BodyBinding:
    """Skin weights (N, 24) and shape movement [m per unit beta] (N, 3, S) of each vertex."""

    weights: np.ndarray
    shapedirs: np.ndarray


def bind_to_body(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> BodyBinding:
    """Weights and shape movement of garment ``vertices`` (N, 3) [m] at rest on ``body`` in T-pose."""
    kernel = body_kernel(vertices, body)
    smooth = smoothing_matrix(faces, len(vertices))
    weights = kernel @ body.weights
    shape = kernel @ body.shapedirs.reshape(body.vertex_count, -1)
    for _ in range(SMOOTHING_PASSES):
        weights = smooth @ weights
        shape = smooth @ shape
    weights = np.where(weights > 1e-3, weights, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return BodyBinding(weights, shape.reshape(len(vertices), 3, -1))


def body_kernel(vertices: np.ndarray, body: BodyModel) -> scipy.sparse.csr_matrix:
    """Sparse rows (N, body vertices) that sum to one: the Gaussian neighbourhood on the body."""
    points = thinned_vertices(body)
    distance, index = nearest_vertices(vertices, body.v_template[points], NEIGHBOURS)
    nearest = distance[:, :1]
    width = KERNEL_BASE_M + KERNEL_GROWTH * nearest
    value = np.exp(-0.5 * (distance**2 - nearest**2) / width**2)
    value /= value.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(vertices)), NEIGHBOURS)
    return scipy.sparse.csr_matrix(
        (value.ravel(), (rows, points[index].ravel())), shape=(len(vertices), body.vertex_count)
    )


def thinned_vertices(body: BodyModel) -> np.ndarray:
    """Body vertices about ``SAMPLE_SPACING_M`` apart, so that finely meshed parts do not outvote the others."""
    cell = np.floor(body.v_template / SAMPLE_SPACING_M).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    return np.sort(first)


def smoothing_matrix(faces: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """One umbrella pass (N, N): half the vertex, half the mean of its neighbours; lone vertices stay."""
    adjacency = mesh_graphs.adjacency(faces, count)
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    mean = scipy.sparse.diags(0.5 / np.maximum(degree, 1)) @ adjacency
    return (mean + scipy.sparse.diags(np.where(degree > 0, 0.5, 1.0))).tocsr()
