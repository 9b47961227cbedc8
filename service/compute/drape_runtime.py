"""What a start loads, the thread that computes, and the clip_job that frames take there (``service.stages``)."""

from __future__ import annotations

import asyncio
import contextvars
import logging
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.errors import DrapeError, InputError, NotFound
from drape.wire.options import DrapeOptions
from service.compute import unchanged
from service.compute.background import processor_count, thread_steps_back
from service.compute.constants_process import ConstantsProcess
from service.compute.costs import Probe
from service.compute.garments import Registry, Scene
from service.compute.motions import Motions
from service.compute.tiers import capped, chosen, read_tiers, spared, tier_of
from service.errors import Busy, Draining, InternalError
from service.graphs.engine import Engine
from service.settings import Settings
from service.stages import make_plan, make_stages, run, walk
from service.stages.batch import Batch, Memories, Plan, PoseInput, Quality
from service.watch.metrics import Metrics
from service.watch.tracing import Tracing, make_tracing

STREAM_WAIT_S = 0.02
"""What a chunk of a clip may take while there are streams, which share processors with it; one frame is the least."""
STREAM_PAUSE_S = 1.0
"""Longer after the last frame of a stream nothing gives way to streams any more."""

CLIP_FPS = 1.0
"""Frames that a clip gets for every second of waiting, after ``DRAPE_CLIP_WAIT_S``; otherwise it is refused, before its
client gives up."""

COSTS_KEPT = 1024
"""Scenes and tiers whose cost is remembered."""

STEPS_BELOW = 2
"""Steps that ``DrapeRuntime.steps`` has before those of the tiers."""

Result = TypeVar("Result")
log = logging.getLogger("drape.service")


