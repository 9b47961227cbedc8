"""The queue of clips of tier exact: processes compute them frame by frame, and the frames stay on disk."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import pickle
import shutil
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drape.cloth.fabric_table import fabric as fabric_named
from drape.errors import DrapeError, MotionError, NotFound, Unavailable
from drape.garment.fine import has_finer
from drape.garment.wrapping import Wrapping
from drape.stages.batch import PoseInput
from service import errors
from service.compute.processes import run_process, wait_for_end
from service.exact import clip_folder as on_disk
from service.exact.block import FrameBlock
from service.exact.clip_folder import AcceptedClip, Lock

if TYPE_CHECKING:
    from drape.stages.plan import Plan
    from service.compute.drape_runtime import DrapeRuntime

KEPT = 32  # the most clips that have ended and whose frames stay
MOST_ATTEMPTS = 20  # the most starts of the service that go on with one clip
WAIT_S = 2.0  # between two tries to drape the frames' starts where the service is busy
FRAME_S = 3600.0  # the most for one frame; the first takes longest
BLOCK = "service.exact.block"
MAKE_ROOM = "Delete clips that were fetched: DELETE /jobs/ID."
log = logging.getLogger("drape.service")


@dataclass(frozen=True, eq=False)
class Work:
    """A ``clip`` to compute, and a ``plan``. Each frame starts from its drape by that plan: in tier accurate, on the
    fine mesh."""

    plan: Plan
    clip: PoseInput


@dataclass(eq=False)
class ClipJob:
    """A clip of tier exact in this service. ``figures`` has for each finished frame, by its number, its ``FIGURES`` by
    name. ``problem`` is the problem document of a failed clip. ``stage`` is "start" while the drapes are
    computed that frames start from, and then "frames". ``lock`` is that of ``folder``."""

    accepted: AcceptedClip
    folder: Path
    state: Literal["queued", "running", "done", "failed", "cancelled"] = "queued"
    figures: dict[int, dict[str, Any]] = field(default_factory=dict)
    problem: dict[str, Any] | None = None
    stage: str | None = None
    lock: Lock | None = None
    work: asyncio.Task[None] | None = None

    @property
    def ended(self) -> bool:
        """Whether the clip is done, failed or cancelled."""
        return self.state not in ("queued", "running")

    @property
    def share(self) -> float:
        """The share of the frames that are on disk, 0 to 1."""
        return len(self.figures) / self.accepted.frames


class ExactClips:
    """The clips of tier exact of a service. ``DRAPE_EXACT_WORKERS`` of them are computed at a time, each by a process
    of its own; the others wait in the order in which they came."""

    def __init__(self, runtime: DrapeRuntime) -> None:
        self._runtime, self._settings = runtime, runtime.settings
        self._root = self._settings.garments_dir
        self._jobs: dict[str, ClipJob] = {}
        self._queue: asyncio.Queue[ClipJob] = asyncio.Queue()
        self._workers: list[asyncio.Task[None]] = []
        self._begin = asyncio.Event()
        self._begin.set()

    def start(self, read_work: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        """Takes over the clips on disk that no running service has, and starts the workers.

        ``read_work`` takes the message of a request and the key that sent it, and returns the ``Work`` that it asks
        for.
        """
        for folder in on_disk.folders(self._root):
            accepted = on_disk.read_accepted(folder)
            lock = Lock(folder)
            if accepted is None or not lock.held:
                if lock.held:
                    if not (folder / on_disk.ABOUT).exists():  # a request that ended before it was accepted
                        on_disk.remove_clip(folder)
                    lock.release()
                continue
            job = self._jobs[accepted.id] = ClipJob(accepted, folder, problem=accepted.problem, lock=lock)
            frames = ((number, on_disk.read_frame(folder, number)) for number in range(accepted.frames))
            job.figures = {number: frame[1] for number, frame in frames if frame is not None}
            if job.problem is not None or len(job.figures) == accepted.frames:
                job.state = "done" if job.problem is None else "failed"
            else:
                self._queue.put_nowait(job)
        for _ in range(self._settings.exact_workers):
            self._workers.append(asyncio.create_task(self._work(read_work), name="exact clips"))

    def pause(self) -> None:
        """Lets no worker begin another clip."""
        self._begin.clear()

    async def stop(self) -> None:
        """Ends workers and processes. Accepted clips stay on disk with their frames, and the next start goes on with
        them."""
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)
        for job in self._jobs.values():
            if job.lock is not None:
                job.lock.release()

    @property
    def waiting(self) -> int:
        """The number of clips that wait or run."""
        return sum(not job.ended for job in self._jobs.values())

    @property
    def runs(self) -> bool:
        """Whether all workers that compute clips run."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def find(self, job_id: str, viewer: str | None) -> ClipJob | None:
        """Returns the clip ``job_id``; None if there is none, or if another key than ``viewer`` has sent it."""
        job = self._jobs.get(job_id)
        return job if job is not None and job.accepted.owner == viewer else None

    def check_place(self, frames: int, vertices: int) -> None:
        """Refuses (``Busy``) another clip where too many wait, and (``Full``) one of ``frames`` frames of ``vertices``
        vertices where the storage has no room for it."""
        most = self._settings.intake_queue
        if self.waiting >= most:
            cure = "Try again when one has ended."
            raise errors.Busy("exact clips", expected=f"fewer than {most} waiting", got=str(self.waiting), cure=cure)
        needed = 12 * frames * vertices
        stored, free = on_disk.stored_bytes(self._root), _free_bytes(self._root)
        if stored + needed > self._settings.max_stored_bytes or needed > free:
            expected = f"room for {needed} bytes"
            got = f"{stored} bytes of clips of at most {self._settings.max_stored_bytes}, {free} free on disk"
            raise errors.Full("disk", expected=expected, got=got, cure=MAKE_ROOM)

    async def submit(self, name: str, owner: str | None, message: bytes, frames: int) -> ClipJob:
        """Stores the ``message`` of a request for a clip of ``frames`` frames, queues it and returns its job. ``name``
        is the job's name, ``owner`` the key that sent it. Refuses (``Full``) where the disk is full."""
        job_id = uuid.uuid4().hex[:12]
        folder = self._root / on_disk.FOLDER / job_id
        accepted = AcceptedClip(job_id, name, owner, frames)
        job = ClipJob(accepted, folder)
        self._jobs[job_id] = job

        def store() -> None:
            folder.mkdir(parents=True)
            job.lock = Lock(folder)
            with (folder / on_disk.CLIP).open("wb") as stream:
                stream.write(message)
            accepted.write(folder)

        try:
            await asyncio.to_thread(store)
        except BaseException as error:
            del self._jobs[job_id]
            on_disk.remove_clip(folder)
            if isinstance(error, OSError):
                raise errors.Full("disk", expected="room", got=str(error.strerror), cure=MAKE_ROOM) from error
            raise
        self._queue.put_nowait(job)
        await self._forget_oldest()
        return job

    async def _forget_oldest(self) -> None:
        ended = [job for job in self._jobs.values() if job.ended]
        for job in ended[: max(0, len(ended) - KEPT)]:
            await self.remove(job)

    async def remove(self, job: ClipJob) -> None:
        """Cancels ``job`` if it has not ended, forgets it and deletes its files."""
        if not job.ended:
            job.state = "cancelled"
        if job.work is not None:
            job.work.cancel()
            await asyncio.wait([job.work])
        self._jobs.pop(job.accepted.id, None)
        await asyncio.to_thread(on_disk.remove_clip, job.folder)
        if job.lock is not None:
            job.lock.release()

    def message(self, job: ClipJob) -> bytes:
        """Returns the CLIP message of the request for ``job``."""
        return (job.folder / on_disk.CLIP).read_bytes()

    def vertices(self, job: ClipJob, plan: Plan) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) float32 of the frames of ``job``, relative to each frame's root joint in
        the world's axes. They are those of the mesh that is drawn of the garment of ``plan``. Refuses (``NotFound``) a
        clip without all of its frames."""
        frames = [on_disk.read_frame(job.folder, number) for number in range(job.accepted.frames)]
        cloth = [frame[0] for frame in frames if frame is not None]
        if len(cloth) < len(frames):
            got = f"{len(cloth)} of {len(frames)} frames"
            raise NotFound("clip", expected="all of its frames", got=got, cure=f"Ask GET /jobs/{job.accepted.id}.")
        (entry,) = plan.scene.layers
        garment = entry.garment
        if has_finer(garment):
            wrapping = Wrapping(garment)
            cloth = [wrapping.wrap(x) for x in cloth]
        return garment.drawn_vertices(np.stack(cloth))

    # --- work ---

    async def _work(self, read_work: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        while True:
            job = await self._queue.get()
            await self._begin.wait()
            if job.state == "cancelled":
                continue
            job.state = "running"
            try:
                job.work = asyncio.create_task(self._run(job, read_work))
                await job.work
                job.state = "done"
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if job.state != "cancelled" or (task is not None and task.cancelling()):
                    raise
            except errors.Draining:
                continue  # the next start goes on with it
            except DrapeError as error:
                await self._fail(job, errors.problem_of(error))
                log.info("exact clip %s refused: %s", job.accepted.id, error)
            except Exception:
                log.exception("exact clip %s failed", job.accepted.id)
                await self._fail(job, errors.problem_of(errors.InternalError()))
            job.work = job.stage = None

    async def _fail(self, job: ClipJob, problem: dict[str, Any]) -> None:
        """Ends ``job`` as failed: writes its ``problem`` and deletes its request and frames."""
        job.problem, job.state, job.figures = problem, "failed", {}

        def clear() -> None:
            on_disk.clear_clip(job.folder)
            with contextlib.suppress(OSError):  # on a full disk the problem is known only until the service ends
                replace(job.accepted, problem=problem).write(job.folder)

        await asyncio.to_thread(clear)

    async def _run(self, job: ClipJob, read_work: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        job.stage = "start"
        if job.accepted.attempts >= MOST_ATTEMPTS:
            expected = f"an end within {MOST_ATTEMPTS} starts of the service"
            raise Unavailable("exact clip", expected=expected, got="none", cure="Ask for fewer frames.")
        job.accepted = await asyncio.to_thread(job.accepted.add_attempt, job.folder)
        work = await read_work(await asyncio.to_thread(self.message, job), job.accepted.owner)
        at_rest = PoseInput(np.zeros((1, 24, 3)), np.zeros((1, 3)), work.clip.betas, np.zeros(1))
        rest, starts = await self._starts(work.plan, at_rest), await self._starts(work.plan, work.clip)
        (entry,), (chosen,) = work.plan.draped, work.plan.fabrics
        fabric = fabric_named(entry.garment.fabric) if chosen is None else chosen
        model = self._runtime.on(work.plan.scene).body
        job.stage = "frames"
        clip, garment = work.clip, entry.garment
        await self._compute(
            job, FrameBlock(garment, fabric, model, clip.betas, rest[0], job.folder, clip.poses, starts)
        )

    async def _starts(self, plan: Plan, clip: PoseInput) -> np.ndarray:
        """Returns the drapes [m] (F, V, 3) that the frames of ``clip`` start from, relative to the root joints."""
        while True:
            try:
                return (await self._runtime.drape(plan, clip)).vertices
            except errors.Busy:  # streams and other clips come first
                await asyncio.sleep(WAIT_S)

    async def _compute(self, job: ClipJob, block: FrameBlock) -> None:
        """Runs the process that computes ``block``, and adds the figures of each frame to ``job``. Raises the refusal
        of the process."""
        memory, most_s = str(self._settings.intake_memory_mb), FRAME_S
        write = partial(pickle.dump, block)
        try:
            async with run_process("exact", BLOCK, memory, write=write, folder=job.folder) as (process, answers):
                while line := await asyncio.wait_for(answers.readline(), most_s):
                    answer = json.loads(line)
                    if "problem" in answer:
                        raise errors.spoken_error(answer["problem"], Unavailable)
                    job.figures[answer.pop("frame")] = answer
                await asyncio.wait_for(wait_for_end(process), most_s)
        except TimeoutError:
            expected = f"a frame within {most_s:g} s"
            cure = "Leave this frame's pose out."
            raise MotionError(f"frame {_next(job)}", expected=expected, got="none", cure=cure) from None
        except OSError as error:
            raise errors.Full("disk", expected="room", got=str(error.strerror), cure=MAKE_ROOM) from error
        if process.returncode:
            got = f"a process that ended with status {process.returncode}"
            raise Unavailable(f"frame {_next(job)}", expected="its drape", got=got, cure="Ask again.")


def _next(job: ClipJob) -> int:
    """Returns the number of the first frame of ``job`` that is not finished; of the last one if all are."""
    return next((number for number in range(job.accepted.frames) if number not in job.figures), job.accepted.frames - 1)


def _free_bytes(root: Path) -> int:
    return shutil.disk_usage(root if root.exists() else root.parent).free
