"""Weights of a garment's vertices on the joints of a character's own rig, and the blends that they make."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from drape.avatar.file_skeleton import FileRig
from drape.avatar.parts import PARTS, parts_of, plain_part
from drape.avatar.wearer import Wearer
from drape.garment.cache import Garment
from drape.garment.skin import smoothing_matrix
from drape.geometry.closest import closest_point

HEAVIEST = 4  # joints of a vertex, which is what players support
SMOOTHING_PASSES = 6


def garment_weights(garment: Garment, wearer: Wearer, rig: FileRig) -> scipy.sparse.csr_matrix:
    """Weights (D, J) of the joints for each vertex that is drawn: those of the skin next to the cloth there, smooth.

    Hair, fingers and what else is no trunk or limb moves no cloth.
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
    """The heaviest joints (V, 4) of each vertex and their weights, float32, summing to one; a single one where a vertex
    is to have it ``alone`` (V,)."""
    used = np.unique(weights.indices)  # of thousands of joints few move a garment
    dense = weights[:, used].toarray()
    order = np.argsort(-dense, axis=1, kind="stable")[:, :HEAVIEST]
    order = np.pad(order, ((0, 0), (0, HEAVIEST - order.shape[1])))
    kept = np.take_along_axis(dense, order, axis=1)
    kept[:, dense.shape[1] :] = 0.0
    kept[alone, 1:] = 0.0
    kept = (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32)
    return np.where(kept > 0.0, used[order], 0), kept


def blended(weights: np.ndarray, bones: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """The blends (V, 3, 4) of ``moves`` (J, 12) by ``weights`` (V, 4) of ``bones`` (V, 4)."""
    return np.einsum("vk,vkm->vm", weights.astype(np.float64), moves[bones]).reshape(-1, 3, 4)


def volume(moves: np.ndarray) -> np.ndarray:
    """Returns the factors (V,) by which ``moves`` (V, 3, 4) make volumes larger."""
    return np.linalg.det(moves[:, :, :3])


def undone(moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of the linear part (V, 3, 3) of ``moves`` (V, 3, 4), and their translation (V, 3)."""
    return np.linalg.inv(moves[:, :, :3]), moves[:, :, 3]