class DrapeRuntime:
    """Everything a start loads: body, model, garments, clips; and the threads that compute.

    ``stream_threads`` have the frames of streams and nothing else, one for each processor unless the settings say how
    many; another has all that streams need not wait for: clips, what a frame costs, garments that are taken in. On a
    GPU, whose buckets take one call at a time, all are the same thread.
    Clips are computed in chunks: of ``DRAPE_CHUNK_FRAMES``, and of as many as take ``STREAM_WAIT_S`` while there are
    streams, of which no step begins while a stream's frame is computed. No bit depends on it.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        body: BodyModel | None = None,
        metrics: Metrics | None = None,
        tracing: Tracing | None = None,
    ) -> None:
        self.settings = settings
        self.metrics = metrics or Metrics()
        self.tracing = tracing or make_tracing(settings.trace)
        self.hurried = False  # clips end now: the service is being restarted
        self.body = body or load_body(settings.body)
        folder = settings.models_dir / settings.model
        self.engine = Engine(
            folder, device=settings.device, int8=settings.int8, half=settings.half, bound=settings.buckets
        )
        self.engine.check_body(self.body)
        self.tiers = read_tiers(self.engine.manifest.tiers)
        self._streamed_s = -math.inf  # when a frame of a stream was last begun
        self.constants_process = ConstantsProcess(lambda: self._streaming)
        self.stages = make_stages(self.engine, self.body, settings, self.constants_process)
        self.garments = Registry(self.body, settings, self.stages, self.constants_process)
        self.motions = Motions(settings.motions_dir)
        self.stream_threads = 1 if self.engine.bound else settings.stream_threads or processor_count()
        self._for_streams = ThreadPoolExecutor(self.stream_threads, thread_name_prefix="drape-streams")
        self._aside = (
            self._for_streams
            if self.engine.bound
            else ThreadPoolExecutor(max_workers=1, thread_name_prefix="drape-aside", initializer=thread_steps_back)
        )
        self._frame_done = asyncio.Event()  # of the streams' latest frame
        self._frame_done.set()
        self._clip_turn = asyncio.Lock()  # one chunk waits for the thread at a time, however many clips there are
        self._frame_ms: dict[tuple[tuple[str, ...], DrapeOptions, bool], float] = {}
        self.warm_up()

    def close(self) -> None:
        """Waits for the running chunk and ends the threads."""
        for executor in (self._for_streams, self._aside):
            executor.shutdown(wait=True, cancel_futures=True)
        self.constants_process.close()
        self.tracing.close()

    def warm_up(self) -> None:
        """One frame of one garment, with all that its streams need, so that the first request pays for no lazy set-up;
        where shapes have buckets, one frame and a chunk of every garment, in each way that frames are asked for."""
        bound = self.engine.bound
        entries = self.garments.entries()
        for entry in entries if bound else entries[:1]:
            for frames in (1, self.settings.chunk_frames) if bound else (1,):
                rest = PoseInput(
                    np.zeros((frames, 24, 3)), np.zeros((frames, 3)), np.zeros(self.body.shape_count), np.zeros(frames)
                )
                for geometry in ("vertices", "jets") if bound else ("vertices",):
                    plan = self.plan(entry, DrapeOptions(push_out=True, geometry=geometry), messages=True)
                    self.add_missing(plan)
                    for stage in plan.stages:
                        stage.prepare(plan)
                    run(plan, [rest])

    @property
    def device_bytes(self) -> int:
        """Memory of the garments' constants and of buckets where the graphs compute."""
        return sum(stage.held_bytes for stage in self.stages) + self.engine.held_bytes

    def check_body_id(self, name: str) -> None:
        """Refuses a body that this service has not loaded."""
        if name != self.body.name:
            raise NotFound(
                "body", expected=self.body.name, got=name, cure="GET /bodies lists the bodies of this service."
            )

    async def aside(self, function: Callable[..., Result], *arguments: object) -> Result:
        """``function(*arguments)`` on the thread of what streams do not wait for, not begun beside a stream's frame."""
        await self._frame_done.wait()
        return await asyncio.get_running_loop().run_in_executor(self._aside, _here(function, *arguments))

    async def stream_frames(self, plan: Plan, inputs: Sequence[PoseInput]) -> list[tuple[bytes | DrapeError, Memories]]:
        """``frames`` on a thread of the streams, or at once where all stand still."""
        self._streamed_s = time.monotonic()
        same = [unchanged.answer_again(plan, one) for one in inputs]
        if None not in same:
            return [one for one in same if one is not None]
        done = self._frame_done = asyncio.Event()
        try:
            loop = asyncio.get_running_loop()
            return await loop.run_in_executor(self._for_streams, _here(self.frames, plan, inputs))
        finally:
            done.set()

    def plan(self, scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
        """``service.stages.make_plan`` with the stages of this service, and the passes and folds of its tiers."""
        asked = chosen(options, self.tiers, self.settings, self.engine.pass_count)
        return make_plan(self.stages, scene, asked, messages=messages)

    async def plan_within(self, scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
        """``plan``, or where ``options`` have a budget that of the best tier within it, of the least where none is."""
        if options.budget_ms is None:
            return self.plan(scene, options, messages=messages)
        if options.tier is not None:
            raise InputError("budget_ms", expected="a tier or a budget", got="both", cure="Name one of the two.")
        plans = [
            self.plan(scene, options.model_copy(update={"tier": tier.name}), messages=messages) for tier in self.tiers
        ]
        for plan in reversed(plans):
            if await self.frame_ms(plan) <= options.budget_ms:
                return plan
        return plans[0]

    async def frame_ms(self, plan: Plan) -> float:
        """What a frame of ``plan`` takes [ms], measured once, frame by frame in its turn with what else is computed."""
        key = plan.keys, plan.options, plan.messages
        if key not in self._frame_ms:
            await self.prepare(plan)
            probe = Probe(plan, self.body)
            while not probe.done:
                async with self._clip_turn:
                    await self.aside(probe.step)
            while len(self._frame_ms) >= COSTS_KEPT:
                self._frame_ms.pop(next(iter(self._frame_ms)))
            self._frame_ms[key] = probe.frame_ms()
        return self._frame_ms[key]

    def tier_of(self, plan: Plan) -> str:
        """The name of the tier that ``plan`` is, or "custom"."""
        return tier_of(plan.options, self.tiers, self.engine.pass_count)

    def steps(self, plan: Plan) -> tuple[Plan, ...]:
        """``plan`` as each tier holds it, the least first: with no more than the tier computes. Before them all what is
        spared of the least, of a single garment, and the same with its folds carried along; layers need each other."""
        held = [capped(plan.options, tier) for tier in self.tiers]
        alone = len(plan.scene.layers) == 1
        held.insert(0, spared(held[0]) if alone else held[0])
        steps = [
            plan
            if options == plan.options
            else replace(make_plan(self.stages, plan.scene, options, messages=plan.messages), stepped=True)
            for options in held
        ]
        carried = alone and bool(plan.options.folds)
        return (replace(steps[0], stepped=True, carried=True) if carried else steps[0], *steps)

    def add_missing(self, plan: Plan) -> None:
        """Lets the stages take in what ``plan`` drapes and they do not know yet: ``prepare`` does so beside frames."""
        for garment in self.garments.missing((*plan.scene.layers, *plan.draped)):
            self.garments.add_to_stages(garment, self.garments.feed(garment))

    async def prepare(self, plan: Plan) -> None:
        """Makes what the plan's stages need, beside the frames that are being computed."""
        for garment in self.garments.missing((*plan.scene.layers, *plan.draped)):
            feed = await asyncio.to_thread(self.garments.feed, garment)
            await self.aside(self.garments.add_to_stages, garment, feed)
        await asyncio.to_thread(lambda: [stage.prepare(plan) for stage in plan.stages])

    async def drape(self, plan: Plan, clip: PoseInput) -> Batch:
        """The draped clip, chunk by chunk."""
        parts = [part async for part in self.parts(plan, clip)]
        if len(parts) == 1:
            return parts[0]
        return await asyncio.to_thread(Batch.of_parts, clip, parts)

    async def parts(self, plan: Plan, clip: PoseInput) -> AsyncIterator[Batch]:
        """The draped clip, a chunk at a time; the next is begun when whoever asks has taken the last."""
        await self.prepare(plan)
        memories = clip.memories

        def compute(rows: slice) -> Iterator[Batch]:
            nonlocal memories
            for part in self._walk(plan, [clip.part(rows, memories)]):
                memories = part.memories[0]
                yield part.answer()

        async for part in self._in_chunks(len(clip.poses), compute):
            yield part

    async def _in_chunks(self, frames: int, compute: Callable[[slice], Iterator[Result]]) -> AsyncIterator[Result]:
        """The last of what ``compute`` gives of all ``frames``, slice after slice, each step of it in its turn.

        Refuses (``Busy``) one that has waited for streams and other clips for ``clip_wait_s`` and a second for every
        ``CLIP_FPS`` frames that it has got.
        """
        frame_s, start = math.inf, 0  # until the first has told how long one takes
        waited_s = 0.0  # for a turn; not for whoever asks to read
        while start < frames:
            if self.hurried:
                raise Draining
            begun_s = time.monotonic()
            async with self._clip_turn:
                self._check_wait(start, waited_s + time.monotonic() - begun_s)
                rows = slice(start, min(frames, start + self._chunk_frames(frame_s)))
                alone = rows.stop - rows.start == 1 and not self._streaming
                result, took_s = await self._last(compute(rows), whole=alone)
            waited_s += time.monotonic() - begun_s - took_s
            yield result
            frame_s, start = took_s / (rows.stop - rows.start), rows.stop

    def _check_wait(self, frames: int, waited_s: float) -> None:
        """Refuses a clip that has waited for ``waited_s`` while ``frames`` of it were computed."""
        most_s = self.settings.clip_wait_s + frames / CLIP_FPS
        if waited_s > most_s:
            raise Busy(
                "processors",
                expected=f"{frames} frames of a clip after waiting {most_s:.0f} s for streams and other clips",
                got=f"{waited_s:.0f} s",
                cure="Ask again when there are fewer, or for fewer frames or a lower tier, or raise DRAPE_CLIP_WAIT_S.",
            )

    async def _last(self, steps: Iterator[Result], *, whole: bool) -> tuple[Result, float]:
        """The last of ``steps``, each ``aside`` in its turn, or all in one, and how long they took there [s]."""
        took_s = 0.0

        def step() -> Result | None:
            nonlocal took_s
            begun_s = time.perf_counter()
            found = next(steps, None)
            took_s += time.perf_counter() - begun_s
            return found

        def through() -> Result | None:
            last = found = step()
            while found is not None:
                last, found = found, step()
            return last

        if whole:
            last = await self.aside(through)
            assert last is not None
            return last, took_s
        last = await self.aside(step)
        while (after := await self.aside(step)) is not None:
            last = after
        assert last is not None
        return last, took_s

    @property
    def _streaming(self) -> bool:
        """Whether there are streams that move."""
        return time.monotonic() - self._streamed_s <= STREAM_PAUSE_S

    def _chunk_frames(self, frame_s: float) -> int:
        """Frames of the next chunk, where one takes ``frame_s`` [s]; on a GPU always the size that has buckets."""
        most = self.settings.chunk_frames
        if self.engine.bound or not self._streaming:
            return most
        return min(most, max(1, int(STREAM_WAIT_S / frame_s)))

    def frames(self, plan: Plan, inputs: Sequence[PoseInput]) -> list[tuple[bytes | DrapeError, Memories]]:
        """The message of each of ``inputs``, which have one frame each, and what it leaves behind.

        Of bodies that stand still nothing is computed (``service.compute.unchanged``). Where the batch fails each is
        tried alone, so that one cannot fail its mates; what was remembered before the one that fails stays.
        """
        found = [unchanged.answer_again(plan, one) for one in inputs]
        moving = [one for one, same in zip(inputs, found, strict=True) if same is None]
        computed = iter(self._computed(plan, moving) if moving else ())
        return [next(computed) if same is None else same for same in found]

    def _computed(self, plan: Plan, inputs: Sequence[PoseInput]) -> list[tuple[bytes | DrapeError, Memories]]:
        try:
            batch = self._run(plan, inputs)
        except Exception as error:
            if len(inputs) > 1:
                return [self._computed(plan, [one])[0] for one in inputs]
            if not isinstance(error, DrapeError):
                log.exception("a stream frame failed")
            return [(error if isinstance(error, DrapeError) else InternalError(), inputs[0].memories)]
        return [
            (message, unchanged.remember(plan, one, memories, message))
            for one, message, memories in zip(inputs, batch.messages, batch.memories, strict=True)
        ]

    def _run(self, plan: Plan, inputs: Sequence[PoseInput]) -> Batch:
        """``service.stages.run``, measured."""
        *_, last = self._walk(plan, inputs)
        return last

    def _walk(self, plan: Plan, inputs: Sequence[PoseInput]) -> Iterator[Batch]:
        """``service.stages.walk``, measured."""
        done = Quality.untouched(0)
        for batch in walk(plan, inputs, self._took):
            done = batch.quality
            yield batch
        self.metrics.drawn(done.pushed_share, done.push_max_m, done.left_m, done.folds_resets)

    def _took(self, stage: str, took_s: float) -> None:
        self.metrics.stage.labels(stage).observe(took_s)
        self.tracing.stage(stage, took_s)

    async def pose_body(self, clip: PoseInput) -> np.ndarray:
        """World vertices [m] (F, Vb, 3) float32 of the body."""

        def compute(rows: slice) -> Iterator[np.ndarray]:
            posed = self.body.posed_vertices(clip.poses[rows], clip.trans[rows], clip.betas)
            yield posed.astype(np.float32)

        return await asyncio.to_thread(
            np.concatenate, [part async for part in self._in_chunks(len(clip.poses), compute)]
        )


def _here(function: Callable[..., Result], *arguments: object) -> Callable[[], Result]:
    """``function(*arguments)`` in a copy of the caller's context, for another thread: whose request it is for."""
    return partial(contextvars.copy_context().run, partial(function, *arguments))
