"""REST: health, garments, uploads, draped clips, bodies and sample clips."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, TypeVar

import numpy as np
from fastapi import APIRouter, Query, Request, Response

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import FABRICS
from drape.errors import BodyError, InputError, MotionError, NotFound
from drape.export import glb
from drape.export.glb_body import add_body
from drape.export.glb_file import GlbFile
from drape.export.root_motion import RootMotion
from drape.export.usda import POINT_BYTES
from drape.files.formats import MESH_CONTENT_TYPES, MESH_NAMES, listed
from drape.garment.cache import Garment
from drape.wire.clips import unpack_clip
from drape.wire.options import Resolution
from service.compute.drape_runtime import DrapeRuntime
from service.compute.garments import Outfit, Scene, layer_list
from service.compute.motions import floor_m
from service.compute.sliced_thread import BRIEF_BYTES
from service.errors import Full, NotAcceptable, TooLarge, TooSlow
from service.guard.access import ClientHere
from service.guard.limits import check_answer
from service.http import negotiation, schemas
from service.http.answers import binary_answer, file_answer, json_answer
from service.http.exports import export_answer
from service.http.jets import check_jets_size, jets_response
from service.http.json_body import (
    check_marks,
    clip_marks,
    content_type,
    document_of,
    json_text,
    parsed,
    validated,
)
from service.http.openapi import BYTES, body_schema, clip_schema, responses
from service.http.poses import motion_arrays, shape_array
from service.http.streamed import ClipJob, plan_headers, quality_headers, streamed_answer
from service.http.validation import check_query
from service.stages.batch import PoseInput
from service.stages.placing import Placed
from service.state import State, StateHere
from service.uploads.avatars import MOST_CHARACTERS, upload_avatar
from service.uploads.jobs import Job
from service.uploads.upload_body import read_upload
from service.version import product_version

router = APIRouter()
NUMBER_TEXT_BYTES = 20  # of one coordinate in JSON
KINDS = (negotiation.BINARY, negotiation.GLB, negotiation.JSON)
CLIP_REFUSALS = (InputError, NotFound, NotAcceptable, TooSlow, TooLarge, MotionError, BodyError)
Asked = TypeVar("Asked", bound=schemas.PosedOptions)
Result = TypeVar("Result")
Betas = Annotated[str | None, Query(max_length=1000, description="Shape coefficients, comma-separated.")]


@router.get("/health")
async def health(state: StateHere) -> schemas.Health:
    """Whether the service works, and with what."""
    runtime = state.runtime
    return schemas.Health(
        status="ok",
        version=product_version(),
        model=runtime.engine.manifest.name,
        model_digest=runtime.engine.manifest.digest,
        dynamic=runtime.engine.dynamic,
        provider=runtime.engine.provider,
        int8=runtime.engine.int8,
        half=runtime.engine.half,
        elsewhere=runtime.engine.nodes_off_provider,
        device_bytes=runtime.device_bytes,
        buckets=runtime.engine.buckets,
        body=runtime.body.name,
        garments=len(runtime.garments.entries()),
        passes=runtime.engine.pass_count,
        fabrics=runtime.engine.knows_fabrics,
        layers=runtime.settings.max_layers,
        max_frames=runtime.settings.max_frames,
        max_body_bytes=runtime.settings.max_body_bytes,
        sessions=state.streams.count,
        refused_garments=runtime.garments.refused,
    )


# --- garments ---


@router.get("/garments")
async def garments(state: StateHere, client: ClientHere) -> list[schemas.GarmentInfo]:
    """The garments that can be draped."""
    return [schemas.GarmentInfo.of(entry) for entry in state.runtime.garments.visible(client.name)]


@router.get("/garments/{garment_id}", responses=responses(NotFound))
async def garment(garment_id: str, state: StateHere, client: ClientHere) -> schemas.GarmentInfo:
    """One garment."""
    return schemas.GarmentInfo.of(await state.garment(garment_id, client))


@router.get(
    "/garments/{garment_id}/mesh",
    response_model=schemas.MeshDocument,
    responses=responses(InputError, NotFound, NotAcceptable, kinds=(negotiation.GLB,)),
)
async def garment_mesh(
    garment_id: str, request: Request, state: StateHere, client: ClientHere, resolution: Resolution = "delivered"
) -> Response:
    """The delivered mesh at rest on the standard body, or the finer one that intake made: JSON, or GLB by Accept."""
    entry = await state.garment(garment_id, client)
    entry = entry.fine if resolution == "fine" else entry
    garment = entry.garment
    kind = negotiation.choose(request.headers.get("accept"), (negotiation.JSON, negotiation.GLB))
    if kind == negotiation.GLB:
        return file_answer(*await asyncio.to_thread(_rest_file, garment), state.sliced_thread, {})
    document = {
        "id": entry.id,
        "vertices": garment.vertices[: garment.vertex_count].astype(np.float32),
        "faces": garment.faces,
        "uv": garment.uv.astype(np.float32),
        "uv_faces": garment.uv_faces,
        "materials": garment.material_names,
        "face_material": garment.face_material,
    }
    return json_answer(document, state.sliced_thread)


def _rest_file(garment: Garment) -> tuple[GlbFile, bytes]:
    """The file, and what it begins with."""
    file = GlbFile()
    glb.add_garment(file, garment, garment.vertices[None, : garment.vertex_count], fps=1.0)
    return file, file.head()


# --- uploads ---


@router.post(
    "/garments",
    status_code=202,
    openapi_extra=body_schema(schemas.UploadRequest, **dict.fromkeys((negotiation.BINARY, *MESH_CONTENT_TYPES), BYTES)),
    responses=responses(InputError, NotFound, TooSlow, TooLarge, BodyError, Full),
)
async def upload(
    request: Request,
    response: Response,
    state: StateHere,
    client: ClientHere,
    name: Annotated[str | None, Query(max_length=120, description="File name or name of the garment.")] = None,
    avatar: Annotated[
        str | None, Query(max_length=MOST_CHARACTERS, description="Phenotype or SMPL parameters as JSON, or a name.")
    ] = None,
    format: Annotated[
        str | None, Query(max_length=10, description=f"{listed().lower()}, where the name does not say it.")
    ] = None,
) -> schemas.JobInfo:
    """Takes a garment file in: the raw bytes as body, or JSON (name, format, data_base64, avatar). Poll the job."""
    check_query(request.query_params, ("name", "avatar", "format"))
    modelled_on: str | dict[str, Any] | None = avatar
    kind, pieces = content_type(request), request.stream()
    state.uploads.check_place(client)  # before anything is read
    if kind == negotiation.JSON:
        sent, decoded = await state.sliced_thread.run(read_upload, await request.body())
        name, format, modelled_on = sent.name, sent.format, sent.avatar
        pieces = state.sliced_thread.each(decoded)
    stem, file_format = _name_and_format(name, format, kind)
    known = upload_avatar(modelled_on, stem, state.runtime.settings.garments_dir)
    job = await state.uploads.submit(stem, file_format, pieces, known, client)
    response.headers["Location"] = f"/jobs/{job.id}"
    return _job_info(job)


@router.get("/jobs/{job_id}", responses=responses(NotFound))
async def job(job_id: str, state: StateHere, client: ClientHere) -> schemas.JobInfo:
    """How far an upload is."""
    return _job_info(state.uploads.get(job_id, client.name))


@router.delete("/jobs/{job_id}", status_code=204, responses=responses(NotFound))
async def cancel_job(job_id: str, state: StateHere, client: ClientHere) -> None:
    """Ends an upload and removes its files; one that has ended is forgotten, and its garment stays."""
    await asyncio.shield(state.uploads.cancel(state.uploads.get(job_id, client.name)))


def _name_and_format(name: str | None, file_format: str | None, content_type: str) -> tuple[str, str]:
    stem, dot, suffix = (name or "").rpartition(".")
    if not dot or suffix.lower() not in MESH_NAMES:
        stem, suffix = name or "", ""
    chosen = (file_format or suffix or MESH_CONTENT_TYPES.get(content_type, "")).lower()
    if chosen not in MESH_NAMES:
        raise InputError(
            "format",
            expected=f"one of {', '.join(MESH_NAMES)}",
            got=chosen or (f"the name {name}" if name else "nothing"),
            cure="Give ?name=shirt.obj, or ?format=obj.",
        )
    if not stem:
        raise InputError("name", expected="the garment's name", got="nothing", cure="Give ?name=shirt.obj.")
    return stem, chosen


def _job_info(job: Job) -> schemas.JobInfo:
    told = {"stage": job.stage, "share": round(job.share, 2), "garment": job.garment, "problem": job.problem}
    return schemas.JobInfo(id=job.id, name=job.name, state=job.state, **told)


# --- draped clips and posed bodies ---


@router.post(
    "/drape",
    response_model=schemas.VerticesDocument,
    openapi_extra=clip_schema(schemas.DrapeRequest),
    responses=responses(*CLIP_REFUSALS, kinds=(*KINDS, negotiation.PC2, negotiation.USDA)),
)
async def drape_clip(request: Request, state: StateHere, client: ClientHere) -> Response:
    """The garment on the moving body, world axes [m]: binary float32 (frames, vertices, 3), GLB, JSON, PC2 or USD by
    Accept.

    With origin "root" positions count from each frame's root, and the roots follow them, float64 (frames, 3). The
    vertices of an outfit's garments follow each other; X-Drape-Garments says how many each has. With geometry "jets"
    the answer holds a JETS message per frame (docs/reference/wire.md), binary only. With streamed frames leave as they
    are ready; with keep and past a clip comes in pieces that are the whole clip.
    """
    runtime = state.runtime
    state.check_slot()  # before anything is read
    asked, clip = await _clip(schemas.DrapeRequest, schemas.ClipOptions, request, state)
    jets = asked.geometry == "jets"
    binary_only = jets or asked.streamed
    offered = (negotiation.BINARY,) if binary_only else (*KINDS, negotiation.PC2, negotiation.USDA)
    offered = (*offered, negotiation.PC2) if asked.streamed and not jets else offered
    kind = negotiation.choose(request.headers.get("accept"), offered)
    scene = await state.scene(asked.garment, asked.garments, client)
    plan = await runtime.plan_within(scene, asked, messages=jets)
    scene = plan.shown
    if asked.past is not None:
        clip = state.continuations.get(asked.past, client.name).followed_by(plan, clip, asked.fps)
    clip_job = ClipJob(plan, clip, asked, client)
    if asked.streamed:
        return await streamed_answer(clip_job, state, kind)
    if jets:
        check_jets_size(len(clip.poses), scene, runtime)
    else:
        _check_size(kind, len(clip.poses), scene.vertex_count, runtime, quantised=asked.quantised)
    with state.access.using(client, "clips"), state.slot():
        draped = await runtime.drape(plan, clip)
        headers = quality_headers(draped) | plan_headers(plan, runtime) | clip_job.remember(draped.memories[0], state)
        if jets:
            return jets_response(draped, headers, state.sliced_thread)
        worn = layer_list(scene) if isinstance(scene, Outfit) else None
        placed = await _of_array(draped.vertices, draped.placed, asked.origin)
        if kind == negotiation.GLB:
            file = await asyncio.to_thread(_garment_file, scene, placed, asked, clip, runtime)
            return file_answer(*file, state.sliced_thread, await _said(placed) | headers)
        if kind in (negotiation.PC2, negotiation.USDA):
            made = kind, scene, placed, asked.fps, state.sliced_thread, headers
            return await asyncio.to_thread(export_answer, *made)
        return await _vertices_answer(placed, asked.fps, kind, state, headers=headers, worn=worn)


@router.post(
    "/bodies/{body_id}/posed",
    response_model=schemas.VerticesDocument,
    openapi_extra=clip_schema(schemas.PosedRequest),
    responses=responses(*CLIP_REFUSALS, kinds=KINDS),
)
async def posed_body(body_id: str, request: Request, state: StateHere, client: ClientHere) -> Response:
    """The posed body's vertices for the same input, in the same formats."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    state.check_slot()
    asked, clip = await _clip(schemas.PosedRequest, schemas.PosedOptions, request, state)
    kind = _kind(request)
    if kind == negotiation.GLB:
        return file_answer(*await asyncio.to_thread(_body_file, runtime.body, clip, asked), state.sliced_thread, {})
    _check_size(kind, len(clip.poses), runtime.body.vertex_count, runtime)
    with state.access.using(client, "clips"), state.slot():
        if asked.origin == "world":
            placed = Placed(await runtime.pose_body(clip))
        else:
            pelvis = runtime.body.rest_joints(clip.betas)[0]
            at_root = replace(clip, trans=np.broadcast_to(-pelvis, clip.trans.shape))
            placed = Placed(await runtime.pose_body(at_root), clip.trans + pelvis)
        return await _vertices_answer(placed, asked.fps, kind, state)


