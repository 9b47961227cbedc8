"""Clips of tier exact: what may be asked of one, the message that asks for it on disk, and the finished clip."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.errors import InputError, Unavailable
from drape.exact.newton import TOLERANCE
from drape.stages.batch import Batch, Layer, PoseInput, shape_array
from drape.stages.tiers import EXACT
from drape.wire.clip_message import pack_clip, unpack_clip
from drape.wire.options import Advanced
from service.exact.clip_queue import ClipJob as ExactJob
from service.exact.clip_queue import Work
from service.http import schemas
from service.http.clip_jobs import RequestedClip
from service.http.job_schemas import FrameTold, JobInfo

if TYPE_CHECKING:
    from service.guard.key_file import Client
    from service.state import State

# What a clip of tier exact has none of, and what it always has.
WITHOUT = (
    *("passes", "folds", "safe_folds", "settle", "inertia", "colliders", "hidden", "pixels_per_m"),
    *("streamed", "keep", "past", "rig", "joints"),
)
ALWAYS = {"push_out": True, "cloth_contact": True, "knob": 0.0, "geometry": "vertices", "folds_by": "server"}
START = {"tier": "accurate", "knob": 0.0, "resolution": "fine"}  # the drape that a frame starts from


def check_exact(asked: schemas.ClipOptions) -> None:
    """Refuses (``InputError``) options that a clip of tier exact cannot have."""
    cure = "Leave it out, or ask for tier accurate."
    if asked.garments is not None and len(asked.garments) > 1:
        cure = "Ask for one garment, or for tier accurate."
        raise InputError("garments", expected="one with tier exact", got=str(len(asked.garments)), cure=cure)
    for name in WITHOUT:
        if got := _value(asked, name):
            raise InputError(name, expected="none with tier exact", got=f"{got!r:.40}", cure=cure)
    for name, value in ALWAYS.items():
        got, known = _value(asked, name), "motion" if name == "knob" else name
        if got not in (None, value):
            raise InputError(known, expected=f"{value} with tier exact", got=str(got), cure=cure)


def _value(asked: schemas.ClipOptions, name: str) -> Any:
    return getattr(asked.advanced if name in Advanced.model_fields else asked, name)


async def submit_clip(asked: schemas.ClipOptions, clip: PoseInput, state: State, client: Client) -> ExactJob:
    """Checks the ``clip`` that is ``asked`` for, stores the request, and returns its job."""
    check_exact(asked)
    scene = await state.requested_scene(asked, client)
    state.runtime.plan(scene, asked.model_copy(update=START))  # refused now rather than in the job
    (entry,) = scene.layers
    state.exact.check_place(len(clip.poses), entry.fine.vertex_count)
    left_out = {"poses", "trans", "rig_poses"}
    about = asked.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=left_out)
    message = await asyncio.to_thread(pack_clip, about, clip.poses, clip.trans)
    return await asyncio.shield(state.exact.submit(entry.id, client.name, message, len(clip.poses)))


async def _read(message: bytes, state: State, client: Client) -> RequestedClip:
    """What ``message`` asks for; refuses (``NotFound``) a garment or an avatar that is gone."""
    text, poses, trans = unpack_clip(message)
    asked = schemas.ClipOptions.model_validate_json(text)
    scene = await state.requested_scene(asked, client)
    betas = shape_array(asked.betas, state.runtime.on(scene).body)
    assert trans is not None
    clip = PoseInput(poses, trans, betas, np.arange(len(poses)) / asked.fps)
    update = START | {"resolution": asked.resolution}
    return RequestedClip(state.runtime.plan(scene, asked.model_copy(update=update)), clip, asked, client)


def work_reader(state: State) -> Callable[[bytes, str | None], Awaitable[Work]]:
    """Returns a function that takes a stored request and the key that sent it, and returns the ``Work`` that it asks
    for."""

    async def opened(message: bytes, owner: str | None) -> Work:
        job = await _read(message, state, state.access.client(owner))
        scene, asked = job.plan.scene, job.asked.model_copy(update=START)
        return Work(state.runtime.plan(scene, asked), job.clip)

    return opened


async def finished_clip(job: ExactJob, state: State, client: Client) -> tuple[RequestedClip, Batch, dict[str, str]]:
    """Returns the request of ``job``, its finished frames, and the headers of the answer. Refuses (``Unavailable``) a
    clip that is not done."""
    if job.state != "done":
        cure = f"Ask GET /jobs/{job.accepted.id} until it is done."
        raise Unavailable("clip", expected="one that is done", got=job.state, cure=cure)
    asked_for = await _read(await asyncio.to_thread(state.exact.message, job), state, client)
    clip, plan = asked_for.clip, asked_for.plan
    vertices = await asyncio.to_thread(partial(state.exact.vertices, job, plan))
    root = clip.trans + state.runtime.on(plan.scene).body.rest_joints(clip.betas)[0]
    batch = replace(Batch.of(plan, [clip]), layers=(Layer(vertices),), root=root)
    headers = {
        "X-Drape-Model": state.runtime.engine.manifest.digest[:16],
        "X-Drape-Tier": EXACT,
        "X-Drape-Force-Left": f"{max(frame['force_share'] for frame in job.figures.values()):.5f}",
        "X-Drape-Crossings": str(max(frame["crossings"] for frame in job.figures.values())),
    }
    return asked_for, batch, headers


def exact_job_info(job: ExactJob) -> JobInfo:
    """The answer about ``job``."""
    accepted = job.accepted
    told = [FrameTold(frame=number, **figures) for number, figures in sorted(job.figures.items())]
    about = {"stage": job.stage, "share": round(job.share, 4), "problem": job.problem, "frames": accepted.frames}
    notes = [] if job.state != "done" else [_unsolved(frame) for frame in told if _is_unsolved(frame)]
    return JobInfo(id=accepted.id, name=accepted.name, state=job.state, told=told, notes=notes, **about)


def _is_unsolved(frame: FrameTold) -> bool:
    return frame.crossings > 0 or frame.force_share > TOLERANCE


def _unsolved(frame: FrameTold) -> str:
    """The sentence about a frame that is not at rest, or passes through itself."""
    return (
        f"Frame {frame.frame} is not solved: {frame.crossings} pairs of triangles cross, the cloth lies"
        f" {1e3 * frame.depth_m:.1f} mm deep in the skin, and {100 * frame.force_share:.1f} % of its weight are left."
    )
