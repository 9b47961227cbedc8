"""Folds on two levels: steps of a coarse cloth, and sweeps that settle the fine one around it.

What is costly in a frame is contact: with the skin, and of cloth with itself. Folds of a few centimetres need no fine
cloth for it. So the coarse cloth, about a fifth of the vertices (``coarse_mesh``), takes the frame's steps as
``fold_step`` has them. Their way from the network's drape is carried to all vertices (``coarse_weights``), and sweeps
of the fine cloth begin there (``source/levels.hpp`` of the engine).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.cloth.coarse_mesh import coarse_mesh
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_named
from drape.contact.skin import body_skin
from drape.engine.calls import call
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.garment.cache import Garment
from drape.live.clock import Frame
from drape.live.coarse_weights import coarse_weights
from drape.live.eased import FineLevel, Levels, LiftMemory, lift_call
from drape.live.fold_constants import (
    FoldConstants,
    LaidCloth,
    WornCloth,
    array_bytes,
    fold_constants,
    heights_m,
    worn_cloth,
    worn_mesh,
)
from drape.live.fold_step import (
    FoldCall,
    FoldEffort,
    FoldMemory,
    FoldReport,
    compute_frame,
    empty_arrays,
    fold_call,
    memory_of,
    no_past,
    no_places,
    past_of,
)
from drape.live.sheet import sheet
from drape.live.skin_walks import TouchedSamples
from drape.live.untangle import tangles_of

LEAST = 700  # the coarse cloth has so many vertices at least: a sock is small, and round
# Cloth bends under its own weight over so many edges of the coarse mesh at least, if it hangs higher than FREE_M over
# the skin. Below NEAR_M it keeps its rigidity.
FOLD_EDGES, NEAR_M, FREE_M = 3.5, 0.04, 0.12
LOWER = [n for n, name in enumerate(JOINT_NAMES) if name.split("_")[-1] in ("pelvis", "hip", "knee", "ankle", "foot")]


@dataclass(frozen=True, eq=False)
class TwoLevelMemory:
    """What a frame of folds on two levels leaves to the next one: the memory of the ``coarse`` cloth, and where the Q
    places of the ``fine`` one were, [m] (Q, 3); (0, 3) if the frame was only eased and lifted."""

    coarse: FoldMemory
    fine: np.ndarray

    def at(self, time_s: float) -> TwoLevelMemory:
        """Returns the same memory, of a frame at ``time_s`` [s]."""
        return replace(self, coarse=self.coarse.at(time_s))


Memory = FoldMemory | TwoLevelMemory | LiftMemory


@dataclass(frozen=True, eq=False)
class OneLevel:
    """The constants of folds on one level: a garment's delivered mesh takes all steps (``fold_step``)."""

    constants: FoldConstants

    @property
    def nbytes(self) -> int:
        """The memory of the arrays, in bytes."""
        return self.constants.nbytes

    @property
    def laid(self) -> LaidCloth:
        """The constants that garments over and below the cloth read."""
        return self.constants.laid

    def own(self, memory: Memory) -> np.ndarray:
        """Returns which skin sample was under each vertex in the frame that left ``memory``: (P,) int32, an index into
        the body's skin samples for each of the P places of the ``Sheet`` of ``constants``."""
        assert isinstance(memory, FoldMemory)
        return memory.touched.own

    def fold(
        self, memory: Memory | None, frame: Frame, effort: FoldEffort
    ) -> tuple[np.ndarray, FoldMemory, FoldReport]:
        """Returns the vertices [m] (V, 3) of ``frame`` with their folds, the memory for the next frame, and a report,
        as ``fold_step.fold`` does. A memory of two levels counts as none."""
        return compute_frame(self.call(memory, frame.time_s, effort), frame, effort)

    def call(self, memory: Memory | None, time_s: float, effort: FoldEffort) -> FoldCall:
        """Returns the engine's call of ``fold`` for a frame at ``time_s`` [s]."""
        return fold_call(self.constants, memory if isinstance(memory, FoldMemory) else None, time_s)

    def begins(self, memory: Memory | None, effort: FoldEffort) -> bool:
        """Returns False: cloth of one level is never lifted without folds (``TwoLevel.begins``)."""
        return False


