"""The fine relief of a drape: its height over its low-pass surface, and the angles of its hinges.

The low-pass u of a surface x minimises |u - x|^2 + t^2 |L u|^2 over the area of the rest metric, L the
Laplace-Beltrami operator (cotangents of the rest triangles, lumped areas, free borders):

    u = (M + t^2 K M^-1 K)^-1 M x,  L = M^-1 K

A wave of length w keeps 1 / (1 + (c / w)^4) of its amplitude with t = (c / 2 pi)^2: half of it at w = c, 0.999 of it at
30 cm and 0.025 at 2 cm for c = 5 cm. One implicit step, (M + t K)^-1 M, has a power of two in place of four: it would
take a sleeve of 5 cm radius to be 1.2 mm off its low-pass, this takes it to be 0.03 mm off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import RestState, dihedral_angles
from drape.geometry import meshes

WAVELENGTH_M = 0.05  # half the amplitude of such a wave counts as detail


@dataclass(frozen=True, eq=False)
class LowPass:
    """The low-pass filter of one garment's mesh (the module has its equation), factored once: ``solve`` filters fields
    (V, n); ``vertex_area`` (V,) [m^2] is at rest."""

    faces: np.ndarray
    vertex_area: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def of(cls, rest: RestState, faces: np.ndarray, vertex_count: int, wavelength_m: float = WAVELENGTH_M) -> LowPass:
        """Returns the filter of ``faces`` (F, 3) with the ``rest`` state that leaves half of the amplitude of waves as
        long as ``wavelength_m``."""
        area = ClothMesh.of(rest, faces, vertex_count).vertex_area
        weight = np.where(area > 0.0, area, area.mean())  # a vertex without a triangle stays where it is
        mass, stiffness = scipy.sparse.diags(weight), cotangent_matrix(rest, faces, vertex_count)
        time_m2 = (wavelength_m / (2.0 * np.pi)) ** 2
        system = mass + time_m2**2 * (stiffness @ scipy.sparse.diags(1.0 / weight) @ stiffness)
        # Symmetric and positive definite: the pattern may be ordered as such, and nothing needs a pivot.
        factor = scipy.sparse.linalg.splu(
            system.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        return cls(faces, area, lambda fields: factor.solve(weight[:, None] * fields))

    def smoothed(self, vertices: np.ndarray) -> np.ndarray:
        """Returns ``vertices`` [m] (..., V, 3) filtered: the low-pass surface [m] (..., V, 3)."""
        columns = np.moveaxis(np.asarray(vertices, dtype=np.float64), -2, 0)
        flat = self.solve(np.ascontiguousarray(columns.reshape(len(columns), -1)))
        return np.moveaxis(flat.reshape(columns.shape), 0, -2)

    def detail_mm(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the RMS height [mm] (...,) of ``vertices`` [m] (..., V, 3) over their low-pass surface, weighted by
        the area at rest.

        It is measured along the normal of that surface: near a border smoothing also moves vertices within it.
        """
        smooth = self.smoothed(vertices)
        height = ((vertices - smooth) * meshes.vertex_normals(smooth, self.faces)).sum(axis=-1)
        return 1e3 * np.sqrt(height**2 @ self.vertex_area / self.vertex_area.sum())


def cotangent_matrix(rest: RestState, faces: np.ndarray, vertex_count: int) -> scipy.sparse.csr_matrix:
    """Returns the stiffness matrix K (V, V) of linear finite elements on the rest triangles: x^T K x is the integral of
    |grad x|^2.

    An entry off the diagonal is minus half the sum of the cotangents of the two angles opposite that edge (Pinkall &
    Polthier 1993).
    """
    first, second = rest.edges[:, 0], rest.edges[:, 1]
    opposite = np.stack([second - first, -second, first], axis=1)  # (F, 3, 2): the side opposite each corner
    local = (opposite @ opposite.transpose(0, 2, 1)) / (4.0 * rest.face_area)[:, None, None]
    rows, columns = np.broadcast_arrays(faces[:, :, None], faces[:, None, :])
    return scipy.sparse.csr_matrix((local.ravel(), (rows.ravel(), columns.ravel())), shape=(vertex_count, vertex_count))


def dihedral_deg(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the RMS dihedral angle [deg] (n,) over the hinges of each drape of ``vertices`` [m] (n, V, 3)."""
    return np.degrees([np.sqrt(np.mean(dihedral_angles(frame, faces) ** 2)) for frame in vertices])
