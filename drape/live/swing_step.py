"""One frame of swing: the network's drape of a still body in, cloth with inertia out.

Cloth that hangs freely is a coarse mesh with its mass. Its nodes go on where they went,

    c' = c0 + h v,

air slows v along the surface's normal, the fabric damps it; weight pulls them back to where still cloth would be, and
the cloth's length holds them (``nodes``), both by implicit Euler. The vertices are moved by what the nodes are away
from the still cloth, so that on a still body all comes to rest at the network's drape. Nodes that this has near the
skin are held there, those of a wide skirt hardly (``slack``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, scaled, sub
from drape.live.fold_step import Frame
from drape.live.skin_contact import NEIGHBOURS, SkinGraph, Touched, follow
from drape.live.swing_mesh import SwingMesh
from drape.live.swing_nodes import GAP_M, TOUCH_M, Ground, Springs, fall_back, keep_length, stretched

NEAR_M, FREE_M = 0.008, 0.04  # over the skin: lower nodes are held, higher ones free
HOLD_N_PER_M, LEAST_FREE = 2.0, 0.01  # of a node that is half free; what is left of freedom at the skin
ROUNDS, TURNS = 20, 6  # of conjugate gradients, and sweeps there and back for length
PAUSE_S = 0.25  # after a longer one a frame has no past
CUT_M = 0.30  # a node that the network moves farther between two frames is in another clip
SHORTEST_STEP_S = 1.0 / 240.0
AIR_KG_M3 = 0.72  # half of air's density times the drag of a plate across
SWING_HZ = 1.5  # at which damping in proportion to stiffness is told as one in proportion to mass
# A body that stands still for longer slows its cloth more and more, but not so much that it creeps.
CALM_S, CALMER_PER_S2, CALMEST_PER_S = 0.2, 20.0, 10.0
STILL_S = 1.8  # after which nothing swings
FAR_M = 1.0  # from still cloth: farther is no swing
LEAST_M = 1e-6  # nearer is none either, but rounding


@dataclass(frozen=True, eq=False)
class Constants:
    """What the kernels read of a garment in a fabric: its ``mesh``, the skin's ``graph``, the sample (N,) that is
    nearest to each node at rest, stiffness [N/m] and damping [1/s]; the share (N,) of the hold near the skin that each
    node has."""

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
class Memory:
    """What is kept of a frame: its time [s], where its ``origin`` was in the world [m] (3,), and relative to that where
    the network had the nodes, where they swung to, how fast [m/s] (N, 3); the samples below them (N,); since when [s]
    the network has not moved."""

    time_s: float
    origin: np.ndarray
    network: np.ndarray
    swung: np.ndarray
    speed: np.ndarray
    touched: np.ndarray
    still_since_s: float


def swing(
    constants: Constants, memory: Memory | None, frame: Frame, origin: np.ndarray, *, share: float = 1.0
) -> tuple[np.ndarray, Memory]:
    """The vertices [m] (V, 3) of ``frame`` with a ``share`` of their swing, and what the next frame needs.

    ``origin`` [m] (3,) is where in the world the frame's own one is. The same input gives the same bits; ``memory`` is
    left as it is. A frame without a past, and one that no swing leads to, hang still.
    """
    vertices, skin, time_s = frame.vertices, frame.skin, frame.time_s
    dtype = constants.mesh.mass_kg.dtype
    network = vertices[constants.mesh.vertex].astype(dtype)
    ground = np.array(skin, dtype=dtype, order="C")  # a copy: kernels are compiled for arrays that may be written
    past = memory if memory is not None and _leads_to(memory, network, time_s) else None
    if past is None:
        return vertices, _still(constants, network, ground, time_s, origin)
    stands = np.array_equal(network, past.network) and np.array_equal(origin, past.origin)
    since_s = past.still_since_s if stands else time_s
    if stands and time_s - since_s >= STILL_S:
        after = Memory(time_s, origin, network, network, np.zeros_like(network), past.touched, since_s)
        return vertices, after
    step_s = max(time_s - past.time_s, SHORTEST_STEP_S)
    damping = constants.damping_per_s + min(CALMER_PER_S2 * max(time_s - since_s - CALM_S, 0.0), CALMEST_PER_S)
    touched = past.touched.copy()
    follow(network, ground, constants.graph, Touched(touched, touched))
    state = State(past.network, past.swung - (origin - past.origin).astype(dtype), past.speed)
    young = dtype.type(constants.young_n_per_m)
    numbers = Numbers(dtype.type(step_s), dtype.type(damping), young, ROUNDS, TURNS)
    near = Near(touched, constants.held)
    swung, speed, far = advance(state, network, ground, near, constants.mesh, constants.graph, numbers)
    if not far <= FAR_M:
        return vertices, _still(constants, network, ground, time_s, origin)
    after = Memory(time_s, origin, network, swung, speed, touched, since_s)
    if far < LEAST_M:
        return vertices, after
    out = np.empty(vertices.shape, dtype)
    carry(vertices.astype(dtype), constants.mesh, dtype.type(share) * (swung - network), out)
    return out.astype(vertices.dtype), after


def _leads_to(memory: Memory, network: np.ndarray, time_s: float) -> bool:
    if not 0.0 < time_s - memory.time_s <= PAUSE_S:
        return False
    way = network - memory.network
    return float(np.einsum("vi,vi->v", way, way).max()) <= CUT_M**2


def _still(constants: Constants, network: np.ndarray, skin: np.ndarray, time_s: float, origin: np.ndarray) -> Memory:
    """The memory of a frame whose cloth hangs still."""
    touched = constants.index.copy()
    follow(network, skin, constants.graph, Touched(touched, touched))
    return Memory(time_s, origin, network, network, np.zeros_like(network), touched, time_s)


class State(NamedTuple):
    """Of the frame before: where the network had the nodes, where they swung to, their speed."""

    network: np.ndarray
    swung: np.ndarray
    speed: np.ndarray


class Numbers(NamedTuple):
    """Since the frame before [s], damping [1/s], stiffness [N/m]; rounds of conjugate gradients, turns of sweeps."""

    step_s: np.floating
    damping: np.floating
    young: np.floating
    rounds: int
    turns: int


class Near(NamedTuple):
    """The samples (N,) below the nodes, and the share (N,) of the hold there that each has."""

    touched: np.ndarray
    held: np.ndarray


@kernel
def advance(state, network, skin, near, mesh, graph, numbers):
    """The swung nodes [m] (N, 3), their speed [m/s], and how far [m] the farthest is from still cloth, NaN where one
    is."""
    h = numbers.step_s
    one, zero = network.dtype.type(1), network.dtype.type(0)
    touched = near.touched
    hold = _holds(network, skin, near)
    inertia, deep = np.zeros_like(hold), np.zeros_like(hold)
    u, rhs, swung = np.zeros_like(network), np.zeros_like(network), network.copy()
    for n in range(len(mesh.order)):
        i = mesh.order[n]
        v = scaled(one / (one + h * numbers.damping), at(state.speed, i))
        across = _normal(state.swung, i, mesh)
        wind = dot(v, across)
        slow = network.dtype.type(AIR_KG_M3) * mesh.area_m2[i] / mesh.mass_kg[i] * abs(wind) * h
        v = sub(v, scaled(wind * slow / (one + slow), across))
        inertia[i] = mesh.mass_kg[i] / (h * h)
        for axis in range(3):
            u[i, axis] = state.swung[i, axis] - state.network[i, axis]
            rhs[i, axis] = inertia[i] * (state.swung[i, axis] + h * v[axis] - network[i, axis])
        j = touched[i]
        below = network.dtype.type(GAP_M) - dot(sub(at(network, i), at(skin, j)), (skin[j, 4], skin[j, 5], skin[j, 6]))
        deep[i] = max(below, zero)
    fall_back(u, mesh, inertia, hold, rhs, numbers.rounds)
    for i in range(len(u)):
        for axis in range(3):
            swung[i, axis] += u[i, axis]
        inertia[i] += hold[i]
    springs, bound = Springs(swung.copy(), inertia), np.empty((len(mesh.other), 3), network.dtype)
    stretched(network, mesh, bound)
    here = touched.copy()
    follow(swung, skin, graph, Touched(here, here))
    for i in range(len(here)):
        # Still cloth that lies near a part of the body stays on its side of that, however far it swings.
        off = sub(at(network, i), at(skin, touched[i]))
        if dot(off, off) < network.dtype.type(TOUCH_M * TOUCH_M):
            here[i] = touched[i]
    keep_length(swung, mesh, numbers.young, bound, springs, Ground(skin, touched, here, deep), numbers.turns)
    far = zero
    for i in range(len(swung)):
        way = sub(at(swung, i), at(network, i))
        square = dot(way, way)
        if far == far and not square <= far:  # NaN, once met, stays
            far = square
    return swung, (swung - state.swung) / h, np.sqrt(far)


@kernel
def _holds(network, skin, near):
    """How stiffly [N/m] (N,) nodes are held where the network has them, times the share of each."""
    dtype = network.dtype.type
    hold = np.empty(len(network), network.dtype)
    for i in range(len(network)):
        j = near.touched[i]
        off = sub(at(network, i), at(skin, j))
        height = dot(off, (skin[j, 4], skin[j, 5], skin[j, 6]))
        if dot(off, off) > dtype(TOUCH_M * TOUCH_M):  # above another part of the body than the sample's
            height = dtype(FREE_M)
        share = (height - dtype(NEAR_M)) / dtype(FREE_M - NEAR_M)
        share = min(max(share, dtype(0)), dtype(1))
        free = share * share * (dtype(3) - share - share)
        hold[i] = near.held[i] * dtype(HOLD_N_PER_M) * (dtype(1) - free) / max(free, dtype(LEAST_FREE))
    return hold


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


@kernel
def carry(vertices, mesh, way, out):
    """``vertices`` [m] (V, 3) moved by the nodes' ``way`` (N, 3), into ``out``."""
    for v in range(len(vertices)):
        moved = at(vertices, v)
        for e in range(mesh.weight_start[v], mesh.weight_start[v + 1]):
            w, j = mesh.weight[e], mesh.weight_node[e]
            moved = (moved[0] + w * way[j, 0], moved[1] + w * way[j, 1], moved[2] + w * way[j, 2])
        out[v, 0], out[v, 1], out[v, 2] = moved[0], moved[1], moved[2]


def warm_up() -> None:
    """Compiles the kernels, or reads them where they are stored, so that no frame waits for that."""
    zero, none = np.zeros((1, 3), np.float32), np.zeros(1, np.float32)
    index, start = np.zeros(1, np.int32), np.zeros(2, np.int32)
    empty, nobody = np.zeros(0, np.float32), np.zeros(0, np.int32)
    mesh = SwingMesh(
        index, none, none, nobody, start, np.zeros((0, 2), np.int32), np.zeros((0, 5), np.float32),
        start, nobody, empty, start, nobody, empty,
    )  # fmt: skip
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1, np.float32), zero)
    made = Constants(mesh, graph, index, 1.0, 0.0, none)
    _, memory = swing(made, None, Frame(zero, np.zeros((1, 8)), 0.0), np.zeros(3))
    swing(made, memory, Frame(zero + np.float32(1e-3), np.zeros((1, 8)), 0.1), np.zeros(3))
