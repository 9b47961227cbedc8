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
from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.projection import CLEARANCE_M, MOVED_M
from drape.kernels.compiled import kernel
from drape.kernels.elements import add, dot, scaled, sub, with_spare
from drape.kernels.lanes import most, points_in, put_points, root
from drape.live.ceiling import ceiling_over, pressed
from drape.live.clock import FIRST_STEP_S, Frame, FrameMemory, Surroundings, follows, step_between
from drape.live.colliders import leave, put_planes
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.lift import lift
from drape.live.places import counted, farthest_place_m, moved_m, put_places, put_vertices
from drape.live.raised_skin import heights_over
from drape.live.residual import EASE, ease, keep_residual
from drape.live.room import keep_apart
from drape.live.sheet import LANES, Sheet
from drape.live.skin_contact import TURNS, stuck_places, touch, write_grip
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples, follow
from drape.live.surface_frames import FRAMES, in_frames, in_world, surface_frames
from drape.live.sweeps import SCRATCH, descend, gradient_at, leash, stick
from drape.live.untangle import WAY_M, farthest_way, untangle
from drape.live.whole import whole_step

# The share of the last step's way that comes before a step: in slow motion, and in fast motion of soft and stiff cloth.
MOMENTUM, FAST_MOMENTUM, STIFF_MOMENTUM = 0.9, 0.7, 0.5
# That of a frame without a past with at least so many rounds: sixty rounds then come as far as five hundred with 0.9.
# Eight rounds would come less far.
SETTLING_MOMENTUM, LONG_ROUNDS = 0.98, 16
FAR_M = 0.25  # a vertex farther from the network's drape is no fold
SLOW_M, FAST_M = 0.01, 0.02  # RMS way of the network's vertices a frame, between which motion becomes fast
FAST_SWEEPS = 2  # sweeps that fast motion adds
STIFF_SHARE = 0.5  # what fast motion leaves of a step of the whole in stiff cloth
# Mean membrane stiffness along warp and weft from which cloth counts as stiff: denim, satin, poplin, but no knit.
STIFF_N_PER_M = 1000.0
# Shaken cloth creeps: the share of friction that is left where the network moves by so much a second or more.
SHAKEN, SHAKEN_M_S = 0.5, 0.1
FADE_S = 1.0  # in which folds without steps come down to 1/e


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


@dataclass(frozen=True)
class FoldEffort:
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


