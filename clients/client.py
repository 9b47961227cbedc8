"""The Python clients. ``DrapeClient`` waits for answers, and ``AsyncDrapeClient`` awaits them.

    client = DrapeClient("http://127.0.0.1:8000")
    vertices = client.drape("tshirt", clip)     # [m], (frame, vertex, 3), world frame

Both have the methods of ``clients.methods.Methods``. A refusal of the service is raised as a ``DrapeError``.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import httpx
import numpy as np

from clients.calls import DEFAULT_URL, Answer, Call, Motion
from clients.connections import open_client, unreachable
from clients.job_steps import Pause, Steps
from clients.methods import Methods
from clients.stream import DrapeStream
from drape.errors import DrapeError
from drape.files.formats import AVATAR_SUFFIXES

Given = ParamSpec("Given")
Whole = Callable[Concatenate[Methods, Given], Call[Answer] | Steps[Answer]]
InParts = Callable[Concatenate[Methods, Given], Iterator[Steps[Answer]]]


def _waiting(method: Whole[Given, Answer]) -> Callable[Concatenate[DrapeClient, Given], Answer]:
    """``method`` for the client that blocks."""

    @wraps(method)
    def waiting(client: DrapeClient, /, *args: Given.args, **more: Given.kwargs) -> Answer:
        return client._run(method(client._methods, *args, **more))

    return waiting


def _waiting_in_parts(method: InParts[Given, Answer]) -> Callable[Concatenate[DrapeClient, Given], Iterator[Answer]]:
    """``method``, which answers part by part, for the client that blocks."""

    @wraps(method)
    def waiting(client: DrapeClient, /, *args: Given.args, **more: Given.kwargs) -> Iterator[Answer]:
        return map(client._run, method(client._methods, *args, **more))

    return waiting


def _awaited(
    method: Whole[Given, Answer],
) -> Callable[Concatenate[AsyncDrapeClient, Given], Coroutine[Any, Any, Answer]]:
    """``method`` for the client that awaits."""

    @wraps(method)
    async def awaited(client: AsyncDrapeClient, /, *args: Given.args, **more: Given.kwargs) -> Answer:
        return await client._run(method(client._methods, *args, **more))

    return awaited


def _awaited_in_parts(
    method: InParts[Given, Answer],
) -> Callable[Concatenate[AsyncDrapeClient, Given], AsyncIterator[Answer]]:
    """``method``, which answers part by part, for the client that awaits."""

    @wraps(method)
    def awaited(client: AsyncDrapeClient, /, *args: Given.args, **more: Given.kwargs) -> AsyncIterator[Answer]:
        return (await client._run(steps) for steps in method(client._methods, *args, **more))

    return awaited


class DrapeClient:
    """A client of a running service, with the methods of ``Methods``. Each call waits for its answer. As a context
    manager it closes its connections at the end."""

    def __init__(
        self, url: str = DEFAULT_URL, *, key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        """``url``: the address of the service. ``key``: a key or a ticket, if the service has keys."""
        self._http = open_client(httpx.Client, url, key, transport)
        self._methods, self._key = Methods(), key

    @property
    def reached(self) -> dict[str, Any]:
        """Returns the arguments "url" and "key" of ``DrapeStream.open`` for the same service."""
        return {"url": str(self._http.base_url), "key": self._key}

    def __enter__(self) -> DrapeClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def avatar(self, source: str | Path, *, alive: bool = False) -> Avatar:
        """Returns the avatar with the id ``source``. If ``source`` is a GLB or VRM file, it is uploaded first; with
        ``alive`` its own clothes become garments."""
        is_file = Path(source).suffix.lower() in AVATAR_SUFFIXES
        return Avatar(self, self.upload_avatar(source, alive=alive) if is_file else str(source))

    def _run(self, steps: Call[Answer] | Steps[Answer]) -> Answer:
        if isinstance(steps, Call):
            return self._send(steps)
        try:
            step = next(steps)
            while True:
                try:
                    answer = time.sleep(step.seconds) if isinstance(step, Pause) else self._send(step)
                except BaseException as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(answer)
        except StopIteration as end:
            return end.value

    def _send(self, call: Call[Answer]) -> Answer:
        try:
            response = self._http.request(**call.arguments())
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self._http.base_url, error) from error
        return call.answer(response)

    health = _waiting(Methods.health)
    garments = _waiting(Methods.garments)
    tiers = _waiting(Methods.tiers)
    fabrics = _waiting(Methods.fabrics)
    bodies = _waiting(Methods.bodies)
    motions = _waiting(Methods.motions)
    motion = _waiting(Methods.motion)
    placed = _waiting(Methods.placed)
    measures = _waiting(Methods.measures)
    shape = _waiting(Methods.shape)
    fit = _waiting(Methods.fit)
    mesh = _waiting(Methods.mesh)
    preview = _waiting(Methods.preview)
    jet_layout = _waiting(Methods.jet_layout)
    upload_garment = _waiting(Methods.upload_garment)
    upload_avatar = _waiting(Methods.upload_avatar)
    avatars = _waiting(Methods.avatars)
    about_avatar = _waiting(Methods.about_avatar)
    remove_avatar = _waiting(Methods.remove_avatar)
    drape = _waiting(Methods.drape)
    drape_at_root = _waiting(Methods.drape_at_root)
    drape_outfit = _waiting(Methods.drape_outfit)
    drape_frames = _waiting_in_parts(Methods.drape_frames)
    drape_jets = _waiting(Methods.drape_jets)
    drape_glb = _waiting(Methods.drape_glb)
    exact = _waiting(Methods.exact)
    body_mesh = _waiting(Methods.body_mesh)
    posed_body = _waiting(Methods.posed_body)
    posed_avatar = _waiting(Methods.posed_avatar)
    size = _waiting(Methods.size)


class AsyncDrapeClient:
    """A client of a running service, with the methods of ``Methods``. Each call is awaited. As an asynchronous context
    manager it closes its connections at the end."""

    def __init__(
        self, url: str = DEFAULT_URL, *, key: str | None = None, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        self._http = open_client(httpx.AsyncClient, url, key, transport)
        self._methods = Methods()

    async def __aenter__(self) -> AsyncDrapeClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes the connections."""
        await self._http.aclose()

    async def _run(self, steps: Call[Answer] | Steps[Answer]) -> Answer:
        if isinstance(steps, Call):
            return await self._send(steps)
        try:
            step = next(steps)
            while True:
                try:
                    answer = await (asyncio.sleep(step.seconds) if isinstance(step, Pause) else self._send(step))
                except BaseException as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(answer)
        except StopIteration as end:
            return end.value

    async def _send(self, call: Call[Answer]) -> Answer:
        try:
            response = await self._http.request(**call.arguments())
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self._http.base_url, error) from error
        return call.answer(response)

    health = _awaited(Methods.health)
    garments = _awaited(Methods.garments)
    tiers = _awaited(Methods.tiers)
    fabrics = _awaited(Methods.fabrics)
    bodies = _awaited(Methods.bodies)
    motions = _awaited(Methods.motions)
    motion = _awaited(Methods.motion)
    placed = _awaited(Methods.placed)
    measures = _awaited(Methods.measures)
    shape = _awaited(Methods.shape)
    fit = _awaited(Methods.fit)
    mesh = _awaited(Methods.mesh)
    preview = _awaited(Methods.preview)
    jet_layout = _awaited(Methods.jet_layout)
    upload_garment = _awaited(Methods.upload_garment)
    upload_avatar = _awaited(Methods.upload_avatar)
    avatars = _awaited(Methods.avatars)
    about_avatar = _awaited(Methods.about_avatar)
    remove_avatar = _awaited(Methods.remove_avatar)
    drape = _awaited(Methods.drape)
    drape_at_root = _awaited(Methods.drape_at_root)
    drape_outfit = _awaited(Methods.drape_outfit)
    drape_frames = _awaited_in_parts(Methods.drape_frames)
    drape_jets = _awaited(Methods.drape_jets)
    drape_glb = _awaited(Methods.drape_glb)
    exact = _awaited(Methods.exact)
    body_mesh = _awaited(Methods.body_mesh)
    posed_body = _awaited(Methods.posed_body)
    posed_avatar = _awaited(Methods.posed_avatar)
    size = _awaited(Methods.size)


