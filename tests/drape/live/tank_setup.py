"""How stretched a tank is."""

from __future__ import annotations

import numpy as np

from tests.fixtures.garments import shipped


def strain(vertices: np.ndarray) -> float:
    """Mean square of (length / length at rest - 1) over two edges of every triangle."""
    garment = shipped("tank")
    rest = np.linalg.norm(garment.delivered_rest().edges, axis=2)
    first, second, third = (vertices[garment.faces[:, n]] for n in range(3))
    now = np.stack([np.linalg.norm(other - first, axis=1) for other in (second, third)], axis=1)
    return float(((now / rest - 1.0) ** 2).mean())
