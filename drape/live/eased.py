"""Cloth without folds: the network's drape, eased by steps of the whole coarse cloth, and lifted off the skin.

The network stretches cloth that no triangle of it feels. One step a frame of the stiffness that the coarse cloth has at
rest (``whole``) takes most of that out, and needs no search: contact is that with the samples of the skin that the
cloth is followed to. How far a frame was eased goes along with the network's surface, fades with the time ``EASED_S``
and is where the next step begins. What is left in the skin is lifted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel
from drape.kernels.elements import add, scaled, sub, with_spare
from drape.kernels.lanes import points_in, put_points
from drape.live.clock import CUT_M, FIRST_STEP_S, Frame, FrameMemory, step_between, writable
from drape.live.coarse_weights import carried_points
from drape.live.colliders import leave, put_planes
from drape.live.fold_constants import FoldConstants
from drape.live.fold_step import FAR_M, FoldEffort, FoldReport
from drape.live.lift import lift, lift_off_skin
from drape.live.places import delivered, farthest_place_m, placed
from drape.live.sheet import LANES, Sheet
from drape.live.skin_contact import ParentSamples, put_own_planes
from drape.live.skin_walks import TouchedSamples, follow
from drape.live.surface_frames import FRAMES, in_frames, in_world, surface_frames
from drape.live.sweeps import PLANES, SCRATCH, gradient_at, leash
from drape.live.untangle import Tangles
from drape.live.whole import whole_step

EASED_S = 0.65  # in which what eased cloth without folds comes down to 1/e


@dataclass(frozen=True, eq=False)
class LiftMemory(FrameMemory):
    """A frame of cloth that was eased and lifted alone: at the coarse cloth's places the network's points, the samples
    ``own`` (P,), and how far it was ``eased`` [m] (P, 3), in the frames of the network's surface."""

    own: np.ndarray
    eased: np.ndarray


class FineLevel(NamedTuple):
    """The fine cloth's ``sheet``. Its places take from coarse ones: ``near`` and ``weight``, flat, ``NEAREST`` rows of
    ``LANES`` numbers a block; ``parent`` (P,) is the coarse place that each takes most from. ``tangles``: the triangles
    that may cross."""

    sheet: Sheet
    near: np.ndarray
    weight: np.ndarray
    parent: np.ndarray
    tangles: Tangles


class Levels(NamedTuple):
    """The ``coarse`` cloth, the fine vertex ``kept`` (n,) at each of its places, and the ``fine`` level."""

    coarse: FoldConstants
    kept: np.ndarray
    fine: FineLevel


class LiftPast(NamedTuple):
    """The arrays of ``LiftMemory`` of the frame ``step_s`` [s] before, infinite where there is none."""

    own: np.ndarray
    network: np.ndarray
    eased: np.ndarray
    step_s: float


def lifted_alone(
    levels: Levels, memory: LiftMemory | None, frame: Frame, effort: FoldEffort
) -> tuple[np.ndarray, LiftMemory, FoldReport]:
    """The vertices [m] (V, 3) of ``frame``, eased, lifted up to the clearance and out of its colliders, the memory for
    the next frame, and a report."""
    dtype = levels.fine.sheet.own.dtype
    past = LiftPast(levels.coarse.index[:0], (none := np.empty((0, 3), dtype)), none, math.inf)
    if memory is not None and memory.leads_to(frame.time_s):
        past = LiftPast(memory.own, memory.network, memory.eased, step_between(memory.time_s, frame.time_s))
    vertices = writable(frame.vertices, dtype)
    lifted, after, follows, moved = _lift(vertices, past, frame.around(dtype), levels, effort)
    own, under, eased = after
    return lifted, LiftMemory(frame.time_s, under, own, eased), FoldReport(not follows, False, *moved)


@kernel
def _lift(vertices, past, around, levels, effort):
    """The eased and lifted ``vertices`` [m] (V, 3), the arrays of ``LiftMemory``, whether the frame goes on from
    ``past``, and what the lift moved (``delivered``)."""
    fine, coarse, skin, clearance = levels.fine, levels.coarse, around.skin, vertices.dtype.type(effort.clearance_m)
    x, under = placed(vertices, fine.sheet.vertex), placed(vertices, levels.kept)
    follows = past.step_s < np.inf and farthest_place_m(under, past.network) <= CUT_M
    own = past.own.copy() if follows else coarse.index.copy()
    follow(under, skin, coarse.graph, TouchedSamples(own, own))
    before, step_s, steps = np.zeros_like(under), FIRST_STEP_S, effort.settle
    if follows:
        before, step_s, steps = past.eased, past.step_s, 1
    eased, off = ease_off(under, before, math.exp(-step_s / EASED_S), own, skin, coarse, steps)
    for block in range(len(x) // LANES):
        put_points(x, LANES * block, carried_points(points_in(x, LANES * block), off, fine, block))
    lifted = lift_off(x, own, around, fine, coarse.graph, clearance)
    out = np.empty_like(vertices)
    return out, (own, under, eased), follows, delivered(x, lifted, fine.sheet.place, out)


@kernel
def ease_off(under, before, share, own, skin, cloth, steps):
    """How far [m] (P, 3) ``steps`` of the whole cloth move it from where the network has it, ``under`` [m] (P, 3), with
    a ``share`` of what it was eased ``before``: in the frames of the surface, and in the axes of the world.

    Contact is that with the skin alone, by the planes of the samples ``own``. What is no fold is left out.
    """
    sheet, k = cloth.sheet, cloth.sheet.constants
    frames, x = np.empty(FRAMES // LANES * len(under), under.dtype), with_spare(under)
    surface_frames(under, sheet, frames)
    for block in range(len(under) // LANES):
        kept = in_world(frames, block, scaled(under.dtype.type(share), points_in(before, LANES * block)))
        put_points(x, LANES * block, add(points_in(under, LANES * block), kept))
    planes, scratch = np.empty(PLANES // LANES * len(under), under.dtype), np.empty(SCRATCH, under.dtype)
    leash(sheet, planes)
    put_own_planes(x, skin, cloth.graph, ParentSamples(own, np.arange(len(own)).astype(np.int32)), planes)
    gradient = np.empty_like(x)
    for _ in range(steps):
        gradient_at(x, sheet, planes, under, scratch, gradient)
        whole_step(x, cloth.factor, gradient, k.one)
    eased, off = np.zeros_like(under), np.zeros_like(under)
    if farthest_place_m(x, under) <= FAR_M:
        for block in range(len(under) // LANES):
            way = sub(points_in(x, LANES * block), points_in(under, LANES * block))
            put_points(off, LANES * block, way)
            put_points(eased, LANES * block, in_frames(frames, block, way))
    return eased, off


@kernel
def lift_off(x, own, around, fine, graph, clearance):
    """How far [m] (P,) each place of ``x`` [m] (P, 3) was lifted up to the ``clearance``, in place, and out of the
    colliders; ``own`` (C,) are the samples below the coarse places."""
    lifted, samples = np.zeros(len(x), x.dtype), ParentSamples(own, fine.parent)
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
