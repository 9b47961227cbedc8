"""``DrapeRuntime``: all that the start of a service loads, and the computing of frames (``drape.stages``)."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from drape.artifacts import model_folder
from drape.avatar.own_garments import MARK
from drape.avatar.wearer import Wearer, load_wearer
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.contact.skin import keep_skins
from drape.engine.card import DRIVER
from drape.errors import DrapeError, NotFound, did_you_mean
from drape.inference.engine import Engine
from drape.inference.onnx_runtime import Device
from drape.live.card_lanes import Lanes, open_lanes
from drape.motion.clip import MotionClip
from drape.motion.grounding import place_on_ground
from drape.motion.readers import read_motion
from drape.runtime import Runtime
from drape.stages.batch import Batch, Memories, PoseInput, Quality
from drape.stages.encode import Idle, answer_again, idle_before, remember
from drape.stages.plan import Plan
from drape.stages.sizes import Sizes
from drape.stages.walk import run, walk
from drape.wire.options import Advanced, DrapeOptions
from service.compute.avatars import Avatars
from service.compute.constants_process import ConstantsProcess
from service.compute.garment_files import list_shipped
from service.compute.garments import Registry, begin_reading
from service.compute.threads import ComputeThreads
from service.errors import InternalError
from service.watch.prometheus import Metrics
from service.watch.tracing import Tracing, make_tracing
from service.watch.watchdog import say_moved

if TYPE_CHECKING:
    from drape.stages.body_stages import BodyStages
    from drape.stages.scene import Entry
    from service.settings import Settings

Result = TypeVar("Result")
log = logging.getLogger("drape.service")


def open_lane(driver: str = DRIVER) -> Lanes | None:
    """Returns the threads (``Lane``) that draw frames on this machine's graphics cards. ``driver`` is the library that
    opens the cards. None without the extra ``cuda``. Logs each card, or why it cannot be used."""
    lanes = open_lanes(driver)
    for lane in () if lanes is None else lanes.lanes:
        if lane.works:
            log.info("card: frames by %s", lane.card)
        else:
            log.warning("card: %s", lane.fault)
    return lanes


class DrapeRuntime(Runtime):
    """Everything that the start of a service loads: body, model, garments, avatars, clips, and the threads that
    compute.

    ``body`` and ``engine`` are those that ``settings`` name unless they are given. With ``at_once`` the constants of
    all garments are made here; otherwise when a request first needs them, or by ``prepare_all``.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        body: BodyModel | None = None,
        engine: Engine | None = None,
        metrics: Metrics | None = None,
        tracing: Tracing | None = None,
        at_once: bool = True,
    ) -> None:
        self.settings = settings
        self._adding = asyncio.Lock()
        self.metrics = metrics or Metrics()
        self._stage_times = cache(self.metrics.stage.labels)
        self.tracing = tracing or make_tracing(settings.trace)
        engine = engine or _engine(settings)
        self.threads = ComputeThreads(stream_threads=settings.stream_threads, chunk_frames=settings.chunk_frames)
        self.constants_process = ConstantsProcess(lambda: self.threads.streaming)
        make, body = self.constants_process.call, body or load_body(settings.body)
        # The garments are read beside the lines that follow, which wait for a process.
        read = None if at_once else begin_reading(settings, body)
        super().__init__(engine, body, settings, make, open_lane())
        self.garments = Registry(settings, self.worn, make, read)
        self.sizes = Sizes(self.body, settings.shipped_garments_dir, self.garments.entries(), make)
        self.avatars = Avatars(self.body, settings, self.stages_on, make)
        self.garments.others = self.avatars.own_garment
        self.motions = Motions(settings.motions_dir)
        if at_once:
            self.warm_up()

    def close(self) -> None:
        """Waits for the chunk of a clip that is being computed, and ends threads and processes."""
        self.threads.close()
        if self.lane is not None:
            self.lane.close()
        self.constants_process.close()
        self.tracing.close()

    def warm_up(self) -> None:
        """Drapes one frame of the first garment with all that streams need, so that the first request is not slower
        than others."""
        rest = PoseInput(np.zeros((1, 24, 3)), np.zeros((1, 3)), np.zeros(self.body.shape_count), np.zeros(1))
        for entry in self.garments.entries()[:1]:
            plan = self.plan(entry, DrapeOptions(advanced=Advanced(push_out=True)), messages=True)
            self.ready(plan)
            run(plan, [rest])

    @property
    def device_bytes(self) -> int:
        """The bytes that the garments' constants take on the device that computes."""
        bodies = (self.worn, *self.avatars.worn)
        return sum(stage.held_bytes for body in bodies for stage in body.stages)

    @property
    def memory_classes(self) -> tuple[type, ...]:
        """The classes of the values of ``Memories``, which a stream takes to another process."""
        return (Idle, *(kind for stage in self.stages for kind in stage.kept))

    def check_body_id(self, name: str) -> None:
        """Refuses (``NotFound``) the id of any body but the one that this service has."""
        if name != self.body.name:
            raise NotFound(
                "body", expected=self.body.name, got=name, cure="GET /bodies lists the bodies of this service."
            )

    # --- constants ---

    def expect_avatar(self, stage: str, folder: Path, viewer: str | None) -> None:
        """Prepares, while the intake of an avatar is in ``stage``, what requests for it will need. "start": starts the
        process of constants. "read": computes where the garments that the key ``viewer`` may see lie on a body.
        "cloth": computes skin samples of the wearer that the intake has stored in ``folder``. Others: nothing."""
        if stage == "start":
            self.constants_process.begin()
        elif stage == "read":
            self.avatars.look_at(self.garments.visible(viewer))
        elif stage == "cloth":
            file = next(path for path in folder.glob("*.npz") if MARK not in path.name)
            keep_skins(load_wearer(file, self.body).body, self.constants_process.call_there)

    async def prepare(self, plan: Plan) -> None:
        """Makes the constants that the stages of ``plan`` lack, beside frames that are being computed."""
        await self._add(self.on(plan.scene), plan.known)

        # Two threads share the parts. Those of folds, which take longest, come first.
        rest = reversed([part for stage in plan.stages for part in stage.parts(plan)])

        def make() -> None:
            for part in rest:
                part()

        await asyncio.gather(*(asyncio.to_thread(make) for _ in range(2)))

    async def prepare_all(self) -> None:
        """Adds all garments to the stages that lack them, one after the other, beside frames that are being computed.
        Of the first it makes all constants that streams need. A garment that is refused is logged and passed over."""
        for number, entry in enumerate(self.garments.entries()):
            try:
                plan = self.plan(entry, DrapeOptions(), messages=True)
                await (self._add(self.worn, plan.known) if number else self.prepare(plan))
            except DrapeError as error:
                log.warning("garment %s: %s", entry.id, error)

    async def _add(self, worn: BodyStages, entries: Sequence[Entry]) -> None:
        if not worn.missing(entries):  # a request that lacks nothing need not wait for the lock
            return
        async with self._adding:
            missing = worn.missing(entries)
            feeds = await asyncio.gather(*(asyncio.to_thread(worn.feed, garment) for garment in missing))
            for garment, feed in zip(missing, feeds, strict=True):
                await self.threads.aside(worn.add, garment, feed)

    async def call_apart(self, function: Callable[..., Result], *arguments: object, **named: object) -> Result:
        """Returns ``function(*arguments, **named)``, which takes long for one client, as ``ConstantsProcess.call``
        computes it, on a thread of ``ComputeThreads.apart``. ``function`` belongs to a module, so it can be pickled."""
        return await self.threads.apart(lambda: self.constants_process.call(function, *arguments, **named))

    # --- frames ---

    async def stream_frames(self, plan: Plan, inputs: Sequence[PoseInput]) -> list[tuple[bytes | DrapeError, Memories]]:
        """Returns for each of ``inputs``, which have one frame each, its message or its refusal, and the memories for
        the stream's next frame.

        For a body that stands still, with cloth at rest, no frame is computed (``drape.stages.encode``).
        """
        self.threads.streamed_s = time.monotonic()
        idle = [idle_before(plan, pose) for pose in inputs]
        answers = [answer_again(plan, pose, before) for pose, before in zip(inputs, idle, strict=True)]
        changed = [(pose, before) for pose, before, again in zip(inputs, idle, answers, strict=True) if again is None]
        computed = iter(await self.threads.for_streams(self._compute, plan, changed) if changed else ())
        return [next(computed) if answer is None else answer for answer in answers]

    def _compute(
        self, plan: Plan, poses: Sequence[tuple[PoseInput, Idle | None]]
    ) -> list[tuple[bytes | DrapeError, Memories]]:
        """Returns what ``stream_frames`` does, for ``poses`` that must be computed, each with its ``idle_before``.

        A batch that fails is computed again one by one, so that no frame fails with another. A frame that fails leaves
        the memories as they were.
        """
        say_moved()
        inputs = [pose for pose, _ in poses]
        try:
            *_, batch = self._walk(plan, inputs)
        except Exception as error:
            if len(poses) > 1:
                return [self._compute(plan, [pose])[0] for pose in poses]
            if not isinstance(error, DrapeError):
                log.exception("a stream frame failed")
            return [(error if isinstance(error, DrapeError) else InternalError(), inputs[0].memories)]
        return [
            (message, remember(plan, pose, before, memories, message))
            for (pose, before), message, memories in zip(poses, batch.messages, batch.memories, strict=True)
        ]

    async def drape(self, plan: Plan, clip: PoseInput) -> Batch:
        """Returns the batch of all frames of ``clip``, draped by ``plan``. Refuses as ``ComputeThreads.in_chunks``."""
        parts = [part async for part in self.parts(plan, clip)]
        return await asyncio.to_thread(Batch.of_parts, clip, parts)

    async def parts(self, plan: Plan, clip: PoseInput) -> AsyncIterator[Batch]:
        """Yields the frames of ``clip``, draped by ``plan``, as a batch for each chunk. A chunk is begun when the
        caller asks for it."""
        await self.prepare(plan)
        memories = clip.memories

        def compute(rows: slice) -> Iterator[Batch]:
            nonlocal memories
            for part in self._walk(plan, [clip.part(rows, memories)]):
                memories = part.memories[0]
                yield part.answer()

        async for part in self.threads.in_chunks(len(clip.poses), compute):
            yield part

    def _walk(self, plan: Plan, inputs: Sequence[PoseInput]) -> Iterator[Batch]:
        """Yields what ``drape.stages.walk.walk`` does, and counts stages and frames in the metrics."""
        quality = Quality.untouched(0)
        for batch in walk(plan, inputs, self._took):
            say_moved()
            quality = batch.quality
            yield batch
        self.metrics.count_drawn(quality.pushed_share, quality.push_max_m, quality.left_m, quality.folds_resets)

    def _took(self, stage: str, took_s: float) -> None:
        self._stage_times(stage).observe(took_s)
        if self.tracing.on:
            self.tracing.stage(stage, took_s)

    async def pose_body(self, clip: PoseInput, wearer: Wearer | None = None) -> np.ndarray:
        """Returns the world vertices [m] (F, V, 3) float32 of the body in the frames of ``clip``, or those of the
        surface of ``wearer``."""
        pose = partial(self.body.posed_vertices, betas=clip.betas) if wearer is None else wearer.posed

        def compute(rows: slice) -> Iterator[np.ndarray]:
            yield pose(clip.poses[rows], clip.trans[rows]).astype(np.float32)

        parts = [part async for part in self.threads.in_chunks(len(clip.poses), compute)]
        return await asyncio.to_thread(np.concatenate, parts)


