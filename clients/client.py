"""The Python clients: ``DrapeClient`` blocks, ``AsyncDrapeClient`` awaits; both make the same calls.

    client = DrapeClient("http://127.0.0.1:8000")
    vertices = client.drape("tshirt", clip)     # [m], (frame, vertex, 3), world frame

Refusals of the service come back as ``DrapeError`` with its sentence.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from clients import calls, pieces
from clients.at_root import at_root
from clients.calls import DEFAULT_URL, Answer, Body, Call, Motion
from clients.meshes import Mesh, check_without_body, glb_of
from clients.refusals import problem_error, unreachable
from drape.errors import DrapeError, Unavailable
from drape.motion.clip import MotionClip
from drape.wire.jets import JetFrame
from drape.wire.layout import JetLayout
from drape.wire.options import Resolution

# A clip of a thousand frames takes a while on a small machine; connecting does not.
TIMEOUT = httpx.Timeout(300.0, connect=5.0)
POLL_S = 0.25
Progress = Callable[[dict[str, Any]], None]


class DrapeClient:
    """Talks to a running service; may be used as a context manager."""

    def __init__(
        self, url: str = DEFAULT_URL, *, key: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        """``key``: an API key or a ticket, where the service has keys."""
        headers = calls.key_headers(key)
        self._http = httpx.Client(base_url=url, timeout=TIMEOUT, headers=headers, transport=transport)
        self._most: int | None = None

    def __enter__(self) -> DrapeClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def _send(self, call: Call[Answer]) -> Answer:
        try:
            response = self._http.request(**call.arguments())
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self._http.base_url, error) from error
        return call.answer(response)

    def _whole(self, call: Call[Answer]) -> Answer:
        """The answer to ``call``, asked for in pieces where its clip is longer than the service takes at once."""
        return pieces.joined(list(self._pieces(call)))

    def _pieces(self, call: Call[Answer], at_once: int | None = None) -> Iterator[Answer]:
        """The answers to the pieces of ``call``, of ``at_once`` frames or of as many as the service takes."""
        frames, past = len(call.clip.poses) if call.clip is not None else 1, None
        most = max(1, frames) if frames <= pieces.UNASKED else self._most_frames()
        for rows in pieces.slices(frames, most if at_once is None else min(at_once, most)):
            answer, past = self._send(pieces.piece(call, rows, past))
            yield answer

    def _most_frames(self) -> int:
        if self._most is None:
            self._most = pieces.most_frames(self.health())
        return self._most

    def health(self) -> dict[str, Any]:
        """Whether the service works, and with what."""
        return self._send(calls.health())

    def garments(self) -> list[dict[str, Any]]:
        """The garments that can be draped; ``id`` names one."""
        return self._send(calls.listed("garments"))

    def tiers(self) -> list[dict[str, Any]]:
        """The tiers that a drape may name, the least first, with what was measured of each."""
        return self._send(calls.listed("tiers"))

    def fabrics(self) -> list[dict[str, Any]]:
        """The fabrics that a drape may name, with their numbers."""
        return self._send(calls.listed("fabrics"))

    def bodies(self) -> list[dict[str, Any]]:
        """The bodies of the service."""
        return self._send(calls.listed("bodies"))

    def motions(self) -> list[dict[str, Any]]:
        """The sample clips of the service."""
        return self._send(calls.listed("motions"))

    def motion(self, name: str, betas: np.ndarray | None = None) -> MotionClip:
        """One sample clip, placed on the ground for the service's body in the shape ``betas``."""
        return self._send(calls.motion(name, betas))

    def placed(self, clip: MotionClip, betas: np.ndarray | None = None) -> MotionClip:
        """A clip from a file, placed on the ground for the service's body in the shape ``betas``."""
        name = self.bodies()[0]["id"]
        return calls.placed(clip, self._send(calls.body(name, betas)))

    def mesh(self, garment: str, resolution: Resolution = "delivered") -> dict[str, Any]:
        """Rest vertices [m], faces, uv and uv_faces of a garment, of the mesh that a drape of ``resolution`` has."""
        return self._send(calls.mesh(garment, resolution))

    def preview(self, garment: str, size: int = 512) -> bytes:
        """A PNG of a garment at rest on its body, ``size`` pixels along each side, 64 to 1,024."""
        return self._send(calls.preview(garment, size))

    def jet_layout(self, garment: str, resolution: Resolution = "delivered") -> JetLayout:
        """What makes vertices of the garment's jets, on its own mesh or a finer one; constant per garment."""
        return self._send(calls.jet_layout(garment, resolution))

    def upload_garment(
        self,
        path: str | Path,
        avatar: str | dict[str, Any] | None = None,
        *,
        name: str | None = None,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> str:
        """Uploads a garment file, waits for its job and returns the new garment's id.

        ``progress`` is told the job as often as it is asked for; what it raises ends the upload too.
        """
        job = self._send(calls.upload(Path(path), avatar, name))
        deadline = time.monotonic() + wait_s
        while (garment := finished(job)) is None:
            check_deadline(job, deadline, wait_s)
            try:
                progress(job)
                time.sleep(POLL_S)
            except BaseException:
                self._send(calls.cancel(job["id"]))
                raise
            job = self._send(calls.job(job["id"]))
        return garment

    def drape(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> np.ndarray:
        """World vertices [m] (F, V, 3) float32 of ``garment`` over a clip or poses (F, 24, 3) [rad].

        ``options`` are those of ``drape.wire.options.DrapeOptions``; the service's own where left out.
        """
        return self._whole(calls.drape(garment, motion, Body(trans, betas), options))

    def drape_at_root(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        """``drape`` as vertices [m] (F, V, 3) float32 counted from the roots [m] (F, 3) float64, which follow.

        Far from the world's origin their sum in float64 keeps the garment's shape, where ``drape`` rounds it.
        """
        return self._whole(at_root(calls.drape(garment, motion, Body(trans, betas), options)))

    def drape_outfit(
        self,
        garments: Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> list[np.ndarray]:
        """``drape`` of several garments worn over each other, the innermost first; vertices of each."""
        return self._whole(calls.drape_outfit(garments, motion, Body(trans, betas), options))

    def drape_frames(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        at_once: int = 240,
        **options: Any,
    ) -> Iterator[list[np.ndarray]]:
        """``drape_outfit`` as vertices [m] (f, V, 3) of each garment, at most ``at_once`` frames at a time.

        No more is held of a clip of any length.
        """
        worn = [garment] if isinstance(garment, str) else garment
        return self._pieces(calls.drape_outfit(worn, motion, Body(trans, betas), options), at_once)

    def drape_jets(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> list[JetFrame]:
        """``drape`` as posed patches, a frame each: ``jet_layout(garment).vertices(frame)`` [m] (V, 3).

        Of several garments over each other ``frame.layers(counts)`` parts the patches.
        """
        return self._whole(calls.drape_jets(garment, motion, Body(trans, betas), options))

    def drape_glb(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        fps: float | None = None,
        body: bool = False,
        quantised: bool = True,
        **options: Any,
    ) -> bytes:
        """An animated GLB of a garment, or of several over each other; with the body beside them if ``body``.

        ``quantised`` (KHR_mesh_quantization) is half as large; float32 otherwise. A clip that comes in pieces is
        written here, without the body (``InputError``).
        """
        more = {"with_body": body, "quantised": quantised}
        shape = Body(trans, betas, fps)
        call = calls.drape_glb(garment, motion, shape, options, **more)
        frames = len(motion.poses) if isinstance(motion, MotionClip) else len(motion)
        if frames <= pieces.UNASKED or frames <= (most := self._most_frames()):
            return self._send(call)
        check_without_body(call, most)
        vertices, roots = self._whole(at_root(calls.drape(garment, motion, shape, options)))
        resolution = options.get("resolution") or "delivered"
        worn = [garment] if isinstance(garment, str) else garment
        meshes = [Mesh.of(self.mesh(name, resolution)) for name in worn]
        return glb_of(call, meshes, vertices, roots)

    def posed_body(
        self, body: str, motion: Motion, *, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> np.ndarray:
        """World vertices [m] (F, Vb, 3) float32 of the posed body."""
        return self._whole(calls.posed_body(body, motion, Body(trans, betas)))


class AsyncDrapeClient:
    """``DrapeClient`` with awaitable methods."""

    def __init__(
        self, url: str = DEFAULT_URL, *, key: str | None = None, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        headers = calls.key_headers(key)
        self._http = httpx.AsyncClient(base_url=url, timeout=TIMEOUT, headers=headers, transport=transport)
        self._most: int | None = None

    async def __aenter__(self) -> AsyncDrapeClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes the connections."""
        await self._http.aclose()

    async def _send(self, call: Call[Answer]) -> Answer:
        try:
            response = await self._http.request(**call.arguments())
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise unreachable(self._http.base_url, error) from error
        return call.answer(response)

    async def _whole(self, call: Call[Answer]) -> Answer:
        """The answer to ``call``, asked for in pieces where its clip is longer than the service takes at once."""
        return pieces.joined([answer async for answer in self._pieces(call)])

    async def _pieces(self, call: Call[Answer], at_once: int | None = None) -> AsyncIterator[Answer]:
        """The answers to the pieces of ``call``, of ``at_once`` frames or of as many as the service takes."""
        frames, past = len(call.clip.poses) if call.clip is not None else 1, None
        most = max(1, frames) if frames <= pieces.UNASKED else await self._most_frames()
        for rows in pieces.slices(frames, most if at_once is None else min(at_once, most)):
            answer, past = await self._send(pieces.piece(call, rows, past))
            yield answer

    async def _most_frames(self) -> int:
        if self._most is None:
            self._most = pieces.most_frames(await self.health())
        return self._most

    async def health(self) -> dict[str, Any]:
        """Whether the service works, and with what."""
        return await self._send(calls.health())

    async def garments(self) -> list[dict[str, Any]]:
        """The garments that can be draped; ``id`` names one."""
        return await self._send(calls.listed("garments"))

    async def tiers(self) -> list[dict[str, Any]]:
        """The tiers that a drape may name, the least first, with what was measured of each."""
        return await self._send(calls.listed("tiers"))

    async def fabrics(self) -> list[dict[str, Any]]:
        """The fabrics that a drape may name, with their numbers."""
        return await self._send(calls.listed("fabrics"))

    async def bodies(self) -> list[dict[str, Any]]:
        """The bodies of the service."""
        return await self._send(calls.listed("bodies"))

    async def motions(self) -> list[dict[str, Any]]:
        """The sample clips of the service."""
        return await self._send(calls.listed("motions"))

    async def motion(self, name: str, betas: np.ndarray | None = None) -> MotionClip:
        """One sample clip, placed on the ground for the service's body in the shape ``betas``."""
        return await self._send(calls.motion(name, betas))

    async def placed(self, clip: MotionClip, betas: np.ndarray | None = None) -> MotionClip:
        """A clip from a file, placed on the ground for the service's body in the shape ``betas``."""
        name = (await self.bodies())[0]["id"]
        return calls.placed(clip, await self._send(calls.body(name, betas)))

    async def mesh(self, garment: str, resolution: Resolution = "delivered") -> dict[str, Any]:
        """Rest vertices [m], faces, uv and uv_faces of a garment, of the mesh that a drape of ``resolution`` has."""
        return await self._send(calls.mesh(garment, resolution))

    async def preview(self, garment: str, size: int = 512) -> bytes:
        """A PNG of a garment at rest on its body, ``size`` pixels along each side, 64 to 1,024."""
        return await self._send(calls.preview(garment, size))

    async def jet_layout(self, garment: str, resolution: Resolution = "delivered") -> JetLayout:
        """What makes vertices of the garment's jets, on its own mesh or a finer one; constant per garment."""
        return await self._send(calls.jet_layout(garment, resolution))

    async def upload_garment(
        self,
        path: str | Path,
        avatar: str | dict[str, Any] | None = None,
        *,
        name: str | None = None,
        wait_s: float = 600.0,
        progress: Progress = lambda job: None,
    ) -> str:
        """Uploads a garment file, waits for its job and returns the new garment's id.

        ``progress`` is told the job as often as it is asked for; what it raises ends the upload too.
        """
        job = await self._send(calls.upload(Path(path), avatar, name))
        deadline = time.monotonic() + wait_s
        while (garment := finished(job)) is None:
            check_deadline(job, deadline, wait_s)
            try:
                progress(job)
                await asyncio.sleep(POLL_S)
            except BaseException:
                await self._send(calls.cancel(job["id"]))
                raise
            job = await self._send(calls.job(job["id"]))
        return garment

    async def drape(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> np.ndarray:
        """World vertices [m] (F, V, 3) float32 of ``garment`` over a clip or poses (F, 24, 3) [rad].

        ``options`` are those of ``drape.wire.options.DrapeOptions``; the service's own where left out.
        """
        return await self._whole(calls.drape(garment, motion, Body(trans, betas), options))

    async def drape_at_root(
        self,
        garment: str,
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        """``drape`` as vertices [m] (F, V, 3) float32 counted from the roots [m] (F, 3) float64, which follow.

        Far from the world's origin their sum in float64 keeps the garment's shape, where ``drape`` rounds it.
        """
        return await self._whole(at_root(calls.drape(garment, motion, Body(trans, betas), options)))

    async def drape_outfit(
        self,
        garments: Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> list[np.ndarray]:
        """``drape`` of several garments worn over each other, the innermost first; vertices of each."""
        return await self._whole(calls.drape_outfit(garments, motion, Body(trans, betas), options))

    def drape_frames(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        at_once: int = 240,
        **options: Any,
    ) -> AsyncIterator[list[np.ndarray]]:
        """``drape_outfit`` as vertices [m] (f, V, 3) of each garment, at most ``at_once`` frames at a time.

        No more is held of a clip of any length.
        """
        worn = [garment] if isinstance(garment, str) else garment
        return self._pieces(calls.drape_outfit(worn, motion, Body(trans, betas), options), at_once)

    async def drape_jets(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        **options: Any,
    ) -> list[JetFrame]:
        """``drape`` as posed patches, a frame each: ``jet_layout(garment).vertices(frame)`` [m] (V, 3).

        Of several garments over each other ``frame.layers(counts)`` parts the patches.
        """
        return await self._whole(calls.drape_jets(garment, motion, Body(trans, betas), options))

    async def drape_glb(
        self,
        garment: str | Sequence[str],
        motion: Motion,
        *,
        trans: np.ndarray | None = None,
        betas: np.ndarray | None = None,
        fps: float | None = None,
        body: bool = False,
        quantised: bool = True,
        **options: Any,
    ) -> bytes:
        """An animated GLB of a garment, or of several over each other; with the body beside them if ``body``.

        ``quantised`` (KHR_mesh_quantization) is half as large; float32 otherwise. A clip that comes in pieces is
        written here, without the body (``InputError``).
        """
        more = {"with_body": body, "quantised": quantised}
        shape = Body(trans, betas, fps)
        call = calls.drape_glb(garment, motion, shape, options, **more)
        frames = len(motion.poses) if isinstance(motion, MotionClip) else len(motion)
        if frames <= pieces.UNASKED or frames <= (most := await self._most_frames()):
            return await self._send(call)
        check_without_body(call, most)
        vertices, roots = await self._whole(at_root(calls.drape(garment, motion, shape, options)))
        resolution = options.get("resolution") or "delivered"
        worn = [garment] if isinstance(garment, str) else garment
        meshes = [Mesh.of(await self.mesh(name, resolution)) for name in worn]
        return glb_of(call, meshes, vertices, roots)

    async def posed_body(
        self, body: str, motion: Motion, *, trans: np.ndarray | None = None, betas: np.ndarray | None = None
    ) -> np.ndarray:
        """World vertices [m] (F, Vb, 3) float32 of the posed body."""
        return await self._whole(calls.posed_body(body, motion, Body(trans, betas)))


def finished(job: dict[str, Any]) -> str | None:
    """The garment of a job that is done, None while it goes on; raises its refusal where it failed or was cancelled."""
    if job["state"] == "failed":
        raise problem_error(job["problem"])
    if job["state"] == "cancelled":
        raise Unavailable(
            f"upload {job['name']}", expected="its end", got="one that was cancelled", cure="Upload again."
        )
    return job["garment"] if job["state"] == "done" else None


def check_deadline(job: dict[str, Any], deadline: float, wait_s: float) -> None:
    """Refuses to wait longer."""
    if time.monotonic() > deadline:
        name, cure = f"upload {job['name']}", f"Ask again later: GET /jobs/{job['id']}."
        raise Unavailable(name, expected=f"an end within {wait_s:g} s", got=f"state {job['state']}", cure=cure)


__all__ = ["AsyncDrapeClient", "DrapeClient", "DrapeError"]