__all__ = ["AsyncDrapeClient", "DrapeClient", "DrapeError"]


@dataclass(frozen=True)
class Avatar:
    """An avatar of a service, the garments that it wears, the innermost first, and the options of their drape.

    A ``motion`` is a clip, SMPL poses (F, 24, 3) [rad], or the name of a sample clip. It may also be local quaternions
    (F, N, 4), x, y, z, w, of the avatar's own ``nodes``, in their order; ``trans`` [m] (F, 3) are then the positions of
    the node of the pelvis.
    """

    client: DrapeClient
    id: str
    garments: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def wear(self, *garments: str, **options: Any) -> Avatar:
        """Returns the same avatar in ``garments`` instead, the innermost first. ``options`` are the fields of
        ``drape.wire.options.DrapeOptions``, and ``size``."""
        return Avatar(self.client, self.id, garments, options)

    @property
    def nodes(self) -> list[str]:
        """Returns the names of the nodes of its file, in the order of its rig's rotations."""
        return self.client.about_avatar(self.id)["nodes"]

    async def stream(self) -> DrapeStream:
        """Returns an open stream of the garments on the avatar. It takes SMPL poses (``send``) and poses of the
        avatar's own rig (``send_rig``)."""
        garments = self.garments[0] if len(self.garments) == 1 else self.garments
        return await DrapeStream.open(garment=garments, avatar=self.id, **self.client.reached, **self.options)

    def play(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> list[np.ndarray]:
        """Returns the vertices (F, V, 3) [m], float32, of each garment in the world over ``motion``."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.drape_outfit(self.garments, clip, trans=trans, avatar=self.id, **self.options)

    def glb(self, motion: str | Motion, *, trans: np.ndarray | None = None, joints: int | None = None) -> bytes:
        """Returns the bytes of a GLB of the garments over ``motion``, skinned to the nodes of the avatar's own file and
        in its unit. Garments have morph targets, or with ``joints`` each has that number of joints of its own.

        Refuses (``InputError``) a clip that is longer than one request may be.
        """
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        more = {"rig": True, "joints": joints, "avatar": self.id}
        return self.client.drape_glb(self.garments, clip, trans=trans, **more, **self.options)

    def surface(self, motion: str | Motion, *, trans: np.ndarray | None = None) -> np.ndarray:
        """Returns the vertices (F, V, 3) [m], float32, of the avatar's own surface in the world over ``motion``."""
        clip = self.client.motion(motion, avatar=self.id) if isinstance(motion, str) else motion
        return self.client.posed_avatar(self.id, clip, trans=trans)
