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
from drape.kernels.compiled import kernel, part
from drape.kernels.elements import add, scaled, sub, with_spare
from drape.kernels.lanes import number_at, points_in, put_points
from drape.live.clock import Frame, writable
from drape.live.coarse_mesh import coarse_mesh
from drape.live.coarse_weights import carried_points, coarse_weights
from drape.live.colliders import leave, put_planes
from drape.live.eased import FineLevel, Levels, LiftMemory, lifted_alone
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
    fold,
    fold_places,
    memory_of,
    past_of,
    report_of,
)
from drape.live.lift import lift
from drape.live.pace import fading
from drape.live.places import delivered, farthest_place_m, placed
from drape.live.sheet import LANES, sheet
from drape.live.skin_contact import ParentSamples, put_other_planes, put_own_planes, write_grip
from drape.live.skin_walks import NEIGHBOURS, SkinGraph, TouchedSamples
from drape.live.sweeps import APART_ROW, PLANES, SCRATCH, descend, leash
from drape.live.untangle import tangles_of, untangle

APART_STEPS = np.int64(2)  # of untangling the fine cloth: four leave fewer crossings and cost time and gain
KEPT_S = 0.25  # in which what sweeps added comes down to 1/e: more lets fine folds pass through each other


@dataclass(frozen=True, eq=False)
class TwoLevelMemory:
    """What a frame leaves: the memory of the ``coarse`` cloth, and what sweeps ``added`` [m] (P, 3) to the fine one."""

    coarse: FoldMemory
    added: np.ndarray

    def at(self, time_s: float) -> TwoLevelMemory:
        """The same at another time [s]."""
        return replace(self, coarse=self.coarse.at(time_s))


Memory = FoldMemory | TwoLevelMemory | LiftMemory


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
    def levels(self) -> Levels:
        """As kernels read them."""
        return Levels(self.coarse, self.kept, self.fine)

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
        return lifted_alone(self.levels, memory if isinstance(memory, LiftMemory) else None, frame, effort)


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


def fold_two_level(
    constants: TwoLevel, memory: TwoLevelMemory | LiftMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, TwoLevelMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report.

    ``effort`` has as many sweeps of the fine cloth as steps of the coarse one. The same input gives the same bits.
    """
    dtype = constants.fine.sheet.own.dtype
    around, levels = frame.around(dtype), constants.levels
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
        added = added.copy()
        share = math.exp(-past.step_s / KEPT_S) if effort.steps else fading(effort.steps, past.step_s)
    apart_m = outcome.untangle if sweeps and effort.cloth_contact else 0.0
    schedule = FineSchedule(kind(share), kind(apart_m), kind(effort.clearance_m), sweeps)
    held = CoarseHold(planes, off, folded.touched)
    x, far, lifted = settle_fine(network, added, held, around, fine, coarse.graph, schedule)
    out, lost = np.empty_like(vertices), not far <= FAR_M
    if lost:
        added[:] = 0.0
        lifted[:] = 0.0
    return out, under, folded, (added, lost), delivered(x, lifted, fine.sheet.place, out)


def _unfolded(constants: TwoLevel, memory: LiftMemory, vertices: np.ndarray, skin: np.ndarray) -> TwoLevelMemory:
    """The ``memory`` of a lift as one of folds: nothing moves, and the skin holds each place where the network has it
    now, in its drape ``vertices`` [m] (V, 3)."""
    under = placed(vertices, constants.kept)
    still, grip = np.zeros_like(under), np.zeros_like(under)
    touched = TouchedSamples(memory.own, np.full_like(memory.own, -1))
    write_grip(under, under.copy(), touched, skin, constants.coarse.graph, grip)
    added = np.zeros((len(constants.fine.parent), 3), under.dtype)
    return TwoLevelMemory(FoldMemory(memory.time_s, memory.network, memory.eased, still, touched, grip, 0), added)


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


@part
def settle_fine(network, added, coarse, around, fine, graph, schedule):
    """``x`` [m] (P, 3), how far [m] the farthest vertex is from the ``network``, NaN where one is, and how far [m] each
    was lifted (P,). ``added`` is written anew."""
    sheet = fine.sheet
    x, carried, lifted = with_spare(network), np.empty_like(network), np.zeros(len(network), network.dtype)
    for block in range(len(network) // LANES):
        points = carried_points(points_in(network, LANES * block), coarse.off, fine, block)
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


def warm_up_lift() -> tuple[TwoLevel, LiftMemory, Frame]:
    """Compiles what makes constants and lifts cloth alone; the levels of a small sheet, its memory and its frame."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"))
    vertices, corner = 0.01 * np.stack([x, y, 0.0 * x], axis=1), np.flatnonzero((x < 8.0) & (y < 8.0))
    faces = np.concatenate([corner[:, None] + np.array(turn) for turn in ((0, 9, 10), (0, 10, 1))])
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1), np.zeros((1, 3)))

    def hung(cloth: ClothMesh, points: np.ndarray) -> WornCloth:
        return WornCloth(cloth, Material(), np.zeros(len(points)), graph, np.zeros(len(points), np.int32))

    made = _around(hung(ClothMesh.from_rest(vertices, faces), vertices), modelled(vertices, faces), vertices, hung)
    frame = Frame(vertices.astype(np.float32), np.ones((1, 8)), 0.0)
    return made, lifted_alone(made.levels, None, frame, FoldEffort(0, clearance_m=0.001))[1], frame


def warm_up() -> None:
    """Compiles the kernels or reads what is stored of them, so that no frame waits for it."""
    fold_two_level(*warm_up_lift(), FoldEffort(1, cloth_contact=True))
