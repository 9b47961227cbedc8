"""Variables in which every free number of a patch is equally stiff.

A cubic term of the height and a shift of the whole patch differ in stiffness by orders of magnitude, and
L-BFGS needs some hundred steps only where the Hessian is near the identity. So the numbers of a patch
are scaled by a Cholesky factor of its block of an approximate Hessian: the Gram matrix of the blended polynomials
under the cloth's stiffness.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.geometry import jets, meshes

LOCAL = 3 * jets.HEIGHT_COUNT  # room for polynomials of order 4 in all three directions
# Stiffness against the membrane's: along the cloth, and across it, where stress and contact hold it.
ALONG, ACROSS = 0.5, 0.15
# Shares of the contact stiffness: most vertices that could touch do not.
HELD_ALONG, HELD_ACROSS = 0.002, 0.3
RIDGE = 1e-6

Sparse = scipy.sparse.csr_matrix


class BlockScaling:
    """Every patch by itself: z (K n,) to numbers (K, n), from Hessian blocks (K, n, n)."""

    def __init__(self, hessian: np.ndarray) -> None:
        size = hessian.shape[2]
        diagonal = np.maximum(np.einsum("kii->ki", hessian), 1e-12)
        factor = np.linalg.cholesky(hessian + RIDGE * diagonal[:, None] * np.eye(size))
        self._onto = _tensor(np.linalg.inv(factor).transpose(0, 2, 1))  # hessian^-1 = onto onto^T
        self._back = _tensor(factor.transpose(0, 2, 1))
        self.size = hessian.shape[0] * size

    def numbers(self, z: Tensor) -> Tensor:
        """The numbers (K, n) of z (K n,)."""
        return (self._onto @ z.reshape(*self._onto.shape[:2], 1))[..., 0]

    def variables(self, numbers: Tensor) -> Tensor:
        """z (K n,) of the numbers (K, n)."""
        return (self._back @ numbers[..., None]).reshape(-1)


def stiffness(vertices: np.ndarray, cloth: ClothMesh, material: Material) -> tuple[Sparse, Sparse]:
    """Approximate Hessians (V, V) [N/m] of the energy in one coordinate, along the cloth and across it."""
    laplacian = cotangent_laplacian(vertices, cloth.faces)
    stretch = material.warp_n_per_m * laplacian
    bend = material.bending_j * (laplacian @ scipy.sparse.diags(1.0 / cloth.vertex_area) @ laplacian)
    held = scipy.sparse.diags(material.contact_j_m4 * cloth.vertex_area)
    return Sparse(ALONG * stretch + HELD_ALONG * held), Sparse(ACROSS * stretch + bend + HELD_ACROSS * held)


def cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> Sparse:
    """Positive semidefinite (V, V): ``f^T L f`` is the integral of |grad f|^2; obtuse corners count as right angles."""
    start, end, opposite = meshes.half_edges(np.asarray(faces)).T
    a, b = vertices[start] - vertices[opposite], vertices[end] - vertices[opposite]
    cotangent = np.sum(a * b, axis=1) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-15)
    graph = Sparse((0.5 * np.maximum(cotangent, 0.0), (start, end)), shape=(len(vertices),) * 2)
    graph = graph + graph.T
    return Sparse(scipy.sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph)


def gram_blocks(shapes: Sparse, along: Sparse, across: Sparse) -> np.ndarray:
    """Blocks (K, 45, 45) of ``shapes^T stiffness shapes`` (V, 15 K): twice ``along`` the patch, once ``across``."""
    count, columns = jets.HEIGHT_COUNT, shapes.tocsc()
    found = np.zeros(((len(columns.indptr) - 1) // count, LOCAL, LOCAL))
    for k, block in enumerate(found):
        own = columns[:, k * count : (k + 1) * count]
        rows = np.unique(own.indices)
        dense = own[rows].toarray()
        flat = dense.T @ (along[rows][:, rows] @ dense)
        block[:count, :count] = block[count : 2 * count, count : 2 * count] = flat
        block[2 * count :, 2 * count :] = dense.T @ (across[rows][:, rows] @ dense)
    return found


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
