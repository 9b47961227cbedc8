"""How deep cloth is in the skin."""

from __future__ import annotations

import igl
import numpy as np

from drape.geometry.closest import signed_distance


def depths_mm(vertices: np.ndarray, skin: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns how deep [mm] (V,) each of ``vertices`` [m] (V, 3) is in the closed ``skin`` [m] (B, 3) with ``faces``
    (F, 3); 0 for those outside.

    The winding number tells what is inside. Where a posed body cuts into itself, an armpit turns inside out and the
    normals of its nearest faces call the air beside it body.
    """
    depth = 1e3 * np.maximum(-signed_distance(vertices, skin, faces), 0.0)
    below = np.flatnonzero(depth)
    if len(below):
        points = vertices[below].astype(np.float64)
        turns = igl.fast_winding_number(skin.astype(np.float64), faces.astype(np.int64), points)
        depth[below[np.asarray(turns) <= 0.5]] = 0.0
    return depth
