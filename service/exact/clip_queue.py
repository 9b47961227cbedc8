"""Clips of tier exact: they wait, are computed in processes, frame by frame, and are kept until they are fetched."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import pickle
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
from service.compute.processes import ended, running
from service.exact import clip_folder as on_disk
from service.exact.block import FrameBlock
from service.exact.clip_folder import AcceptedClip, Lock

if TYPE_CHECKING:
    from drape.stages.plan import Plan
    from service.compute.drape_runtime import DrapeRuntime

KEPT = 32  # clips that have ended
MOST_ATTEMPTS = 20  # starts of the service in which one clip is gone on with
WAIT_S = 2.0  # until the drapes that frames start from are asked for again, where the service is busy
FRAME_S = 3600.0  # for one frame; the first takes longest
BLOCK = "service.exact.block"
MAKE_ROOM = "Delete clips that were fetched: DELETE /jobs/ID."
log = logging.getLogger("drape.service")


@dataclass(frozen=True, eq=False)
class Work:
    """A ``clip``, and the ``plan`` of the drapes that its frames start from, on the finer mesh."""

    plan: Plan
    clip: PoseInput


@dataclass(eq=False)
class ClipJob:
    """One clip and how far it is. ``figures`` of each finished frame, by its number."""

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
        """Whether nothing more happens to it."""
        return self.state not in ("queued", "running")

    @property
    def share(self) -> float:
        """The share of the frames that are on disk."""
        return len(self.figures) / self.accepted.frames


class ExactClips:
    """A queue of clips, of which ``DRAPE_EXACT_WORKERS`` are computed side by side, each by a process of its own."""

    def __init__(self, runtime: DrapeRuntime) -> None:
        self._runtime, self._settings = runtime, runtime.settings
        self._root = self._settings.garments_dir
        self._jobs: dict[str, ClipJob] = {}
        self._queue: asyncio.Queue[ClipJob] = asyncio.Queue()
        self._workers: list[asyncio.Task[None]] = []
        self._begin = asyncio.Event()
        self._begin.set()

    def start(self, opened: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        """Takes over what ended processes had accepted, and begins to compute.

        ``opened`` takes the message that asked for a clip and the key that sent it, and returns the ``Work`` to be
        done.
        """
        for folder in on_disk.folders(self._root):
            accepted = on_disk.read_accepted(folder)
            lock = Lock(folder)
            if accepted is None or not lock.held:
                if lock.held:
                    if not (folder / on_disk.ABOUT).exists():  # its request was never answered
                        on_disk.remove_clip(folder)
                    lock.release()
                continue
            job = self._jobs[accepted.id] = ClipJob(accepted, folder, problem=accepted.problem, lock=lock)
            frames = ((number, on_disk.read_frame(folder, number)) for number in range(accepted.frames))
            job.figures = {number: kept[1] for number, kept in frames if kept is not None}
            if job.problem is not None or len(job.figures) == accepted.frames:
                job.state = "done" if job.problem is None else "failed"
            else:
                self._queue.put_nowait(job)
        for _ in range(self._settings.exact_workers):
            self._workers.append(asyncio.create_task(self._work(opened), name="exact clips"))

    def pause(self) -> None:
        """Begins no further clip."""
        self._begin.clear()

    async def stop(self) -> None:
        """Ends the processes; what was accepted stays for the next start with the frames that it has."""
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)
        for job in self._jobs.values():
            if job.lock is not None:
                job.lock.release()

    @property
    def waiting(self) -> int:
        """Clips that wait or run."""
        return sum(not job.ended for job in self._jobs.values())

    @property
    def runs(self) -> bool:
        """Whether the workers that compute clips run."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def find(self, job_id: str, viewer: str | None) -> ClipJob | None:
        """The clip ``job_id``, if it is one of the key ``viewer``."""
        job = self._jobs.get(job_id)
        return job if job is not None and job.accepted.owner == viewer else None

    def check_place(self, frames: int, vertices: int) -> None:
        """Refuses (``Busy``, ``Full``) when too many clips wait, and when there is no room for another."""
        most = self._settings.intake_queue
        if self.waiting >= most:
            cure = "Try again when one has ended."
            raise errors.Busy("exact clips", expected=f"fewer than {most} waiting", got=str(self.waiting), cure=cure)
        wanted = 12 * frames * vertices
        there, room = on_disk.stored_bytes(self._root), _free_bytes(self._root)
        if there + wanted > self._settings.max_stored_bytes or wanted > room:
            expected = f"room for {wanted} bytes"
            got = f"{there} bytes of clips of at most {self._settings.max_stored_bytes}, {room} free on disk"
            raise errors.Full("disk", expected=expected, got=got, cure=MAKE_ROOM)

    async def submit(self, name: str, owner: str | None, message: bytes, frames: int) -> ClipJob:
        """Stores the ``message`` that asks for a clip of so many ``frames``, and queues it."""
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
        """Ends ``job`` and takes all of it off the disk."""
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
        """The message that asked for ``job``."""
        return (job.folder / on_disk.CLIP).read_bytes()

    def vertices(self, job: ClipJob, plan: Plan) -> np.ndarray:
        """Returns the vertices [m] (F, V, 3) float32 of the finished ``job``, relative to the roots, on the mesh that
        ``plan`` delivers. Refuses (``NotFound``) a clip of which frames are missing."""
        frames = [on_disk.read_frame(job.folder, number) for number in range(job.accepted.frames)]
        drawn = [frame[0] for frame in frames if frame is not None]
        if len(drawn) < len(frames):
            got = f"{len(drawn)} of {len(frames)} frames"
            raise NotFound("clip", expected="all of its frames", got=got, cure=f"Ask GET /jobs/{job.accepted.id}.")
        (entry,) = plan.scene.layers
        garment = entry.garment
        if has_finer(garment):
            wrapping = Wrapping(garment)
            drawn = [wrapping.wrap(x) for x in drawn]
        return garment.drawn_vertices(np.stack(drawn))

    # --- work ---

    async def _work(self, opened: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        while True:
            job = await self._queue.get()
            await self._begin.wait()
            if job.state == "cancelled":
                continue
            job.state = "running"
            try:
                job.work = asyncio.create_task(self._run(job, opened))
                await job.work
                job.state = "done"
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if job.state != "cancelled" or (task is not None and task.cancelling()):
                    raise
            except errors.Draining:
                continue  # the next start goes on with it
            except DrapeError as error:
                await self._failed(job, errors.problem_of(error))
                log.info("exact clip %s refused: %s", job.accepted.id, error)
            except Exception:
                log.exception("exact clip %s failed", job.accepted.id)
                await self._failed(job, errors.problem_of(errors.InternalError()))
            job.work = job.stage = None

    async def _failed(self, job: ClipJob, problem: dict[str, Any]) -> None:
        """Keeps the ``problem`` of ``job``, and nothing else of it."""
        job.problem, job.state, job.figures = problem, "failed", {}

        def clear() -> None:
            on_disk.clear_clip(job.folder)
            with contextlib.suppress(OSError):  # a full disk: it is known here as long as this service runs
                replace(job.accepted, problem=problem).write(job.folder)

        await asyncio.to_thread(clear)

    async def _run(self, job: ClipJob, opened: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        job.stage = "start"
        if job.accepted.attempts >= MOST_ATTEMPTS:
            expected = f"an end within {MOST_ATTEMPTS} starts of the service"
            raise Unavailable("exact clip", expected=expected, got="none", cure="Ask for fewer frames.")
        job.accepted = await asyncio.to_thread(job.accepted.tried, job.folder)
        work = await opened(await asyncio.to_thread(self.message, job), job.accepted.owner)
        at_rest = PoseInput(np.zeros((1, 24, 3)), np.zeros((1, 3)), work.clip.betas, np.zeros(1))
        rest, starts = await self._starts(work.plan, at_rest), await self._starts(work.plan, work.clip)
        (entry,), (made_of,) = work.plan.draped, work.plan.fabrics
        cloth = fabric_named(entry.garment.fabric) if made_of is None else made_of
        model = self._runtime.on(work.plan.scene).body
        job.stage = "frames"
        made = (entry.garment, cloth, model, work.clip.betas, rest[0], job.folder)
        await self._computed(job, FrameBlock(*made, work.clip.poses, starts))

    async def _starts(self, plan: Plan, clip: PoseInput) -> np.ndarray:
        """The drapes [m] (F, V, 3) that the frames of ``clip`` start from, relative to the roots."""
        while True:
            try:
                return (await self._runtime.drape(plan, clip)).vertices
            except errors.Busy:  # streams and other clips come first
                await asyncio.sleep(WAIT_S)

    async def _computed(self, job: ClipJob, block: FrameBlock) -> None:
        """Has ``block`` computed by a process of its own."""
        memory, most_s = str(self._settings.intake_memory_mb), FRAME_S
        write = partial(pickle.dump, block)
        try:
            async with running("exact", BLOCK, memory, write=write, folder=job.folder) as (process, answers):
                while line := await asyncio.wait_for(answers.readline(), most_s):
                    said = json.loads(line)
                    if "problem" in said:
                        raise _refusal(said["problem"])
                    job.figures[said.pop("frame")] = said
                await asyncio.wait_for(ended(process), most_s)
        except TimeoutError:
            expected = f"a frame within {most_s:g} s"
            cure = "Leave the pose out."
            raise MotionError(f"frame {_next(job)}", expected=expected, got="none", cure=cure) from None
        except OSError as error:
            raise errors.Full("disk", expected="room", got=str(error.strerror), cure=MAKE_ROOM) from error
        if process.returncode:
            got = f"a process that ended with status {process.returncode}"
            raise Unavailable(f"frame {_next(job)}", expected="its drape", got=got, cure="Ask again.")


def _next(job: ClipJob) -> int:
    """The frame that ``job`` is at."""
    return next((number for number in range(job.accepted.frames) if number not in job.figures), job.accepted.frames - 1)


def _refusal(said: dict[str, str]) -> DrapeError:
    """The error that a process put in words."""
    kinds: dict[str, type[DrapeError]] = {kind.__name__: kind for kind in errors.TABLE}
    kind = kinds.get(said["kind"], Unavailable)
    return kind(said["name"], expected=said["expected"], got=said["got"], cure=said["cure"])


def _free_bytes(root: Path) -> int:
    found = os.statvfs(root if root.exists() else root.parent)
    return found.f_bavail * found.f_frsize
