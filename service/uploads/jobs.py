"""Uploads: a file waits, goes through the intake in a process with limits, and becomes a garment or a refusal."""

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
from service.uploads.accepted import CANCEL, Accepted, Kind, find_elsewhere, staging_folder, sync, take_over, touch
from service.uploads.intake_process import SHARES, run_sandbox
from service.uploads.job_records import JobRecord
from service.uploads.spare import Spare

if TYPE_CHECKING:
    from opentelemetry.trace import Link

    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.threads import SlicedThread
    from service.guard.access import Access

MOST_ATTEMPTS = 3  # the most starts of the service that begin one upload
log = logging.getLogger("drape.service")


@dataclass(eq=False)
class Job:
    """An upload and its state. ``results`` are the ids of its garments, the innermost first, or that of its avatar;
    ``wearer`` has the fields of ``WearerFound``. Fields that do not apply to the state are None or empty."""

    id: str
    name: str
    owner: str | None = None
    state: Literal["queued", "running", "done", "failed", "cancelled"] = "queued"
    kind: Kind = "garment"
    notes: tuple[str, ...] = ()  # sentences for the client about a file that is done
    results: tuple[str, ...] = ()  # the ids of the garments, the innermost first, or that of the avatar
    wearer: dict[str, Any] | None = None  # the body that the intake found from the cloth
    problem: dict[str, Any] | None = None  # the problem document of a failed one
    stage: str | None = None  # the name in SHARES of what runs now
    link: Link | None = None  # a link to the span of its request
    work: asyncio.Task[tuple[str, ...]] | None = None
    folder: Path | None = None  # the folder of an upload that another service has

    @property
    def share(self) -> float:
        """The share of the work that is done, 0 to 1, by the usual times of the stages."""
        if self.state == "done":
            return 1.0
        shares = SHARES[self.kind]
        names = list(shares)
        return sum(shares[name] for name in names[: names.index(self.stage)]) if self.stage in shares else 0.0

    @property
    def ended(self) -> bool:
        """Whether it is done, failed or cancelled."""
        return self.state not in ("queued", "running")


