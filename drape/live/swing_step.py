"""One frame of swing: the network's drape of a still body in, cloth with inertia out.

Cloth that hangs freely is a coarse mesh of nodes with their mass. A node goes on where it went,

    c' = c0 + h v,

air slows v along the surface's normal, and the fabric damps it. Weight then pulls the node back to where still cloth
would be, and the length of the cloth holds it (``drape.live.swing_nodes``), both by implicit Euler. The vertices move
and turn as the nodes do beside the still cloth (``drape.live.swing_carry``), so that on a still body all comes to rest
at the network's drape. A node that the network has near the skin is held there; in a wide skirt hardly
(``drape.live.swing_slack``).

Colliders of the scene hold nodes too. Cloth that lies on one comes to rest there, and a frame without a past begins
where it rests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.elements import at, dot, farthest_m, scaled, sub
from drape.kernels.lanes import LANES
from drape.live.clock import CUT_M, FIRST_STEP_S, Frame, FrameMemory, Surroundings, writable
from drape.live.fold_constants import array_bytes
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples
from drape.live.swing_carry import move_vertices
from drape.live.swing_compiled import follow, placed, step_between, write_planes
from drape.live.swing_mesh import SHARED, SwingMesh
from drape.live.swing_nodes import GAP_M, TOUCH_M, Ground, Springs, fall_back, keep_length, write_bounds
from drape.live.swing_rows import swing_rows

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
LYING_M, STUCK_N_PER_M = 0.008, 2.0  # a node lies on a collider that is nearer, and is held where it lay
SETTLE = 60  # steps of a frame without a past whose cloth is in a collider
CUT, LOST, STILL, MOVED = range(4)


class SwingConstants(NamedTuple):
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
        return array_bytes(tuple(self.mesh)) + self.index.nbytes + self.held.nbytes


@dataclass(frozen=True, eq=False)
class SwingMemory(FrameMemory):
    """A frame as swing remembers it: the ``origin`` of its coordinates in the world [m] (3,); where the nodes
    ``swung`` to [m] and their ``speed`` [m/s] (N, 3); the samples ``touched`` (N,) below them; since when [s] the
    network has not moved; and the ``colliders`` (M, 16), from that origin."""

    origin: np.ndarray
    swung: np.ndarray
    speed: np.ndarray
    touched: np.ndarray
    still_since_s: float
    colliders: np.ndarray


class SwingPast(NamedTuple):
    """What a frame goes on from: ``SwingMemory``, ``origin`` by which that of the coordinates has moved since [m] (3,),
    and the times [s] of both frames."""

    network: np.ndarray
    swung: np.ndarray
    speed: np.ndarray
    touched: np.ndarray
    colliders: np.ndarray
    origin: np.ndarray
    times_s: tuple[float, float]
    still_since_s: float


class Swung(NamedTuple):
    """What a frame has become: ``CUT`` off from its past, ``LOST``, ``STILL`` or ``MOVED``; and the arrays of
    ``SwingMemory``."""

    kind: int
    network: np.ndarray
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
    time_s, dtype = frame.time_s, constants.mesh.mass_kg.dtype
    vertices, around, kind = writable(frame.vertices, dtype), frame.around(dtype), CUT
    if memory is not None and memory.time_s != time_s and memory.leads_to(time_s):
        past = SwingPast(
            memory.network, memory.swung, memory.speed, memory.touched, memory.colliders, origin - memory.origin,
            (memory.time_s, time_s), memory.still_since_s,
        )  # fmt: skip
        out, swung = _swing_on(vertices, past, around, constants, share)
        kind = swung.kind
        if kind >= STILL:
            after = SwingMemory(time_s, swung.network, origin, *swung[2:], around.colliders)
            return out if kind == MOVED else frame.vertices, after
    network = placed(vertices, constants.mesh.vertex)
    still = _still(constants, network, around, time_s, origin)
    if kind == LOST:
        return frame.vertices, still
    after = _at_rest(constants, still, around)
    out, kind = _moved(vertices, network, after.swung, constants.mesh, share)
    return (frame.vertices, still) if kind == LOST else (out if kind == MOVED else frame.vertices, after)


@kernel
def _swing_on(vertices, past, around, cloth, share):
    """The ``vertices`` [m] (V, 3) with a ``share`` of their swing after ``past``, and ``Swung``."""
    mesh, kind = cloth.mesh, vertices.dtype.type
    before_s, time_s = past.times_s
    network = placed(vertices, mesh.vertex)
    if not farthest_m(network, past.network) <= CUT_M:
        return vertices, Swung(CUT, network, network, network, past.touched, time_s)
    moved = past.origin.any() or not _same(network, past.network) or not _same(around.colliders, past.colliders)
    since_s = time_s if moved else past.still_since_s
    speed = np.zeros_like(network)
    if not moved and time_s - since_s >= STILL_S:
        swung, touched = past.swung if len(around.colliders) else network, past.touched
    else:
        damping = cloth.damping_per_s + min(CALMER_PER_S2 * max(time_s - since_s - CALM_S, 0.0), CALMEST_PER_S)
        touched, start = past.touched.copy(), past.swung.copy()
        follow(network, around.skin, cloth.graph, TouchedSamples(touched, touched))
        for i in range(len(start)):
            for axis in range(3):
                start[i, axis] -= kind(past.origin[axis])
        before, hold = SwingState(past.network, start, past.speed), SkinHold(touched, cloth.held)
        schedule = _schedule(network, step_between(before_s, time_s), damping, cloth.young_n_per_m, False)
        swung, speed = advance(before, network, around, hold, mesh, cloth.graph, schedule)
    out, found = _moved(vertices, network, swung, mesh, share)
    return out, Swung(found, network, swung, speed, touched, since_s)


@kernel
def _same(one, other):
    """Whether two tables have the same numbers."""
    if one.shape != other.shape:
        return False
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            if one[i, j] != other[i, j]:
                return False
    return True


@kernel
def _moved(vertices, network, swung, mesh, share):
    """The ``vertices`` [m] (V, 3) moved as nodes of the ``network`` that ``swung``, and whether these are ``MOVED``,
    ``STILL`` or ``LOST``."""
    far = farthest_m(swung, network)
    if not far <= FAR_M:
        return vertices, LOST
    if far < LEAST_M:
        return vertices, STILL
    out = np.empty_like(vertices)
    move_vertices(vertices, network, swung, mesh, vertices.dtype.type(share), out)
    return out, MOVED


@kernel
def _schedule(network, step_s, damping_per_s, young_n_per_m, first):
    kind = network.dtype.type
    return SwingSchedule(kind(step_s), kind(damping_per_s), kind(young_n_per_m), ROUNDS, TURNS, first)


def _still(
    constants: SwingConstants, network: np.ndarray, around: Surroundings, time_s: float, origin: np.ndarray
) -> SwingMemory:
    """The memory of a frame whose cloth hangs still."""
    touched = constants.index.copy()
    follow(network, around.skin, constants.graph, TouchedSamples(touched, touched))
    speed = np.zeros_like(network)
    return SwingMemory(time_s, network, origin, network, speed, touched, time_s, around.colliders)


def _at_rest(constants: SwingConstants, still: SwingMemory, around: Surroundings) -> SwingMemory:
    """The memory of ``still`` cloth once it lies on the colliders that it is in."""
    network = still.network
    planes = np.empty((len(network), 2, 4), network.dtype)
    if not write_planes(network, network, True, around.colliders, around.skin, still.touched, planes):
        return still
    damping = constants.damping_per_s + CALMEST_PER_S
    schedule = _schedule(network, FIRST_STEP_S, damping, constants.young_n_per_m, True)
    state, hold = SwingState(network, network, still.speed), SkinHold(still.touched, constants.held)
    for _ in range(SETTLE):
        swung, speed = advance(state, network, around, hold, constants.mesh, constants.graph, schedule)
        state = SwingState(network, swung, speed)
    return replace(still, swung=state.swung)


class SwingState(NamedTuple):
    """The frame before: where the network had the nodes, where they swung to, and their speed."""

    network: np.ndarray
    swung: np.ndarray
    speed: np.ndarray


class SwingSchedule(NamedTuple):
    """The computation of a frame: the step [s], damping [1/s] and stiffness [N/m]; ``rounds`` of conjugate gradients
    and ``turns`` of sweeps; whether it is the ``first`` frame."""

    step_s: np.floating
    damping: np.floating
    young: np.floating
    rounds: int
    turns: int
    first: bool


class SkinHold(NamedTuple):
    """The samples ``touched`` (N,) below the nodes, and the share ``held`` (N,) of the hold there that each has."""

    touched: np.ndarray
    held: np.ndarray


@kernel
def advance(before, network, around, hold, mesh, graph, schedule):
    """The swung nodes [m] (N, 3) and their speed [m/s]."""
    h, skin = schedule.step_s, around.skin
    one, zero = network.dtype.type(1), network.dtype.type(0)
    touched = hold.touched
    held = _holds(network, skin, hold)
    inertia, deep = np.zeros_like(held), np.zeros_like(held)
    planes = np.empty((len(held), 2, 4), network.dtype)
    write_planes(before.swung, before.swung, schedule.first, around.colliders, skin, touched, planes)
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
        if _lies(before.swung, network, planes, i):
            stuck = network.dtype.type(STUCK_N_PER_M)
            held[i] += stuck
            for axis in range(3):
                rhs[i, axis] = (inertia[i] + stuck) * (before.swung[i, axis] - network[i, axis])
        j = touched[i]
        below = network.dtype.type(GAP_M) - dot(sub(at(network, i), at(skin, j)), (skin[j, 4], skin[j, 5], skin[j, 6]))
        deep[i] = max(below, zero)
    fall_back(u, mesh, inertia, held, rhs, schedule.rounds)
    for i in range(len(u)):
        for axis in range(3):
            swung[i, axis] += u[i, axis]
        inertia[i] += held[i]
    springs, bound = (
        Springs(swung.copy(), inertia),
        np.empty(6 * LANES * mesh.rows.start[mesh.rows.moving], network.dtype),
    )
    write_bounds(network, mesh, bound)
    here = touched.copy()
    follow(swung, skin, graph, TouchedSamples(here, here))
    for i in range(len(here)):
        # Still cloth that lies near a part of the body stays on its side of that, however far it swings.
        off = sub(at(network, i), at(skin, touched[i]))
        if dot(off, off) < network.dtype.type(TOUCH_M * TOUCH_M):
            here[i] = touched[i]
    write_planes(swung, before.swung, schedule.first, around.colliders, skin, touched, planes)
    ground = Ground(skin, touched, here, deep, planes)
    keep_length(swung, mesh, schedule.young, bound, springs, ground, schedule.turns)
    return swung, (swung - before.swung) / h


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


@part
def _lies(c, network, planes, i):
    """Whether node ``i`` lies on the first of its ``planes``, beyond which the network has it."""
    normal, where = at(planes[i], 0), planes[i, 0, 3]
    return dot(normal, at(c, i)) - where < c.dtype.type(LYING_M) and dot(normal, at(network, i)) < where


@part
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
        np.zeros((1, SHARED), np.int32), np.zeros((1, SHARED), np.float32), start, nobody, empty,
        swing_rows(nobody, start, np.zeros((0, 2), np.int32), np.zeros((0, 5), np.float32)),
    )  # fmt: skip
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1, np.float32), zero)
    made = SwingConstants(mesh, graph, index, 1.0, 0.0, none)
    _, memory = swing(made, None, Frame(zero, np.zeros((1, 8)), 0.0), np.zeros(3))
    swing(made, memory, Frame(zero + np.float32(1e-3), np.zeros((1, 8)), 0.1), np.zeros(3))
    move_vertices(zero, zero, zero, mesh, np.float32(1.0), np.empty_like(zero))  # nothing has swung above
