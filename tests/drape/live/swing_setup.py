"""A strip of cloth that hangs from its upper edge, far from any skin."""

from __future__ import annotations

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.live.fold_step import Frame
from drape.live.skin_walks import NEIGHBOURS, SkinGraph
from drape.live.swing_mesh import SwingMesh, swing_mesh
from drape.live.swing_step import SwingConstants

LENGTH_M, WIDTH_M, EDGE_M = 0.6, 0.16, 0.02
FAR_SKIN = np.array([[0.0, 5.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])


def strip(length_m: float = LENGTH_M) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] (V, 3) from y = 0 down, and faces."""
    down, across = round(length_m / EDGE_M) + 1, round(WIDTH_M / EDGE_M) + 1
    y, x = np.meshgrid(-EDGE_M * np.arange(down), EDGE_M * np.arange(across), indexing="ij")
    i = (across * np.arange(down - 1)[:, None] + np.arange(across - 1)).reshape(-1)
    faces = np.concatenate(
        [np.stack([i, i + across, i + 1], axis=1), np.stack([i + 1, i + across, i + across + 1], axis=1)]
    )
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), faces


def hanging(dtype: type[np.floating] = np.float64, length_m: float = LENGTH_M) -> tuple[np.ndarray, SwingMesh]:
    """The strip and its swing mesh, held along its upper edge."""
    rest, faces = strip(length_m)
    made = swing_mesh(ClothMesh.from_rest(rest, faces), Material(), rest, rest[:, 1] > -1e-9, dtype=dtype)
    assert made is not None
    return rest, made


def constants(mesh: SwingMesh, *, damping_per_s: float = 0.0) -> SwingConstants:
    """Of the strip beside skin that is out of reach."""
    dtype = mesh.mass_kg.dtype
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1, dtype), np.zeros((1, 3), dtype))
    count = len(mesh.vertex)
    return SwingConstants(mesh, graph, np.zeros(count, np.int32), 300.0, damping_per_s, np.ones(count, dtype))


def frame(rest: np.ndarray, time_s: float) -> Frame:
    return Frame(rest, FAR_SKIN, time_s)
