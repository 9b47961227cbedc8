"""One frame of swing: the network's drape of a still body in, cloth with inertia out.

The engine computes it (``drape/engine/source/swing.hpp``, which has the equations). A coarse mesh of nodes with their
mass hangs from where the network has it (``drape.live.swing_mesh``), and the vertices move and turn as the nodes do
beside the still cloth, so that on a still body all comes to rest at the network's drape.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.packer import Record, Recorded
from drape.live.clock import Frame, FrameMemory, writable
from drape.live.fold_constants import array_bytes
from drape.live.skin_walks import SkinGraph
from drape.live.swing_mesh import SwingMesh

SWING_HZ = 1.5  # frequency at which damping in proportion to mass equals the fabric's, in proportion to stiffness


@dataclass(frozen=True, eq=False)
class SwingConstants(Recorded):
    """The constants of swing of a garment in a fabric, as the engine reads them.

    ``mesh`` are the N nodes; ``graph`` are the skin samples, ``index`` (N,) the one nearest to each node at rest.
    ``young_n_per_m`` [N/m] and ``damping_per_s`` [1/s] are the fabric's. ``held`` (N,) is the factor of ``held_share``
    at each node.
    """

    mesh: SwingMesh
    graph: SkinGraph
    index: np.ndarray
    young_n_per_m: float
    damping_per_s: float
    held: np.ndarray

    @property
    def nbytes(self) -> int:
        """The memory of the garment's own arrays, in bytes; the skin's graph is shared."""
        return array_bytes(tuple(self.mesh)) + self.index.nbytes + self.held.nbytes


@dataclass(frozen=True, eq=False)
class SwingMemory(FrameMemory, Recorded):
    """What a frame of swing leaves to the next one. Its N points are the nodes of ``SwingMesh``; coordinates count from
    ``origin`` [m] (3,) in the world.

    ``swung`` [m] (N, 3) is where the nodes were and ``speed`` [m/s] (N, 3) how they moved. ``climb`` [m/s] (N,) is how
    fast the network's drape of each went up, NaN where it is not known. ``touched`` (N,) are the skin samples below
    the nodes, ``still_since_s`` [s] (1,) is the time since when the network's drape has not moved, and ``colliders``
    (M, 16) are the scene's.
    """

    origin: np.ndarray
    swung: np.ndarray
    speed: np.ndarray
    climb: np.ndarray
    touched: np.ndarray
    still_since_s: np.ndarray
    colliders: np.ndarray


_NONE = np.zeros(0, np.float32)
NO_PAST = SwingMemory(
    -math.inf, _NONE, np.zeros(3), _NONE, _NONE, _NONE, np.zeros(0, np.int32), np.zeros(1), np.zeros(0)
)


def swing(
    constants: SwingConstants, memory: SwingMemory | None, frame: Frame, origin: np.ndarray, *, share: float = 1.0
) -> tuple[np.ndarray, SwingMemory]:
    """Returns the vertices [m] (V, 3) of ``frame`` with a ``share``, 0 to 1, of their swing, and the memory for the
    next frame.

    ``origin`` [m] (3,) is that of the frame's coordinates in the world. The same input gives the same bits; ``memory``
    is only read. Cloth begins at rest in a frame that cannot go on from ``memory``: there is none, its time is not
    within ``PAUSE_S`` before, or the network's drape has jumped.
    """
    dtype = constants.mesh.mass_kg.dtype
    vertices, around = writable(frame.vertices, dtype), frame.around(dtype)
    after = empty_memory(constants, frame.time_s, origin, around.colliders)
    given = (memory or NO_PAST, Record("Surroundings", around, dtype), constants, float(share))
    out = np.empty_like(vertices)
    moved = call_with_scratch("swing", dtype, vertices, len(vertices), *given, after, out)
    return out if moved else frame.vertices, after


def empty_memory(constants: SwingConstants, time_s: float, origin: np.ndarray, colliders: np.ndarray) -> SwingMemory:
    """Returns an unwritten memory for a frame at ``time_s`` [s], which the engine fills. ``origin`` [m] (3,) is that of
    the frame's coordinates in the world, ``colliders`` (M, 16) are those of the scene from there."""
    dtype, count = constants.mesh.mass_kg.dtype, len(constants.mesh.vertex)
    network, swung, speed = np.empty((3, count, 3), dtype)
    here = np.ascontiguousarray(origin, np.float64)
    climb, touched = np.empty(count, dtype), np.empty(count, np.int32)
    return SwingMemory(time_s, network, here, swung, speed, climb, touched, np.empty(1), colliders)
