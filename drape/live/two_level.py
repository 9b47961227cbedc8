"""Folds on two levels: steps of a coarse cloth, and sweeps that settle the fine one around it.

What is costly in a frame is contact: with the skin, and of cloth with itself. Folds of a few centimetres need no fine
cloth for it. So the coarse cloth, about a fifth of the vertices (``coarse_mesh``), takes the frame's steps as
``fold_step`` has them. Their way from the network's drape is carried to all vertices (``coarse_weights``), and

    x = X + W (x_c - X_c) + share e

is where sweeps of vertex block descent begin. e is what the sweeps of the frame before added; it fades with the time
``KEPT_S``. No contact is looked for on the fine cloth. Its planes are those of the sample that its coarse vertex is at,
blended anew. Where its coarse vertex is kept apart from others, crossings come apart (``untangle``). The lift ends the
frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_named
from drape.cloth.material import Material
from drape.cloth.rest_state import RestState, modelled
from drape.garment.cache import Garment
from drape.kernels.compiled import kernel
from drape.kernels.elements import add, scaled, sub, with_spare
from drape.kernels.lanes import number_at, points_at, points_in, put_points, row_at
from drape.live.clock import CUT_M, Frame, FrameMemory, writable
from drape.live.coarse_mesh import coarse_mesh
from drape.live.coarse_weights import NEAREST, coarse_weights
from drape.live.colliders import leave, put_planes
from drape.live.fold_constants import (
    FoldConstants,
    LaidCloth,
    WornCloth,
    array_bytes,
    fold_constants,
    worn_cloth,
    worn_mesh,
)
from drape.live.fold_step import (
    FAR_M,
    FoldEffort,
    FoldMemory,
    FoldReport,
    fading,
    fold,
    fold_places,
    memory_of,
    past_of,
    report_of,
)
from drape.live.lift import lift, lift_off_skin
from drape.live.places import delivered, farthest_place_m, placed
from drape.live.sheet import LANES, Sheet, sheet
from drape.live.skin_contact import ParentSamples, put_other_planes, put_own_planes, write_grip
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples, follow
from drape.live.sweeps import APART_ROW, PLANES, SCRATCH, descend, leash
from drape.live.untangle import Tangles, tangles_of, untangle

APART_STEPS = 2  # of untangling the fine cloth: four leave fewer crossings and cost time and gain
KEPT_S = 0.25  # in which what sweeps added comes down to 1/e: more lets fine folds pass through each other


@dataclass(frozen=True, eq=False)
class TwoLevelMemory:
    """What a frame leaves: the memory of the ``coarse`` cloth, and what sweeps ``added`` [m] (P, 3) to the fine one."""

    coarse: FoldMemory
    added: np.ndarray

    def at(self, time_s: float) -> TwoLevelMemory:
        """The same at another time [s]."""
        return replace(self, coarse=self.coarse.at(time_s))


@dataclass(frozen=True, eq=False)
class LiftMemory(FrameMemory):
    """A frame of cloth that has no folds and was lifted alone: at the coarse cloth's places the network's points, and
    the samples ``own`` (P,)."""

    own: np.ndarray


Memory = FoldMemory | TwoLevelMemory | LiftMemory


class FineLevel(NamedTuple):
    """The fine cloth's ``sheet``. Its places take from coarse ones: ``near`` and ``weight``, flat, ``NEAREST`` rows of
    ``LANES`` numbers a block; ``parent`` (P,) is the coarse place that each takes most from. ``tangles``: the triangles
    that may cross."""

    sheet: Sheet
    near: np.ndarray
    weight: np.ndarray
    parent: np.ndarray
    tangles: Tangles


@dataclass(frozen=True, eq=False)
class OneLevel:
    """Folds of the fine cloth alone (``fold_step``)."""

    constants: FoldConstants

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return self.constants.nbytes

    @property
    def laid(self) -> LaidCloth:
        """The cloth as garments over and below it read it."""
        return self.constants.laid

    def own(self, memory: Memory) -> np.ndarray:
        """The sample (P,) that each place is at in a ``memory`` that ``fold`` made."""
        assert isinstance(memory, FoldMemory)
        return memory.touched.own

    def fold(
        self, memory: Memory | None, frame: Frame, effort: FoldEffort
    ) -> tuple[np.ndarray, FoldMemory, FoldReport]:
        """``fold_step.fold``; a memory of two levels is none."""
        return fold(self.constants, memory if isinstance(memory, FoldMemory) else None, frame, effort)


@dataclass(frozen=True, eq=False)
class TwoLevel:
    """The ``coarse`` cloth, the fine vertex ``kept`` (n,) at each of its places, the ``fine`` level, and the sample
    nearest to each place of that at rest, ``index`` (P,)."""

    coarse: FoldConstants
    kept: np.ndarray
    fine: FineLevel
    index: np.ndarray

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return self.coarse.nbytes + array_bytes(tuple(self.fine))

    @property
    def laid(self) -> LaidCloth:
        """The fine cloth as garments over and below it read it."""
        return LaidCloth(self.fine.sheet, self.coarse.graph, self.index)

    def own(self, memory: Memory) -> np.ndarray:
        """The sample (P,) that each place of the fine cloth is at in a ``memory`` that ``fold`` made."""
        assert not isinstance(memory, FoldMemory)
        own = memory.own if isinstance(memory, LiftMemory) else memory.coarse.touched.own
        return own[self.fine.parent]

    def fold(
        self, memory: Memory | None, frame: Frame, effort: FoldEffort
    ) -> tuple[np.ndarray, TwoLevelMemory | LiftMemory, FoldReport]:
        """``fold_two_level``, or the lift alone where there are neither steps nor folds that fade; a memory of one
        level is none."""
        if effort.steps or isinstance(memory, TwoLevelMemory):
            return fold_two_level(self, None if isinstance(memory, FoldMemory) else memory, frame, effort)
        return lifted_alone(self, memory if isinstance(memory, LiftMemory) else None, frame, effort.clearance_m)


def one_level(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> OneLevel:
    """The constants of ``garment`` on ``body``, made of ``fabric`` or else its own; takes a third of a second."""
    return OneLevel(fold_constants(garment, body, fabric))


def two_level(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> TwoLevel:
    """The same of its coarse cloth and the fine one; takes half a second to one."""
    worn = worn_cloth(garment, body, fabric)
    fabric = fabric_named(garment.fabric) if fabric is None else fabric
    vertices = garment.vertices[: garment.vertex_count].astype(np.float64)
    return _around(
        worn, garment.delivered_rest(), vertices, lambda cloth, points: worn_mesh(cloth, points, body, fabric)
    )


def _around(
    worn: WornCloth, rest: RestState, vertices: np.ndarray, dressed: Callable[[ClothMesh, np.ndarray], WornCloth]
) -> TwoLevel:
    """The levels of ``worn``, whose state is ``rest`` and whose ``vertices`` [m] (V, 3) are at rest on the body; the
    coarse cloth on some of these is worn as ``dressed`` says."""
    made = coarse_mesh(rest, vertices, worn.cloth.faces)
    cloth = ClothMesh.of(made.rest, made.faces, len(made.vertex))
    coarse = FoldConstants.of(dressed(cloth, vertices[made.vertex]))
    fine = sheet(worn.cloth, worn.material, worn.band_n_per_m)
    taken, weight = coarse_weights(vertices, worn.cloth.faces, made.vertex, cloth.mean_edge_m)
    taken, weight = coarse.sheet.place[taken][fine.vertex], weight[fine.vertex]
    most = np.abs(weight).argmax(axis=1)[:, None]
    level = FineLevel(
        fine,
        _in_blocks(taken, np.int32),
        _in_blocks(weight, fine.own.dtype),
        np.take_along_axis(taken, most, axis=1)[:, 0].astype(np.int32),
        tangles_of(worn.cloth.faces, fine.place),
    )
    return TwoLevel(coarse, made.vertex[coarse.sheet.vertex].astype(np.int32), level, worn.index[fine.vertex])


def _in_blocks(table: np.ndarray, dtype: Any) -> np.ndarray:
    """A ``table`` (P, n) flat, as n rows of ``LANES`` numbers a block."""
    return np.ascontiguousarray(table.reshape(-1, LANES, table.shape[1]).transpose(0, 2, 1), dtype).reshape(-1)


def lifted_alone(
    constants: TwoLevel, memory: LiftMemory | None, frame: Frame, clearance_m: float
) -> tuple[np.ndarray, LiftMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame``, lifted up to the clearance and out of its colliders, the memory for the
    next frame, and a report: what ``fold_two_level`` without steps makes of a frame without a past."""
    dtype = constants.fine.sheet.own.dtype
    past = LiftPast(constants.coarse.index[:0], np.empty((0, 3), dtype))
    if memory is not None and memory.leads_to(frame.time_s):
        past = LiftPast(memory.own, memory.network)
    vertices, levels = writable(frame.vertices, dtype), Levels(constants.coarse, constants.kept, constants.fine)
    lifted, own, under, follows, moved = _lift(vertices, past, frame.around(dtype), levels, dtype.type(clearance_m))
    return lifted, LiftMemory(frame.time_s, under, own), FoldReport(not follows, False, *moved)