def fold(
    constants: FoldConstants, memory: FoldMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, FoldMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    The same input gives the same bits. ``memory`` is not written to.
    """
    sheet, dtype = constants.sheet, constants.sheet.own.dtype
    placed = PlacedFrame(np.empty((len(sheet.vertex), 3), dtype), frame.around(dtype), frame.time_s)
    put_places(frame.vertices, sheet.vertex, placed.network)
    x, after, lifted_m, report = fold_places(constants, memory, placed, effort, sheet.planes())
    if x is None:
        return frame.vertices, after, report
    return delivered(x, sheet), after, with_lift(report, lifted_m, sheet)


class PlacedFrame(NamedTuple):
    """A frame at the places of a cloth: the ``network``'s [m] (P, 3), what is ``around``, and the time [s]."""

    network: np.ndarray
    around: Surroundings
    time_s: float


def fold_places(
    constants: FoldConstants, memory: FoldMemory | None, frame: PlacedFrame, effort: FoldEffort, planes: np.ndarray
) -> tuple[np.ndarray | None, FoldMemory, np.ndarray, FoldReport]:
    """``fold`` from place to place: where cloth is [m] (P, 3), None where that is no fold, the memory, how far [m] (P,)
    it was lifted, and a report without that. What held the cloth is left in ``planes`` (``Sheet.planes``)."""
    past = memory if memory is not None and follows(memory, frame.network, frame.time_s) else None
    if past is not None:
        x, after, lifted_m = _advanced(constants, past, frame, effort, planes)
        if x is not None:
            return x, after, lifted_m, FoldReport(settled=False)
    none = _without_past(constants, frame)
    x, after, lifted_m = _advanced(constants, none, frame, effort, planes)
    if x is None:
        return None, none, lifted_m, FoldReport(settled=True, reset=True)
    return x, after, lifted_m, FoldReport(settled=True, reset=past is not None)


def delivered(x: np.ndarray, sheet: Sheet) -> np.ndarray:
    """The vertices [m] (V, 3) of the cloth ``x`` [m] (P, 3)."""
    vertices = np.empty((len(sheet.place), 3), x.dtype)
    put_vertices(x, sheet.place, vertices)
    return vertices


def with_lift(report: FoldReport, lifted_m: np.ndarray, sheet: Sheet) -> FoldReport:
    """``report`` with what ``lifted_m`` [m] (P,) says of the vertices."""
    count, most_m = counted(lifted_m, sheet.place, MOVED_M)
    return FoldReport(report.settled, report.reset, count / len(sheet.place), float(most_m))


def calmness(way_m: float) -> float:
    """1 where the network moves its vertices slowly, by ``way_m`` [m] (``moved_m``), 0 where fast."""
    return min(max((FAST_M - way_m) / (FAST_M - SLOW_M), 0.0), 1.0)


def grip_left(way_m: float, step_s: float) -> float:
    """The share of friction with the skin that holds where the network moves its vertices by ``way_m`` [m]
    (``moved_m``) in ``step_s`` [s]: 1 at rest, ``SHAKEN`` from ``SHAKEN_M_S`` on."""
    return 1.0 - (1.0 - SHAKEN) * min(way_m / (SHAKEN_M_S * step_s), 1.0)


def _without_past(constants: FoldConstants, frame: PlacedFrame) -> FoldMemory:
    still = np.zeros_like(frame.network)
    touched = TouchedSamples(constants.index, np.full_like(constants.index, -1))
    return FoldMemory(frame.time_s, frame.network, still, still, touched, still, 0)


def _advanced(
    constants: FoldConstants, past: FoldMemory, frame: PlacedFrame, effort: FoldEffort, planes: np.ndarray
) -> tuple[np.ndarray | None, FoldMemory, np.ndarray]:
    """The cloth [m] (P, 3) of the frame after ``past``, None where that is no fold, its memory, and how far [m] (P,) it
    was lifted."""
    network, time_s, dtype = frame.network, frame.time_s, frame.network.dtype.type
    settled = past.network is network
    step_s = FIRST_STEP_S if settled else step_between(past.time_s, time_s)
    rounds = 0 if effort.steps == 0 else effort.settle if settled else 1
    share = fading(effort, step_s)
    way_m = moved_m(past.network, network, constants.sheet.place)
    friction = 0.0 if settled else grip_left(way_m, step_s) * constants.friction
    k = constants.sheet.constants
    # Each is half of the fabric's.
    pace = paced(effort.steps, calmness(way_m), stiff=float(k.warp + k.weft) > STIFF_N_PER_M)
    momentum = SETTLING_MOMENTUM if settled and rounds >= LONG_ROUNDS else pace.momentum
    schedule = FoldSchedule(
        dtype(step_s), dtype(momentum), dtype(pace.share), rounds, pace.steps, pace.sweeps,
        -1 if settled else past.turn, effort.cloth_contact and rounds > 0,
        dtype(friction), dtype(effort.clearance_m),
        dtype(WAY_M if settled else farthest_way(way_m)),
    )  # fmt: skip
    touched = TouchedSamples(past.touched.own.copy(), past.touched.other.copy())
    state = FoldState(dtype(share) * past.residual, dtype(share == 1.0) * past.velocity, past.grip.copy())
    places = FoldPlaces(past.network, network, planes)
    x, far, lifted_m = advance(places, state, touched, frame.around, constants, schedule)
    after = FoldMemory(time_s, network, state.residual, state.velocity, touched, state.grip, (past.turn + 1) % TURNS)
    return x if far <= FAR_M else None, after, lifted_m


def fading(effort: FoldEffort, step_s: float) -> float:
    """The share of the residual that is left after ``step_s`` [s]: 1 where there are steps, less where folds fade."""
    return 1.0 if effort.steps else math.exp(-step_s / FADE_S)


class Pace(NamedTuple):
    """``steps`` of the whole cloth, a ``share`` of each, with ``momentum``, and ``sweeps`` over its vertices."""

    steps: int
    sweeps: int
    share: float
    momentum: float


def paced(steps: int, calm: float, *, stiff: bool) -> Pace:
    """The pace of an effort of ``steps`` in motion that is ``calm`` (``calmness``), for cloth that is ``stiff`` or not.

    A step of the whole answers to where soft cloth was, and in fast motion that is out of date: steps fade out, and
    sweeps take their place. Stiff cloth crumples without steps: half of each stays, with less momentum, and sweeps for
    contact are added.
    """
    half = (steps + 1) // 2
    if stiff:
        momentum = STIFF_MOMENTUM + calm * (MOMENTUM - STIFF_MOMENTUM)
        sweeps = half if calm == 1.0 else steps + FAST_SWEEPS
        return Pace(steps, sweeps, STIFF_SHARE + calm * (1.0 - STIFF_SHARE), momentum)
    momentum = FAST_MOMENTUM + calm * (MOMENTUM - FAST_MOMENTUM)
    if calm == 0.0:
        return Pace(0, steps + FAST_SWEEPS, 0.0, momentum)
    return Pace(steps, half + (FAST_SWEEPS if calm < 1.0 else 0), calm, momentum)


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


class FoldState(NamedTuple):
    """The arrays of ``FoldMemory`` that a frame writes anew."""

    residual: np.ndarray
    velocity: np.ndarray
    grip: np.ndarray


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


@kernel
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


@kernel
def _descend_rounds(x, way, lifted, guides, touched, cloth, schedule):
    """Moves ``x`` by the rounds of ``schedule`` and the lift, in place, and writes the ``way`` of the last step and how
    far each vertex was ``lifted``."""
    sheet, network, skin, colliders = cloth.sheet, guides.network, guides.around.skin, guides.around.colliders
    planes, gradient = guides.planes, np.empty_like(x)
    before, scratch = np.empty_like(x), np.empty(SCRATCH, x.dtype)
    follow(network, skin, cloth.graph, touched)
    leash(sheet, planes)
    stick(sheet, guides.stuck, schedule.friction, planes)
    first, every = schedule.turn < 0, np.arange(len(cloth.tangles.start) - 1)
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
            crossed = untangle(x, cloth.tangles, every, schedule.untangle)
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
