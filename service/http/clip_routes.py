"""Routes for draped clips and posed bodies."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sized
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from drape.avatar.wearer import rotations
from drape.errors import BodyError, InputError, MotionError, NotFound, TooLarge
from drape.export.usda import POINT_BYTES, usda_pieces
from drape.stages.batch import Batch, PoseInput, motion_arrays, shape_array
from drape.stages.placing import Placed
from drape.stages.scene import Outfit, layer_list
from drape.stages.tiers import EXACT
from drape.wire.clip_message import of_rig, unpack_clip
from drape.wire.jets import message_bytes
from service.compute.threads import BRIEF_BYTES
from service.errors import Full, NotAcceptable, TooSlow
from service.guard.limits import check_answer
from service.http import exact_clips, schemas
from service.http.answers import (
    BINARY,
    GLB,
    JSON,
    PC2,
    USDA,
    USDZ,
    VAT,
    binary_answer,
    choose,
    file_answer,
    json_answer,
)
from service.http.clip_files import (
    body_file,
    check_package,
    dress_scene,
    garment_file,
    move_garments,
    on_rig_file,
    pack_scene,
    point_cache,
)
from service.http.clip_jobs import (
    RequestedClip,
    floor_headers,
    jets_response,
    plan_headers,
    quality_headers,
    streamed_answer,
)
from service.http.job_schemas import JobInfo
from service.http.json_body import (
    check_marks,
    clip_marks,
    content_type,
    json_text,
    parse_text,
    read_document,
    validate_document,
)
from service.http.openapi import Responses, clip_schema, responses
from service.http.problems import JsonSource
from service.http.undressing import undressed_avatar
from service.state import ClientHere, State, StateHere

if TYPE_CHECKING:
    from service.guard.key_file import Client
    from service.settings import Settings

router = APIRouter()
CLIP_END = JsonSource("request body", "End the CLIP message with a JSON object.", "a clip whose last part is not JSON")
NUMBER_TEXT_BYTES = 20  # of one coordinate in JSON, with its comma
KINDS = (BINARY, GLB, JSON)
FILES = (*KINDS, PC2, USDA, USDZ, VAT)
PLACE_AND_NORMAL_BYTES = 24
CLIP_REFUSALS = (InputError, NotFound, NotAcceptable, TooSlow, TooLarge, MotionError, BodyError)
EXACT_ANSWER: Responses = {202: {"description": "The job of a clip of tier exact.", "model": JobInfo}}
Asked = TypeVar("Asked", bound=schemas.PosedOptions)
Result = TypeVar("Result")


@router.post(
    "/drape",
    response_model=schemas.VerticesDocument,
    openapi_extra=clip_schema(schemas.DrapeRequest),
    responses=responses(*CLIP_REFUSALS, Full, kinds=FILES) | EXACT_ANSWER,
)
async def drape_clip(request: Request, state: StateHere, client: ClientHere) -> Response:
    """Drapes a garment, or an outfit, on a moving body. Positions are in metres, in the world's axes.

    The Accept header chooses the format: binary float32 (frames, vertices, 3), GLB, JSON, PC2, USD (text or USDZ), or a
    vertex animation texture as a ZIP. The vertices of an outfit's garments follow each other; X-Drape-Garments says how
    many each has. With ``origin`` root positions are relative to each frame's root joint, and the positions of the root
    joints follow as float64 (frames, 3). With ``geometry`` jets the answer is binary and holds a JETS message for each
    frame (docs/reference/wire.md). With ``streamed`` frames are sent as soon as they are computed. ``keep`` and
    ``past`` split a long clip into several requests. With ``rig_poses`` in place of ``poses`` an avatar moves by its
    own rig (docs/guide/avatars.md). With ``tier`` exact the answer is 202 and a job.
    """
    state.check_slot()  # before the body is read
    asked, clip, turns, has_trans = await _clip(schemas.DrapeRequest, schemas.ClipOptions, request, state, client)
    if asked.tier == EXACT:
        job = exact_clips.exact_job_info(await exact_clips.submit_clip(asked, clip, state, client))
        where = {"Location": f"/jobs/{job.id}"}
        return Response(job.model_dump_json(), status_code=202, media_type=JSON, headers=where)
    kind = choose(request.headers.get("accept"), _offered(asked))
    check_rig(asked, kind)
    check_package(kind)
    scene = await state.requested_scene(asked, client)
    plan = state.runtime.plan(scene, asked, messages=asked.geometry == "jets")
    if asked.past is not None:
        clip = state.continuations.get(asked.past, client.name).continue_by(plan, clip, asked.fps)
    job = RequestedClip(plan, clip, asked, client, turns)
    if asked.streamed:
        return await streamed_answer(job, state, kind)
    check_clip_size(job, kind, state.runtime.settings)
    with state.access.using(client, "clips"), state.slot():
        draped = await state.runtime.drape(plan, clip)
        headers = quality_headers(draped) | plan_headers(plan, state.runtime) | job.remember(draped.memories[0], state)
        headers |= await asyncio.to_thread(floor_headers, clip, state.runtime.on(scene).body) if has_trans else {}
        if asked.geometry == "jets":
            return jets_response(draped, headers, state.sliced_thread)
        return await _clip_answer(job, draped, kind, headers, state)


@router.get(
    "/jobs/{job_id}/clip",
    response_model=schemas.VerticesDocument,
    responses=responses(NotFound, NotAcceptable, TooLarge, kinds=FILES),
)
async def exact_clip(job_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """Returns the finished clip of tier exact in any format of POST /drape. The options ``body``, ``origin`` and
    ``quantised`` are those of the request that made the job.
    """
    stored = state.exact.find(job_id, client.name)
    if stored is None:
        cure = "Send POST /drape with tier exact; its answer has the id."
        raise NotFound("job", expected="the id of a clip of tier exact", got=job_id[:120], cure=cure)
    kind = choose(request.headers.get("accept"), FILES)
    check_package(kind)
    with state.access.using(client, "clips"), state.slot():
        job, draped, headers = await exact_clips.finished_clip(stored, state, client)
        check_clip_size(job, kind, state.runtime.settings)
        return await _clip_answer(job, draped, kind, headers, state)


def _offered(asked: schemas.ClipOptions) -> tuple[str, ...]:
    """Returns the media types that the answer to a request with the options ``asked`` can have."""
    if asked.geometry == "jets":
        return (BINARY,)
    return (BINARY, PC2) if asked.streamed else FILES


async def _clip_answer(job: RequestedClip, draped: Batch, kind: str, headers: dict[str, str], state: State) -> Response:
    """Returns the response with the vertices of ``draped`` in the media type ``kind``."""
    scene, asked = job.plan.shown, job.request
    apart, placed = state.runtime.threads.apart, await _of_array(draped.vertices, draped.placed, asked.origin)
    if kind == GLB and asked.rig and asked.avatar is not None:
        wearer, left = await undressed_avatar(asked.avatar, scene, state, job.client)
        stored = (await state.avatar(asked.avatar, job.client)).path
        on_rig = partial(on_rig_file, fps=asked.fps, quantised=asked.quantised, joints=asked.joints)
        dressed_layers = await apart(dress_scene, scene, placed)
        file = await state.runtime.call_apart(on_rig, dressed_layers, wearer, stored, job.clip, job.turns, left)
        return file_answer(*file, state.sliced_thread, await _placed_headers(placed) | headers)
    if kind == GLB:
        file = await apart(garment_file, scene, placed, asked, job.clip, state.runtime.on(scene).body)
        return file_answer(*file, state.sliced_thread, await _placed_headers(placed) | headers)
    if kind == PC2:
        pieces = await apart(point_cache, placed)
        return StreamingResponse(
            state.sliced_thread.run_pieces(pieces), media_type=kind, headers=placed.headers | headers
        )
    if kind in (USDA, USDZ, VAT):
        layers, point = await apart(move_garments, scene, placed)
        headers = placed.headers | headers
        if kind == USDA:
            pieces = usda_pieces(layers, asked.fps, point=point)
            return StreamingResponse(state.sliced_thread.run_pieces(pieces), media_type=kind, headers=headers)
        return Response(await state.runtime.call_apart(pack_scene, layers, point, asked.fps, kind), 200, headers, kind)
    worn = layer_list(scene) if isinstance(scene, Outfit) else None
    return await _vertices_answer(placed, asked.fps, kind, state, headers=headers, worn=worn)


@router.post(
    "/bodies/{body_id}/posed",
    response_model=schemas.VerticesDocument,
    openapi_extra=clip_schema(schemas.PosedRequest),
    responses=responses(*CLIP_REFUSALS, kinds=KINDS),
)
async def posed_body(body_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """Returns the vertices [m] of the posed body. Poses are sent as in POST /drape; the formats are binary, GLB and
    JSON.
    """
    runtime = state.runtime
    runtime.check_body_id(body_id)
    state.check_slot()
    asked, clip, _, _ = await _clip(schemas.PosedRequest, schemas.PosedOptions, request, state, client)
    kind = choose(request.headers.get("accept"), KINDS)
    if kind == GLB:
        return file_answer(*await runtime.threads.apart(body_file, runtime.body, clip, asked), state.sliced_thread, {})
    _check_size(kind, len(clip.poses), runtime.body.vertex_count, runtime.settings)
    with state.access.using(client, "clips"), state.slot():
        if asked.origin == "world":
            placed = Placed(await runtime.pose_body(clip))
        else:
            pelvis = runtime.body.rest_joints(clip.betas)[0]
            at_root = replace(clip, trans=np.broadcast_to(-pelvis, clip.trans.shape))
            placed = Placed(await runtime.pose_body(at_root), clip.trans + pelvis)
        return await _vertices_answer(placed, asked.fps, kind, state)


@router.post(
    "/avatars/{avatar_id}/posed",
    response_model=schemas.VerticesDocument,
    openapi_extra=clip_schema(schemas.PosedRequest),
    responses=responses(*CLIP_REFUSALS, kinds=(BINARY, JSON)),
)
async def posed_avatar(avatar_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """Returns the vertices [m] of a character's own surface in every frame of the clip, posed as POST /drape poses it
    under garments. The Accept header chooses binary or JSON, in the forms that POST /drape has.
    """
    await state.avatar(avatar_id, client)
    state.check_slot()
    models = schemas.PosedRequest, schemas.PosedOptions
    asked, clip, _, _ = await _clip(*models, request, state, client, avatar=avatar_id)
    kind = choose(request.headers.get("accept"), (BINARY, JSON))
    wearer = await state.wearer(avatar_id, client)
    _check_size(kind, len(clip.poses), len(wearer.vertices), state.runtime.settings)
    with state.access.using(client, "clips"), state.slot():
        return await _vertices_answer(Placed(await state.runtime.pose_body(clip, wearer)), asked.fps, kind, state)


async def _clip(
    whole: type[schemas.PosedRequest],
    options: type[Asked],
    request: Request,
    state: State,
    client: Client,
    *,
    avatar: str | None = None,
) -> tuple[Asked, PoseInput, np.ndarray | None, bool]:
    """Reads the body of ``request``: JSON of the model ``whole``, or a CLIP message with fields of ``options``.

    Returns the fields, the checked motion, the quaternions (F, N, 4) (xyzw) of an avatar's own rig, None unless these
    were sent, and whether root translations were sent. Poses of a rig, that of ``avatar`` or of the avatar that the
    request names, become those of the 24 joints.
    """
    most, brief = state.runtime.settings.max_frames, state.sliced_thread.brief
    asked: Any
    if content_type(request) == BINARY:
        sent = await request.body()
        text, poses, trans = unpack_clip(sent)
        document = await brief(text, partial(read_document, text, source=CLIP_END))
        asked, on_rig = await brief(text, partial(validate_document, options, document, source=CLIP_END)), of_rig(poses)
    else:
        sent = await json_text(request)
        await check_marks(sent, state.sliced_thread, most_marks=clip_marks(most))
        document = await brief(sent, parse_text, sent)
        on_rig = options is schemas.ClipOptions and isinstance(document, dict) and "rig_poses" in document
        asked = await brief(sent, validate_document, schemas.RigDrapeRequest if on_rig else whole, document)
        poses, trans = asked.rig_poses if on_rig else asked.poses, asked.trans
    avatar = getattr(asked, "avatar", None) if avatar is None else avatar
    wearer = None if avatar is None else await state.wearer(avatar, client)
    turns, has_trans = None, trans is not None
    if on_rig:
        if wearer is None:
            cure = "Name the avatar whose nodes these are, or send poses of the 24 joints."
            raise InputError("avatar", expected="the avatar whose rig is posed", got="none", cure=cure)
        check_rig_frames(poses, trans, most)
        turns = await asyncio.to_thread(rotations, poses, len(wearer.nodes))
        poses, trans = await asyncio.to_thread(wearer.from_rig, turns, trans)
    body = state.runtime.body if wearer is None else wearer.body
    poses, trans = await brief(sent, partial(motion_arrays, poses, trans, max_frames=most))
    clip = PoseInput(poses, trans, shape_array(asked.betas, body), np.arange(len(poses)) / asked.fps)
    return asked, clip, turns, has_trans


def check_rig_frames(rig_poses: Sized, trans: Sized | None, most: int) -> None:
    """Refuses (``TooLarge``) more than ``most`` frames of ``rig_poses``, and (``MotionError``) a ``trans`` with another
    number of frames; None passes."""
    frames = len(rig_poses)
    if frames > most:
        cure = "Send the clip in pieces."
        raise TooLarge("rig_poses", expected=f"at most {most} frames", got=str(frames), cure=cure)
    if trans is not None and len(trans) != frames:
        cure = "Send as many as rig_poses, or none."
        raise MotionError("trans", expected=f"{frames} places, one a frame", got=str(len(trans)), cure=cure)


def check_rig(asked: schemas.ClipOptions, kind: str) -> None:
    """Refuses (``InputError``) the option ``rig`` in four cases: the media type ``kind`` is not GLB, no avatar is
    named, ``body`` is asked for too, or ``origin`` is root. Refuses ``joints`` without ``rig`` too."""
    if not asked.rig:
        if asked.joints is not None:
            raise InputError(
                "joints", expected="rig: true beside it", got="no rig", cure="Ask for rig, or leave joints out."
            )
        return
    if kind != GLB:
        raise InputError("rig", expected=f"Accept: {GLB}", got=kind, cure="Ask for a GLB, or leave rig out.")
    if asked.avatar is None:
        cure = "Name the avatar that wears it, or ask for body."
        raise InputError("rig", expected="an avatar, which has a rig of its own", got="none", cure=cure)
    if asked.body or asked.origin == "root":
        got = "body" if asked.body else "origin root"
        cure = "Leave it out: the file has only garments, to be drawn with the character's own file, in its world."
        raise InputError("rig", expected="garments alone, in the world of the rig", got=got, cure=cure)


def check_clip_size(job: RequestedClip, kind: str, settings: Settings) -> None:
    """Refuses (``TooLarge``) the clip of ``job`` if its answer in the media type ``kind`` would exceed
    ``DRAPE_MAX_ANSWER_BYTES``."""
    scene, frames = job.plan.shown, len(job.clip.poses)
    if job.request.geometry == "jets":
        patches = scene.patch_count
        check_answer(frames * message_bytes(patches), f"{frames} frames of {patches} patches", settings)
        return
    glb_bytes = 24 if not job.request.quantised else 16 if job.request.rig else 12
    _check_size(kind, frames, scene.vertex_count, settings, glb_bytes=glb_bytes)


def _check_size(kind: str, frames: int, vertices: int, settings: Settings, *, glb_bytes: int = 24) -> None:
    json_bytes = 3 * NUMBER_TEXT_BYTES
    per_vertex = {BINARY: 12, PC2: 12, GLB: glb_bytes, JSON: json_bytes, USDA: POINT_BYTES}
    per_vertex |= {USDZ: PLACE_AND_NORMAL_BYTES, VAT: PLACE_AND_NORMAL_BYTES}
    check_answer(frames * vertices * per_vertex[kind], f"{frames} frames of {vertices} vertices", settings)


async def _placed_headers(placed: Placed) -> dict[str, str]:
    """Returns the headers of ``placed``, which depend on every coordinate."""
    return await _of_array(placed.vertices, lambda: placed.headers)


async def _of_array(array: np.ndarray, function: Callable[..., Result], *arguments: object) -> Result:
    """Returns ``function(*arguments)``, which reads ``array``: called here if that is small, else on a thread."""
    return function(*arguments) if array.nbytes <= BRIEF_BYTES else await asyncio.to_thread(function, *arguments)


async def _vertices_answer(
    placed: Placed,
    fps: float,
    kind: str,
    state: State,
    *,
    headers: dict[str, str] | None = None,
    worn: list[dict[str, str | int]] | None = None,
) -> Response:
    vertices, headers = placed.vertices, await _placed_headers(placed) | (headers or {})
    if kind == BINARY:
        return binary_answer(vertices, state.sliced_thread, headers, tail=placed.tail)
    document: dict[str, Any] = {"fps": fps, "frames": len(vertices), "vertices": vertices.shape[1]}
    document["origin"] = placed.origin
    if placed.roots is not None:
        document["roots"] = placed.roots
    if worn is not None:
        document["garments"] = worn
    return json_answer(document | {"positions": vertices}, state.sliced_thread, headers)