class Uploads:
    """The uploads of a service: a queue, and ``DRAPE_INTAKE_WORKERS`` workers. Files lie in the folder ``staging``
    until they are garments or avatars. Uploads to other services with the same folder of garments can be asked for
    too."""

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
        """Takes over the uploads of ended processes and starts the workers."""
        self._queue_all(self._take_over())
        self._spare.start()
        for number in range(self._settings.intake_workers):
            self._workers.append(asyncio.create_task(self._work(), name=f"uploads {number}"))

    def _take_over(self) -> list[tuple[Accepted, Path]]:
        shared = self._settings.garments_look_s > 0.0
        return list(take_over(self._root, self.staging, shared=shared))

    def _queue_all(self, uploads: Iterable[tuple[Accepted, Path]]) -> None:
        for accepted, folder in uploads:
            job = self._jobs[accepted.id] = Job(accepted.id, accepted.name, accepted.owner, kind=accepted.kind)
            self._queue.put_nowait((job, folder, accepted))

    async def follow(self) -> None:
        """Marks the staging folder as that of a running service, cancels uploads that clients cancelled at other
        services, and takes over uploads of services that have ended."""
        touch(self.staging)
        for job in [job for job in self._jobs.values() if not job.ended]:
            if (self.staging / job.id / CANCEL).exists():
                await self.cancel(job)
        if self._begin.is_set():
            self._queue_all(await asyncio.to_thread(self._take_over))

    def pause(self) -> None:
        """Lets no worker begin another upload. The next start of the service goes on with them."""
        self._begin.clear()

    async def stop(self) -> None:
        """Ends the workers and their processes. Accepted uploads stay on disk for the next start."""
        self._spare.stop()
        for worker in self._workers:
            worker.cancel()
        await asyncio.gather(*self._workers, return_exceptions=True)
        if not self.waiting:
            shutil.rmtree(self.staging, ignore_errors=True)

    @property
    def waiting(self) -> int:
        """The number of uploads that wait or run."""
        return sum(not job.ended for job in list(self._jobs.values()))

    @property
    def runs(self) -> bool:
        """Whether all workers run."""
        return bool(self._workers) and not any(worker.done() for worker in self._workers)

    def get(self, job_id: str, viewer: str | None = None) -> Job:
        """Returns the upload ``job_id``. Refuses (``NotFound``) an unknown one, and one of another key than
        ``viewer``."""
        job = self._jobs.get(job_id) or (self._elsewhere(job_id) if re.fullmatch("[0-9a-f]{12}", job_id) else None)
        if job is None or job.owner != viewer:
            cure = "Upload the file again."
            raise NotFound("job", expected="the id of an upload", got=job_id[:120], cure=cure)
        return job

    def _elsewhere(self, job_id: str) -> Job | None:
        """Returns an upload to another service, or one that has ended, as the disk has it; None for an unknown one."""
        upload = find_elsewhere(self._root, self.staging, job_id)
        if upload is not None:
            accepted, folder = upload
            job = Job(job_id, accepted.name, accepted.owner, kind=accepted.kind, folder=folder)
            if accepted.attempts:
                job.state, job.stage = "running", "start"
            if (folder / CANCEL).exists():
                job.state = "cancelled"
            return job
        record = job_records.read_job_record(self._root, job_id)
        if record is None:
            return None
        kind: Kind = "garment" if record.avatar is None else "avatar"
        last = record.garment or record.avatar
        results = tuple(record.garments) or (() if last is None else (last,))
        outcome = tuple(record.notes), results, record.wearer, record.problem
        return Job(record.id, record.name, record.owner, record.state, kind, *outcome)

    async def cancel(self, job: Job) -> None:
        """Cancels ``job`` and deletes its files. If another service runs the job, that service does this when it next
        looks at the folder, within ``DRAPE_GARMENTS_LOOK_S``. Of a job that has ended only the record is deleted; its
        garment stays."""
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
        """Writes the record of the ended ``job`` to the folder of garments, where all services read it."""
        assert job.state not in ("queued", "running")
        last = {job.kind: job.results[-1] if job.results else None}
        outcome = last.get("garment"), job.problem, last.get("avatar"), job.notes
        layers = job.results if job.kind == "garment" else ()
        record = JobRecord(job.id, job.name, job.owner, job.state, *outcome, layers, job.wearer)
        try:
            await asyncio.to_thread(record.write, self._root)
        except OSError as error:  # on a full disk the job is known only until this service ends
            log.warning("upload %s: its record was not kept: %s", job.id, error)
        else:
            self._jobs.pop(job.id, None)

    def check_place(self, client: Client = ANYONE) -> None:
        """Refuses (``Busy``) an upload of ``client`` where too many wait or run, and (``Full``) where the storage, or
        the key's share of it, has no room for another garment."""
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
        """Stores the file whose bytes are ``pieces``, queues its intake and returns its job. Refuses as ``check_place``
        does, and an empty file. ``avatar``, ``kind`` and ``replaces`` are those of ``Accepted``."""
        self.check_place(client)
        job = Job(uuid.uuid4().hex[:12], slug(name), client.name, kind=kind, link=self._runtime.tracing.here())
        file = self.staging / job.id / f"{job.name}.{file_format}"
        self._jobs[job.id] = job  # before the file is stored, so that it counts as waiting
        try:
            if not await self.store(file, pieces):
                refusal, what = (MeshError, "mesh") if kind == "garment" else (BodyError, "character's")
                expected, cure = f"the bytes of a {what} file", "Send the file as the body."
                raise refusal("request body", expected=expected, got="nothing", cure=cure)
            accepted = Accepted(job.id, job.name, job.owner, file.name, avatar, kind=kind, replaces=replaces)
            await asyncio.to_thread(accepted.write, file.parent)
        except BaseException:
            del self._jobs[job.id]
            shutil.rmtree(file.parent, ignore_errors=True)
            raise
        finished = [key for key, other in self._jobs.items() if other.ended]
        for key in finished[: max(0, len(self._jobs) - job_records.KEPT)]:
            del self._jobs[key]
        self._queue.put_nowait((job, file.parent, accepted))
        return job

    async def store(self, file: Path, pieces: AsyncIterator[bytes]) -> int:
        """Writes ``pieces`` to ``file``, in a new folder, and returns the number of bytes. Refuses (``Unavailable``)
        where the service cannot write there."""
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
            # A worker that is cancelled does not get here, and the next start goes on with the upload. The record is
            # written before the folder goes, so that other services always find one of both.
            await self._keep(job)
            shutil.rmtree(folder, ignore_errors=True)

    def _findings(self, job: Job) -> tuple[tuple[str, ...], dict[str, Any] | None]:
        """Returns sentences on what differs from the file of the done ``job`` or looks wrong with it, and the body that
        the intake found from the cloth, None if it was named."""
        if job.kind == "avatar":
            return tuple(self._runtime.avatars.get(job.results[-1], job.owner).facts.notes), None
        garments = [self._runtime.garments.get(garment, job.owner).garment for garment in job.results]
        notes = dict.fromkeys(note for garment in garments for note in garment.warnings)
        return tuple(notes), garments[-1].manifest.get("wearer")

    async def _run_intake(self, job: Job, folder: Path, accepted: Accepted) -> tuple[str, ...]:
        """Runs the intake of ``accepted``, whose file lies in ``folder``, and puts what it makes in service. Returns
        the ids of the garments, the innermost first, or that of the avatar."""
        if accepted.attempts >= MOST_ATTEMPTS:
            raise MeshError(
                f"upload {accepted.file}",
                expected=f"an intake that ends within {MOST_ATTEMPTS} starts of the service",
                got="none",
                cure="Upload the file again.",
            )
        await asyncio.to_thread(accepted.add_attempt, folder)
        out, client = folder / "out", self._access.client(accepted.owner)
        beside: list[asyncio.Future[None]] = []

        def expect(stage: str) -> None:
            if accepted.kind == "avatar":  # clients will ask at once for what it can wear
                call = asyncio.to_thread(self._runtime.expect_avatar, stage, out, client.name)
                beside.append(asyncio.ensure_future(call))

        def begin_stage(stage: str) -> None:
            job.stage = stage
            self._runtime.tracing.event(stage)
            expect(stage)

        expect("start")
        file, spare = folder / accepted.file, self._spare.take()
        intake = run_sandbox(file, accepted.avatar, out, self._settings, begin_stage, kind=accepted.kind, waiting=spare)
        try:
            report = await intake
            await asyncio.gather(*beside)
        finally:
            for call in beside:
                call.cancel()
        job.stage = "prepare"
        self._runtime.tracing.event(job.stage)
        if accepted.kind == "avatar":
            return (await self._publish_avatar(out, report, file, accepted, client),)
        files = [out / str(name) for name in report["files"]]
        self._check_room(client, sum(cache.stat().st_size for cache in files), len(files))
        return tuple([await self._publish(cache, client) for cache in files])

    async def _publish_avatar(
        self, out: Path, report: dict[str, Any], file: Path, accepted: Accepted, client: Client
    ) -> str:
        """Puts the avatar of ``report`` in service: its wearer and own garments in ``out``, and the user's ``file``.
        Returns its id."""
        avatars, (avatar, *own) = self._runtime.avatars, [out / str(name) for name in report["files"]]
        self._check_room(client, sum(path.stat().st_size for path in (avatar, file, *own)))
        clothes = OwnFiles(own, report["stiff"]) if "stiff" in report else None
        if accepted.replaces is not None:
            entry = avatars.get(accepted.replaces, client.name)
            return (await asyncio.to_thread(avatars.replace, entry, avatar, clothes)).id
        return (await asyncio.to_thread(avatars.add, avatar, file, client.name, clothes)).id

    async def _publish(self, cache: Path, client: Client) -> str:
        """Checks ``cache``, moves it to the folder of ``client`` and puts its garment in service. Returns the id.

        The cache is read again here: arrays that come from a stranger's file are never used unchecked.
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
            if not known:  # otherwise the file belongs to an earlier upload of the same garment
                stored.unlink(missing_ok=True)
            raise
        return registry.add(prepared, "user", stored).id

    def _check_room(self, client: Client, more: int = 0, count: int = 1) -> None:
        """Refuses (``Full``) ``count`` more garments of ``more`` bytes together, where storage or key have no room."""
        characters = self._root / AVATARS
        stored = file_sizes([self._root, *self._root.glob(f"{OWNED}*/"), characters, *characters.glob(f"{OWNED}*/")])
        rules = [("bytes of all garments", self._settings.max_stored_bytes, sum(stored), more)]
        if client.limits is not None:
            own, figures = (file_sizes([folder_of(root, client.name)]) for root in (self._root, characters))
            rules.append(("bytes of a key's garments", client.limits.bytes, sum(own + figures), more))
            rules.append(("garments of a key", client.limits.garments, len(own), count))
        for name, most, present, added in rules:
            if present + added > most or present >= most:
                cure = "Delete garments that are no longer worn: DELETE /garments/ID."
                raise errors.Full(name, expected=f"at most {most}", got=f"{present} and another", cure=cure)
