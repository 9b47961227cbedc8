"""One frame of folds: the network's drape and what is remembered of the frame before in, cloth and a memory out.

The start is the network's surface X with the residual of the frame before, carried in local frames R of the surface:

    x = X + R^T r,   v = R^T u dt

Then rounds of steps of the whole cloth, each from where 0.9 of the last one's way leads to, and of sweeps of vertex
block descent (Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4)). The way is carried over frames, so that the
descent has the memory of a heavy ball. What is left, r = R (x - X) and u = R v / dt, is the new memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.contact.projection import CLEARANCE_M, MOVED_M
from drape.kernels.compiled import kernel
from drape.kernels.elements import at, dot, scaled, sub
from drape.kernels.lanes import points_in, put_points
from drape.live.fold_constants import Constants, Dressed
from drape.live.layers import covered
from drape.live.lift import lift
from drape.live.room import Near, hold_within
from drape.live.sheet import LANES, Sheet
from drape.live.skin_contact import NEIGHBOURS, TURNS, SkinGraph, Touched, carried, follow, gripped, touch
from drape.live.surface_frames import FRAMES, in_frames, in_world, mend, surface_frames
from drape.live.sweeps import PLANES, SCRATCH, descend, gradient_at, leash, stick
from drape.live.whole import Whole, whole_step

# Of the last step's way before a step: in slow motion, and in fast motion of soft and of stiff cloth.
MOMENTUM, FAST_MOMENTUM, STIFF_MOMENTUM = 0.9, 0.7, 0.5
# Of a frame without a past with as many rounds: sixty then come as far as five hundred with 0.9, but eight less far.
SETTLING_MOMENTUM, LONG_ROUNDS = 0.98, 16
FAR_M = 0.25  # from the network's drape: farther is no fold
CUT_M = 0.30  # a vertex that the network moves farther between two frames is in another clip
SLOW_M, FAST_M = 0.01, 0.02  # RMS way of the network's vertices a frame, between which motion becomes fast
FAST_SWEEPS = 2  # more in fast motion
STIFF_SHARE = 0.5  # that fast motion leaves of a step of the whole in stiff cloth
# Mean membrane stiffness along warp and weft from which cloth counts as stiff: denim, satin, poplin, but no knit.
STIFF_N_PER_M = 1000.0
MENDS, MEND_M = 2, 0.03  # rounds of following the neighbours where a residual is that far from theirs
PAUSE_S = 0.25  # after a longer one a frame has no past
SHORTEST_STEP_S = 1.0 / 240.0  # frames that come closer together count as this far apart
FIRST_STEP_S = 1.0 / 30.0  # of a frame without a past
FADE_S = 1.0  # in which folds that are only carried along come down to 1/e


@dataclass(frozen=True, eq=False)
class Frame:
    """What is known of a frame: the network's ``vertices`` [m] (V, 3), the posed samples ``skin`` (S, 8) of
    ``drape.contact.samples.sample_table``, both relative to the same origin, and the time [s] by the client's clock."""

    vertices: np.ndarray
    skin: np.ndarray
    time_s: float


@dataclass(frozen=True, eq=False)
class Memory:
    """What is kept of a frame, in the order of the constants' places.

    Where the ``network`` had its vertices [m] (P, 3); in its surface's frames the ``residual`` [m] and ``velocity``
    [m/s] (P, 3) of the folds; the samples ``touched``, and the ``grip`` [m] (P, 3), where friction holds in the
    frames of the own ones. ``turn``: whose turn it is to look for other parts of the body.
    """

    time_s: float
    network: np.ndarray
    residual: np.ndarray
    velocity: np.ndarray
    touched: Touched
    grip: np.ndarray
    turn: int


@dataclass(frozen=True)
class Report:
    """``settled``: the frame had no past, or one that does not lead here. ``reset``: what came out was no fold, and the
    frame was begun anew from the network's drape. The share of the vertices that were lifted off the skin, and the
    furthest way of one [m]."""

    settled: bool
    reset: bool = False
    lifted_share: float = 0.0
    lifted_max_m: float = 0.0


