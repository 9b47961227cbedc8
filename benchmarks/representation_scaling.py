"""Variables in which every free number of a patch is equally stiff.

A cubic term of the height and a shift of the whole patch differ in stiffness by orders of magnitude, and
L-BFGS needs some hundred steps only where the Hessian is near the identity. So the numbers of the patches
are scaled by a Cholesky factor of an approximate Hessian: the Gram matrix of the blended polynomials under
the cloth's stiffness. Each patch's own block of it is enough where only the energy counts; where overlapping
charts are made to agree, the sum of their numbers is soft and their difference stiff, and the factor of the
whole matrix is needed.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
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


class CoupledScaling:
    """All patches together: z (K n,) to numbers (K, n), from one Hessian (K n, K n)."""

    def __init__(self, hessian: Sparse, patch_count: int) -> None:
        dense = hessian.toarray()
        diagonal = np.einsum("ii->i", dense)
        diagonal += RIDGE * diagonal.max(initial=0.0) * 1e-3 + RIDGE * diagonal
        factor = scipy.linalg.cholesky(dense, overwrite_a=True, check_finite=False)
        self._factor = _tensor(factor)
        self._patch_count = patch_count
        self.size = len(factor)

    def numbers(self, z: Tensor) -> Tensor:
        """The numbers (K, n) of z (K n,)."""
        solved = torch.linalg.solve_triangular(self._factor, z[:, None], upper=True)
        return solved.reshape(self._patch_count, -1)

    def variables(self, numbers: Tensor) -> Tensor:
        """z (K n,) of the numbers (K, n)."""
        return self._factor @ numbers.reshape(-1)


Scaling = BlockScaling | CoupledScaling


def stiffness(vertices: np.ndarray, cloth: ClothMesh, material: Material) -> tuple[Sparse, Sparse]:
    """Approximate Hessians (V, V) [N/m] of the energy in one coordinate, along the cloth and across it."""
    laplacian = cotangent_laplacian(vertices, cloth.faces)
    stretch = (2.0 * material.mu_n_per_m + material.lambda_n_per_m) * laplacian
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


def moves(shapes: Sparse, columns: np.ndarray, rotation: np.ndarray) -> Sparse:
    """Movement (3 rows, K n) per number: ``shapes`` (rows, 15 K) scalar, ``columns`` (K, 45, n) the form's numbers
    as coefficients, ``rotation`` (K, 3, 3) the posed frames."""
    count, size = columns.shape[0], columns.shape[2]
    by_direction = columns.reshape(count, 3, jets.HEIGHT_COUNT, size)
    turned = np.einsum("kcd,kdjm->kjcm", rotation, by_direction).reshape(count, LOCAL, size)
    return Sparse(scipy.sparse.kron(shapes, np.eye(3), format="csr") @ scipy.sparse.block_diag(turned, format="csr"))


def energy_hessian(blended: Sparse, normals: np.ndarray, along: Sparse, across: Sparse) -> Sparse:
    """Approximate Hessian [J] of the energy in the numbers: ``blended`` (3 V, K n) is ``moves`` of the blend,
    ``normals`` (V, 3) split its movement into that along the cloth and that across it."""
    count = len(normals)
    rows = np.arange(3 * count)
    normal = Sparse((normals.ravel(), (rows, rows // 3)), shape=(3 * count, count))
    over = Sparse(normal.T @ blended)
    flat = Sparse(blended - normal @ over)
    return Sparse(flat.T @ (scipy.sparse.kron(along, np.eye(3), format="csr") @ flat) + over.T @ (across @ over))


def agreement_hessian(said: Sparse, blended: Sparse, weight: np.ndarray, share: np.ndarray) -> Sparse:
    """Hessian [m^2] of ``PatchSpace.disagreement`` in the numbers: ``said`` (12 V, K n) is ``moves`` of every chart,
    ``blended`` (3 V, K n) of their mean by ``weight`` (V, 4); ``share`` (V,) of the area."""
    each = scipy.sparse.diags(np.repeat((weight * share[:, None]).ravel(), 3))
    return Sparse(2.0 * (said.T @ each @ said - blended.T @ scipy.sparse.diags(np.repeat(share, 3)) @ blended))


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
