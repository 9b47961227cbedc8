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
from drape.body.skeleton import JOINT_NAMES
from drape.geometry import mesh_graphs
from drape.geometry.closest import nearest_vertices

KERNEL_BASE_M = 0.006
KERNEL_GROWTH = 0.5
NEIGHBOURS = 96
SAMPLE_SPACING_M = 0.012
SMOOTHING_PASSES = 12
ARMS = {
    side: [JOINT_NAMES.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist", "hand")]
    for side in ("left", "right")
}


@dataclass(frozen=True)
class BodyBinding:
    """How N vertices follow the body: bone weights ``weights`` (N, 24), rows summing to one, and ``shapedirs`` (N, 3,
    S), their movement [m per unit of beta]."""

    weights: np.ndarray
    shapedirs: np.ndarray


def bind_to_body(
    vertices: np.ndarray, faces: np.ndarray, body: BodyModel, *, arm: np.ndarray | None = None
) -> BodyBinding:
    """Returns the bone weights and the shape movement of a garment with ``vertices`` [m] (N, 3) and ``faces``, at rest
    on ``body`` in T-pose. ``arm`` (N,) in [0, 1]: the share by which each vertex follows the arm on its side, and the
    trunk by the rest; by default it follows the skin near it."""
    if arm is None:
        kernel = body_kernel(vertices, body)
    else:
        trunk, arms = trunk_and_arm_kernels(vertices, body)
        kernel = scipy.sparse.diags(1.0 - arm) @ trunk + scipy.sparse.diags(arm) @ arms
    smooth = smoothing_matrix(faces, len(vertices))
    weights = kernel @ body.weights
    shape = kernel @ body.shapedirs.reshape(body.vertex_count, -1)
    for _ in range(SMOOTHING_PASSES):
        weights = smooth @ weights
        shape = smooth @ shape
    weights = np.where(weights > 1e-3, weights, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return BodyBinding(weights, shape.reshape(len(vertices), 3, -1))


def trunk_and_arm_kernels(
    vertices: np.ndarray, body: BodyModel
) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
    """Returns two sparse matrices of weights (N, B) over the B vertices of ``body`` like ``body_kernel``: over the skin
    without arms, and over the arm on the side of each of ``vertices`` [m] (N, 3)."""
    arms = [body.weights[:, bones].sum(axis=1) > 0.5 for bones in ARMS.values()]
    left, right = (body_kernel(vertices, body, arm) for arm in arms)
    on_left = (vertices[:, 0] > 0.0).astype(np.float64)
    own = scipy.sparse.diags(on_left) @ left + scipy.sparse.diags(1.0 - on_left) @ right
    return body_kernel(vertices, body, ~(arms[0] | arms[1])), scipy.sparse.csr_matrix(own)


def body_kernel(vertices: np.ndarray, body: BodyModel, counts: np.ndarray | None = None) -> scipy.sparse.csr_matrix:
    """Returns sparse weights (N, B), rows summing to one, over the vertices of ``body`` near each of ``vertices`` [m]
    (N, 3): Gaussian in the distance. Only ``thinned_vertices`` have weight, and of these only those that ``counts``
    (B,) bool marks, if it is given."""
    points = thinned_vertices(body)
    points = points if counts is None else points[counts[points]]
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
    """Returns the ascending indices (n,) of vertices of ``body`` about ``SAMPLE_SPACING_M`` apart, so that finely
    meshed parts do not outvote the others."""
    cell = np.floor(body.v_template / SAMPLE_SPACING_M).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    return np.sort(first)


def smoothing_matrix(faces: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """Returns the sparse matrix (N, N) of one smoothing pass over ``count`` vertices: half of the vertex itself and
    half of the mean of its neighbours; a vertex without neighbours stays."""
    adjacency = mesh_graphs.adjacency(faces, count)
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    mean = scipy.sparse.diags(0.5 / np.maximum(degree, 1)) @ adjacency
    return (mean + scipy.sparse.diags(np.where(degree > 0, 0.5, 1.0))).tocsr()
