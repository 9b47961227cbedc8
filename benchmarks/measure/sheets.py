"""Sheets of skinning with push-out, network and physics below each other, a column per hard pose.

Strain as colour, or plain cloth under a raking light, which shows what ``detail_mm`` counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.shared.render import LIGHT, PLAIN_CLOTH, RAKING_LIGHT, SKIN, Surface, render, sheet
from drape.garment.cache import Garment
from drape.geometry import meshes

METHODS = ("skinning_push", "network", "physics")
FULL_COLOUR = 0.20  # of area
STRETCHED, PRESSED, UNCHANGED = np.array([0.85, 0.12, 0.12]), np.array([0.12, 0.25, 0.85]), np.array([0.93, 0.93, 0.93])
COLUMNS = 6
Colour = tuple[float, float, float] | np.ndarray
SIZE, EXTENT_M = (300, 230), 1.5
CLOTH_SIZE, CLOTH_MARGIN = (420, 330), 1.15


@dataclass(frozen=True, eq=False)
class Drapes:
    """A garment's drapes to draw: ``positions`` [m] (F, V, 3) by method on the bodies ``skin`` [m] (F, Vb, 3)."""

    garment: Garment
    positions: Mapping[str, np.ndarray]
    skin: np.ndarray
    skin_faces: np.ndarray


def strain_colours(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3) of the triangles by their change of area: white at rest length, red stretched, blue pressed."""
    change = meshes.face_areas(vertices, faces) / meshes.face_areas(rest, faces) - 1.0
    share = np.clip(np.abs(change) / FULL_COLOUR, 0.0, 1.0)[:, None]
    return (1.0 - share) * UNCHANGED + share * np.where(change[:, None] > 0.0, STRETCHED, PRESSED)


def strain_sheet(drapes: Drapes) -> np.ndarray:
    """The sheet of one garment with the colours of ``strain_colours``."""
    rest, faces = drapes.garment.vertices.astype(np.float64), drapes.garment.fine_faces.astype(np.int64)
    return _sheet(drapes, lambda vertices: strain_colours(vertices, rest, faces), SIZE, EXTENT_M, LIGHT)


def cloth_sheet(drapes: Drapes) -> np.ndarray:
    """The sheet of one garment as plain cloth, as large as the garment allows, under a raking light."""
    tallest = max(float(np.ptp(drapes.positions[method][:COLUMNS, :, 1], axis=1).max()) for method in METHODS)
    return _sheet(drapes, lambda _: PLAIN_CLOTH, CLOTH_SIZE, CLOTH_MARGIN * tallest, RAKING_LIGHT)


def _sheet(
    drapes: Drapes,
    colour: Callable[[np.ndarray], Colour],
    size: tuple[int, int],
    extent_m: float,
    light: np.ndarray,
) -> np.ndarray:
    faces = drapes.garment.fine_faces.astype(np.int64)
    rows = []
    for method in METHODS:
        row = []
        for frame, vertices in enumerate(drapes.positions[method][:COLUMNS]):
            cloth = Surface(vertices, faces, colour(vertices))
            body = Surface(drapes.skin[frame], drapes.skin_faces, SKIN)
            centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            row.append(
                render([body, cloth], size=size, azimuth_deg=20.0, centre=centre, extent_m=extent_m, light=light)
            )
        rows.append(row)
    return sheet(rows)