@dataclass(frozen=True)
class Effort:
    """``sweeps``: steps of the whole cloth per frame, and half as many over its vertices, one at least; a frame without
    a past gets ``settle`` times as many of both, after ``settle`` sweeps. Of 0 folds are carried along with the
    network's surface, and fade: no energy is looked at, and a frame without a past is the network's.

    In fast motion ``paced`` tells how much of either there is.
    ``cloth_contact``: whether the cloth keeps to the room that the network's drape leaves between its sheets.
    ``friction``: whether the skin takes cloth along that has a past. ``clearance_m`` [m]: no vertex is left nearer to
    its own part of the skin, but with 0 all are left where they are.
    """

    sweeps: int
    settle: int = 8
    cloth_contact: bool = False
    friction: bool = True
    clearance_m: float = CLEARANCE_M


def fold(
    constants: Constants, memory: Memory | None, frame: Frame, effort: Effort
) -> tuple[np.ndarray, Memory, Report]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, what the next frame needs of them, and a report.

    The same input gives the same bits. ``memory`` is left as it is.
    """
    dtype = constants.sheet.own.dtype
    network = np.take(frame.vertices, constants.sheet.vertex, axis=0).astype(dtype)  # in a third of the time of [...]
    skin = np.array(frame.skin, dtype=dtype, order="C")  # a copy: kernels are compiled for arrays that may be written
    none = _without_past(constants, network, frame.time_s)
    past = memory if memory is not None and _leads_to(memory, network, frame.time_s) else none
    x, after, report = _advanced(constants, past, network, skin, frame.time_s, effort)
    if x is None:
        x, after, report = _advanced(constants, none, network, skin, frame.time_s, effort)
        report = replace(report, reset=True)
    if x is None:
        return frame.vertices, none, Report(settled=True, reset=True)
    return x, after, report


def _leads_to(memory: Memory, network: np.ndarray, time_s: float) -> bool:
    """Whether the frame at ``time_s`` with the ``network``'s vertices (P, 3) follows the one that is remembered."""
    if not 0.0 <= time_s - memory.time_s <= PAUSE_S:
        return False
    way = network - memory.network
    return float(np.einsum("vi,vi->v", way, way).max()) <= CUT_M**2


def calmness(before: np.ndarray, network: np.ndarray) -> float:
    """1 where the network moves its vertices slowly, 0 where fast."""
    way = network - before
    moved_m = float(np.sqrt(np.einsum("vi,vi->", way, way) / len(way)))
    return float(np.clip((FAST_M - moved_m) / (FAST_M - SLOW_M), 0.0, 1.0))


def _without_past(constants: Constants, network: np.ndarray, time_s: float) -> Memory:
    still = np.zeros_like(network)
    touched = Touched(constants.index, np.full_like(constants.index, -1))
    return Memory(time_s, network, still, still, touched, still, 0)


def _advanced(
    constants: Constants, past: Memory, network: np.ndarray, skin: np.ndarray, time_s: float, effort: Effort
) -> tuple[np.ndarray | None, Memory, Report]:
    """Vertices [m] (V, 3) of the frame after ``past``, None where they are no folds, its memory, and a report."""
    dtype = network.dtype.type
    settled = past.network is network
    step_s = FIRST_STEP_S if settled else max(time_s - past.time_s, SHORTEST_STEP_S)
    rounds = 0 if effort.sweeps == 0 else effort.settle if settled else 1
    share = fading(effort, step_s)
    place = constants.sheet.place
    calm = calmness(np.take(past.network, place, axis=0), np.take(network, place, axis=0))
    k = constants.sheet.constants
    pace = paced(effort.sweeps, calm, stiff=float(k.warp + k.weft) > STIFF_N_PER_M)  # each is half of the fabric's
    momentum = SETTLING_MOMENTUM if settled and rounds >= LONG_ROUNDS else pace.momentum
    numbers = Numbers(
        dtype(step_s), dtype(momentum), dtype(pace.share), rounds, pace.steps, pace.sweeps,
        -1 if settled else past.turn, effort.cloth_contact and rounds > 0,
        dtype(constants.friction if effort.friction and not settled else 0.0), dtype(effort.clearance_m),
    )  # fmt: skip
    cloth = Cloth(constants.sheet, constants.level, constants.graph, constants.near)
    touched = Touched(past.touched.own.copy(), past.touched.other.copy())
    kept = Kept(dtype(share) * past.residual, dtype(share == 1.0) * past.velocity, past.grip.copy())
    x, far, lifted_m = advance(network, kept, touched, skin, cloth, numbers)
    lifted_m = np.take(lifted_m, place)
    after = Memory(time_s, network, kept.residual, kept.velocity, touched, kept.grip, (past.turn + 1) % TURNS)
    report = Report(settled, False, float((lifted_m > MOVED_M).mean()), float(lifted_m.max()))
    return (np.take(x, place, axis=0) if far <= FAR_M else None), after, report


