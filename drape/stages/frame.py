"""Frames that one call of the engine makes of poses: novelty, network, swing, folds, and the message's coordinates.

The stages one after the other make the same bits and memories. The objects of Python that they hand on take a fifth of
a T-shirt's frame, most of which is saved here. A card draws such frames of many
streams together, and keeps their memories.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drape.geometry.colliders import seen_from
from drape.inference.packing import check_finite
from drape.live.fold_step import FoldEffort
from drape.network.card_frame import draw_by_card
from drape.network.card_memory import name_of, to_processor
from drape.network.frame import MOST_LAYERS, PARTS, FrameGarment, FrameOutfit, FrameResult, Moment, Past, draw, identity
from drape.stages.batch import Batch, Layer, changed
from drape.stages.encode import Encode, coordinate_bits
from drape.stages.folds import FoldFigures, Folds, feel_each_other, read_layers
from drape.stages.network import Network, Novelty
from drape.stages.plan import SKIN, Plan
from drape.stages.stage import Stage
from drape.stages.swing import Swing
from drape.wire.messages import BYTE_COUNT, STEP_COUNT

if TYPE_CHECKING:
    from drape.live.card_lanes import Lanes

NO_EFFORT = FoldEffort(0)


class AtOnce(NamedTuple):
    """The first stages of a plan, which the engine runs in one call a frame; None for those that the plan leaves
    out."""

    novelty: Novelty | None
    network: Network
    swing: Swing | None
    folds: Folds | None

    @property
    def stages(self) -> list[Stage]:
        """Returns the stages of the plan among these, in their order."""
        return [stage for stage in self if stage is not None]


def at_once(plan: Plan) -> AtOnce | None:
    """Returns the stages of ``plan`` that ``drawn`` runs in one call a frame; None if the engine cannot.

    It can for up to ``MOST_LAYERS`` garments, where later stages read neither jets nor the skin.
    """
    if "at_once" not in plan.kept:
        plan.kept["at_once"] = _at_once(plan)
    return plan.kept["at_once"]


def _at_once(plan: Plan) -> AtOnce | None:
    by_kind = {type(stage): stage for stage in plan.stages}
    novelty, network, swing, folds = (by_kind.get(kind) for kind in (Novelty, Network, Swing, Folds))
    if not isinstance(network, Network) or not network.in_engine:
        return None
    stages = AtOnce(novelty, network, swing, folds)  # pyright: ignore[reportArgumentType]
    first, rest = plan.stages[: len(stages.stages)], plan.stages[len(stages.stages) :]
    if len(plan.draped) > MOST_LAYERS or len(set(plan.draped_keys)) < len(plan.draped) or list(first) != stages.stages:
        return None
    return None if "jets" in plan.needs or any(SKIN in stage.needs(plan) for stage in rest) else stages


def drawn(
    batch: Batch, stages: AtOnce, took: Callable[[str, float], None] = lambda name, s: None
) -> Iterator[Batch] | None:
    """Returns an iterator that yields ``batch`` after each frame, or on a card after all frames, and at last the batch
    with the layers, memories and figures of ``stages``.

    Returns None where the stages must run one after the other: cloth that was only lifted begins to fold, several
    layers settle, or the network shares the frames out between threads. ``took`` is called at the end with the name of
    each of ``stages`` and the wall time [s] that it took in all frames.
    """
    lane, outfit = stages.network.lane, _outfit(batch.plan, stages)
    pasts = [
        tuple(Past(memories.get(("swing", key)), memories.get(("folds", key))) for key in batch.plan.draped_keys)
        for memories in batch.memories
    ]
    by_card = lane if lane is not None and lane.works and outfit.folds else None
    if batch.count > 1 and not stages.network.on_one_thread and not by_card:
        return None
    if by_card is None or outfit.effort.steps:  # the first steps after lifts alone are the processor's
        pasts = [tuple(_here(past) if by_card is None or _lifted(past) else past for past in own) for own in pasts]
    worn = [(garment.folds, past.folded) for own in pasts for garment, past in zip(outfit.garments, own, strict=True)]
    if any(folds is not None and folds.begins(folded, outfit.effort) for folds, folded in worn):
        return None
    settles = outfit.folds and any(folded is None for _, folded in worn)
    if by_card is None and settles and len(outfit.garments) > 1:  # tens of milliseconds for each layer
        return None
    return _drawn(batch, stages, outfit, pasts, by_card, took)


def _here(past: Past) -> Past:
    """``past`` in the memory of this machine, fetched from a card if it lies there."""
    return Past(*map(to_processor, past))


def _lifted(past: Past) -> bool:
    return name_of(past.folded) == "lift_alone"


def _outfit(plan: Plan, stages: AtOnce) -> FrameOutfit:
    """The garments of ``plan`` as the engine draws them; those of the frame before unless constants have changed."""
    options = plan.options
    rows = stages.network.rows(plan)
    dressed = list(zip(plan.draped_keys, plan.fabrics, strict=True))
    swings = [None if stages.swing is None else stages.swing.constants(*own) for own in dressed]
    coarse = options.advanced.coarse
    folds = [None if stages.folds is None else stages.folds.constants(*own, coarse=coarse) for own in dressed]
    known: FrameOutfit | None = plan.kept.get("worn")
    made_of = [(row.patches, swing, fold) for row, swing, fold in zip(rows, swings, folds, strict=True)]
    if known is not None and all(
        worn.patches is row and worn.swing is swing and worn.folds is fold
        for worn, (row, swing, fold) in zip(known.garments, made_of, strict=True)
    ):
        return known
    compiled = stages.network.engine.compiled
    assert compiled is not None
    garments = [
        FrameGarment(
            weights=compiled.weights,
            passes=compiled.corrections if (passes := options.advanced.passes) is None else passes,
            patches=row.patches,
            tiles=row.tiles,
            kept=None if stages.novelty is None else stages.novelty.kept_poses,
            swing=swing,
            share=options.knob or 0.0,
            folds=fold,
            efforts=(NO_EFFORT, NO_EFFORT) if stages.folds is None else stages.folds.efforts(plan),
            vertex_count=row.vertex_count,
            felt=stages.folds is not None and feel_each_other(plan),
            read=read,
        )
        for row, swing, fold, read in zip(rows, swings, folds, read_layers(plan), strict=True)
    ]
    alike: Any = stages.network.drawn_alike
    garments = tuple(alike.setdefault(identity(garment), garment) for garment in garments)
    outfit = FrameOutfit(garments, plan.visible, _step_count(plan, stages))
    plan.kept["worn"] = alike.setdefault(identity(outfit), outfit)
    return plan.kept["worn"]


def _step_count(plan: Plan, stages: AtOnce) -> int:
    """The highest step of a coordinate in the message; 0 where there is no message, or where another stage or a
    wrapping changes vertices before it."""
    behind = plan.stages[len(stages.stages) :]
    if plan.keys != plan.draped_keys or not behind or not isinstance(behind[0], Encode):
        return 0
    return BYTE_COUNT if coordinate_bits(plan.options) == 8 else STEP_COUNT


def _drawn(
    batch: Batch,
    stages: AtOnce,
    outfit: FrameOutfit,
    pasts: list[tuple[Past, ...]],
    lane: Lanes | None,
    took: Callable[[str, float], None],
) -> Iterator[Batch]:
    spent_s, root, frames = [0.0] * len(PARTS), np.empty((batch.count, 3)), list[FrameResult]()
    moments = list(_moments(batch, stages, root))
    begun_s = time.perf_counter()
    if lane is not None:
        by_card, vertices, steps = draw_by_card(lane, outfit, pasts, moments)
        frames = [_checked(stages, frame) for frame in by_card]
        ends = np.cumsum([len(own) for own in moments])
        pasts = [frames[end - 1].pasts for end in ends]
        spent_s = _shares(frames, time.perf_counter() - begun_s)
        yield batch
    else:
        vertices = np.empty((batch.count, outfit.vertex_count, 3), np.float32)
        steps = np.empty((batch.count, outfit.shown_count if outfit.step_count else 0, 3), np.uint16)
        for i, own in enumerate(moments):
            for at in own:
                begun_s, row = time.perf_counter(), len(frames)
                frames.append(_checked(stages, draw(outfit, pasts[i], at, vertices[row], steps[row])))
                pasts[i] = frames[row].pasts
                took_s = _shares(frames[row:], time.perf_counter() - begun_s)
                spent_s = [spent + own_s for spent, own_s in zip(spent_s, took_s, strict=True)]
                yield batch
    boxes = [(frame.low, frame.step) for frame in frames]
    quantised = tuple((own, *box) for own, box in zip(steps, boxes, strict=True)) if outfit.step_count else ()
    layers = (Layer(vertices),) if len(outfit.rows) == 1 else tuple(Layer(vertices[:, rows]) for rows in outfit.rows)
    batch = changed(batch, root=root, layers=layers, steps=quantised)
    yield _with_outcomes(batch, stages, outfit, frames, pasts)
    for name, spent in zip(PARTS, spent_s, strict=True):
        if name in [stage.name for stage in stages.stages]:
            took(name, spent)


def _moments(batch: Batch, stages: AtOnce, root: np.ndarray) -> Iterator[list[Moment]]:
    """Yields the moments of each input, and writes the places of their root joints into ``root`` (F, 3) [m]."""
    for client, rows in batch.rows():
        feed, place = stages.network.feed_of(client.betas)
        np.add(client.trans, place, out=root[rows])
        poses, times_s = np.ascontiguousarray(client.poses, np.float64), client.times_s.tolist()
        yield [
            Moment(feed, pose, time_s, here, seen_from(batch.plan.colliders, here))
            for pose, time_s, here in zip(poses, times_s, root[rows], strict=True)
        ]


def _checked(stages: AtOnce, frame: FrameResult | None) -> FrameResult:
    check_finite(stages.network.engine, frame is not None)
    assert frame is not None
    return frame


def _shares(frames: Sequence[FrameResult], took_s: float) -> list[float]:
    """The time [s] of each of ``PARTS`` in ``frames``, which took ``took_s`` [s] together."""
    ticks = [sum(own) for own in zip(*(frame.ticks for frame in frames), strict=True)]
    tick_s = took_s / max(sum(ticks), 1)
    return [tick_s * own for own in ticks]


def _with_outcomes(
    batch: Batch, stages: AtOnce, outfit: FrameOutfit, frames: list[FrameResult], pasts: list[tuple[Past, ...]]
) -> Batch:
    """``batch`` with the memories and figures of its ``frames``, and with delivered meshes wrapped around fine ones."""
    plan, quality, layers, figures = batch.plan, batch.quality, list(batch.layers), FoldFigures(len(frames))
    if stages.novelty is not None:
        quality = changed(quality, novelty=np.array([frame.novelty for frame in frames], np.float32))
    garments = zip(plan.draped_keys, plan.keys, outfit.garments, read_layers(plan), strict=True)
    for i, (key, sent, worn, read) in enumerate(garments):
        if worn.swing is not None:
            batch = batch.remember(("swing", key), [own[i].swung for own in pasts])
        if stages.folds is None or worn.folds is None:
            continue
        batch = batch.remember(("folds", key), [own[i].folded for own in pasts])
        reports = [report for frame in frames if (report := frame.reports[i]) is not None]
        figures.add(reports, len(worn.folds.laid.sheet.vertex), visible=plan.visible[i])
        if sent != key and read:
            layers[i] = stages.folds.wrapped(layers[i], plan.scene.layers[i].garment)
    return changed(batch, quality=figures.quality(quality) if outfit.folds else quality, layers=tuple(layers))