def _kind(request: Request) -> str:
    return negotiation.choose(request.headers.get("accept"), KINDS)


async def _clip(
    whole: type[schemas.PosedRequest], options: type[Asked], request: Request, state: State
) -> tuple[Asked, PoseInput]:
    """The body of ``request``, JSON as a ``whole`` or a CLIP message, and its checked motion."""
    body, most, brief = state.runtime.body, state.runtime.settings.max_frames, state.sliced_thread.brief
    if content_type(request) == negotiation.BINARY:
        sent = await request.body()
        text, poses, trans = unpack_clip(sent)
        document = await brief(text, partial(document_of, text, otherwise="a clip whose last part is not JSON"))
        asked = await brief(text, validated, options, document)
    else:
        sent = await json_text(request)
        await check_marks(sent, state.sliced_thread, most_marks=clip_marks(most))
        read = await brief(sent, validated, whole, await brief(sent, parsed, sent))
        poses, trans = read.poses, read.trans
        assert isinstance(read, options)
        asked = read
    poses, trans = await brief(sent, partial(motion_arrays, poses, trans, max_frames=most))
    return asked, PoseInput(poses, trans, shape_array(asked.betas, body), np.arange(len(poses)) / asked.fps)


def _check_size(kind: str, frames: int, vertices: int, runtime: DrapeRuntime, *, quantised: bool = False) -> None:
    per_vertex = {
        negotiation.BINARY: 12,
        negotiation.PC2: 12,
        negotiation.GLB: 12 if quantised else 24,
        negotiation.JSON: 3 * NUMBER_TEXT_BYTES,
        negotiation.USDA: POINT_BYTES,
    }
    check_answer(frames * vertices * per_vertex[kind], f"{frames} frames of {vertices} vertices", runtime.settings)


