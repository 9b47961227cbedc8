"""The stages of the service in this process, without its server: a stream, or one frame after the other."""

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
    """Returns the plan of ``garments`` worn together, with all constants computed. ``options`` are fields of
    ``DrapeOptions``; with ``messages`` frames are encoded as those of streams are."""
    layers = tuple(Entry(garment.name, garment, "user") for garment in garments)
    chosen = DrapeOptions.model_validate(options)
    plan = runtime.plan(layers[0] if len(layers) == 1 else Outfit(layers), chosen, messages=messages)
    runtime.add_missing(plan)
    return plan


class Stream:
    """A stream that drapes frames by ``plan``, one after the other; each goes on from what the stages remember of those
    before it.

    ``took`` is called after each stage with its name and its time [s]. With ``staged`` every stage runs by itself, so
    that the calls of each can be traced. ``shape_count`` is the number of the body's shape coefficients.
    """

    def __init__(
        self, plan: Plan, shape_count: int, *, took: Took = lambda name, s: None, staged: bool = False
    ) -> None:
        self.plan, self.clock, self._betas, self.took = plan, Clock(), np.zeros(shape_count), took
        self._walk = by_stages if staged else walk
        self.memories: Memories = {}
        for stage in plan.stages:
            stage.prepare(plan)

    def frame(self, pose: PoseInput) -> Batch:
        """Returns the batch of one frame, that of ``pose``. It goes on from the memories of the stream, not from those
        in ``pose``. Its time is added to ``clock``."""
        pose = replace(pose, memories=self.memories)
        with self.clock:
            *_, batch = self._walk(self.plan, [pose], self.took)
        self.memories = batch.memories[0]
        return batch

    def pose(self, pose: np.ndarray, time_s: float) -> Batch:
        """Does as ``frame``, for ``pose`` (24, 3) [rad] at ``time_s`` on the body of mean shape, its root in its rest
        place."""
        return self.frame(PoseInput(pose[None], np.zeros((1, 3)), self._betas, np.array([time_s])))

    def forget(self) -> None:
        """Drops the stream's memories: the next frame has no past."""
        self.memories = {}
