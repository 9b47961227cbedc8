"""One frame of swing: the network's drape of a still body in, cloth with inertia out.

Cloth that hangs freely is a coarse mesh of nodes with their mass. A node goes on where it went,

    c' = c0 + h v,

air slows v along the surface's normal, and the fabric damps it. Weight then pulls the node back to where still cloth
would be, and the length of the cloth holds it (``drape.live.swing_nodes``), both by implicit Euler. The vertices move
and turn as the nodes do beside the still cloth (``drape.live.swing_carry``), so that on a still body all comes to rest
at the network's drape. A node that the network has near the skin is held there; in a wide skirt hardly
(``drape.live.swing_slack``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, farthest_m, scaled, sub
from drape.live.clock import Frame, FrameMemory, follows, step_between
from drape.live.skin_contact import NEIGHBOURS, SkinGraph, TouchedSamples, follow
from drape.live.swing_carry import move_vertices
from drape.live.swing_mesh import SwingMesh
from drape.live.swing_nodes import GAP_M, TOUCH_M, Ground, Springs, fall_back, keep_length, write_bounds

NEAR_M, FREE_M = 0.008, 0.04  # over the skin: lower nodes are held, higher ones free
HOLD_N_PER_M, LEAST_FREE = 2.0, 0.01  # the hold of a node that is half free; the least that a node is free
ROUNDS, TURNS = 20, 6  # of conjugate gradients, and of sweeps there and back for length
AIR_KG_M3 = 0.72  # half of air's density times the drag of a plate across
SWING_HZ = 1.5  # frequency at which damping in proportion to mass equals the fabric's, in proportion to stiffness
# A body that stands still for longer slows its cloth more and more, but not so much that it creeps.
CALM_S, CALMER_PER_S2, CALMEST_PER_S = 0.2, 20.0, 10.0
STILL_S = 1.8  # after which nothing swings
FAR_M = 1.0  # a node farther from still cloth does not swing any more
LEAST_M = 1e-6  # a node nearer to it only rounds


@dataclass(frozen=True, eq=False)
class SwingConstants:
    """The arrays and numbers that kernels read of a garment in a fabric.

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
        """Memory of the mesh."""
        return sum(array.nbytes for array in self.mesh) + self.index.nbytes + self.held.nbytes


@dataclass(frozen=True, eq=False)
class SwingMemory(FrameMemory):
    """A frame as swing remembers it: the ``origin`` of its coordinates in the world [m] (3,); where the nodes
    ``swung`` to [m] and their ``speed`` [m/s] (N, 3); the samples ``touched`` (N,) below them; since when [s] the
    network has not moved."""

    origin: np.ndarray
    swung: np.ndarray
    speed: np.ndarray
    touched: np.ndarray
    still_since_s: float


def swing(
    constants: SwingConstants, memory: SwingMemory | None, frame: Frame, origin: np.ndarray, *, share: float = 1.0
) -> tuple[np.ndarray, SwingMemory]:
    """The vertices [m] (V, 3) of ``frame`` with a ``share`` of their swing, and the memory for the next frame.

    ``origin`` [m] (3,) is that of the frame's coordinates in the world. The same input gives the same bits; ``memory``
    is not written to. In a frame without a past, and in one to which no swing leads, cloth hangs still.
    """
    vertices, skin, time_s = frame.vertices, frame.skin, frame.time_s
    dtype = constants.mesh.mass_kg.dtype
    network = vertices[constants.mesh.vertex].astype(dtype)
    ground = np.array(skin, dtype=dtype, order="C")  # a copy: kernels are compiled for arrays that may be written
    past = memory if memory is not None and memory.time_s != time_s and follows(memory, network, time_s) else None
    if past is None:
        return vertices, _still(constants, network, ground, time_s, origin)
    stands = np.array_equal(network, past.network) and np.array_equal(origin, past.origin)
    since_s = past.still_since_s if stands else time_s
    if stands and time_s - since_s >= STILL_S:
        return vertices, SwingMemory(time_s, network, origin, network, np.zeros_like(network), past.touched, since_s)
    damping = constants.damping_per_s + min(CALMER_PER_S2 * max(time_s - since_s - CALM_S, 0.0), CALMEST_PER_S)
    touched = past.touched.copy()
    follow(network, ground, constants.graph, TouchedSamples(touched, touched))
    before = SwingState(past.network, past.swung - (origin - past.origin).astype(dtype), past.speed)
    step_s, young = step_between(past.time_s, time_s), constants.young_n_per_m
    schedule = SwingSchedule(dtype.type(step_s), dtype.type(damping), dtype.type(young), ROUNDS, TURNS)
    hold = SkinHold(touched, constants.held)
    swung, speed, far = advance(before, network, ground, hold, constants.mesh, constants.graph, schedule)
    if not far <= FAR_M:
        return vertices, _still(constants, network, ground, time_s, origin)
    after = SwingMemory(time_s, network, origin, swung, speed, touched, since_s)
    if far < LEAST_M:
        return vertices, after
    out = np.empty(vertices.shape, dtype)
    move_vertices(vertices.astype(dtype), network, swung, constants.mesh, dtype.type(share), out)
    return out.astype(vertices.dtype), after


def _still(
    constants: SwingConstants, network: np.ndarray, skin: np.ndarray, time_s: float, origin: np.ndarray
) -> SwingMemory:
    """The memory of a frame whose cloth hangs still."""
    touched = constants.index.copy()
    follow(network, skin, constants.graph, TouchedSamples(touched, touched))
    return SwingMemory(time_s, network, origin, network, np.zeros_like(network), touched, time_s)