@dataclass(frozen=True, eq=False)
class TwoLevel:
    """The constants of folds on two ``levels``, a coarse and a fine cloth; ``laid`` are those of the fine one that
    garments over and below it read."""

    levels: Levels
    laid: LaidCloth

    @property
    def nbytes(self) -> int:
        """The memory of the arrays, in bytes."""
        return array_bytes(self.levels)

    def own(self, memory: Memory) -> np.ndarray:
        """Returns which skin sample was under each vertex in the frame that left ``memory``: (P,) int32, an index into
        the body's skin samples for each of the P places of the ``Sheet`` of the fine cloth."""
        assert not isinstance(memory, FoldMemory)
        own = memory.own if isinstance(memory, LiftMemory) else memory.coarse.touched.own
        return own[self.levels.fine.parent]

    def fold(
        self, memory: Memory | None, frame: Frame, effort: FoldEffort
    ) -> tuple[np.ndarray, TwoLevelMemory | LiftMemory, FoldReport]:
        """Returns the vertices [m] (V, 3) of ``frame``, the memory for the next frame, and a report.

        Without steps, and without earlier folds that fade, cloth is eased and lifted alone. The fine cloth gets as many
        sweeps as ``effort`` has steps of the coarse one. The same input gives the same bits. A memory of one level
        counts as none.
        """
        if self.begins(memory, effort):
            memory = _unfolded(self.levels, memory, frame)
        return compute_frame(self.call(memory, frame.time_s, effort), frame, effort)

    def call(self, memory: Memory | None, time_s: float, effort: FoldEffort) -> FoldCall:
        """Returns the engine's call of ``fold`` for a frame at ``time_s`` [s], where ``begins`` is false."""
        if effort.steps or isinstance(memory, TwoLevelMemory):
            return two_level_call(self.levels, memory if isinstance(memory, TwoLevelMemory) else None, time_s)
        return lift_call(self.levels, memory if isinstance(memory, LiftMemory) else None, time_s)

    def begins(self, memory: Memory | None, effort: FoldEffort) -> TypeGuard[LiftMemory]:
        """Returns whether a frame after ``memory`` is the first with steps of folds: the frame before was only eased
        and lifted. ``fold`` can make such a frame, ``call`` cannot."""
        return effort.steps > 0 and isinstance(memory, LiftMemory)


