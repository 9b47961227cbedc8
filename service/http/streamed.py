"""Answers whose frames leave as they are ready: of a clip of any length a chunk is held, and the next is computed when
it has been sent."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from dataclasses import dataclass

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from drape.export.pc2 import HEAD_BYTES, pc2_head
from drape.wire.jets import message_bytes
from service.compute.drape_runtime import DrapeRuntime
from service.compute.garments import Outfit, layer_list
from service.guard.keys import Client
from service.http.answers import number_bytes
from service.http.continuations import Continuation
from service.http.jets import jets_headers
from service.http.negotiation import PC2
from service.http.schemas import ClipOptions
from service.stages.batch import Batch, Memories, Plan, PoseInput
from service.state import State


@dataclass(frozen=True, eq=False)
class ClipJob:
    """What is draped for whom: the ``plan`` and the ``clip`` that ``asked`` came to."""

    plan: Plan
    clip: PoseInput
    asked: ClipOptions
    client: Client

    def remember(self, memories: Memories, state: State, token: str | None = None) -> dict[str, str]:
        """Keeps ``memories`` of the last frame where that was asked for, under ``token`` or one of its own, and tells
        the header that names them."""
        if not self.asked.keep:
            return {}
        token = token or state.continuations.token()
        frames = self.clip.sequence + len(self.clip.poses)
        past = Continuation(self.plan, self.clip.betas, self.asked.fps, frames, memories)
        state.continuations.put(token, past, self.client.name)
        return {"X-Drape-Past": token}


def plan_headers(plan: Plan, runtime: DrapeRuntime) -> dict[str, str]:
    """What will be computed: the model, the tier by name, the network's passes, the steps of folds, the motion."""
    options, passes, scene = plan.options, runtime.engine.pass_count, plan.shown
    headers = {
        "X-Drape-Model": runtime.engine.manifest.digest[:16],
        "X-Drape-Push-Out": str(int(bool(options.push_out))),
        "X-Drape-Tier": runtime.tier_of(plan),
        "X-Drape-Passes": str(passes if options.passes is None else options.passes),
        "X-Drape-Folds": str(options.folds),
        "X-Drape-Safe-Folds": str(options.safe_folds or 0),
        "X-Drape-Motion": f"{options.knob:g}",
    }
    if isinstance(scene, Outfit):
        headers["X-Drape-Garments"] = ",".join(f"{layer['id']}:{layer['vertices']}" for layer in layer_list(scene))
    return headers


def quality_headers(draped: Batch) -> dict[str, str]:
    """What was done to the frames, which is known at their end."""
    return {
        "X-Drape-Pushed-Share": f"{draped.quality.pushed_share.mean():.6f}",
        "X-Drape-Push-Max-M": f"{draped.quality.push_max_m.max():.6f}",
        "X-Drape-Novelty": f"{draped.quality.novelty.max():.3f}",
        "X-Drape-Unlike": str(int((draped.quality.novelty > 1.0).sum())),
        "X-Drape-Folds-Resets": str(int(draped.quality.folds_resets.sum())),
    }


class _Frames(StreamingResponse):
    """Ends its frames with itself, whether they were all sent or the client went away: their place is free then."""

    def __init__(self, frames: AsyncGenerator[bytes], kind: str, headers: dict[str, str]) -> None:
        super().__init__(frames, media_type=kind, headers=headers)
        self._frames = frames

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with contextlib.aclosing(self._frames):
            await super().__call__(scope, receive, send)


async def streamed_answer(clip_job: ClipJob, state: State, kind: str) -> StreamingResponse:
    """The frames of ``clip_job``, binary or PC2.

    The first chunk is computed before the head is sent, so that a refusal is still an answer of its own.
    """
    scene, frames = clip_job.plan.shown, len(clip_job.clip.poses)
    headers = plan_headers(clip_job.plan, state.runtime)
    if clip_job.asked.geometry == "jets":
        size = frames * message_bytes(scene.patch_count)
        headers |= jets_headers(frames, scene)
    else:
        size = frames * (12 * scene.vertex_count + (24 if clip_job.asked.origin == "root" else 0))
        headers |= {"X-Drape-Frames": str(frames), "X-Drape-Vertices": str(scene.vertex_count)}
        headers["X-Drape-Origin"] = clip_job.asked.origin
    head = b""
    if kind == PC2:
        head, size = pc2_head(scene.vertex_count, frames), HEAD_BYTES + 12 * frames * scene.vertex_count
    token = state.continuations.token()
    if clip_job.asked.keep:
        headers["X-Drape-Past"] = token
    pieces = _pieces(clip_job, state, token, kind)
    frames_sent = _after(head + await anext(pieces), pieces)
    return _Frames(frames_sent, kind, headers | {"Content-Length": str(size)})


async def _after(first: bytes, rest: AsyncGenerator[bytes]) -> AsyncGenerator[bytes]:
    async with contextlib.aclosing(rest):
        yield first
        async for piece in rest:
            yield piece


async def _pieces(clip_job: ClipJob, state: State, token: str, kind: str) -> AsyncGenerator[bytes]:
    """The bytes of the answer; holds a place for a clip meanwhile."""
    tail: list[bytes] = []
    first_root = None
    with state.access.using(clip_job.client, "clips"), state.slot():
        part = None
        async for part in state.runtime.parts(clip_job.plan, clip_job.clip):
            placed = None
            if clip_job.asked.geometry == "vertices":
                placed = part.placed(clip_job.asked.origin)
                first_root = part.root[0] if first_root is None else first_root
                if kind == PC2:
                    placed = placed.counted_from(first_root)
                tail += [placed.tail] if placed.tail else []
            pieces = iter(part.messages) if placed is None else number_bytes(placed.vertices)
            async for piece in state.sliced_thread.each(pieces):
                yield piece
        assert part is not None
        clip_job.remember(part.memories[0], state, token)
        for piece in tail:
            yield piece