class SwingState(NamedTuple):
    """The frame before: where the network had the nodes, where they swung to, and their speed."""

    network: np.ndarray
    swung: np.ndarray
    speed: np.ndarray


class SwingSchedule(NamedTuple):
    """The computation of a frame: the step [s], damping [1/s] and stiffness [N/m]; ``rounds`` of conjugate gradients
    and ``turns`` of sweeps."""

    step_s: np.floating
    damping: np.floating
    young: np.floating
    rounds: int
    turns: int


class SkinHold(NamedTuple):
    """The samples ``touched`` (N,) below the nodes, and the share ``held`` (N,) of the hold there that each has."""

    touched: np.ndarray
    held: np.ndarray


@kernel
def advance(before, network, skin, hold, mesh, graph, schedule):
    """The swung nodes [m] (N, 3), their speed [m/s], and how far [m] the farthest one is from still cloth, NaN where
    one is."""
    h = schedule.step_s
    one, zero = network.dtype.type(1), network.dtype.type(0)
    touched = hold.touched
    held = _holds(network, skin, hold)
    inertia, deep = np.zeros_like(held), np.zeros_like(held)
    u, rhs, swung = np.zeros_like(network), np.zeros_like(network), network.copy()
    for n in range(len(mesh.order)):
        i = mesh.order[n]
        v = scaled(one / (one + h * schedule.damping), at(before.speed, i))
        across = _normal(before.swung, i, mesh)
        wind = dot(v, across)
        slow = network.dtype.type(AIR_KG_M3) * mesh.area_m2[i] / mesh.mass_kg[i] * abs(wind) * h
        v = sub(v, scaled(wind * slow / (one + slow), across))
        inertia[i] = mesh.mass_kg[i] / (h * h)
        for axis in range(3):
            u[i, axis] = before.swung[i, axis] - before.network[i, axis]
            rhs[i, axis] = inertia[i] * (before.swung[i, axis] + h * v[axis] - network[i, axis])
        j = touched[i]
        below = network.dtype.type(GAP_M) - dot(sub(at(network, i), at(skin, j)), (skin[j, 4], skin[j, 5], skin[j, 6]))
        deep[i] = max(below, zero)
    fall_back(u, mesh, inertia, held, rhs, schedule.rounds)
    for i in range(len(u)):
        for axis in range(3):
            swung[i, axis] += u[i, axis]
        inertia[i] += held[i]
    springs, bound = Springs(swung.copy(), inertia), np.empty((len(mesh.other), 6), network.dtype)
    write_bounds(network, mesh, bound)
    here = touched.copy()
    follow(swung, skin, graph, TouchedSamples(here, here))
    for i in range(len(here)):
        # Still cloth that lies near a part of the body stays on its side of that, however far it swings.
        off = sub(at(network, i), at(skin, touched[i]))
        if dot(off, off) < network.dtype.type(TOUCH_M * TOUCH_M):
            here[i] = touched[i]
    keep_length(swung, mesh, schedule.young, bound, springs, Ground(skin, touched, here, deep), schedule.turns)
    return swung, (swung - before.swung) / h, farthest_m(swung, network)


@kernel
def _holds(network, skin, hold):
    """How stiffly [N/m] (N,) each node is held where the network has it."""
    dtype = network.dtype.type
    found = np.empty(len(network), network.dtype)
    for i in range(len(network)):
        j = hold.touched[i]
        off = sub(at(network, i), at(skin, j))
        height = dot(off, (skin[j, 4], skin[j, 5], skin[j, 6]))
        if dot(off, off) > dtype(TOUCH_M * TOUCH_M):  # above another part of the body than the sample's
            height = dtype(FREE_M)
        share = (height - dtype(NEAR_M)) / dtype(FREE_M - NEAR_M)
        share = min(max(share, dtype(0)), dtype(1))
        free = share * share * (dtype(3) - share - share)
        found[i] = hold.held[i] * dtype(HOLD_N_PER_M) * (dtype(1) - free) / max(free, dtype(LEAST_FREE))
    return found


@kernel
def _normal(c, i, mesh):
    """The unit normal of the coarse triangles around node ``i``, zeros where they have no area."""
    zero = c.dtype.type(0)
    total, own = (zero, zero, zero), at(c, i)
    for e in range(mesh.start[i], mesh.start[i + 1]):
        a, b = sub(at(c, mesh.other[e, 0]), own), sub(at(c, mesh.other[e, 1]), own)
        total = (
            total[0] + a[1] * b[2] - a[2] * b[1],
            total[1] + a[2] * b[0] - a[0] * b[2],
            total[2] + a[0] * b[1] - a[1] * b[0],
        )
    square = dot(total, total)
    return scaled(c.dtype.type(1) / np.sqrt(square), total) if square > zero else total


def warm_up() -> None:
    """Compiles the kernels or reads what is stored of them, so that no frame waits for it."""
    zero, none = np.zeros((1, 3), np.float32), np.zeros(1, np.float32)
    index, start = np.zeros(1, np.int32), np.zeros(2, np.int32)
    empty, nobody = np.zeros(0, np.float32), np.zeros(0, np.int32)
    mesh = SwingMesh(
        index, none, none, nobody, start, np.zeros((0, 2), np.int32), np.zeros((0, 5), np.float32),
        start, nobody, empty, start, nobody, empty,
    )  # fmt: skip
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1, np.float32), zero)
    made = SwingConstants(mesh, graph, index, 1.0, 0.0, none)
    _, memory = swing(made, None, Frame(zero, np.zeros((1, 8)), 0.0), np.zeros(3))
    swing(made, memory, Frame(zero + np.float32(1e-3), np.zeros((1, 8)), 0.1), np.zeros(3))
