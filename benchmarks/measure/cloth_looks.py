"""Measures of cloth in motion beside the same cloth at rest: what an eye sees and an energy hardly does.

A share is 1 where a stream looks as its still does, more where it is crumpled, less where it is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.measure.detail import LowPass, dihedral_deg
from benchmarks.measure.hem import hem_vertices
from drape.cloth.rest_state import RestState
from drape.geometry import meshes

BANDS_M = (0.02, 0.08, 0.30)  # wavelengths between which relief is fine, middle and coarse
BANDS = ("fine", "middle", "coarse")


@dataclass(frozen=True, eq=False)
class ClothLooks:
    """What measures the looks of one garment: its mesh with ``faces`` (F, 3), their ``rest`` state, and the vertices
    ``place`` [m] (V, 3) at rest. ``vertices`` of its functions are drapes [m] (n, V, 3)."""

    rest: RestState
    faces: np.ndarray
    place: np.ndarray

    @cached_property
    def filters(self) -> tuple[LowPass, ...]:
        """A low-pass for each of ``BANDS_M``."""
        return tuple(LowPass.of(self.rest, self.faces, len(self.place), wave) for wave in BANDS_M)

    @cached_property
    def hems(self) -> list[np.ndarray]:
        """The indices of the vertices along each hem in order, an array (h,) for each."""
        hem = hem_vertices(self.place, self.faces)
        return [loop for loop in meshes.boundary_loops(self.faces) if np.isin(loop, hem).all()]

    @cached_property
    def inner(self) -> np.ndarray:
        """Which vertices (V,) lie within the cloth, not on a border."""
        inside = np.zeros(len(self.place), dtype=bool)
        inside[self.faces] = True
        inside[meshes.boundary_edges(self.faces)] = False
        return inside

    def curvature(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the total Gaussian curvature [rad] (n,): |2 pi - angles round a vertex|, summed over inner vertices.
        Cloth folds along lines and has hardly any; crumpled cloth has peaks and dimples."""
        totals = []
        for corners in vertices[:, self.faces]:
            turned = np.zeros(len(self.place))
            for first in range(3):
                ahead, back = (corners[:, (first + step) % 3] - corners[:, first] for step in (1, 2))
                sine = np.linalg.norm(np.cross(ahead, back), axis=1)
                np.add.at(turned, self.faces[:, first], np.arctan2(sine, (ahead * back).sum(axis=1)))
            totals.append(np.abs(2.0 * np.pi - turned)[self.inner].sum())
        return np.array(totals)

    def strain_pct(self, vertices: np.ndarray) -> float:
        """Returns the 99.9th percentile [%], over all of ``vertices`` [m] (n, V, 3), of how much longer or shorter than
        at rest an edge is; two edges of every triangle count."""
        rest = np.linalg.norm(self.rest.edges, axis=2)
        corners = vertices[:, self.faces]
        lengths = np.linalg.norm(corners[:, :, 1:] - corners[:, :, :1], axis=3)
        return 100.0 * float(np.percentile(np.abs(lengths / rest - 1.0), 99.9))

    def dihedral_deg(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the RMS dihedral angle [deg] (n,) of ``vertices`` [m] (n, V, 3)."""
        return dihedral_deg(vertices, self.faces)

    def area_m2(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the area [m^2] (n,) of ``vertices`` [m] (n, V, 3)."""
        return np.array([meshes.face_areas(x, self.faces).sum() for x in vertices])

    def relief_mm(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the RMS height [mm] (n, 3) of the waves of ``vertices`` [m] (n, V, 3) in the fine, the middle and the
        coarse band, along the normals of the surface without the band."""
        heights = np.stack([self._height_m(vertices, band) for band in range(len(BANDS_M))], axis=-1)
        weight = self.filters[0].vertex_area
        return 1e3 * np.sqrt(np.einsum("nvb,v->nb", heights**2, weight) / weight.sum())

    def hem_mm(self, vertices: np.ndarray) -> np.ndarray:
        """Returns the RMS third difference [mm] (n,) from vertex to vertex along the hems of ``vertices`` [m]
        (n, V, 3); NaN for a garment without hems."""
        if not self.hems:
            return np.full(len(vertices), np.nan)
        third = [
            x - 3.0 * np.roll(x, -1, axis=1) + 3.0 * np.roll(x, -2, axis=1) - np.roll(x, -3, axis=1)
            for x in (vertices[:, loop] for loop in self.hems)
        ]
        return 1e3 * np.sqrt((np.concatenate(third, axis=1) ** 2).sum(axis=-1).mean(axis=1))

    def pop(self, vertices: np.ndarray) -> float:
        """Returns the RMS change of the height of fine waves from one frame of ``vertices`` [m] (F, V, 3) to the next,
        over the RMS of that height: 0 where folds move with the cloth, 1.4 where every frame has others."""
        height = self._height_m(vertices, 0)
        return float(np.sqrt((np.diff(height, axis=0) ** 2).mean() / (height**2).mean()))

    def _height_m(self, vertices: np.ndarray, band: int) -> np.ndarray:
        """Height [m] (n, V) in a ``band``."""
        smooth = self.filters[band].smoothed(vertices)
        upper = vertices if band == 0 else self.filters[band - 1].smoothed(vertices)
        return ((upper - smooth) * meshes.vertex_normals(smooth, self.faces)).sum(axis=-1)