def _garment_file(
    scene: Scene, placed: Placed, asked: schemas.ClipOptions, clip: PoseInput, runtime: DrapeRuntime
) -> tuple[GlbFile, bytes]:
    """The file, and what it begins with."""
    file, start = GlbFile(), 0
    vertices, point = placed.from_first()
    root_motion = None
    if asked.quantised:
        root_motion = RootMotion(clip.poses[:, 0], clip.trans + runtime.body.rest_joints(clip.betas)[0] - point)
    for layer, worn in enumerate(scene.layers):
        colour = glb.GARMENT_COLOURS[layer % len(glb.GARMENT_COLOURS)]
        own = vertices[:, start : start + worn.vertex_count]
        glb.add_garment(file, worn.garment, own, asked.fps, colour, root_motion=root_motion)
        start += worn.vertex_count
    if asked.body:
        add_body(file, runtime.body, clip.betas, clip.poses, clip.trans - point, asked.fps)
    if asked.origin == "root":
        file.place("root", point)
    return file, file.head()


def _body_file(body: BodyModel, clip: PoseInput, asked: schemas.PosedOptions) -> tuple[GlbFile, bytes]:
    """The file, and what it begins with."""
    file = GlbFile()
    point = clip.trans[0] + body.rest_joints(clip.betas)[0] if asked.origin == "root" else np.zeros(3)
    add_body(file, body, clip.betas, clip.poses, clip.trans - point, asked.fps)
    if asked.origin == "root":
        file.place("root", point)
    return file, file.head()