def fold_two_level(
    constants: TwoLevel, memory: TwoLevelMemory | LiftMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, TwoLevelMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    ``effort`` has as many sweeps of the fine cloth as steps of the coarse one. The same input gives the same bits.
    """
    dtype = constants.fine.sheet.own.dtype
    around, levels = frame.around(dtype), Levels(constants.coarse, constants.kept, constants.fine)
    vertices = writable(frame.vertices, dtype)
    if isinstance(memory, LiftMemory):
        memory = _unfolded(constants, memory, vertices, around.skin)
    before = None if memory is None else memory.coarse
    added = np.empty((0, 3), dtype) if memory is None else memory.added
    past = past_of(before, frame.time_s, dtype)
    folded, under, coarse, (added, lost), moved = _fold(vertices, past, added, around, levels, effort)
    after = TwoLevelMemory(memory_of(frame.time_s, under, coarse), added)
    report = report_of(coarse.outcome, moved)
    return (frame.vertices, after, replace(report, reset=True)) if lost else (folded, after, report)


class Levels(NamedTuple):
    """The ``coarse`` cloth, the fine vertex ``kept`` (n,) at each of its places, and the ``fine`` level."""

    coarse: FoldConstants
    kept: np.ndarray
    fine: FineLevel


class LiftPast(NamedTuple):
    """The samples ``own`` (P,) and the network's coarse places [m] (P, 3) of the frame before, none without a past."""

    own: np.ndarray
    network: np.ndarray


@kernel
def _fold(vertices, past, added, around, levels, effort):
    """The folded ``vertices`` [m] (V, 3); the coarse cloth's places in the network's drape and ``Folded``; what sweeps
    ``added`` to the fine cloth [m] (P, 3), and whether that was no fold; and what the lift moved (``delivered``)."""
    fine, coarse = levels.fine, levels.coarse
    kind = vertices.dtype.type
    network, under = placed(vertices, fine.sheet.vertex), placed(vertices, levels.kept)
    planes = np.empty(PLANES // LANES * len(under), under.dtype)
    # What no step moved is lifted on the fine cloth.
    clearance_m = effort.clearance_m if effort.steps else 0.0
    coarsely = FoldEffort(effort.steps, effort.settle, effort.cloth_contact, clearance_m)
    folded = fold_places(under, past, around, coarse, coarsely, planes)
    outcome, off = folded.outcome, np.zeros_like(under)
    if not outcome.lost:
        off = folded.x - under
    sweeps, share = effort.steps * (effort.settle if outcome.settled else 1), 0.0
    if outcome.settled:
        added = np.zeros_like(network)
    else:
        added, share = added.copy(), math.exp(-past.step_s / KEPT_S) if effort.steps else fading(effort, past.step_s)
    apart_m = outcome.untangle if sweeps and effort.cloth_contact else 0.0
    schedule = FineSchedule(kind(share), kind(apart_m), kind(effort.clearance_m), sweeps)
    held = CoarseHold(planes, off, folded.touched)
    x, far, lifted = settle_fine(network, added, held, around, fine, coarse.graph, schedule)
    out, lost = np.empty_like(vertices), not far <= FAR_M
    if lost:
        added[:] = 0.0
        lifted[:] = 0.0
    return out, under, folded, (added, lost), delivered(x, lifted, fine.sheet.place, out)


@kernel
def _lift(vertices, past, around, levels, clearance):
    """The lifted ``vertices`` [m] (V, 3), the samples below the coarse places, these in the network's drape, whether
    the frame goes on from ``past``, and what the lift moved (``delivered``)."""
    fine = levels.fine
    x, under = placed(vertices, fine.sheet.vertex), placed(vertices, levels.kept)
    follows = len(past.own) > 0 and farthest_place_m(under, past.network) <= CUT_M
    own = past.own.copy() if follows else levels.coarse.index.copy()
    lifted = lift_off(x, TouchedSamples(own, own), under, around, fine, levels.coarse.graph, clearance)
    out = np.empty_like(vertices)
    return out, own, under, follows, delivered(x, lifted, fine.sheet.place, out)


def _unfolded(constants: TwoLevel, memory: LiftMemory, vertices: np.ndarray, skin: np.ndarray) -> TwoLevelMemory:
    """The ``memory`` of a lift as one of folds, which are none yet: nothing moves, and the skin holds each place where
    the network has it now, in its drape ``vertices`` [m] (V, 3)."""
    under = placed(vertices, constants.kept)
    still, grip = np.zeros_like(under), np.zeros_like(under)
    touched = TouchedSamples(memory.own, np.full_like(memory.own, -1))
    write_grip(under, under.copy(), touched, skin, constants.coarse.graph, grip)
    added = np.zeros((len(constants.fine.parent), 3), under.dtype)
    return TwoLevelMemory(FoldMemory(memory.time_s, memory.network, still, still, touched, grip, 0), added)


class CoarseHold(NamedTuple):
    """The coarse cloth as it lies: the ``planes`` that held it, its way ``off`` [m] (P, 3) the network's drape, and the
    samples that are ``touched``."""

    planes: np.ndarray
    off: np.ndarray
    touched: TouchedSamples


class FineSchedule(NamedTuple):
    """The ``share`` that is kept of what sweeps added before, how far [m] what crosses comes apart in a step, the
    ``clearance`` [m] of the lift, and the ``sweeps``."""

    share: np.floating
    untangle: np.floating
    clearance: np.floating
    sweeps: int


@kernel
def settle_fine(network, added, coarse, around, fine, graph, schedule):
    """``x`` [m] (P, 3), how far [m] the farthest vertex is from the ``network``, NaN where one is, and how far [m] each
    was lifted (P,). ``added`` is written anew."""
    sheet = fine.sheet
    x, carried, lifted = with_spare(network), np.empty_like(network), np.zeros(len(network), network.dtype)
    for block in range(len(network) // LANES):
        points = points_in(network, LANES * block)
        for n in range(NEAREST):
            row = LANES * (NEAREST * block + n)
            points = add(points, scaled(row_at(fine.weight, row), points_at(coarse.off, fine.near, row)))
        put_points(carried, LANES * block, points)
        put_points(x, LANES * block, add(points, scaled(schedule.share, points_in(added, LANES * block))))
    planes, scratch = np.empty(PLANES // LANES * len(x), x.dtype), np.empty(SCRATCH, x.dtype)
    leash(sheet, planes)
    put_own_planes(x, around.skin, graph, ParentSamples(coarse.touched.own, fine.parent), planes)
    put_other_planes(x, around.skin, graph, ParentSamples(coarse.touched.other, fine.parent), planes)
    put_planes(x, around.colliders, planes)
    for _ in range(schedule.sweeps):
        descend(x, sheet, planes, network, scratch)
    if schedule.untangle > 0:
        untangle(x, fine.tangles, close_clusters(coarse.planes, fine), schedule.untangle, APART_STEPS)
    leave(x, around.colliders, planes, schedule.clearance)
    if schedule.clearance > 0.0:
        lift(x, planes, schedule.clearance, lifted)
    for block in range(len(x) // LANES):
        put_points(added, LANES * block, sub(points_in(x, LANES * block), points_in(carried, LANES * block)))
    return x, farthest_place_m(x, network), lifted


@kernel
def lift_off(x, touched, under, around, fine, graph, clearance):
    """How far [m] (P,) each place of ``x`` [m] (P, 3) was lifted up to the ``clearance``, in place, and out of the
    colliders. ``touched`` is moved on below the coarse places ``under``."""
    lifted, samples = np.zeros(len(x), x.dtype), ParentSamples(touched.own, fine.parent)
    follow(under, around.skin, graph, touched)
    if len(around.colliders) == 0:
        lift_off_skin(x, around.skin, graph, samples, clearance, lifted)
        return lifted
    planes = np.zeros(PLANES // LANES * len(x), x.dtype)
    put_own_planes(x, around.skin, graph, samples, planes)
    put_planes(x, around.colliders, planes)
    leave(x, around.colliders, planes, clearance)
    if clearance > 0.0:
        lift(x, planes, clearance, lifted)
    return lifted


@kernel
def close_clusters(planes, fine):
    """The clusters of the tangles of ``fine`` (n,) with a triangle whose first corner's coarse place is kept apart by
    its ``planes``."""
    corner, count = fine.tangles.corner, len(planes) // PLANES
    apart, any_apart = np.empty(LANES * count, np.uint8), False
    for block in range(count):
        for lane in range(LANES):
            apart[LANES * block + lane] = planes[PLANES * block + APART_ROW + lane] > 0
            any_apart |= planes[PLANES * block + APART_ROW + lane] > 0
    found, filled = np.empty(len(fine.tangles.start) - 1, np.int32), 0
    for c in range(len(found) if any_apart else 0):
        close = 0
        for lane in range(LANES):
            close |= number_at(apart, number_at(fine.parent, number_at(corner, 3 * LANES * c + lane)))
        if close:
            found[filled] = c
            filled += 1
    return found[:filled]


def warm_up() -> None:
    """Compiles the kernels or reads what is stored of them, so that no frame waits for it."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"))
    vertices, corner = 0.01 * np.stack([x, y, 0.0 * x], axis=1), np.flatnonzero((x < 8.0) & (y < 8.0))
    faces = np.concatenate([corner[:, None] + np.array(turn) for turn in ((0, 9, 10), (0, 10, 1))])
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1), np.zeros((1, 3)))

    def hung(cloth: ClothMesh, points: np.ndarray) -> WornCloth:
        return WornCloth(cloth, Material(), np.zeros(len(points)), graph, np.zeros(len(points), np.int32))

    made = _around(hung(ClothMesh.from_rest(vertices, faces), vertices), modelled(vertices, faces), vertices, hung)
    frame = Frame(vertices.astype(np.float32), np.ones((1, 8)), 0.0)
    _, memory, _ = lifted_alone(made, None, frame, 0.001)
    fold_two_level(made, memory, frame, FoldEffort(1, cloth_contact=True))
