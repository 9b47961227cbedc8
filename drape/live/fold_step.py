"""One frame of folds: the network's drape and the memory of the frame before in, folded cloth and a new memory out.

The memory holds the folds as a residual r and a velocity u in local frames R of the network's surface X. The frame
starts from them,

    x = X + R^T r,   v = R^T u dt.

Rounds follow: steps of the whole cloth, each from x + m v with the momentum m, and sweeps of vertex block descent (Chen
et al. 2024, "Vertex Block Descent", ACM TOG 43(4)). v is the way of the last step. It is kept from frame to frame, so
that the descent has the memory of a heavy ball. The lift ends the frame, and the new memory is

    r = R (x - X),   u = R v / dt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.projection import CLEARANCE_M
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, dot, scaled, sub, with_spare
from drape.kernels.lanes import most, points_in, put_points, root
from drape.live.ceiling import ceiling_over, pressed
from drape.live.clock import CUT_M, FIRST_STEP_S, Frame, FrameMemory, Surroundings, step_between, writable
from drape.live.colliders import leave, put_planes
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.lift import lift
from drape.live.pace import LONG_ROUNDS, SETTLING_MOMENTUM, STIFF_N_PER_M, calmness, fading, grip_left, paced
from drape.live.places import delivered, farthest_place_m, moved_m, placed
from drape.live.raised_skin import heights_over
from drape.live.residual import EASE, ease, keep_residual
from drape.live.room import keep_apart
from drape.live.sheet import LANES
from drape.live.skin_contact import TURNS, stuck_places, touch, write_grip
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples, follow
from drape.live.surface_frames import FRAMES, in_frames, in_world, surface_frames
from drape.live.sweeps import PLANES, SCRATCH, descend, gradient_at, leash, stick
from drape.live.untangle import STEPS as APART_STEPS
from drape.live.untangle import WAY_M, farthest_way, untangle
from drape.live.whole import whole_step

FAR_M = 0.25  # a vertex farther from the network's drape is no fold


@dataclass(frozen=True, eq=False)
class FoldMemory(FrameMemory):
    """A frame as folds remember it, in the order of the constants' places.

    In the frames of the network's surface the ``residual`` [m] and ``velocity`` [m/s] (P, 3) of the folds; the samples
    ``touched``; ``grip`` [m] (P, 3): where friction holds each place, in the frame of its own sample. In the next frame
    vertices whose number is ``turn`` modulo ``TURNS`` look for other parts of the body.
    """

    residual: np.ndarray
    velocity: np.ndarray
    touched: TouchedSamples
    grip: np.ndarray
    turn: int


@dataclass(frozen=True)
class FoldReport:
    """The outcome of a frame. It ``settled`` if it had no past to go on from. It was ``reset`` if its result was no
    fold, and it was begun anew from the network's drape. ``lifted_share`` of the vertices were lifted off the skin, the
    farthest by ``lifted_max_m`` [m]."""

    settled: bool
    reset: bool = False
    lifted_share: float = 0.0
    lifted_max_m: float = 0.0


class FoldState(NamedTuple):
    """The arrays of ``FoldMemory`` that a frame writes anew."""

    residual: np.ndarray
    velocity: np.ndarray
    grip: np.ndarray


class FoldEffort(NamedTuple):
    """The work that a frame gets.

    ``steps`` of the whole cloth, and half as many sweeps over its vertices, at least one; ``paced`` changes both in
    fast motion. A frame without a past gets ``settle`` sweeps, and then ``settle`` times all of these. With 0 steps no
    energy is looked at: the folds go along with the network's surface and fade, and a frame without a past has none.

    ``cloth_contact``: whether cloth keeps apart from itself.
    ``clearance_m`` [m]: a vertex nearer to its own part of the skin is lifted; 0 lifts none.
    """

    steps: int
    settle: int = 8
    cloth_contact: bool = False
    clearance_m: float = CLEARANCE_M


class FoldPast(NamedTuple):
    """What a frame goes on from: ``FoldMemory``, ``step_s`` [s] before. Where that is infinite there is none."""

    network: np.ndarray
    state: FoldState
    touched: TouchedSamples
    turn: int
    step_s: float


class FoldOutcome(NamedTuple):
    """``FoldReport`` of a frame. ``turn`` is that of the memory, and what crosses came apart by ``untangle`` [m] at
    most in a step. It was ``lost`` if even without a past its result was no fold."""

    settled: bool
    reset: bool
    lost: bool
    turn: int
    untangle: float


class Folded(NamedTuple):
    """The cloth ``x`` [m] (P, 3) of a frame, how far [m] (P,) it was ``lifted``, and what the memory keeps of it."""

    x: np.ndarray
    lifted: np.ndarray
    state: FoldState
    touched: TouchedSamples
    outcome: FoldOutcome


def fold(
    constants: FoldConstants, memory: FoldMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, FoldMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    The same input gives the same bits. ``memory`` is not written to.
    """
    sheet, dtype = constants.sheet, constants.sheet.own.dtype
    past, around, vertices = past_of(memory, frame.time_s, dtype), frame.around(dtype), writable(frame.vertices, dtype)
    network, out = placed(vertices, sheet.vertex), np.empty_like(vertices)
    planes = np.empty(PLANES // LANES * len(network), dtype)
    # Three calls, since a kernel around these would be compiled as long as ``fold_places`` once more.
    folded = fold_places(network, past, around, constants, effort, planes)
    report = report_of(folded.outcome, delivered(folded.x, folded.lifted, sheet.place, out))
    return frame.vertices if folded.outcome.lost else out, memory_of(frame.time_s, network, folded), report


def past_of(memory: FoldMemory | None, time_s: float, dtype: np.dtype) -> FoldPast:
    """What ``memory`` says to a frame at ``time_s`` [s], of ``dtype``."""
    if memory is None or not memory.leads_to(time_s):
        return _no_past(dtype)
    state = FoldState(memory.residual, memory.velocity, memory.grip)
    return FoldPast(memory.network, state, memory.touched, memory.turn, step_between(memory.time_s, time_s))


@cache
def _no_past(dtype: np.dtype) -> FoldPast:
    none, nowhere = np.zeros((0, 3), dtype), np.zeros(0, np.int32)
    return FoldPast(none, FoldState(none, none, none), TouchedSamples(nowhere, nowhere), 0, math.inf)


def memory_of(time_s: float, network: np.ndarray, folded: Folded) -> FoldMemory:
    """The memory of a frame at ``time_s`` [s] with the ``network``'s places [m] (P, 3)."""
    residual, velocity, grip = folded.state
    return FoldMemory(time_s, network, residual, velocity, folded.touched, grip, folded.outcome.turn)


def report_of(outcome: FoldOutcome, moved: tuple[float, float]) -> FoldReport:
    """The report of ``outcome`` and of what the lift ``moved``: a share of the vertices, the farthest so far [m]."""
    return FoldReport(outcome.settled, outcome.reset, *moved)


@kernel
def fold_places(network, past, around, cloth, effort, planes):
    """``Folded``: the cloth of a frame, from the ``network``'s places [m] (P, 3). What held it is left in
    ``planes``, ``PLANES`` a block (``sweeps``).

    A frame whose result is no fold is computed once more without its past. What it leaves is nothing if that is none
    either.
    """
    follows = past.step_s < np.inf and farthest_place_m(network, past.network) <= CUT_M
    begun = past if follows else _without_past(network, cloth)
    while True:  # one place that calls ``_advanced``, whose code it gets
        folded = _advanced(network, begun, around, cloth, effort, planes)
        if begun.step_s == np.inf:
            break
        if not folded.outcome.lost:
            return folded
        begun = _without_past(network, cloth)
    x, lifted, state, touched, outcome = folded
    if outcome.lost:
        none = _without_past(network, cloth)
        state, touched = none.state, none.touched
        lifted[:] = 0.0  # the network's drape is delivered, which nothing lifted
    reset, turn = follows or outcome.lost, 0 if outcome.lost else outcome.turn
    return Folded(x, lifted, state, touched, FoldOutcome(True, reset, outcome.lost, turn, outcome.untangle))


@kernel
def _without_past(network, cloth):
    """A past in which the cloth lay where the network has it: its time is infinitely long ago."""
    still = np.zeros_like(network)
    touched = TouchedSamples(cloth.index, np.full_like(cloth.index, -1))
    return FoldPast(network, FoldState(still, still, still), touched, 0, np.inf)


@part
def _advanced(network, past, around, cloth, effort, planes):
    """``Folded`` of the frame after ``past``."""
    kind, k, settled = network.dtype.type, cloth.sheet.constants, past.step_s == np.inf
    step_s = FIRST_STEP_S if settled else past.step_s
    rounds = 0 if effort.steps == 0 else effort.settle if settled else 1
    share = fading(effort.steps, step_s)
    way_m = moved_m(past.network, network, cloth.sheet.place)
    # Each is half of the fabric's.
    pace = paced(effort.steps, calmness(way_m), k.warp + k.weft > STIFF_N_PER_M)
    momentum = SETTLING_MOMENTUM if settled and rounds >= LONG_ROUNDS else pace.momentum
    untangled_m = WAY_M if settled else farthest_way(way_m)
    friction = 0.0 if settled else grip_left(way_m, step_s) * cloth.friction
    schedule = FoldSchedule(
        kind(step_s), kind(momentum), kind(pace.share), rounds, pace.steps, pace.sweeps,
        -1 if settled else past.turn, effort.cloth_contact and rounds > 0,
        kind(friction), kind(effort.clearance_m), kind(untangled_m),
    )  # fmt: skip
    touched = TouchedSamples(past.touched.own.copy(), past.touched.other.copy())
    still = kind(1.0 if share == 1.0 else 0.0)
    state = FoldState(kind(share) * past.state.residual, still * past.state.velocity, past.state.grip.copy())
    x, far, lifted = advance(FoldPlaces(past.network, network, planes), state, touched, around, cloth, schedule)
    outcome = FoldOutcome(settled, False, not far <= FAR_M, (past.turn + 1) % TURNS, untangled_m)
    return Folded(x, lifted, state, touched, outcome)


class FoldGuides(NamedTuple):
    """The guides of a frame's cloth: the ``network``'s places and the places where the skin has taken what was
    ``stuck`` to it, both [m] (P, 3), the ``planes``, and what is ``around``."""

    network: np.ndarray
    stuck: np.ndarray
    planes: np.ndarray
    around: Surroundings


class FoldPlaces(NamedTuple):
    """The network's places [m] (P, 3) in the frame ``before`` and in this one, and the ``planes`` that are written."""

    before: np.ndarray
    network: np.ndarray
    planes: np.ndarray


class FoldSchedule(NamedTuple):
    """The computation of a frame ``step_s`` [s] after the one before: ``rounds``, each of ``steps`` of the whole, a
    ``share`` of each, with ``momentum``, and of ``sweeps``. ``turn`` is that of ``touch``, negative without a past.
    ``within``: whether cloth keeps apart from itself, and what crosses comes apart by ``untangle`` [m] at most in a
    step. ``friction`` with the skin; the ``clearance`` [m] of the lift."""

    step_s: np.floating
    momentum: np.floating
    share: np.floating
    rounds: int
    steps: int
    sweeps: int
    turn: int
    within: bool
    friction: np.floating
    clearance: np.floating
    untangle: np.floating


@part
def advance(places, state, touched, around, cloth, schedule):
    """``x`` [m] (P, 3), how far [m] the farthest vertex is from the network, NaN where one is, and how far [m] each was
    lifted (P,). ``state`` and ``touched`` are moved on in place."""
    sheet, k, before, network = cloth.sheet, cloth.sheet.constants, places.before, places.network
    residual, velocity, grip = state
    skin = around.skin
    stuck = np.empty_like(network)
    stuck_places(grip, touched, skin, cloth.graph, stuck)
    frames = np.empty(FRAMES // LANES * len(network), network.dtype)
    surface_frames(network, sheet, frames)
    x, way = with_spare(network), np.empty_like(network)
    for block in range(len(network) // LANES):
        first = LANES * block
        put_points(x, first, in_world(frames, block, points_in(residual, first)))
        put_points(way, first, in_world(frames, block, scaled(schedule.step_s, points_in(velocity, first))))
    keep_residual(x, before, network, frames, sheet, cloth.hem)
    x += network
    lifted = np.zeros(len(x), x.dtype)
    _descend_rounds(x, way, lifted, FoldGuides(network, stuck, places.planes, around), touched, cloth, schedule)
    if schedule.turn < 0:
        stuck[:] = x
    write_grip(x, stuck, touched, skin, cloth.graph, grip)
    for block in range(len(network) // LANES):
        first = LANES * block
        put_points(residual, first, in_frames(frames, block, sub(points_in(x, first), points_in(network, first))))
        put_points(velocity, first, in_frames(frames, block, scaled(k.one / schedule.step_s, points_in(way, first))))
    return x, farthest_place_m(x, network), lifted


@part
def _descend_rounds(x, way, lifted, guides, touched, cloth, schedule):
    """Moves ``x`` by the rounds of ``schedule`` and the lift, in place, and writes the ``way`` of the last step and how
    far each vertex was ``lifted``."""
    sheet, network, skin, colliders = cloth.sheet, guides.network, guides.around.skin, guides.around.colliders
    planes, gradient = guides.planes, np.empty_like(x)
    before, scratch = np.empty_like(x), np.empty(SCRATCH, x.dtype)
    follow(network, skin, cloth.graph, touched)
    leash(sheet, planes)
    stick(sheet, guides.stuck, schedule.friction, planes)
    first, every = schedule.turn < 0, np.arange(len(cloth.tangles.start) - 1, dtype=np.int32)
    for _ in range(schedule.rounds):
        touch(x, skin, cloth.graph, sheet, touched, schedule.turn, planes)
        put_planes(x, colliders, planes)
        if schedule.within:
            keep_apart(x, sheet, cloth.neighbours, planes)
        if first:
            # Triangles that the network stretches are stiffer than K knows, and steps would run away: sweeps first.
            for _ in range(schedule.rounds):
                descend(x, sheet, planes, network, scratch)
            first = False
        for _ in range(schedule.steps):
            before[:] = x
            _go_on(x, way, schedule.momentum, sheet.constants)
            gradient_at(x, sheet, planes, network, scratch, gradient)
            whole_step(x, cloth.factor, gradient, schedule.share)
            _set_way(way, x, before)
        for _ in range(schedule.sweeps):
            before[:] = x
            if schedule.steps == 0:
                _go_on(x, way, schedule.momentum, sheet.constants)
            descend(x, sheet, planes, network, scratch)
            if schedule.steps == 0:
                _set_way(way, x, before)
        if schedule.within:
            crossed = untangle(x, cloth.tangles, every, schedule.untangle, APART_STEPS)
            ease(x, network, crossed, x.dtype.type(EASE / WAY_M) * schedule.untangle, sheet)
    if schedule.rounds == 0 and (schedule.clearance > 0.0 or len(colliders)):  # folds without steps have no planes yet
        touch(x, skin, cloth.graph, sheet, touched, schedule.turn, planes)
    leave(x, colliders, planes, schedule.clearance)
    if schedule.clearance > 0.0:
        lift(x, planes, schedule.clearance, lifted)


@kernel
def _go_on(x, way, momentum, k):
    """Moves ``x`` by a share ``momentum`` of its ``way``, of which no more than the reach counts."""
    for block in range(len(x) // LANES):
        u = points_in(way, LANES * block)
        share = momentum * k.reach / root(most(dot(u, u), k.reach * k.reach))
        put_points(x, LANES * block, add(points_in(x, LANES * block), scaled(share, u)))


@kernel
def _set_way(way, x, before):
    for block in range(len(x) // LANES):
        put_points(way, LANES * block, sub(points_in(x, LANES * block), points_in(before, LANES * block)))


def warm_up() -> None:
    """Compiles the kernels or reads what is stored of them, so that no frame waits for it."""
    square, faces = (
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]]),
        [[0, 1, 2], [0, 2, 3]],
    )
    cloth = ClothMesh.from_rest(square, np.array(faces))
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1), np.zeros((1, 3)))
    small = FoldConstants.of(WornCloth(cloth, Material(), np.zeros(4), graph, np.zeros(4, np.int32)))
    skin = np.zeros((1, 8))
    x, memory, _ = fold(small, None, Frame(square, skin, 0.0), FoldEffort(steps=1))
    heights_over(x, small.sheet, memory.touched.own, skin, small.graph)
    skin[:, 6] = 1.0
    above = square + np.array([0.0, 0.0, 0.05])
    pressed(above, small.laid, memory.touched.own, skin, ceiling_over(square, small.laid, skin))