async def _said(placed: Placed) -> dict[str, str]:
    """The headers of ``placed``, for which every coordinate is looked at."""
    return await _of_array(placed.vertices, lambda: placed.headers)


async def _of_array(array: np.ndarray, function: Callable[..., Result], *arguments: object) -> Result:
    """``function(*arguments)``, which reads ``array``: at once where that is small, else on a thread."""
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
    vertices, headers = placed.vertices, await _said(placed) | (headers or {})
    if kind == negotiation.BINARY:
        return binary_answer(vertices, state.sliced_thread, headers, tail=placed.tail)
    document: dict[str, Any] = {"fps": fps, "frames": len(vertices), "vertices": vertices.shape[1]}
    document["origin"] = placed.origin
    if placed.roots is not None:
        document["roots"] = placed.roots
    if worn is not None:
        document["garments"] = worn
    return json_answer(document | {"positions": vertices}, state.sliced_thread, headers)


# --- fabrics, bodies and clips ---


@router.get("/fabrics")
async def fabrics() -> list[schemas.FabricInfo]:
    """The fabrics that a request may name; those of ``drape.cloth.fabric_table``."""
    return [schemas.FabricInfo.model_validate({"id": name, **_public(cloth)}) for name, cloth in FABRICS.items()]


def _public(cloth: Fabric) -> dict[str, Any]:
    return {name: getattr(cloth, name) for name in schemas.FabricInfo.model_fields if name != "id"}