def one_level(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> OneLevel:
    """Returns the constants of folds on one level for ``garment`` on ``body``, made of ``fabric`` or else its own. It
    takes a third of a second."""
    return OneLevel(fold_constants(garment, body, fabric))


def two_level(garment: Garment, body: BodyModel, fabric: Fabric | None = None) -> TwoLevel:
    """Returns the constants of folds on two levels for ``garment`` on ``body``, made of ``fabric`` or else its own. It
    takes half a second to one."""
    worn = worn_cloth(garment, body, fabric)
    vertices = garment.vertices[: garment.vertex_count].astype(np.float64)
    small = coarse_mesh(garment.delivered_rest(), vertices, worn.cloth.faces, least=LEAST)
    cloth, fabric = ClothMesh.of(small.rest, small.faces, len(small.vertex)), fabric or fabric_named(garment.fabric)
    rest = vertices[small.vertex]
    below = worn_mesh(cloth, rest, body, fabric)
    coarse = FoldConstants.of(stiffen(below, hang_shares(rest, body, below.index)))
    fine = sheet(worn.cloth, worn.material, worn.band_n_per_m)
    near, weight = coarse_weights(vertices, worn.cloth.faces, small.vertex, cloth.mean_edge_m)
    near, weight = coarse.sheet.place[near][fine.vertex], weight[fine.vertex]
    most = np.abs(weight).argmax(axis=1)[:, None]
    level = FineLevel(
        fine,
        _in_blocks(near, np.int32),
        _in_blocks(weight, fine.own.dtype),
        np.take_along_axis(near, most, axis=1)[:, 0].astype(np.int32),
        tangles_of(worn.cloth.faces, fine.place),
    )
    levels = Levels(coarse, small.vertex[coarse.sheet.vertex].astype(np.int32), level)
    return TwoLevel(levels, LaidCloth(fine, coarse.graph, worn.index[fine.vertex]))


def hang_shares(vertices: np.ndarray, body: BodyModel, index: np.ndarray) -> np.ndarray:
    """Returns how freely ``vertices`` [m] (V, 3) hang at rest round hips and legs of ``body``, (V,) in [0, 1].

    It rises from 0 at the height ``NEAR_M`` over the skin sample ``index`` (V,) to 1 at ``FREE_M``. Round trunk and
    arms it is 0: an arm that comes down presses cloth into folds that stiffer cloth does not make, and passes through
    itself.
    """
    skin = body_skin(body)
    lower = (skin.operator[: skin.count] @ body.weights)[:, LOWER].sum(axis=1)[index]
    return lower * np.clip((heights_m(vertices, skin, index) - NEAR_M) / (FREE_M - NEAR_M), 0.0, 1.0)


def stiffen(worn: WornCloth, hangs: np.ndarray) -> WornCloth:
    """Returns ``worn`` with hinges so stiff that its edges resolve the folds of its own weight.

    Cloth of rigidity B [J] and weight q [N/m^2] bends under its weight over the length (B / q)^(1/3) (Cerda, Mahadevan
    and Pasini 2004, "The elements of draping", PNAS 101(7)). Where that is less than an edge, as on a coarse mesh of
    satin, a mesh does not fold but crumples. Here it is ``FOLD_EDGES`` mean edges at least where ``hangs`` (V,) is 1.
    Where it is 0 cloth keeps its own rigidity.
    """
    cloth, material = worn.cloth, worn.material
    weight = material.gravity_m_s2 * material.density_kg_m2
    times = weight * (FOLD_EDGES * cloth.mean_edge_m) ** 3 / material.bending_j
    free = hangs[cloth.hinge_index.reshape(4, -1)].mean(axis=0)
    weights = cloth.hinge_weight * (1.0 + np.maximum(times - 1.0, 0.0) * free)
    return replace(worn, cloth=replace(cloth, hinge_weight=weights))


def _in_blocks(table: np.ndarray, dtype: Any) -> np.ndarray:
    """A ``table`` (P, n) flat, as n rows of ``LANES`` numbers a block."""
    return np.ascontiguousarray(table.reshape(-1, LANES, table.shape[1]).transpose(0, 2, 1), dtype).reshape(-1)


def two_level_call(levels: Levels, memory: TwoLevelMemory | None, time_s: float) -> FoldCall:
    """Returns the engine's call of folds on two levels for a frame at ``time_s`` [s] after ``memory``."""
    dtype, places = levels.fine.sheet.own.dtype, len(levels.fine.sheet.vertex)
    past = no_past(dtype) if memory is None else past_of(memory.coarse, time_s, memory.fine)
    after, record = empty_arrays(len(levels.kept), places, dtype)

    def remembered(turn: int) -> TwoLevelMemory:
        return TwoLevelMemory(memory_of(time_s, after, turn, record), after.fine)

    return FoldCall("fold_two_levels", levels, past, record, remembered)


def _unfolded(levels: Levels, memory: LiftMemory, frame: Frame) -> TwoLevelMemory:
    """The ``memory`` of a lift as one of folds: nothing moves, and the skin holds each place where the network has it
    now, in its drape of ``frame``."""
    dtype, skin = levels.fine.sheet.own.dtype, frame.around(levels.fine.sheet.own.dtype).skin
    under = np.ascontiguousarray(frame.vertices[levels.kept], dtype)
    still, grip = np.zeros_like(under), np.empty_like(under)
    graph = Record("SkinGraph", levels.coarse.graph)
    call("write_grip", dtype, under, len(under), under, memory.own, skin, len(skin), graph, grip)
    touched = TouchedSamples(memory.own, np.full_like(memory.own, -1))
    coarse = FoldMemory(memory.time_s, memory.network, memory.eased, still, touched, grip, 0)
    return TwoLevelMemory(coarse, no_places(dtype))
