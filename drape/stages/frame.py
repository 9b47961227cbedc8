"""Frames that one call of the engine makes of poses: novelty, network, swing, folds, and coordinates of the message.

These stages make the same bits one after the other. What they hand on to each other as objects of Python takes a fifth
of a T-shirt's frame, most of which is saved here. Their memories are the same too. A card draws such frames of many
streams together, and keeps their memories.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drape.geometry.colliders import seen_from
from drape.inference.packing import check_finite
from drape.live.fold_step import FoldEffort
from drape.network.card_frame import draw_by_card
from drape.network.card_memory import fetched, name_of
from drape.network.frame import PARTS, Drawn, FrameGarment, Moment, Past, draw
from drape.stages.batch import Batch, Layer, changed
from drape.stages.encode import Encode, coordinate_bits
from drape.stages.folds import FoldFigures, Folds, read_layers
from drape.stages.network import Network, Novelty
from drape.stages.plan import SKIN, Plan
from drape.stages.stage import Stage
from drape.stages.swing import Swing
from drape.wire.messages import BYTE_COUNT, STEP_COUNT

if TYPE_CHECKING:
    from drape.live.card_lanes import Lanes

NO_EFFORT = FoldEffort(0)


class AtOnce(NamedTuple):
    """The first stages of a plan, which the engine runs in one call a frame."""

    novelty: Novelty | None
    network: Network
    swing: Swing | None
    folds: Folds | None

    @property
    def stages(self) -> list[Stage]:
        """The stages that the plan has."""
        return [stage for stage in self if stage is not None]


def at_once(plan: Plan) -> AtOnce | None:
    """Returns the stages of ``plan`` that ``drawn`` runs in one call a frame; None if the engine cannot.

    It drapes a single garment, and later stages may read neither jets nor the skin.
    """
    if "at_once" not in plan.kept:
        plan.kept["at_once"] = _at_once(plan)
    return plan.kept["at_once"]


def _at_once(plan: Plan) -> AtOnce | None:
    found = {type(stage): stage for stage in plan.stages}
    novelty, network, swing, folds = (found.get(kind) for kind in (Novelty, Network, Swing, Folds))
    if not isinstance(network, Network) or not network.in_engine:
        return None
    made = AtOnce(novelty, network, swing, folds)  # pyright: ignore[reportArgumentType]
    first, rest = plan.stages[: len(made.stages)], plan.stages[len(made.stages) :]
    if len(plan.draped) > 1 or list(first) != made.stages:
        return None
    return None if "jets" in plan.needs or any(SKIN in stage.needs(plan) for stage in rest) else made


def drawn(
    batch: Batch, stages: AtOnce, took: Callable[[str, float], None] = lambda name, s: None
) -> Iterator[Batch] | None:
    """Yields ``batch`` after each frame, the last one with all that ``stages`` make.

    Returns None where the stages must run by themselves: cloth that was lifted alone begins to fold, or the network
    shares the frames out between threads. ``took`` is called with the name of each stage and its share of the time [s].
    """
    plan, lane = batch.plan, stages.network.lane
    worn, (key,) = _worn(plan, stages), plan.draped_keys
    pasts = [Past(one.memories.get(("swing", key)), one.memories.get(("folds", key))) for one in batch.inputs]
    by_card = lane if lane is not None and lane.works and worn.folds is not None else None
    if batch.count > 1 and not stages.network.on_one_thread and not by_card:
        return None
    if by_card is None or worn.effort.steps:  # the first steps after lifts alone are the processor's
        pasts = [
            Past(*map(fetched, past)) if by_card is None or name_of(past.folded) == "lift_alone" else past
            for past in pasts
        ]
    if worn.folds is not None and any(worn.folds.begins(past.folded, worn.effort) for past in pasts):
        return None
    return _drawn(batch, stages, worn, pasts, by_card, took)


def _worn(plan: Plan, stages: AtOnce) -> FrameGarment:
    """What drapes the garment of ``plan``: made anew where constants are others than in the frame before."""
    (key,), (fabric,), options = plan.draped_keys, plan.fabrics, plan.options
    rows = stages.network.rows(plan)
    swing = None if stages.swing is None else stages.swing.constants(key, fabric)
    folds = None if stages.folds is None else stages.folds.constants(key, fabric, coarse=options.advanced.coarse)
    known: FrameGarment | None = plan.kept.get("worn")
    if known is not None and known.patches is rows.patches and known.swing is swing and known.folds is folds:
        return known
    compiled = stages.network.engine.compiled
    assert compiled is not None
    made = FrameGarment(
        weights=compiled.weights,
        passes=compiled.corrections if (passes := options.advanced.passes) is None else passes,
        patches=rows.patches,
        tiles=rows.tiles,
        kept=None if stages.novelty is None else stages.novelty.kept_poses,
        swing=swing,
        share=options.knob or 0.0,
        folds=folds,
        efforts=(NO_EFFORT, NO_EFFORT) if stages.folds is None else stages.folds.efforts(plan),
        vertex_count=rows.vertex_count,
        step_count=_step_count(plan, stages),
    )
    plan.kept["worn"] = stages.network.drawn_alike.setdefault(made.identity, made)
    return plan.kept["worn"]


def _step_count(plan: Plan, stages: AtOnce) -> int:
    """The last step of coordinates in the message; 0 where another stage or a wrapping changes vertices before it, or
    there is none."""
    behind = plan.stages[len(stages.stages) :]
    if plan.keys != plan.draped_keys or not behind or not isinstance(behind[0], Encode):
        return 0
    return BYTE_COUNT if coordinate_bits(plan.options) == 8 else STEP_COUNT


def _drawn(
    batch: Batch,
    stages: AtOnce,
    worn: FrameGarment,
    pasts: list[Past],
    lane: Lanes | None,
    took: Callable[[str, float], None],
) -> Iterator[Batch]:
    spent_s, root, frames = [0.0] * len(PARTS), np.empty((batch.count, 3)), list[Drawn]()
    moments = list(_moments(batch, stages, root))
    begun_s = time.perf_counter()
    if lane is not None:
        found, vertices, steps = draw_by_card(lane, worn, pasts, moments)
        frames = [_checked(stages, made) for made in found]
        ends = np.cumsum([len(own) for own in moments])
        pasts = [frames[end - 1].past for end in ends]
        spent_s = _shares(frames, time.perf_counter() - begun_s)
        yield batch
    else:
        vertices = np.empty((batch.count, worn.vertex_count, 3), np.float32)
        steps = np.empty((batch.count, worn.vertex_count if worn.step_count else 0, 3), np.uint16)
        for i, own in enumerate(moments):
            for at in own:
                begun_s, row = time.perf_counter(), len(frames)
                frames.append(_checked(stages, draw(worn, pasts[i], at, vertices[row], steps[row])))
                pasts[i] = frames[row].past
                took_s = _shares(frames[row:], time.perf_counter() - begun_s)
                spent_s = [spent + own_s for spent, own_s in zip(spent_s, took_s, strict=True)]
                yield batch
    boxes = [(made.low, made.step) for made in frames]
    quantised = tuple((own, *box) for own, box in zip(steps, boxes, strict=True)) if worn.step_count else ()
    batch = changed(batch, root=root, layers=(Layer(vertices),), steps=quantised)
    yield _told(batch, stages, worn, frames, pasts)
    for name, spent in zip(PARTS, spent_s, strict=True):
        if name in [stage.name for stage in stages.stages]:
            took(name, spent)


def _moments(batch: Batch, stages: AtOnce, root: np.ndarray) -> Iterator[list[Moment]]:
    """Yields the moments of each input, of which the ``root`` (F, 3) [m] is written."""
    for one, rows in batch.rows():
        feed, place = stages.network.posed_by(one.betas)
        np.add(one.trans, place, out=root[rows])
        poses, times_s = np.ascontiguousarray(one.poses, np.float64), one.times_s.tolist()
        yield [
            Moment(feed, pose, time_s, here, seen_from(batch.plan.colliders, here))
            for pose, time_s, here in zip(poses, times_s, root[rows], strict=True)
        ]


def _checked(stages: AtOnce, made: Drawn | None) -> Drawn:
    check_finite(stages.network.engine, made is not None)
    assert made is not None
    return made


def _shares(frames: Sequence[Drawn], took_s: float) -> list[float]:
    """The time that each of ``PARTS`` had of what frames took."""
    ticks = [sum(own) for own in zip(*(made.ticks for made in frames), strict=True)]
    tick_s = took_s / max(sum(ticks), 1)
    return [tick_s * own for own in ticks]


def _told(batch: Batch, stages: AtOnce, worn: FrameGarment, frames: list[Drawn], pasts: list[Past]) -> Batch:
    """``batch`` with what its ``frames`` leave and tell, wrapped around finer cloth where that was draped."""
    (key,), (sent,), quality, layers = batch.plan.draped_keys, batch.plan.keys, batch.quality, batch.layers
    if stages.novelty is not None:
        quality = changed(quality, novelty=np.array([made.novelty for made in frames], np.float32))
    if worn.swing is not None:
        batch = batch.remember(("swing", key), [past.swung for past in pasts])
    if stages.folds is not None and worn.folds is not None:
        batch = batch.remember(("folds", key), [past.folded for past in pasts])
        told = FoldFigures(len(frames))
        reports = [made.report for made in frames if made.report is not None]
        told.add(reports, len(worn.folds.laid.sheet.vertex), seen=batch.plan.visible[0])
        quality = told.quality(quality)
        if sent != key and read_layers(batch.plan)[0]:
            layers = (stages.folds.wrapped(layers[0], batch.plan.scene.layers[0].garment),)
    return changed(batch, quality=quality, layers=layers)