def fading(effort: Effort, step_s: float) -> float:
    """What is left of the residual after ``step_s`` [s], 1 where folds are computed; where not, no way is left."""
    return 1.0 if effort.sweeps else float(np.exp(-step_s / FADE_S))


class Pace(NamedTuple):
    """``steps`` of the whole cloth, a ``share`` of each, with ``momentum``, and ``sweeps`` over its vertices."""

    steps: int
    sweeps: int
    share: float
    momentum: float


def paced(effort: int, calm: float, *, stiff: bool) -> Pace:
    """What ``effort`` stands for where motion is so ``calm``, in cloth that is ``stiff`` or not.

    In fast motion steps of the whole ask soft cloth for what is past: they fade out, and sweeps take their place. Stiff
    cloth crumples without them: half of each stays, with less momentum, and sweeps for contact come beside them.
    """
    half = (effort + 1) // 2
    if stiff:
        momentum = STIFF_MOMENTUM + calm * (MOMENTUM - STIFF_MOMENTUM)
        return Pace(
            effort, half if calm == 1.0 else effort + FAST_SWEEPS, STIFF_SHARE + calm * (1.0 - STIFF_SHARE), momentum
        )
    momentum = FAST_MOMENTUM + calm * (MOMENTUM - FAST_MOMENTUM)
    if calm == 0.0:
        return Pace(0, effort + FAST_SWEEPS, 0.0, momentum)
    return Pace(effort, half + (FAST_SWEEPS if calm < 1.0 else 0), calm, momentum)


class Cloth(NamedTuple):
    """The arrays of ``Constants``."""

    sheet: Sheet
    level: Whole
    graph: SkinGraph
    near: Near


class Around(NamedTuple):
    """What a frame's cloth is led by: the ``network``'s vertices and where its own were ``stuck`` to the skin, [m]
    (P, 3), and the samples of the ``skin`` (S, 8)."""

    network: np.ndarray
    stuck: np.ndarray
    skin: np.ndarray


class Kept(NamedTuple):
    """Of ``Memory``, what a frame writes anew."""

    residual: np.ndarray
    velocity: np.ndarray
    grip: np.ndarray


class Numbers(NamedTuple):
    """``step_s`` since the frame before [s]; ``rounds`` of ``steps`` of the whole, a ``share`` of each, and of
    ``sweeps``; the ``turn`` of ``touch``; whether cloth is held ``within`` its room; ``friction`` with the skin, and
    the ``clearance`` [m] that cloth is lifted to."""

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


