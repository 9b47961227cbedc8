"""Uploads: a file waits, goes through the intake in a limited process, and becomes a garment or a refusal."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import shutil
import uuid
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drape.errors import BodyError, DrapeError, MeshError, NotFound, Unavailable
from service import errors
from service.compute.avatars import FOLDER as AVATARS
from service.compute.avatars import OwnFiles
from service.compute.garment_files import OWNED, file_sizes, folder_of
from service.compute.garments import slug
from service.guard.key_file import ANYONE, Client
from service.uploads import job_records
from service.uploads.accepted import CANCEL, Accepted, Kind, elsewhere, staging_folder, sync, taken_over, touch
from service.uploads.intake_process import SHARES, run_sandbox
from service.uploads.job_records import JobRecord
from service.uploads.spare import Spare

if TYPE_CHECKING:
    from opentelemetry.trace import Link

    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.threads import SlicedThread
    from service.guard.access import Access

MOST_ATTEMPTS = 3  # of one upload, where the service ends while it runs
log = logging.getLogger("drape.service")


@dataclass(eq=False)
class Job:
    """One upload and how far it is."""

    id: str
    name: str
    owner: str | None = None
    state: Literal["queued", "running", "done", "failed", "cancelled"] = "queued"
    kind: Kind = "garment"
    notes: tuple[str, ...] = ()  # what whoever sent it should know, where it is done
    results: tuple[str, ...] = ()  # where it is done the ids of the garments, the innermost first, or of the avatar
    wearer: dict[str, Any] | None = None  # that was found in the cloth
    problem: dict[str, Any] | None = None
    stage: str | None = None  # of SHARES, while it runs
    link: Link | None = None  # to the request that it came with
    work: asyncio.Task[tuple[str, ...]] | None = None
    folder: Path | None = None  # where it lies in another service

    @property
    def share(self) -> float:
        """The share of the work that is done, by the times of the stages for usual garments."""
        if self.state == "done":
            return 1.0
        shares = SHARES[self.kind]
        names = list(shares)
        return sum(shares[name] for name in names[: names.index(self.stage)]) if self.stage in shares else 0.0

    @property
    def ended(self) -> bool:
        """Whether nothing more happens to it."""
        return self.state not in ("queued", "running")


class Uploads:
    """A queue with ``DRAPE_INTAKE_WORKERS`` workers; files lie in a staging folder of this process until they are
    garments. Uploads to other services that have the same folder are known too."""

    def __init__(self, runtime: DrapeRuntime, sliced_thread: SlicedThread, access: Access) -> None:
        self._access = access
        self._runtime, self._settings, self._sliced_thread = runtime, runtime.settings, sliced_thread
        self._jobs: dict[str, Job] = {}
        self._queue: asyncio.Queue[tuple[Job, Path, Accepted]] = asyncio.Queue()
        self._root = self._settings.garments_dir
        self.staging = staging_folder(self._root)
        self._workers: list[asyncio.Task[None]] = []
        self._begin = asyncio.Event()
        self._begin.set()
        self._spare = Spare(lambda: not self.waiting)

    def start(self) -> None:
        """Goes on with what ended processes had accepted, clears what else they left, and starts the workers."""
        self._go_on(self._taken_over())
        self._spare.start()
        self._workers = [
            asyncio.create_task(self._work(), name=f"uploads {number}")
            for number in range(self._settings.intake_workers)
        ]

    def _taken_over(self) -> list[tuple[Accepted, Path]]:
        shared = self._settings.garments_look_s > 0.0
        return list(taken_over(self._root, self.staging, shared=shared))

    def _go_on(self, uploads: Iterable[tuple[Accepted, Path]]) -> None:
        for accepted, folder in uploads:
            job = self._jobs[accepted.id] = Job(accepted.id, accepted.name, accepted.owner, kind=accepted.kind)
            self._queue.put_nowait((job, folder, accepted))

    async def follow(self) -> None:
        """Plays its part among services that share the folder.

        It says that this one runs, ends uploads that others were asked to cancel, and goes on with uploads that ended
        services had accepted.
        """
        touch(self.staging)
        for job in [job for job in self._jobs.values() if not job.ended]:
            if (self.staging / job.id / CANCEL).exists():
                await self.cancel(job)
        if self._begin.is_set():
            self._go_on(await asyncio.to_thread(self._taken_over))

    def pause(self) -> None:
        """Begins no further upload: the next start of the service goes on with them."""
        self._begin.clear()

    async def stop(self) -> None:
        """Ends the workers and their processes; what was accepted stays for the next start, nothing else."""
        self._spare.stop()
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)
        if not self.waiting:
            shutil.rmtree(self.staging, ignore_errors=True)

    @property
    def waiting(self) -> int:
        """Uploads that wait or run."""
        return sum(not job.ended for job in list(self._jobs.values()))

    @property
    def runs(self) -> bool:
        """Whether all workers take uploads in."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def get(self, job_id: str, viewer: str | None = None) -> Job:
        """The upload ``job_id``; refuses an unknown one, and one of another key than ``viewer``."""
        job = self._jobs.get(job_id) or (self._elsewhere(job_id) if re.fullmatch("[0-9a-f]{12}", job_id) else None)
        if job is None or job.owner != viewer:
            cure = "Upload the file again."
            raise NotFound("job", expected="the id of an upload", got=job_id[:120], cure=cure)
        return job

    def _elsewhere(self, job_id: str) -> Job | None:
        """An upload to another service, or one of before: as the disk says it."""
        there = elsewhere(self._root, self.staging, job_id)
        if there is not None:
            accepted, folder = there
            job = Job(job_id, accepted.name, accepted.owner, kind=accepted.kind, folder=folder)
            if accepted.attempts:
                job.state, job.stage = "running", "start"
            if (folder / CANCEL).exists():
                job.state = "cancelled"
            return job
        kept = job_records.read_job_record(self._root, job_id)
        if kept is None:
            return None
        kind: Kind = "garment" if kept.avatar is None else "avatar"
        last = kept.garment or kept.avatar
        results = tuple(kept.garments) or (() if last is None else (last,))
        outcome = tuple(kept.notes), results, kept.wearer, kept.problem
        return Job(kept.id, kept.name, kept.owner, kept.state, kind, *outcome)

    async def cancel(self, job: Job) -> None:
        """Ends ``job`` and removes its files. One that has ended is only forgotten, and its garment stays.

        A job of another service ends within ``DRAPE_GARMENTS_LOOK_S``.
        """
        if job.ended:
            self._jobs.pop(job.id, None)
            await asyncio.to_thread(job_records.remove_record, self._root, job.id)
            return
        if job.folder is not None:
            with contextlib.suppress(FileNotFoundError):  # it has just ended
                (job.folder / CANCEL).touch()
            return
        job.state = "cancelled"
        if job.work is not None:
            job.work.cancel()
            await asyncio.wait([job.work])
        await self._keep(job)
        await asyncio.to_thread(shutil.rmtree, self.staging / job.id, ignore_errors=True)

    async def _keep(self, job: Job) -> None:
        """Stores what became of ``job``, where every service that has the folder finds it."""
        assert job.state not in ("queued", "running")
        last = {job.kind: job.results[-1] if job.results else None}
        outcome = last.get("garment"), job.problem, last.get("avatar"), job.notes
        layers = job.results if job.kind == "garment" else ()
        record = JobRecord(job.id, job.name, job.owner, job.state, *outcome, layers, job.wearer)
        try:
            await asyncio.to_thread(record.write, self._root)
        except OSError as error:  # a full disk: it is known here as long as this service runs
            log.warning("upload %s: its record was not kept: %s", job.id, error)
        else:
            self._jobs.pop(job.id, None)

    def check_place(self, client: Client = ANYONE) -> None:
        """Refuses when too many uploads wait, are stored or run, and when there is no room for another garment."""
        self._check_room(client)
        if self.waiting >= self._settings.intake_queue:
            raise errors.Busy(
                "uploads",
                expected=f"fewer than {self._settings.intake_queue} waiting",
                got=str(self.waiting),
                cure="Try again in a minute.",
            )

    async def submit(
        self,
        name: str,
        file_format: str,
        pieces: AsyncIterator[bytes],
        avatar: str | None,
        client: Client = ANYONE,
        *,
        kind: Kind = "garment",
        replaces: str | None = None,
    ) -> Job:
        """Stores the file that ``pieces`` make and queues it; refuses when too many wait, and an empty one.

        ``avatar``, ``kind`` and ``replaces`` as in ``Accepted``.
        """
        self.check_place(client)
        job = Job(uuid.uuid4().hex[:12], slug(name), client.name, kind=kind, link=self._runtime.tracing.here())
        file = self.staging / job.id / f"{job.name}.{file_format}"
        self._jobs[job.id] = job  # at once, so that files that are being stored count
        try:
            if not await self.stored(file, pieces):
                refusal, what = (MeshError, "mesh") if kind == "garment" else (BodyError, "character's")
                expected, cure = f"the bytes of a {what} file", "Send the file as the body."
                raise refusal("request body", expected=expected, got="nothing", cure=cure)
            accepted = Accepted(job.id, job.name, job.owner, file.name, avatar, kind=kind, replaces=replaces)
            await asyncio.to_thread(accepted.write, file.parent)
        except BaseException:
            del self._jobs[job.id]
            shutil.rmtree(file.parent, ignore_errors=True)
            raise
        finished = [key for key, kept in self._jobs.items() if kept.ended]
        for key in finished[: max(0, len(self._jobs) - job_records.KEPT)]:
            del self._jobs[key]
        self._queue.put_nowait((job, file.parent, accepted))
        return job

    async def stored(self, file: Path, pieces: AsyncIterator[bytes]) -> int:
        """Writes ``pieces`` to ``file`` as they come. Returns how many bytes they were."""
        try:
            file.parent.mkdir(parents=True)
        except OSError as error:
            raise Unavailable(
                "folder of garments",
                expected="one that the service can write to",
                got=str(error.strerror),
                cure="Set DRAPE_GARMENTS_DIR to another folder, or let the user of the service write there.",
            ) from error
        with file.open("wb") as target:
            size = sum([await self._sliced_thread.run(target.write, piece) async for piece in pieces])
            target.flush()
            await asyncio.to_thread(os.fsync, target.fileno())
            return size

    async def _work(self) -> None:
        while True:
            job, folder, accepted = await self._queue.get()
            await self._begin.wait()
            if job.state == "cancelled":
                continue
            job.state, job.stage = "running", "start"
            try:
                with self._runtime.tracing.work("upload", [job.link], job=job.id):
                    job.work = asyncio.create_task(self._run_intake(job, folder, accepted))
                    job.results = await job.work
                    job.notes, job.wearer = self._findings(job)
                job.state = "done"
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if job.state != "cancelled" or (task is not None and task.cancelling()):
                    raise
            except DrapeError as error:
                job.problem, job.state = errors.problem_of(error), "failed"
                log.info("upload %s refused: %s", job.id, error)
            except Exception:
                log.exception("upload %s failed", job.id)
                job.problem, job.state = errors.problem_of(errors.InternalError()), "failed"
            job.work = job.stage = None
            # Not where the worker is ended: the next start goes on with it. The record comes first, so that other
            # services always find one of both.
            await self._keep(job)
            shutil.rmtree(folder, ignore_errors=True)

    def _findings(self, job: Job) -> tuple[tuple[str, ...], dict[str, Any] | None]:
        """What is otherwise than in the file that ``job`` brought, or looks wrong with it, and who wore it."""
        if job.kind == "avatar":
            return tuple(self._runtime.avatars.get(job.results[-1], job.owner).facts.notes), None
        garments = [self._runtime.garments.get(garment, job.owner).garment for garment in job.results]
        notes = dict.fromkeys(note for garment in garments for note in garment.warnings)
        return tuple(notes), garments[-1].manifest.get("wearer")

    async def _run_intake(self, job: Job, folder: Path, accepted: Accepted) -> tuple[str, ...]:
        """The ids of the garments or the avatar made from what was ``accepted`` and lies in ``folder``."""
        if accepted.attempts >= MOST_ATTEMPTS:
            raise MeshError(
                f"upload {accepted.file}",
                expected=f"an intake that ends within {MOST_ATTEMPTS} starts of the service",
                got="none",
                cure="Upload the file again.",
            )
        await asyncio.to_thread(accepted.tried, folder)
        out, client = folder / "out", self._access.client(accepted.owner)

        def begun(stage: str) -> None:
            job.stage = stage
            self._runtime.tracing.event(stage)
            expect(stage)

        def expect(stage: str) -> None:
            if accepted.kind == "avatar":  # who wears its own clothes at once
                made = asyncio.to_thread(self._runtime.expect_avatar, stage, out, client.name)
                beside.append(asyncio.ensure_future(made))

        beside: list[asyncio.Future[None]] = []
        expect("start")
        file = folder / accepted.file
        try:
            told, spare = accepted.avatar, self._spare.take()
            report = await run_sandbox(file, told, out, self._settings, begun, kind=accepted.kind, waiting=spare)
            await asyncio.gather(*beside)
        finally:
            for one in beside:
                one.cancel()
        job.stage = "prepare"
        self._runtime.tracing.event(job.stage)
        if accepted.kind == "avatar":
            return (await self._publish_avatar(out, report, file, accepted, client),)
        files = [out / str(name) for name in report["files"]]
        self._check_room(client, sum(one.stat().st_size for one in files), len(files))
        return tuple([await self._publish(one, client) for one in files])

    async def _publish_avatar(
        self, out: Path, report: dict[str, Any], file: Path, accepted: Accepted, client: Client
    ) -> str:
        """The id of the avatar whose wearer, and the garments that it came in, are those of the ``report``, in ``out``,
        with the user's ``file``, now in service."""
        avatars, (avatar, *own) = self._runtime.avatars, [out / str(name) for name in report["files"]]
        self._check_room(client, sum(one.stat().st_size for one in (avatar, file, *own)))
        clothes = OwnFiles(own, report["stiff"]) if "stiff" in report else None
        if accepted.replaces is not None:
            entry = avatars.get(accepted.replaces, client.name)
            return (await asyncio.to_thread(avatars.replaced, entry, avatar, clothes)).id
        return (await asyncio.to_thread(avatars.add, avatar, file, client.name, clothes)).id

    async def _publish(self, cache: Path, client: Client) -> str:
        """The id of the garment that ``cache`` is of: checked, on disk in the folder of ``client``, in service.

        The cache is read again here: arrays that a stranger's file led to are never taken unchecked.
        """
        registry = self._runtime.garments
        prepared = await self._runtime.threads.aside(registry.prepare, cache)
        stored = folder_of(self._root, client.name) / cache.name
        stored.parent.mkdir(exist_ok=True)
        await asyncio.to_thread(sync, cache)
        known = stored.exists()
        os.replace(cache, stored)
        try:
            await asyncio.to_thread(sync, stored.parent)
        except asyncio.CancelledError:
            if not known:  # another upload of the same file has it
                stored.unlink(missing_ok=True)
            raise
        return registry.add(prepared, "user", stored).id

    def _check_room(self, client: Client, more: int = 0, count: int = 1) -> None:
        """Refuses (``Full``) ``count`` garments, of ``more`` bytes, that the disk or its key has no room for."""
        characters = self._root / AVATARS
        stored = file_sizes([self._root, *self._root.glob(f"{OWNED}*/"), characters, *characters.glob(f"{OWNED}*/")])
        rules = [("bytes of all garments", self._settings.max_stored_bytes, sum(stored), more)]
        if client.limits is not None:
            own = file_sizes([folder_of(self._root, client.name)])
            rules.append(("bytes of a key's garments", client.limits.bytes, sum(own), more))
            rules.append(("garments of a key", client.limits.garments, len(own), count))
        for name, most, there, asked in rules:
            if there + asked > most or there >= most:
                cure = "Delete garments that are no longer worn: DELETE /garments/ID."
                raise errors.Full(name, expected=f"at most {most}", got=f"{there} and another", cure=cure)
