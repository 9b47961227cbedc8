"""Measures of cloth in motion beside the same cloth at rest: what an eye sees and an energy hardly does.

A share is 1 where a stream looks as its still does, more where it is crumpled, less where it is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.measure.detail import LowPass, dihedral_deg
from benchmarks.measure.hem import hem_vertices
from drape.cloth.rest_state import RestState, dihedral_angles
from drape.geometry import meshes

BANDS_M = (0.02, 0.08, 0.30)  # wavelengths between which relief is fine, middle and coarse
SHARP_DEG = 60.0  # a hinge that is folded by more is creased


@dataclass(frozen=True, eq=False)
class Looks:
    """The looks of a garment with the ``rest`` state of its ``faces`` (F, 3), whose vertices are at ``place`` [m]
    (V, 3) at rest."""

    rest: RestState
    faces: np.ndarray
    place: np.ndarray

    @cached_property
    def filters(self) -> tuple[LowPass, ...]:
        """A low-pass for each of ``BANDS_M``."""
        return tuple(LowPass.of(self.rest, self.faces, len(self.place), wave) for wave in BANDS_M)

    @cached_property
    def hems(self) -> list[np.ndarray]:
        """The loops of hem vertices."""
        hem = hem_vertices(self.place, self.faces)
        return [loop for loop in meshes.boundary_loops(self.faces) if np.isin(loop, hem).all()]

    def dihedral_deg(self, vertices: np.ndarray) -> np.ndarray:
        """RMS dihedral angle [deg] (n,) of ``vertices`` [m] (n, V, 3)."""
        return dihedral_deg(vertices, self.faces)

    def sharp_pct(self, vertices: np.ndarray) -> np.ndarray:
        """Share [%] (n,) of hinges folded by more than ``SHARP_DEG``."""
        limit = np.radians(SHARP_DEG)
        return np.array([100.0 * (np.abs(dihedral_angles(x, self.faces)) > limit).mean() for x in vertices])

    def area_m2(self, vertices: np.ndarray) -> np.ndarray:
        """Area [m^2] (n,)."""
        return np.array([meshes.face_areas(x, self.faces).sum() for x in vertices])

    def relief_mm(self, vertices: np.ndarray) -> np.ndarray:
        """RMS height [mm] (n, 3) in the fine, middle and coarse band, along normals of the surface without the band."""
        heights = np.stack([self._height_m(vertices, band) for band in range(len(BANDS_M))], axis=-1)
        weight = self.filters[0].vertex_area
        return 1e3 * np.sqrt(np.einsum("nvb,v->nb", heights**2, weight) / weight.sum())

    def hem_mm(self, vertices: np.ndarray) -> np.ndarray:
        """RMS third difference [mm] (n,) along the hems; NaN where there is none."""
        if not self.hems:
            return np.full(len(vertices), np.nan)
        third = [
            x - 3.0 * np.roll(x, -1, axis=1) + 3.0 * np.roll(x, -2, axis=1) - np.roll(x, -3, axis=1)
            for x in (vertices[:, loop] for loop in self.hems)
        ]
        return 1e3 * np.sqrt((np.concatenate(third, axis=1) ** 2).sum(axis=-1).mean(axis=1))

    def pop(self, vertices: np.ndarray) -> float:
        """RMS change of the fine height from one frame of ``vertices`` [m] (F, V, 3) to the next one, over its RMS: 0
        where folds go along, 1.4 where they are others in every frame."""
        height = self._height_m(vertices, 0)
        return float(np.sqrt((np.diff(height, axis=0) ** 2).mean() / (height**2).mean()))

    def _height_m(self, vertices: np.ndarray, band: int) -> np.ndarray:
        """Height [m] (n, V) in a ``band``."""
        smooth = self.filters[band].smoothed(vertices)
        upper = vertices if band == 0 else self.filters[band - 1].smoothed(vertices)
        return ((upper - smooth) * meshes.vertex_normals(smooth, self.faces)).sum(axis=-1)