@kernel
def advance(network, kept, touched, skin, cloth, numbers):
    """``x`` [m] (P, 3), how far [m] it is from the network, NaN where one is, and how far [m] each was lifted (P,).

    What is ``kept`` and ``touched`` is moved on in place.
    """
    sheet, k = cloth.sheet, cloth.sheet.constants
    residual, velocity, grip = kept
    stuck = np.empty_like(network)
    carried(grip, touched, skin, cloth.graph, stuck)
    frames = np.empty(FRAMES // LANES * len(network), network.dtype)
    surface_frames(network, sheet, frames)
    x, way = np.empty_like(network), np.empty_like(network)
    for block in range(len(network) // LANES):
        first = LANES * block
        put_points(x, first, in_world(frames, block, points_in(residual, first)))
        put_points(way, first, in_world(frames, block, scaled(numbers.step_s, points_in(velocity, first))))
    for _ in range(MENDS):
        mend(x, sheet, MEND_M)
    x += network
    lifted = np.zeros(len(x), x.dtype)
    _descend_rounds(x, way, lifted, Around(network, stuck, skin), touched, cloth, numbers)
    if numbers.turn < 0:
        stuck[:] = x
    gripped(x, stuck, touched, skin, cloth.graph, grip)
    far = k.zero
    for v in range(len(network)):
        off = sub(at(x, v), at(network, v))
        square = dot(off, off)
        if far == far and not square <= far:  # NaN, once met, stays
            far = square
    for block in range(len(network) // LANES):
        first = LANES * block
        r = sub(points_in(x, first), points_in(network, first))
        put_points(residual, first, in_frames(frames, block, r))
        u = scaled(k.one / numbers.step_s, points_in(way, first))
        put_points(velocity, first, in_frames(frames, block, u))
    return x, np.sqrt(far), lifted


@kernel
def _descend_rounds(x, way, lifted, around, touched, cloth, numbers):
    """The rounds of ``numbers`` on ``x``, in place, with the ``way`` of the last step, and how far each was ``lifted``
    in the end."""
    sheet, network, skin = cloth.sheet, around.network, around.skin
    planes, gradient = np.empty(PLANES // LANES * len(x), x.dtype), np.empty_like(x)
    before, scratch = np.empty_like(x), np.empty(SCRATCH, x.dtype)
    follow(network, skin, cloth.graph, touched)
    leash(sheet, planes)
    stick(sheet, around.stuck, numbers.friction, planes)
    if numbers.within:
        hold_within(network, sheet, cloth.near, planes)
    first = numbers.turn < 0
    for _ in range(numbers.rounds):
        touch(x, skin, cloth.graph, sheet, touched, numbers.turn, planes)
        if first:
            # Where the network stretches triangles, Green's strain stiffens cloth past what K knows: steps run away.
            for _ in range(numbers.rounds):
                descend(x, sheet, planes, network, scratch)
            first = False
        for _ in range(numbers.steps):
            before[:] = x
            _go_on(x, way, numbers.momentum, sheet.constants)
            gradient_at(x, sheet, planes, network, scratch, gradient)
            whole_step(x, cloth.level, gradient, numbers.share)
            _set_way(way, x, before)
        for _ in range(numbers.sweeps):
            before[:] = x
            if numbers.steps == 0:
                _go_on(x, way, numbers.momentum, sheet.constants)
            descend(x, sheet, planes, network, scratch)
            if numbers.steps == 0:
                _set_way(way, x, before)
    if numbers.clearance > 0.0:
        if numbers.rounds == 0:  # folds that are only carried along have no planes yet
            touch(x, skin, cloth.graph, sheet, touched, numbers.turn, planes)
        lift(x, planes, numbers.clearance, lifted)


@kernel
def _go_on(x, way, momentum, k):
    """Moves ``x`` by its ``momentum``, as far as a vertex may go at most."""
    for v in range(len(x)):
        u = at(way, v)
        share = momentum * k.reach / np.sqrt(max(dot(u, u), k.reach * k.reach))
        for i in range(3):
            x[v, i] += share * u[i]


@kernel
def _set_way(way, x, before):
    for v in range(len(x)):
        for i in range(3):
            way[v, i] = x[v, i] - before[v, i]


def warm_up() -> None:
    """Compiles the kernels, or reads them where they are stored, so that no frame waits for that."""
    square, faces = (
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.0, 0.1, 0.0]]),
        [[0, 1, 2], [0, 2, 3]],
    )
    cloth = ClothMesh.from_rest(square, np.array(faces))
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1), np.zeros((1, 3)))
    small = Constants.of(Dressed(cloth, Material(), np.zeros(4), graph, np.zeros(4, np.int32)))
    skin = np.zeros((1, 8))
    x, memory, _ = fold(small, None, Frame(square, skin, 0.0), Effort(sweeps=1))
    covered(x, small.sheet, memory.touched.own, skin, small.graph)
