"""The stages of the service in this process, without its server: what a stream or a single frame computes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.stopwatch import Clock
from drape.garment.cache import Garment
from drape.stages.batch import Batch, Memories, PoseInput
from drape.stages.plan import Plan
from drape.stages.scene import Entry, Outfit
from drape.stages.walk import Took, by_stages, walk
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime


def plan_of(runtime: DrapeRuntime, garments: Sequence[Garment], *, messages: bool = False, **options: object) -> Plan:
    """The plan of ``garments`` worn together, with the fields of ``DrapeOptions``; with ``messages`` as a stream's."""
    layers = tuple(Entry(one.name, one, "user") for one in garments)
    asked = DrapeOptions.model_validate(options)
    plan = runtime.plan(layers[0] if len(layers) == 1 else Outfit(layers), asked, messages=messages)
    runtime.add_missing(plan)
    return plan


class Stream:
    """Frames under one plan, one after the other; each goes on from what the stages remember of those before.

    ``took`` is told the name of each stage and how long it took [s]. ``staged``: no stages run in one call, so
    that what each of them calls is seen.
    """

    def __init__(
        self, plan: Plan, shape_count: int, *, took: Took = lambda name, s: None, staged: bool = False
    ) -> None:
        self.plan, self.clock, self._betas, self.took = plan, Clock(), np.zeros(shape_count), took
        self._walk = by_stages if staged else walk
        self.memories: Memories = {}
        for stage in plan.stages:
            stage.prepare(plan)

    def frame(self, one: PoseInput) -> Batch:
        """The drape of ``one``, which is timed; the memories that it holds are replaced by the stream's."""
        one = replace(one, memories=self.memories)
        with self.clock:
            *_, batch = self._walk(self.plan, [one], self.took)
        self.memories = batch.memories[0]
        return batch

    def pose(self, pose: np.ndarray, time_s: float) -> Batch:
        """The drape of ``pose`` (24, 3) at ``time_s`` on the body of mean shape, its root in its place."""
        return self.frame(self._input(pose, time_s))

    def forget(self) -> None:
        """Leaves the next frame without a past."""
        self.memories = {}

    def _input(self, pose: np.ndarray, time_s: float) -> PoseInput:
        return PoseInput(pose[None], np.zeros((1, 3)), self._betas, np.array([time_s]))
