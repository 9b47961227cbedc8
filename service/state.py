"""The state of a running service, and how routes get it: ``StateHere``, ``ClientHere``."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from fastapi import Depends, Request
from starlette.requests import HTTPConnection

from drape.avatar.own_garments import MARK
from drape.errors import InputError
from service.errors import Busy, Draining
from service.guard.key_file import Client

if TYPE_CHECKING:
    from drape.avatar.wearer import Wearer
    from drape.stages.scene import Entry, Scene
    from drape.stages.sizes import SizeChoice
    from service.compute.avatars import AvatarEntry
    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.threads import SlicedThread
    from service.exact.clip_queue import ExactClips, Work
    from service.guard.access import Access
    from service.http.continuations import Continuations
    from service.http.kept import Kept
    from service.http.schemas import ClipOptions, OpenRequest
    from service.replicas.handover import Handover
    from service.stream.workers import Streams
    from service.uploads.jobs import Uploads
    from service.uploads.motions import MotionFiles
    from service.uploads.shared_folder import SharedFolder
    from service.watch.probes import Lifecycle

HURRY_S = 3.0  # from the beginning of a drain until running requests are refused
STREAMS_S = 2.0  # the time that a drain waits for streams to go


@dataclass(eq=False)
class State:
    """The objects of a running service that routes reach from a request: the runtime with body, model and garments;
    uploads, streams and clips in progress (``clips`` is their number); the thread that writes JSON; kept answers."""

    runtime: DrapeRuntime
    uploads: Uploads
    shared_folder: SharedFolder
    motion_files: MotionFiles
    streams: Streams
    sliced_thread: SlicedThread
    access: Access
    handover: Handover
    life: Lifecycle
    continuations: Continuations
    previews: Kept
    fold_messages: Kept
    meshes: Kept
    exact: ExactClips
    clips: int = 0

    async def garment(self, garment_id: str, client: Client) -> Entry:
        """Returns the entry of the garment ``garment_id``. Refuses (``NotFound``) an unknown one, and one that
        ``client`` may not see."""
        await self._load_own([garment_id], client)
        return await self.shared_folder.look_up(lambda: self.runtime.garments.get(garment_id, client.name))

    async def _load_own(self, ids: Sequence[str], client: Client) -> str | None:
        """Returns the id of the avatar that came in the first of the garments ``ids`` that an avatar came in, and reads
        that avatar's garments from the disk; None if there is no such garment."""
        name = next((garment.partition(MARK)[0] for garment in ids if MARK in garment), None)
        if name is not None:
            await asyncio.to_thread(self.runtime.avatars.own, (await self.avatar(name, client)).id)
        return name

    async def avatar(self, avatar_id: str, client: Client) -> AvatarEntry:
        """Returns the entry of the avatar ``avatar_id``. Refuses (``NotFound``) an unknown one, and one that ``client``
        may not see."""
        return await self.shared_folder.look_up(lambda: self.runtime.avatars.get(avatar_id, client.name))

    async def scene(
        self,
        garment: str | None,
        garments: Sequence[str] | None,
        client: Client,
        *,
        avatar: str | None = None,
        size: SizeChoice = None,
        alive: bool = False,
    ) -> Scene:
        """Returns the scene of one ``garment``, or of ``garments`` worn over each other (the innermost first), in
        ``size``, cut for ``avatar`` if one is named.

        With ``alive`` the avatar wears its own clothes too. A garment that an avatar came in is worn by that avatar
        even where ``avatar`` is None. Refuses (``InputError``) ``alive`` without an avatar, and what
        ``Registry.scene``, ``Sizes.wear``, ``Avatars.with_own`` and ``Avatars.dress`` refuse.
        """
        registry, avatars = self.runtime.garments, self.runtime.avatars
        worn_by = None if avatar is None else (await self.avatar(avatar, client)).id
        owner = await self._load_own([name for name in (garment, *(garments or ())) if name is not None], client)
        worn_by, scene = worn_by or owner, None
        if alive and worn_by is None:
            raise InputError("alive", expected="an avatar", got="none", cure="Name the avatar, or leave alive out.")
        if not alive or garment or garments:
            scene = await self.shared_folder.look_up(lambda: registry.scene(garment, garments, client.name))
            scene = scene if size is None else await asyncio.to_thread(self.runtime.sizes.wear, scene, size)
        if worn_by is not None and alive:
            scene = await asyncio.to_thread(avatars.with_own, worn_by, scene)
        assert scene is not None
        return scene if worn_by is None else await asyncio.to_thread(avatars.dress, worn_by, scene)

    async def requested_scene(self, request: ClipOptions | OpenRequest, client: Client) -> Scene:
        """Returns the ``scene`` that ``request`` of ``client`` names."""
        choices = {"avatar": request.avatar, "size": request.size, "alive": request.alive}
        return await self.scene(request.garment, request.garments, client, **choices)

    async def wearer(self, avatar: str, client: Client) -> Wearer:
        """Returns the body, rig and surface of the avatar with the id ``avatar``, read from the disk if they are not in
        memory. Refuses (``NotFound``) as ``avatar`` does."""
        entry = await self.avatar(avatar, client)
        return await asyncio.to_thread(self.runtime.avatars.wearer, entry.id)

    def watch(self) -> None:
        """Registers the functions by which metrics and readiness read the state of streams, clips, uploads and
        cards."""
        runtime, streams, uploads = self.runtime, self.streams, self.uploads
        runtime.metrics.watch(
            streams=lambda: streams.count,
            poses_waiting=lambda: streams.waiting,
            clips=lambda: self.clips,
            uploads_waiting=lambda: uploads.waiting,
            garments=lambda: len(runtime.garments.entries()),
        )
        if (lane := runtime.lane) is not None:
            runtime.metrics.watch(
                card_works=lambda: lane.works,
                card_occupied=lambda: lane.report().occupied,
                card_queue=lambda: lane.report().queue_s,
                card_frames=lambda: lane.report().frames,
                card_launches=lambda: lane.report().launches,
            )
        self.life.works |= {"streams": lambda: streams.runs, "uploads": lambda: uploads.runs}
        self.life.works["exact clips"] = lambda: self.exact.runs
        self.life.works["shared folder"] = lambda: self.shared_folder.runs

    def start(self, read_work: Callable[[bytes, str | None], Awaitable[Work]]) -> None:
        """Starts streams, uploads, exact clips and the look at the shared folder. ``read_work`` is that of
        ``ExactClips.start``."""
        for part in (self.uploads, self.streams, self.shared_folder):
            part.start()
        self.exact.start(read_work)
        self.watch()

    async def stop(self) -> None:
        """Ends what ``start`` began, and the threads and processes that compute."""
        for part in (self.shared_folder, self.uploads, self.exact, self.streams):
            await part.stop()
        self.sliced_thread.close()
        self.runtime.close()

    async def drain(self) -> None:
        """Takes no more work, and waits up to ``STREAMS_S`` until streams are gone: each takes its state to another
        process, or is told to connect again. Requests that still run after ``HURRY_S`` are refused (``Draining``)."""
        self.life.draining = True
        self.uploads.pause()
        self.exact.pause()
        self.streams.move(Draining())
        asyncio.get_running_loop().call_later(HURRY_S, self._hurry)
        until_s = time.monotonic() + STREAMS_S
        while self.streams.count and time.monotonic() < until_s:
            await asyncio.sleep(0.02)

    def _hurry(self) -> None:
        self.life.hurried = self.runtime.threads.hurried = True

    def check_slot(self) -> None:
        """Refuses (``Busy``) where ``max_clips`` clips are in progress: their answers could fill the memory."""
        limit = self.runtime.settings.max_clips
        if self.clips >= limit:
            raise Busy(
                "clips", expected=f"fewer than {limit} at a time", got=str(self.clips), cure="Try again in a second."
            )

    @contextmanager
    def slot(self) -> Iterator[None]:
        """Counts a clip as in progress while the block runs. Refuses as ``check_slot`` does."""
        self.check_slot()
        self.clips += 1
        try:
            yield
        finally:
            self.clips -= 1


# These are coroutines because FastAPI would run plain functions on a thread.
async def _state(request: Request) -> State:
    return request.app.state.drape


async def _admitted(connection: HTTPConnection) -> Client:
    return connection.app.state.drape.access.admit(connection.headers)


StateHere = Annotated[State, Depends(_state)]
ClientHere = Annotated[Client, Depends(_admitted)]
ADMITTED = [Depends(_admitted)]
