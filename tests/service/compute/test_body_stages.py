"""The stages of a body: what becomes of them."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable

from drape.stages.plan import make_plan
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime


def test_stages_that_nobody_uses_go_at_once_with_what_they_hold(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(folds=1, inertia="mesh")
    entry, stages = runtime.garments.entries()[0], runtime.stages_on(runtime.body)
    stages.add(entry.garment, stages.feed(entry.garment))
    for stage in stages.stages:
        stage.prepare(make_plan(stages.stages, entry, DrapeOptions(advanced=Advanced(folds=1, push_out=True))))
    names, held = [stage.name for stage in stages.stages], [weakref.ref(stage) for stage in stages.stages]
    gc.disable()  # the collector comes seldom, and what a ring of garments' constants holds is tens of megabytes
    try:
        del stage, stages
        assert [name for name, one in zip(names, held, strict=True) if one() is not None] == []
    finally:
        gc.enable()


def test_a_garment_that_is_worn_and_draped_is_missing_once(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime()
    entry, stages = runtime.garments.entries()[0], runtime.stages_on(runtime.body)
    plan = make_plan(stages.stages, entry, DrapeOptions())
    worn = (*plan.scene.layers, *plan.draped)
    assert len(worn) == 2 and stages.missing(worn) == [entry.garment]


def test_tables_of_the_push_out_wait_for_a_plan_that_projects(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime()
    entry, stages = runtime.garments.entries()[0], runtime.stages_on(runtime.body)
    stages.add(entry.garment, stages.feed(entry.garment))
    (collision,) = (stage for stage in stages.stages if stage.name == "collision")
    options = (DrapeOptions(advanced=Advanced(folds=folds, push_out=True)) for folds in (1, 0))
    folded, pushed = (make_plan(stages.stages, entry, one) for one in options)
    assert folded.known == folded.draped and collision not in folded.stages
    assert entry in pushed.known and collision in pushed.stages and collision.held_bytes == 0
    collision.prepare(pushed)
    assert collision.held_bytes > 0