@router.get("/tiers")
async def tiers(state: StateHere) -> list[schemas.TierInfo]:
    """The tiers that a request may name, the least first, with what was measured of each and where."""
    runtime = state.runtime
    default = runtime.settings.tier
    return [schemas.TierInfo.of(tier, runtime.engine.pass_count, default=default) for tier in runtime.tiers]


@router.get("/bodies")
async def bodies(state: StateHere) -> list[schemas.BodyInfo]:
    """The bodies of this service: the one that its model was trained on."""
    return [_body_info(state.runtime.body)]


def _body_info(body: BodyModel) -> schemas.BodyInfo:
    return schemas.BodyInfo(
        id=body.name,
        digest=body.digest,
        vertices=body.vertex_count,
        faces=len(body.faces),
        shapes=body.shape_count,
    )


@router.get("/bodies/{body_id}", responses=responses(InputError, NotFound, BodyError))
async def body(body_id: str, state: StateHere, betas: Betas = None) -> schemas.BodyDocument:
    """One body, in the shape ``betas``."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = shape_array(_numbers("betas", betas), runtime.body)
    return schemas.BodyDocument(
        **_body_info(runtime.body).model_dump(),
        joints=runtime.body.rest_joints(shape).tolist(),
        floor_m=floor_m(runtime.body, shape),
    )


@router.get(
    "/bodies/{body_id}/mesh",
    response_model=schemas.MeshDocument,
    responses=responses(InputError, NotFound, NotAcceptable, BodyError, kinds=(negotiation.GLB,)),
)
async def body_mesh(
    body_id: str,
    request: Request,
    state: StateHere,
    betas: Betas = None,
) -> Response:
    """The body at rest: JSON, or by Accept a GLB with its 24 joints as a skeleton, ready to be posed."""
    runtime = state.runtime
    runtime.check_body_id(body_id)
    shape = shape_array(_numbers("betas", betas), runtime.body)
    kind = negotiation.choose(request.headers.get("accept"), (negotiation.JSON, negotiation.GLB))
    if kind == negotiation.GLB:
        file = GlbFile()
        add_body(file, runtime.body, shape)
        return file_answer(file, file.head(), state.sliced_thread, {})
    faces = runtime.body.faces
    vertices = runtime.body.rest_vertices(shape).astype(np.float32)
    document = {"id": runtime.body.name, "vertices": vertices, "faces": faces, "uv": [], "uv_faces": []}
    return json_answer(
        document | {"materials": ["body"], "face_material": np.zeros(len(faces), int)}, state.sliced_thread
    )


def _numbers(name: str, text: str | None) -> list[float]:
    try:
        return [float(part) for part in text.split(",")] if text else []
    except ValueError as error:
        raise InputError(
            name, expected="comma-separated numbers", got=str(text)[:60], cure="For example ?betas=0.5,-1."
        ) from error


@router.get("/motions")
async def motions(state: StateHere) -> list[schemas.MotionInfo]:
    """The shipped sample clips."""
    clips = {key: state.runtime.motions.get(key) for key in state.runtime.motions.ids()}
    return [
        schemas.MotionInfo(id=key, name=clip.name, frames=clip.frame_count, fps=clip.fps) for key, clip in clips.items()
    ]


@router.get(
    "/motions/{motion_id}",
    response_model=schemas.MotionDocument,
    responses=responses(InputError, NotFound, BodyError),
)
async def motion(motion_id: str, state: StateHere, betas: Betas = None) -> Response:
    """One sample clip with its poses [rad] and translations [m], for the body in the shape ``betas``."""
    runtime = state.runtime
    clip = runtime.motions.placed(motion_id, runtime.body, shape_array(_numbers("betas", betas), runtime.body))
    document = {"id": motion_id, "name": clip.name, "frames": clip.frame_count, "fps": clip.fps}
    document |= {"poses": np.round(clip.poses, 6), "trans": np.round(clip.trans, 6)}
    return json_answer(document, state.sliced_thread)
