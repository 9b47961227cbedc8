"""Routes for uploads of garment files, and for jobs."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Annotated

from fastapi import APIRouter, Query, Request, Response

from drape.errors import BodyError, InputError, NotFound, TooLarge
from drape.files.formats import MESH_CONTENT_TYPES, MESH_NAMES, listed
from service.errors import Full, TooSlow
from service.http import exact_clips
from service.http.answers import BINARY, JSON
from service.http.job_schemas import JobInfo
from service.http.json_body import content_type
from service.http.openapi import BYTES, responses
from service.http.problems import check_query
from service.state import ClientHere, StateHere
from service.uploads.avatars import MOST_CHARACTERS, upload_avatar

if TYPE_CHECKING:
    from service.uploads.jobs import Job

router = APIRouter()
KINDS = (BINARY, *MESH_CONTENT_TYPES)
FORM = "multipart/form-data"


@router.post(
    "/garments",
    status_code=202,
    openapi_extra={"requestBody": {"content": {kind: {"schema": BYTES} for kind in KINDS}, "required": True}},
    responses=responses(InputError, NotFound, TooSlow, TooLarge, BodyError, Full),
)
async def upload(
    request: Request,
    response: Response,
    state: StateHere,
    client: ClientHere,
    name: Annotated[str | None, Query(max_length=120, description="The name of the file or of the garment.")] = None,
    avatar: Annotated[
        str | None,
        Query(
            max_length=MOST_CHARACTERS,
            description="The body that the garment was modelled on: a phenotype or SMPL parameters as JSON, or a name "
            "(docs/guide/data.md). Left out: that of the file's name, or the body that is found from the cloth.",
        ),
    ] = None,
    format: Annotated[
        str | None,
        Query(max_length=10, description=f"The format, if the name has no suffix for it: {listed().lower()}."),
    ] = None,
) -> JobInfo:
    """Uploads a garment. The body of the request is the raw bytes of its file, or a form (multipart/form-data) of a
    mesh file and the files that it names. The answer is a job: ask for its state until it has ended.
    """
    check_query(request.query_params, ("name", "avatar", "format"))
    state.uploads.check_place(client)  # before the body is read
    if (kind := content_type(request)) == JSON:
        cure = f"Send the file itself as body, with ?name=shirt.obj and Content-Type: {BINARY}."
        raise InputError("request body", expected="the bytes of a mesh file", got="JSON", cure=cure)
    # The reader of zip files also reads the parts of a form.
    stem, file_format = _name_and_format(name, "zip" if kind == FORM else format, kind)
    body = upload_avatar(avatar, stem, state.runtime.settings.garments_dir)
    job = await state.uploads.submit(stem, file_format, request.stream(), body, client)
    response.headers["Location"] = f"/jobs/{job.id}"
    return job_info(job)


@router.get("/jobs/{job_id}", responses=responses(NotFound))
async def job(job_id: str, state: StateHere, client: ClientHere) -> JobInfo:
    """Returns the state of an upload, or of a clip of tier exact."""
    clip = state.exact.find(job_id, client.name)
    return job_info(state.uploads.get(job_id, client.name)) if clip is None else exact_clips.exact_job_info(clip)


@router.delete("/jobs/{job_id}", status_code=204, responses=responses(NotFound))
async def cancel_job(job_id: str, state: StateHere, client: ClientHere) -> None:
    """Cancels an upload and removes its files. Of an upload that has ended only the record is removed, and its garment
    stays. A clip of tier exact is cancelled and removed with all its frames.
    """
    if (clip := state.exact.find(job_id, client.name)) is not None:
        return await asyncio.shield(state.exact.remove(clip))
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
            cure="Export the garment as one of these. Say which one: ?name=shirt.obj, or ?format=obj.",
        )
    if not stem:
        raise InputError("name", expected="the garment's name", got="nothing", cure="Give ?name=shirt.obj.")
    return stem, chosen


def job_info(job: Job) -> JobInfo:
    last = job.results[-1] if job.results else None
    fields = {"stage": job.stage, "share": round(job.share, 2), job.kind: last, "problem": job.problem}
    fields |= {"notes": list(job.notes), "wearer": job.wearer}
    if job.kind == "garment":
        fields["garments"] = list(job.results)
    return JobInfo(id=job.id, name=job.name, state=job.state, **fields)
