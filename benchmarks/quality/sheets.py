"""Sheets of skinning with push-out, network and physics below each other, a column per hard pose, strain as colour."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.shared.render import SKIN, Surface, render, sheet
from drape.garment.cache import Garment
from drape.geometry import meshes

METHODS = ("skinning_push", "network", "physics")
FULL_COLOUR = 0.20  # of area
STRETCHED, PRESSED, UNCHANGED = np.array([0.85, 0.12, 0.12]), np.array([0.12, 0.25, 0.85]), np.array([0.93, 0.93, 0.93])
COLUMNS = 6
SIZE, EXTENT_M = (300, 230), 1.5


def strain_colours(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3) of the triangles by their change of area: white at rest length, red stretched, blue pressed."""
    change = meshes.face_areas(vertices, faces) / meshes.face_areas(rest, faces) - 1.0
    share = np.clip(np.abs(change) / FULL_COLOUR, 0.0, 1.0)[:, None]
    return (1.0 - share) * UNCHANGED + share * np.where(change[:, None] > 0.0, STRETCHED, PRESSED)


def strain_sheet(
    garment: Garment, positions: Mapping[str, np.ndarray], skin: np.ndarray, skin_faces: np.ndarray
) -> np.ndarray:
    """The sheet of one garment: ``positions`` [m] (F, V, 3) by method on the bodies ``skin`` [m] (F, Vb, 3)."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    rows = []
    for method in METHODS:
        row = []
        for frame, vertices in enumerate(positions[method][:COLUMNS]):
            cloth = Surface(vertices, faces, strain_colours(vertices, rest, faces))
            body = Surface(skin[frame], skin_faces, SKIN)
            centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            row.append(render([body, cloth], size=SIZE, azimuth_deg=20.0, centre=centre, extent_m=EXTENT_M))
        rows.append(row)
    return sheet(rows)