def _engine(settings: Settings) -> Engine:
    """Returns the model that ``settings`` name, opened on their device."""
    return Engine(model_folder(settings.model), device=Device(settings.provider, settings.threads))


class Motions:
    """The sample clips, npz files in ``folder``, by their ids. Refuses a folder that does not exist, and raises what
    ``read_motion`` raises of an unreadable clip, which stops the start."""

    def __init__(self, folder: Path) -> None:
        self._clips = {path.stem: read_motion(path) for path in list_shipped(folder, "DRAPE_MOTIONS_DIR")}

    def ids(self) -> list[str]:
        return list(self._clips)

    def get(self, name: str) -> MotionClip:
        """Returns the clip with the id ``name``. Refuses (``NotFound``) an unknown one."""
        if name not in self._clips:
            cure = did_you_mean(name, self.ids(), "GET /motions lists the clips.")
            raise NotFound("motion", expected=f"one of: {', '.join(self.ids())}", got=name, cure=cure)
        return self._clips[name]

    def placed(self, name: str, body: BodyModel, betas: np.ndarray) -> MotionClip:
        """Returns the clip ``name`` with translations [m] in the world, as POST /drape takes them, that put the soles
        of ``body`` in the shape ``betas`` (S,) on the ground, y = 0."""
        return place_on_ground(self.get(name), body.rest_joints(betas), floor=body.floor_m(betas))
