"""The clip_job of a frame: its stages in order, and which of them a plan takes.

A new stage is a file here, a line in ``STAGES``, and a field of ``drape.wire.options`` where clients choose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from drape.body.model import BodyModel
from drape.wire.options import DrapeOptions
from service.compute.constants_process import IN_PLACE, ConstantsProcess
from service.compute.hidden import narrowed
from service.graphs.engine import Engine
from service.settings import Settings
from service.stages.batch import BODY, FINE, Batch, Memories, Plan, PoseInput, Stage
from service.stages.collision import Collision
from service.stages.encode import Encode
from service.stages.folds import Folds
from service.stages.motion import Motion
from service.stages.network import Network
from service.stages.novelty import Novelty
from service.stages.swing import Swing

if TYPE_CHECKING:
    from service.compute.garments import Scene

STAGES: tuple[type[Stage], ...] = (Novelty, Motion, Network, Swing, Folds, Collision, Encode)


def make_stages(
    engine: Engine, body: BodyModel, settings: Settings, constants_process: ConstantsProcess = IN_PLACE
) -> tuple[Stage, ...]:
    """All stages of a service, in order; they make their constants in the ``constants_process``."""
    stages = tuple(stage(engine, body, settings) for stage in STAGES)
    for stage in stages:
        stage.constants_process = constants_process
    return stages


def make_plan(stages: Sequence[Stage], scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
    """What ``options`` come to for ``scene``: their values, the stages that they take, and what these need.

    Refuses (``InputError``) what the model cannot do.
    """
    chosen = {name: getattr(options, name) for name in DrapeOptions.model_fields}
    for stage in stages:
        chosen |= stage.resolve(options)
    scene = scene.fine if options.resolution == "fine" else scene
    plan = Plan(scene, DrapeOptions().model_copy(update=chosen), messages)
    for stage in stages:
        stage.check(plan)
    taken = tuple(stage for stage in stages if stage.wanted(plan))
    scene, known = narrowed(scene, plan.options, felt=any(stage.joins_layers(plan) for stage in taken))
    plan = replace(plan, scene=scene, options=known)
    needs = frozenset({plan.options.geometry}).union(*(stage.needs(plan) for stage in taken))
    draped = (scene.fine if FINE in needs else scene).layers
    return replace(plan, stages=taken, needs=needs, draped=draped)


def walk(
    plan: Plan, inputs: Sequence[PoseInput], took: Callable[[str, float], None] = lambda name, s: None
) -> Iterator[Batch]:
    """All frames of ``inputs``, which may differ in shape, through the stages of ``plan``: the batch after every step.

    A step is what others may have to wait for: a stage, or a part of one that is long. ``took`` is told the name of
    each stage and how long it took [s].
    """
    batch = Batch.of(plan, inputs)
    for stage in plan.stages:
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


def run(plan: Plan, inputs: Sequence[PoseInput], took: Callable[[str, float], None] = lambda name, s: None) -> Batch:
    """The batch at the end of ``walk``."""
    *_, last = walk(plan, inputs, took)
    return last


def carried(memories: Memories, before: Plan, after: Plan) -> Memories:
    """What of ``memories`` still holds once the plan ``before`` has become ``after``: that of stages which go on, on
    the same options, and of the body or of garments that are worn on."""
    old = {stage.name: stage.depends_on(before) for stage in before.stages}
    new = {stage.name: stage.depends_on(after) for stage in after.stages}
    owners = {BODY, *after.keys, *after.draped_keys}
    return {
        (stage, owner): memory
        for (stage, owner), memory in memories.items()
        if owner in owners and stage in old and stage in new and old[stage] == new[stage]
    }
