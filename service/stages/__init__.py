"""The stages of a frame in order, and the plan that says which of them a frame takes.

A new stage is a file here, a line in ``STAGES``, and a field of ``drape.wire.options`` where clients choose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from drape.wire.options import DrapeOptions
from service.stages.batch import FINE, Batch, Plan, PoseInput, Stage, StageSetup
from service.stages.collision import Collision
from service.stages.encode import Encode
from service.stages.folds import Folds
from service.stages.motion import Motion
from service.stages.network import Network
from service.stages.novelty import Novelty
from service.stages.scene import Scene, layer_fabrics, narrowed
from service.stages.swing import Swing

STAGES: tuple[type[Stage], ...] = (Novelty, Motion, Network, Swing, Folds, Collision, Encode)


def make_stages(setup: StageSetup) -> tuple[Stage, ...]:
    """All stages of a service, in order."""
    return tuple(stage(setup) for stage in STAGES)


def make_plan(stages: Sequence[Stage], scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
    """The plan for ``scene`` under ``options``: their values, the stages that they take, and the needs of these.

    Refuses (``InputError``) what the model cannot do.
    """
    chosen = {name: getattr(options, name) for name in DrapeOptions.model_fields}
    for stage in stages:
        chosen |= stage.resolve(options)
    scene = scene.fine if options.resolution == "fine" else scene
    known = DrapeOptions().model_copy(update=chosen)
    plan = Plan(scene, known, messages, fabrics=layer_fabrics(known, len(scene.layers)))
    for stage in stages:
        stage.check(plan)
    taken = tuple(stage for stage in stages if stage.wanted(plan))
    rows, known = narrowed(scene, plan.options, felt=any(stage.joins_layers(plan) for stage in taken))
    if len(rows) < len(scene.layers):
        scene = scene.only([scene.layers[row].id for row in rows])
    plan = replace(plan, scene=scene, options=known, fabrics=tuple(plan.fabrics[row] for row in rows))
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
