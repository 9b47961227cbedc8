"""Answers with a draped clip: their headers, and answers whose frames are sent as soon as they are computed.

Such a streamed answer keeps one chunk of the clip in memory. The next is computed when the last has been sent."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from fastapi import Response
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from drape.export.pc2 import HEAD_BYTES, pc2_head
from drape.motion.grounding import floor_note
from drape.stages.batch import Batch, Memories, PoseInput
from drape.stages.plan import Plan
from drape.stages.scene import Outfit, Scene, layer_list
from drape.wire.jets import message_bytes
from service.http.answers import PC2, messages_answer, number_bytes
from service.http.continuations import Continuation

if TYPE_CHECKING:
    from drape.body.model import BodyModel
    from service.compute.drape_runtime import DrapeRuntime
    from service.compute.threads import SlicedThread
    from service.guard.key_file import Client
    from service.http.schemas import ClipOptions
    from service.state import State


@dataclass(frozen=True, eq=False)
class RequestedClip:
    """A clip that ``client`` asks for: its ``request``, and the ``plan`` and the motion (``clip``) made of that.
    ``turns`` (F, N, 4) are the quaternions (xyzw) of the N nodes of an avatar's own rig, None unless these were
    sent."""

    plan: Plan
    clip: PoseInput
    request: ClipOptions
    client: Client
    turns: np.ndarray | None = None

    def remember(self, memories: Memories, state: State, token: str | None = None) -> dict[str, str]:
        """Keeps ``memories``, those after the clip's last frame, under ``token``, a new one by default. Returns the
        header X-Drape-Past with the token. Does nothing and returns no header unless the request says ``keep``."""
        if not self.request.keep:
            return {}
        token = token or state.continuations.token()
        frames = self.clip.sequence + len(self.clip.poses)
        past = Continuation(self.plan, self.clip.betas, self.request.fps, frames, memories)
        state.continuations.put(token, past, self.client.name)
        return {"X-Drape-Past": token}


def plan_headers(plan: Plan, runtime: DrapeRuntime) -> dict[str, str]:
    """Returns the headers that are known before a frame is computed: X-Drape-Model (16 digits of its digest),
    X-Drape-Push-Out (0 or 1), X-Drape-Tier, X-Drape-Passes, X-Drape-Folds and X-Drape-Safe-Folds (numbers of steps),
    X-Drape-Motion (the knob); of an outfit also X-Drape-Garments (ID:VERTICES of each, with commas between)."""
    options, numbers, scene = plan.options, plan.options.advanced, plan.shown
    headers = {
        "X-Drape-Model": runtime.engine.manifest.digest[:16],
        "X-Drape-Push-Out": str(int(bool(numbers.push_out))),
        "X-Drape-Tier": runtime.tier_of(plan),
        "X-Drape-Passes": str(runtime.engine.pass_count if numbers.passes is None else numbers.passes),
        "X-Drape-Folds": str(numbers.folds),
        "X-Drape-Safe-Folds": str(numbers.safe_folds or 0),
        "X-Drape-Motion": f"{options.knob:g}",
    }
    if isinstance(scene, Outfit):
        headers["X-Drape-Garments"] = ",".join(f"{layer['id']}:{layer['vertices']}" for layer in layer_list(scene))
    return headers


def quality_headers(draped: Batch) -> dict[str, str]:
    """Returns the headers with what was measured over all frames of ``draped``: X-Drape-Pushed-Share (the mean share
    of vertices that the push-out moved), X-Drape-Push-Max-M (the farthest that it moved one [m]), X-Drape-Novelty (the
    largest), X-Drape-Unlike (the number of frames with a novelty above 1), X-Drape-Folds-Resets (how often the folds of
    a layer began anew)."""
    return {
        "X-Drape-Pushed-Share": f"{draped.quality.pushed_share.mean():.6f}",
        "X-Drape-Push-Max-M": f"{draped.quality.push_max_m.max():.6f}",
        "X-Drape-Novelty": f"{draped.quality.novelty.max():.3f}",
        "X-Drape-Unlike": str(int((draped.quality.novelty > 1.0).sum())),
        "X-Drape-Folds-Resets": str(int(draped.quality.folds_resets.sum())),
    }


def floor_headers(clip: PoseInput, body: BodyModel) -> dict[str, str]:
    """Returns the header X-Drape-Note with a sentence if the feet of ``body`` are not on the floor in ``clip``;
    otherwise no header."""
    note = floor_note(clip.poses, clip.trans, body.rest_joints(clip.betas), floor=body.floor_m(clip.betas))
    return {"X-Drape-Note": note} if note else {}


def jets_headers(frames: int, scene: Scene) -> dict[str, str]:
    """Returns the headers of an answer with ``frames`` JETS messages: X-Drape-Frames, X-Drape-Patches (the number of
    patches), X-Drape-Origin ("root"); of an outfit also X-Drape-Garments (ID:PATCHES of each, with commas
    between)."""
    headers = {"X-Drape-Frames": str(frames), "X-Drape-Patches": str(scene.patch_count), "X-Drape-Origin": "root"}
    if isinstance(scene, Outfit):
        worn = layer_list(scene, patches=True)
        headers["X-Drape-Garments"] = ",".join(f"{layer['id']}:{layer['patches']}" for layer in worn)
    return headers


def jets_response(draped: Batch, headers: dict[str, str], sliced_thread: SlicedThread) -> Response:
    """Returns the response with one JETS message for each frame of ``draped``. Its sequence is the number of the frame,
    its client time the time of the frame in the clip [s]."""
    scene = draped.plan.shown
    headers = headers | jets_headers(len(draped.messages), scene)
    headers["X-Drape-Left-M"] = f"{draped.quality.left_m.max():.6f}"
    return messages_answer(draped.messages, sliced_thread, headers)


class _Frames(StreamingResponse):
    """A streamed response that closes ``frames`` when it ends, also where the client goes away, so that the clip no
    longer counts as in progress."""

    def __init__(self, frames: AsyncGenerator[bytes], kind: str, headers: dict[str, str]) -> None:
        super().__init__(frames, media_type=kind, headers=headers)
        self._frames = frames

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with contextlib.aclosing(self._frames):
            await super().__call__(scope, receive, send)


async def streamed_answer(job: RequestedClip, state: State, kind: str) -> StreamingResponse:
    """Returns the response that sends the frames of ``job`` as they are computed, in the media type ``kind``: binary or
    PC2.

    The first chunk is computed before this returns, so that a refusal can still be answered with its own status.
    """
    size, headers = _streamed_size(job), plan_headers(job.plan, state.runtime) | _streamed_headers(job)
    head = b""
    if kind == PC2:
        frames, vertices = len(job.clip.poses), job.plan.shown.vertex_count
        head, size = pc2_head(vertices, frames), HEAD_BYTES + 12 * frames * vertices
    token = state.continuations.token()
    if job.request.keep:
        headers["X-Drape-Past"] = token
    pieces = _pieces(job, state, token, kind)
    frames_sent = _after(head + await anext(pieces), pieces)
    return _Frames(frames_sent, kind, headers | {"Content-Length": str(size)})


def _streamed_size(job: RequestedClip) -> int:
    """Returns the bytes of a binary answer with all frames of ``job``."""
    scene, frames = job.plan.shown, len(job.clip.poses)
    if job.request.geometry == "jets":
        return frames * message_bytes(scene.patch_count)
    return frames * (12 * scene.vertex_count + (24 if job.request.origin == "root" else 0))


def _streamed_headers(job: RequestedClip) -> dict[str, str]:
    """Returns the headers about the frames of a streamed answer."""
    scene, frames = job.plan.shown, len(job.clip.poses)
    if job.request.geometry == "jets":
        return jets_headers(frames, scene)
    headers = {"X-Drape-Frames": str(frames), "X-Drape-Vertices": str(scene.vertex_count)}
    return headers | {"X-Drape-Origin": job.request.origin}


async def _after(first: bytes, rest: AsyncGenerator[bytes]) -> AsyncGenerator[bytes]:
    async with contextlib.aclosing(rest):
        yield first
        async for piece in rest:
            yield piece


async def _pieces(job: RequestedClip, state: State, token: str, kind: str) -> AsyncGenerator[bytes]:
    """Yields the bytes of the answer. The clip counts as in progress meanwhile."""
    tail: list[bytes] = []
    first_root = None
    with state.access.using(job.client, "clips"), state.slot():
        done = 0
        async for part in state.runtime.parts(job.plan, job.clip):
            done += len(part.inputs[0].poses)
            if done == len(job.clip.poses):  # before the last bytes, as the client may ask for more once it has them
                job.remember(part.memories[0], state, token)
            placed = None
            if job.request.geometry == "vertices":
                placed = part.placed(job.request.origin)
                first_root = part.root[0] if first_root is None else first_root
                if kind == PC2:
                    placed = placed.counted_from(first_root)
                tail += [placed.tail] if placed.tail else []
            pieces = iter(part.messages) if placed is None else number_bytes(placed.vertices)
            async for piece in state.sliced_thread.run_pieces(pieces):
                yield piece
        for piece in tail:
            yield piece
