"""Skinning weights of a garment's vertices on the joints of a character's own rig, and blends of the joints' maps."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.avatar.file_skeleton import FileRig
from drape.avatar.parts import PARTS, parts_of, plain_part
from drape.avatar.wearer import Wearer
from drape.garment.cache import Garment
from drape.garment.skin import smoothing_matrix
from drape.geometry.closest import closest_point

HEAVIEST = 4  # Players support so many joints a vertex.
SMOOTHING_PASSES = 6


def garment_weights(garment: Garment, wearer: Wearer, rig: FileRig) -> scipy.sparse.csr_matrix:
    """Returns the skinning weights (D, J), sparse, of the garment's D drawn vertices on the J joints of ``rig``: those
    of the wearer's surface next to the cloth, smoothed along it. Rows sum to one.

    Heads, hands, hair and things that are carried move no cloth.
    """
    corners = parts_of(wearer.weights)[wearer.faces]
    names = list(PARTS)
    other = [number for number, part in enumerate(names) if plain_part(part) in ("head", "palm")]
    near = ~np.isin(corners, other).any(axis=1)
    if wearer.attire.parts:
        near &= ~wearer.attire.of_kinds(("hair", "hat", "carried"))
    faces = wearer.faces[near].astype(np.int64)
    vertices = garment.vertices[: garment.vertex_count].astype(np.float64)
    found = closest_point(vertices, wearer.vertices.astype(np.float64), faces)
    rows = np.repeat(np.arange(len(vertices)), 3)
    onto = (found.barycentric.reshape(-1), (rows, faces[found.face].reshape(-1)))
    nearest = scipy.sparse.csr_matrix(onto, (len(vertices), len(wearer.vertices)))
    weights = nearest @ rig.weights
    smooth = smoothing_matrix(garment.faces.astype(np.int64), len(vertices))
    for _ in range(SMOOTHING_PASSES):
        weights = smooth @ weights
    if garment.drawn is not None:
        weights = garment.drawn.shares(len(vertices)) @ weights
    return scipy.sparse.csr_matrix(weights)


def heaviest(weights: scipy.sparse.csr_matrix, alone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the heaviest joints (V, 4) of each vertex, as columns of ``weights`` (V, J), and their weights (V, 4),
    float32, which sum to one. A vertex that is ``alone`` (V,) bool has its heaviest joint only. Entries without weight
    name joint 0."""
    used = np.unique(weights.indices)  # Of thousands of joints few move a garment.
    dense = weights[:, used].toarray()
    order = np.argsort(-dense, axis=1, kind="stable")[:, :HEAVIEST]
    order = np.pad(order, ((0, 0), (0, HEAVIEST - order.shape[1])))
    kept = np.take_along_axis(dense, order, axis=1)
    kept[:, dense.shape[1] :] = 0.0
    kept[alone, 1:] = 0.0
    kept = (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32)
    return np.where(kept > 0.0, used[order], 0), kept


def joint_blends(weights: np.ndarray, bones: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Returns the blends (V, 3, 4) of the joints' affine maps ``moves`` (J, 12), flat, for vertices with ``weights``
    (V, 4) of the joints ``bones`` (V, 4)."""
    return np.einsum("vk,vkm->vm", weights.astype(np.float64), moves[bones]).reshape(-1, 3, 4)


def volume(moves: np.ndarray) -> np.ndarray:
    """Returns the factors (V,) by which the affine maps ``moves`` (V, 3, 4) enlarge volumes, negative where they
    mirror."""
    return np.linalg.det(moves[:, :, :3])
