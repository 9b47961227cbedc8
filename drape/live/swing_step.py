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
    """The constants that the engine reads of a garment in a fabric.

    The coarse ``mesh``; the skin's ``graph`` and the sample ``index`` (N,) nearest to each node at rest; the fabric's
    stiffness [N/m] and damping [1/s]; ``held`` (N,): the share of the hold near the skin that each node has.
    """

    mesh: SwingMesh
    graph: SkinGraph
    index: np.ndarray
    young_n_per_m: float
    damping_per_s: float
    held: np.ndarray

    @property
    def nbytes(self) -> int:
        """The memory of the mesh [bytes]."""
        return array_bytes(tuple(self.mesh)) + self.index.nbytes + self.held.nbytes


@dataclass(frozen=True, eq=False)
class SwingMemory(FrameMemory, Recorded):
    """A frame as swing remembers it: the ``origin`` of its coordinates in the world [m] (3,); where the nodes
    ``swung`` to [m] and their ``speed`` [m/s] (N, 3); how fast the network had them ``climb`` [m/s] (N,), no number
    where it is not known; the samples ``touched`` (N,) below them; since when [s] (1,) the
    network has not moved; and the ``colliders`` (M, 16), from that origin."""

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
    """The vertices [m] (V, 3) of ``frame`` with a ``share`` of their swing, and the memory for the next frame.

    ``origin`` [m] (3,) is that of the frame's coordinates in the world. The same input gives the same bits; ``memory``
    is not written to. In a frame without a past, and in one to which no swing leads, cloth hangs still.
    """
    dtype = constants.mesh.mass_kg.dtype
    vertices, around = writable(frame.vertices, dtype), frame.around(dtype)
    after = empty_memory(constants, frame.time_s, origin, around.colliders)
    given = (memory or NO_PAST, Record("Surroundings", around, dtype), constants, float(share))
    out = np.empty_like(vertices)
    moved = call_with_scratch("swing", dtype, vertices, len(vertices), *given, after, out)
    return out if moved else frame.vertices, after


def empty_memory(constants: SwingConstants, time_s: float, origin: np.ndarray, colliders: np.ndarray) -> SwingMemory:
    """The memory of a frame at ``time_s`` [s], which the engine fills: ``origin`` [m] (3,) and ``colliders`` (M, 16)
    from there are the frame's."""
    dtype, count = constants.mesh.mass_kg.dtype, len(constants.mesh.vertex)
    network, swung, speed = np.empty((3, count, 3), dtype)
    here = np.ascontiguousarray(origin, np.float64)
    climb, touched = np.empty(count, dtype), np.empty(count, np.int32)
    return SwingMemory(time_s, network, here, swung, speed, climb, touched, np.empty(1), colliders)
