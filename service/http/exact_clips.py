"""Requests for clips of tier exact: which options they may have, how they are stored, and the finished clip."""

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

# The options that a clip of tier exact cannot have, and those that always have these values.
WITHOUT = (
    *("passes", "folds", "safe_folds", "settle", "inertia", "colliders", "hidden", "pixels_per_m"),
    *("streamed", "keep", "past", "rig", "joints"),
)
ALWAYS = {"push_out": True, "cloth_contact": True, "coarse": False, "knob": 0.0}
ALWAYS |= {"geometry": "vertices", "folds_by": "server"}
START = {"tier": "accurate", "knob": 0.0, "resolution": "fine"}  # the drape that a frame starts from


def check_exact(request: schemas.ClipOptions) -> None:
    """Refuses (``InputError``) options of ``request`` that a clip of tier exact cannot have."""
    _check_single(len(request.garments or ()))
    cure = "Leave it out, or ask for tier accurate."
    for name in WITHOUT:
        value = _value(request, name)
        if value not in (None, ()) and value is not False:  # 0 passes or folds are a choice
            raise InputError(name, expected="none with tier exact", got=f"{value!r:.40}", cure=cure)
    for name, fixed in ALWAYS.items():
        value, label = _value(request, name), "motion" if name == "knob" else name
        if value not in (None, fixed):
            raise InputError(label, expected=f"{fixed} with tier exact", got=str(value), cure=cure)


def _check_single(garments: int) -> None:
    if garments > 1:
        cure = "Ask for one garment, or for tier accurate."
        raise InputError("garments", expected="one garment with tier exact", got=f"{garments} garments", cure=cure)


def _value(request: schemas.ClipOptions, name: str) -> Any:
    return getattr(request.advanced if name in Advanced.model_fields else request, name)


async def submit_clip(request: schemas.ClipOptions, clip: PoseInput, state: State, client: Client) -> ExactJob:
    """Checks ``request``, stores it with the motion of ``clip``, queues it and returns its job. Refuses several
    garments (``InputError``), among which an avatar's own clothes count, and what ``check_exact``, ``Runtime.plan`` and
    ``ExactClips.check_place`` refuse."""
    check_exact(request)
    scene = await state.requested_scene(request, client)
    _check_single(len(scene.layers))
    state.runtime.plan(scene, request.model_copy(update=START))  # refuses options now rather than in the job
    (entry,) = scene.layers
    state.exact.check_place(len(clip.poses), entry.fine.vertex_count)
    left_out = {"poses", "trans", "rig_poses"}
    about = request.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=left_out)
    message = await asyncio.to_thread(pack_clip, about, clip.poses, clip.trans)
    return await asyncio.shield(state.exact.submit(entry.id, client.name, message, len(clip.poses)))


async def _read(message: bytes, state: State, client: Client) -> RequestedClip:
    """Returns the clip that the CLIP message of a stored request asks for. Refuses (``NotFound``) a garment or an
    avatar that was deleted since."""
    text, poses, trans = unpack_clip(message)
    request = schemas.ClipOptions.model_validate_json(text)
    scene = await state.requested_scene(request, client)
    betas = shape_array(request.betas, state.runtime.on(scene).body)
    assert trans is not None
    clip = PoseInput(poses, trans, betas, np.arange(len(poses)) / request.fps)
    update = START | {"resolution": request.resolution}
    return RequestedClip(state.runtime.plan(scene, request.model_copy(update=update)), clip, request, client)


def work_reader(state: State) -> Callable[[bytes, str | None], Awaitable[Work]]:
    """Returns the function for ``ExactClips.start``: it takes the CLIP message of a stored request and the key that
    sent it, and returns the ``Work`` that this asks for."""

    async def read_work(message: bytes, owner: str | None) -> Work:
        job = await _read(message, state, state.access.client(owner))
        return Work(state.runtime.plan(job.plan.scene, job.request.model_copy(update=START)), job.clip)

    return read_work


async def finished_clip(job: ExactJob, state: State, client: Client) -> tuple[RequestedClip, Batch, dict[str, str]]:
    """Returns the request of ``job``, a batch with its finished frames, and headers of the answer: X-Drape-Model,
    X-Drape-Tier, and the largest force left and number of crossings of any frame (X-Drape-Force-Left,
    X-Drape-Crossings). Refuses (``Unavailable``) a clip that is not done."""
    if job.state != "done":
        cure = f"Ask GET /jobs/{job.accepted.id} until it is done."
        raise Unavailable("clip", expected="one that is done", got=job.state, cure=cure)
    requested = await _read(await asyncio.to_thread(state.exact.message, job), state, client)
    clip, plan = requested.clip, requested.plan
    vertices = await asyncio.to_thread(partial(state.exact.vertices, job, plan))
    root = clip.trans + state.runtime.on(plan.scene).body.rest_joints(clip.betas)[0]
    batch = replace(Batch.of(plan, [clip]), layers=(Layer(vertices),), root=root)
    headers = {
        "X-Drape-Model": state.runtime.engine.manifest.digest[:16],
        "X-Drape-Tier": EXACT,
        "X-Drape-Force-Left": f"{max(frame['force_share'] for frame in job.figures.values()):.5f}",
        "X-Drape-Crossings": str(max(frame["crossings"] for frame in job.figures.values())),
    }
    return requested, batch, headers


def exact_job_info(job: ExactJob) -> JobInfo:
    """Returns the answer to GET /jobs/ID about ``job``."""
    accepted = job.accepted
    frames = [FrameTold(frame=number, **figures) for number, figures in sorted(job.figures.items())]
    about = {"stage": job.stage, "share": round(job.share, 4), "problem": job.problem, "frames": accepted.frames}
    notes = [] if job.state != "done" else [_unsolved(frame) for frame in frames if _is_unsolved(frame)]
    return JobInfo(id=accepted.id, name=accepted.name, state=job.state, told=frames, notes=notes, **about)


def _is_unsolved(frame: FrameTold) -> bool:
    return frame.crossings > 0 or frame.force_share > TOLERANCE


def _unsolved(frame: FrameTold) -> str:
    """Returns the sentence about a frame that is not at rest, or whose cloth passes through itself."""
    return (
        f"Frame {frame.frame} is not solved: {frame.crossings} pairs of triangles cross, the cloth lies"
        f" {1e3 * frame.depth_m:.1f} mm deep in the skin, and {100 * frame.force_share:.1f} % of its weight is left as"
        " force."
    )
