"""The equations of a swing mesh once more, in NumPy, to be read and compared with the engine's."""

from __future__ import annotations

import numpy as np

from drape.live.swing_mesh import SwingMesh

COMPRESSED = 0.2


def triangles(mesh: SwingMesh) -> tuple[np.ndarray, np.ndarray]:
    """Corners (T, 3) and slopes (T, 5) of the coarse triangles, each once."""
    own = np.repeat(np.arange(len(mesh.vertex)), np.diff(mesh.start))
    corner = np.concatenate([own[:, None], mesh.other], axis=1)
    once = corner[:, 0] == corner.min(axis=1)
    return corner[once], mesh.slope[once].astype(np.float64)


def strains(c: np.ndarray, mesh: SwingMesh) -> np.ndarray:
    """Green's strain (T, 2, 2) of the coarse triangles at ``c`` [m] (N, 3)."""
    corner, slope = triangles(mesh)
    sides = c[corner[:, 1:]] - c[corner[:, :1]]
    columns = np.einsum("tcx,tac->tax", sides, np.stack([slope[:, 0:2], slope[:, 2:4]], axis=1))
    return 0.5 * (np.einsum("tax,tbx->tab", columns, columns) - np.eye(2))


def pulled(strain: np.ndarray) -> np.ndarray:
    """The part of symmetric matrices (T, 2, 2) with their positive principal values."""
    value, vector = np.linalg.eigh(strain)
    return np.einsum("tap,tp,tbp->tab", vector, np.maximum(value, 0.0), vector)


def length_energy(c: np.ndarray, still: np.ndarray, mesh: SwingMesh, young_n_per_m: float) -> float:
    """Energy [J] of nodes ``c`` [m] (N, 3) where still cloth has them at ``still``.

    It is the sum of A Y / 2 (|(G - G0+)+|^2 + ``COMPRESSED`` |(G - G0-)-|^2).
    """
    area, strain, before = triangles(mesh)[1][:, 4], strains(c, mesh), strains(still, mesh)
    over, under = pulled(strain - pulled(before)), pulled(-pulled(-before) - strain)
    square = (over**2 + COMPRESSED * under**2).sum(axis=(1, 2))
    return 0.5 * young_n_per_m * float((area * square).sum())


def pull_matrix(mesh: SwingMesh) -> np.ndarray:
    """K [N/m] (N, N): by how much weight pulls nodes back to still cloth."""
    matrix = np.zeros((len(mesh.vertex), len(mesh.vertex)))
    row = np.repeat(np.arange(len(mesh.vertex)), np.diff(mesh.pull_start))
    matrix[row, mesh.pull_node] = mesh.pull
    return matrix
