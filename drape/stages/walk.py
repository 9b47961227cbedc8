"""The way of a batch through the stages of its plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import cast

from drape.stages.batch import Batch, PoseInput
from drape.stages.frame import at_once, drawn
from drape.stages.plan import Plan, StageRules
from drape.stages.stage import Stage

Took = Callable[[str, float], None]


def walk(plan: Plan, inputs: Sequence[PoseInput], took: Took = lambda name, s: None) -> Iterator[Batch]:
    """Yields the batch of ``inputs`` under ``plan`` after every step; the last one is the result.

    A step is one frame where the engine runs the first stages in one call, and otherwise a stage or a part of a long
    one. Between steps other batches may be computed. The bodies of the inputs may differ in shape. ``took`` is called
    with the name of each stage and the wall time [s] that it took in all frames.
    """
    batch = Batch.of(plan, inputs)
    first, rest = at_once(plan), plan.stages
    steps = None if first is None else drawn(batch, first, took)
    if first is not None and steps is not None:
        rest = rest[len(first.stages) :]
        for batch in steps:
            yield batch
    yield from _through(batch, rest, took)


def by_stages(plan: Plan, inputs: Sequence[PoseInput], took: Took = lambda name, s: None) -> Iterator[Batch]:
    """Yields the batch as ``walk`` does, but the engine runs no stages in one call; the bits are the same."""
    return _through(Batch.of(plan, inputs), plan.stages, took)


def run(plan: Plan, inputs: Sequence[PoseInput], took: Took = lambda name, s: None) -> Batch:
    """Returns the last batch of ``walk``, which is the result."""
    *_, last = walk(plan, inputs, took)
    return last


def _through(batch: Batch, stages: Sequence[StageRules], took: Took) -> Iterator[Batch]:
    for stage in cast("Sequence[Stage]", stages):  # plans know only the rules of their stages
        steps, spent_s = iter(stage.steps(batch)), 0.0
        while True:
            begun_s = time.perf_counter()
            after = next(steps, None)
            spent_s += time.perf_counter() - begun_s
            if after is None:
                break
            batch = after
            yield batch
        took(stage.name, spent_s)
