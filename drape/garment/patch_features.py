"""The features of each patch that the garment encoder reads: smooth on the body, without an arbitrary axis or sign."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from drape.arrays import Array, like, namespace
from drape.body.model import BodyModel
from drape.geometry import jets, meshes
from drape.geometry.closest import nearest_vertices
from drape.geometry.rotations import matrix_to_sixd

FREQUENCIES = (1.0, 2.0, 4.0, 8.0)  # of the positional encoding, cycles per 2 m / pi
JOINT_REACH_M = 0.3  # joints farther from a patch than this tell it little
BOUNDARY_REACH_M = 0.25  # farther hems are all alike


def saturated(offsets: Array) -> Array:
    """Returns ``offsets`` [m] (..., 3) with their length r turned into tanh(r / 0.3 m), without unit: far joints say
    little about a patch."""
    xp = namespace(offsets)
    # A maximum and not a sum: graph optimisers take "+ 1e-12" for "+ 0" and drop the guard.
    reach = xp.sqrt(xp.maximum(xp.sum(offsets * offsets, axis=-1, keepdims=True), like(offsets, 1e-12)))
    return offsets * (xp.tanh(reach / JOINT_REACH_M) / reach)


def positional_encoding(points: np.ndarray) -> np.ndarray:
    """Returns ``points`` [m] (..., 3) followed by their sines and cosines at the n ``FREQUENCIES``, (..., 3 + 6 n)
    (Mildenhall et al. 2020)."""
    parts = [points]
    for frequency in FREQUENCIES:
        parts += [np.sin(np.pi * frequency * points), np.cos(np.pi * frequency * points)]
    return np.concatenate(parts, axis=-1)


def patch_features(
    *,
    centre: np.ndarray,
    rotation: np.ndarray,
    scale: np.ndarray,
    jet: np.ndarray,
    weights: np.ndarray,
    seeds: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    graph: scipy.sparse.csr_matrix,
    body: BodyModel,
) -> np.ndarray:
    """Returns the features (K, 154) float32 of K patches that the garment encoder reads. Their columns: 27, the
    ``positional_encoding`` of the centre from the pelvis; 6, the rotation (``matrix_to_sixd``); 24, the bone weights;
    15, the height coefficients of the jet, times 4; 3 + 1, the way to the nearest skin and its length [dm]; 1, the
    distance to the nearest border [dm]; 1, how near that is, in [0, 1]; 3, this times the direction to the border; 1,
    the scale [dm]; 72, the ways to the joints (``saturated``). Ways and directions are in the patch's frame.

    Of the patches in the body's frame: ``centre`` [m] (K, 3), ``rotation`` (K, 3, 3), ``scale`` (K,), ``jet`` (K, 27),
    bone ``weights`` (K, 24), and ``seeds`` (K,), the vertex nearest to each centre. Of the garment: ``vertices`` [m]
    (N, 3), ``faces`` (G, 3), and ``graph``, its ``vertex_graph``.
    """
    joints = body.joints_template
    local = np.einsum("kba,kjb->kja", rotation, joints[None] - centre[:, None])  # joints in the patch frame
    joint_offsets = saturated(local).reshape(len(centre), -1)

    _, near = nearest_vertices(centre, body.v_template, 8)
    offset = np.einsum("kba,kb->ka", rotation, body.v_template[near].mean(axis=1) - centre)

    rim = meshes.boundary_vertices(faces)
    if len(rim):
        distance, _, source = dijkstra(graph, directed=False, indices=rim, min_only=True, return_predecessors=True)
        distance, source = distance[seeds], source[seeds]
        lost = ~np.isfinite(distance) | (source < 0)
        distance = np.where(lost, BOUNDARY_REACH_M, distance)
        direction = np.einsum("kba,kb->ka", rotation, vertices[np.where(lost, seeds, source)] - centre)
        direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-3)
    else:
        distance, direction = np.full(len(centre), BOUNDARY_REACH_M), np.zeros((len(centre), 3))
    nearness = np.exp(-((distance / 0.08) ** 2))[:, None]
    height = jets.unpack(jet)[2]
    parts = [
        positional_encoding(centre - joints[0]),
        matrix_to_sixd(rotation),
        weights,
        4.0 * height,
        10.0 * offset,
        10.0 * np.linalg.norm(offset, axis=1, keepdims=True),
        10.0 * np.minimum(distance, BOUNDARY_REACH_M)[:, None],
        nearness,
        nearness * direction,
        10.0 * scale[:, None],
        joint_offsets,
    ]
    return np.concatenate(parts, axis=1).astype(np.float32)
