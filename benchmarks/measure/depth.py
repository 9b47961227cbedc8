"""How deep cloth is in the skin."""

from __future__ import annotations

import igl
import numpy as np

from drape.geometry.closest import signed_distance


def depth_mm(vertices: np.ndarray, skin: np.ndarray, faces: np.ndarray) -> float:
    """How deep [mm] the deepest of ``vertices`` [m] (V, 3) is in a closed ``skin`` [m] (B, 3), (F, 3); 0 where none is.

    The winding number tells what is inside. Where a posed body cuts into itself, an armpit turns inside out and the
    normals of its nearest faces call the air beside it body.
    """
    distance = signed_distance(vertices, skin, faces)
    below = np.flatnonzero(distance < 0.0)
    if not len(below):
        return 0.0
    turns = igl.fast_winding_number(skin.astype(np.float64), faces.astype(np.int64), vertices[below].astype(np.float64))
    return 1e3 * float(np.max(-distance[below], where=np.asarray(turns) > 0.5, initial=0.0))
