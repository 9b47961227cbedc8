"""Routes for avatars, the characters of users that wear garments: upload, facts, correction, pictures, removal."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import Field

from drape.avatar.attire import TOLD as SURE
from drape.avatar.attire_words import Kind
from drape.avatar.covered import DEEPER_M, MARGIN_M, covered_in_file, ranges_of
from drape.avatar.file_skeleton import load_file_rig
from drape.avatar.mapping import TOLD
from drape.avatar.own_garments import Undressed
from drape.avatar.rig_file import bare_file
from drape.avatar.wearer import Wearer
from drape.errors import BodyError, InputError, NotFound, TooLarge
from drape.files.formats import AVATAR_SUFFIXES
from drape.garment.portrait import Sitter, portrait
from drape.stages.scene import Scene
from service.compute.avatar_facts import AvatarInfo, AvatarWears
from service.compute.avatars import AvatarEntry
from service.errors import Forbidden, Full, TooSlow
from service.guard.access import Client
from service.http import schemas
from service.http.answers import BINARY, GLB, JSON, PNG, json_answer
from service.http.garment_routes import LEAST, MOST, USUAL
from service.http.garment_schemas import CoveredFaces, CoveredPrimitive
from service.http.job_schemas import JobInfo
from service.http.json_body import json_text, read_document, validate_document
from service.http.openapi import BYTES, KNOWN, body_schema, responses
from service.http.problems import check_query
from service.http.undressing import undressed_avatar
from service.http.upload_routes import job_info
from service.state import ClientHere, State, StateHere

router = APIRouter()
PIECE_BYTES = 1 << 20
KINDS = (BINARY, "model/gltf-binary", "model/vrm")


@dataclass(frozen=True)
class Clothes:
    """The clothes that a character wears in a request about it, as query parameters."""

    garments: Annotated[
        str, Query(max_length=1000, description="The ids of the garments that it wears, separated by commas.")
    ] = ""
    size: Annotated[
        str | None,
        Query(
            max_length=40,
            description="One size for all garments, or a size for each, separated by commas. An empty one is M.",
        ),
    ] = None
    alive: Annotated[bool, Query(description="Whether it also wears its own clothes as cloth.")] = False


ClothesHere = Annotated[Clothes, Depends()]


class AvatarChange(schemas.Request):
    """A correction of a character: which nodes are its joints, and which kinds its parts have. All that is left out
    stays as it is.
    """

    joints: dict[Annotated[str, Field(max_length=40)], Annotated[str, Field(max_length=120)]] = Field(
        default={}, max_length=24, description="The name of the node of each joint, by SMPL's name of the joint."
    )
    parts: dict[Annotated[str, Field(max_length=400)], Kind] = Field(
        default={}, max_length=400, description="The kind of each part by the part's name."
    )


@router.post(
    "/avatars",
    status_code=202,
    openapi_extra={"requestBody": {"content": {kind: {"schema": BYTES} for kind in KINDS}, "required": True}},
    responses=responses(InputError, NotFound, TooSlow, TooLarge, BodyError, Full),
)
async def add_avatar(
    request: Request,
    response: Response,
    state: StateHere,
    client: ClientHere,
    name: Annotated[str | None, Query(max_length=120, description="The name of the file or of the avatar.")] = None,
    alive: Annotated[bool, Query(description="Whether its own clothes become garments, which takes seconds.")] = False,
) -> JobInfo:
    """Uploads a character with a skeleton and a skin. The body of the request is the raw bytes of a GLB or VRM file.
    The answer is a job. Once it is done, its ``avatar`` is the avatar's id.
    """
    check_query(request.query_params, ("name", "alive"))
    state.uploads.check_place(client)  # before the body is read
    stem, dot, suffix = (name or "").rpartition(".")
    stem = stem if f"{dot}{suffix.lower()}" in AVATAR_SUFFIXES else name or ""
    if not stem:
        raise InputError("name", expected="the avatar's name", got="nothing", cure="Give ?name=me.vrm.")
    meaning = json.dumps({"alive": True}) if alive else None
    job = await state.uploads.submit(stem, "glb", request.stream(), meaning, client, kind="avatar")
    response.headers["Location"] = f"/jobs/{job.id}"
    return job_info(job)


@router.get("/avatars", response_model=list[AvatarInfo])
async def avatars(state: StateHere, client: ClientHere) -> Response:
    """Lists the avatars that the client may use."""
    documents = b",".join(entry.document for entry in state.runtime.avatars.visible(client.name))
    return Response(b"[%b]" % documents, media_type=JSON)


@router.get("/avatars/{avatar_id}", response_model=AvatarWears, responses=responses(NotFound))
async def avatar(avatar_id: str, state: StateHere, client: ClientHere) -> Response:
    """Returns one avatar: which of its nodes are its joints, how well the body that stands for it fits its skin, the
    kinds of its parts, and which garments it can wear.
    """
    entry = await state.avatar(avatar_id, client)
    known = state.runtime.garments.visible(client.name)
    why = await asyncio.to_thread(state.runtime.avatars.wears, entry.id, known)
    wears = {"wears": {key: reason is None for key, reason in why.items()}}
    wears |= {"wears_why": {key: reason for key, reason in why.items() if reason is not None}}
    return Response(entry.document[:-1] + b"," + json.dumps(wears).encode()[1:], media_type=JSON)


@router.patch(
    "/avatars/{avatar_id}",
    status_code=202,
    openapi_extra=body_schema(AvatarChange),
    responses=responses(InputError, NotFound, TooSlow, TooLarge, Full),
)
async def change_avatar(
    avatar_id: str, request: Request, response: Response, state: StateHere, client: ClientHere
) -> JobInfo:
    """Corrects which nodes are joints, and the kinds of parts. The service then makes the avatar anew from its file.
    The answer is a job: ask for its state until it has ended.
    """
    entry = await _own(avatar_id, client, state)
    change = validate_document(AvatarChange, read_document(await json_text(request)))
    if not await asyncio.to_thread(entry.source.is_file):
        raise NotFound("avatar", expected="one whose file is stored", got="none", cure="Upload the character again.")
    if not (change.joints or change.parts):
        raise InputError("avatar", expected="joints or parts", got="neither", cure='Send {"parts": {"NAME": "hair"}}.')
    joints = entry.facts.joints if change.joints or entry.facts.found_by == TOLD else {}
    parts = {part.name: part.kind for part in entry.facts.parts if part.sure == SURE}
    whole = {"joints": joints | change.joints, "parts": parts | change.parts, "alive": entry.facts.alive is not None}
    meaning, file = json.dumps(whole), _pieces(entry.source)
    job = await state.uploads.submit(entry.facts.name, "glb", file, meaning, client, kind="avatar", replaces=entry.id)
    response.headers["Location"] = f"/jobs/{job.id}"
    return job_info(job)


@router.delete("/avatars/{avatar_id}", status_code=204, responses=responses(NotFound))
async def delete_avatar(avatar_id: str, state: StateHere, client: ClientHere) -> None:
    """Removes an avatar and its files from the service. Open streams of it go on."""
    entry = await _own(avatar_id, client, state)
    await asyncio.shield(asyncio.to_thread(state.runtime.avatars.remove, entry))


async def _own(avatar_id: str, client: Client, state: State) -> AvatarEntry:
    """Returns the entry of the avatar. Refuses (``NotFound``) an unknown one, and (``Forbidden``) one that was uploaded
    without a key, where there are keys now: all may use it."""
    entry = await state.avatar(avatar_id, client)
    if entry.owner != client.name:
        cure = "Only the key that uploaded an avatar may change it."
        raise Forbidden("avatar", expected="one of your own", got="one of no key", cure=cure)
    return entry


@router.get("/avatars/{avatar_id}/mesh", response_model=schemas.MeshDocument, responses=responses(NotFound))
async def avatar_mesh(avatar_id: str, state: StateHere, client: ClientHere) -> Response:
    """Returns the character's own surface in the T-pose [m], with its vertices welded. It stands where the standard
    body stands.
    """
    wearer = await state.wearer(avatar_id, client)
    document = {"id": avatar_id, "vertices": wearer.vertices.astype(np.float32), "faces": wearer.faces, "uv": []}
    document |= {"uv_faces": [], "materials": ["avatar"], "face_material": np.zeros(len(wearer.faces), int)}
    return json_answer(document, state.sliced_thread)


@router.get("/avatars/{avatar_id}/covered", responses=responses(InputError, NotFound, TooSlow, TooLarge))
async def avatar_covered(
    avatar_id: str,
    state: StateHere,
    client: ClientHere,
    clothes: ClothesHere,
    margin_m: Annotated[
        float, Query(ge=0.0, le=0.5, description="How far covered faces are at least from hems and from bare skin [m].")
    ] = MARGIN_M,
) -> CoveredFaces:
    """Returns the faces of the character that lie wholly under its garments at rest, away from their hems, and the
    faces of its own clothes that the garments replace. A client should draw the former a little deeper and leave the
    latter out, so that neither shows through the cloth.
    """
    entry = await state.avatar(avatar_id, client)
    state.check_slot()
    with state.access.using(client, "clips"), state.slot():
        scene = await _scene(state, avatar_id, clothes, client)
        wearer, left = await undressed_avatar(avatar_id, scene, state, client)
        surface = wearer.vertices.astype(np.float64), wearer.faces.astype(np.int64)
        cloth = [(worn.garment.vertices, worn.garment.faces) for worn in scene.layers]
        covered, of_file = await state.runtime.call_apart(
            covered_in_file, entry.path, *surface, cloth, left.off, margin_m
        )
    return CoveredFaces(
        deeper_m=DEEPER_M,
        share=round(float(covered.mean()), 4),
        ranges=_runs(ranges_of(covered)),
        hidden=_runs(ranges_of(left.off)),
        bare=left.added,
        skin_colour=list(wearer.attire.skin_colour),
        primitives=[
            CoveredPrimitive(**part.primitive._asdict(), ranges=_runs(part.ranges), hidden=_runs(part.hidden))
            for part in of_file
        ],
    )


def _runs(ranges: np.ndarray) -> list[int]:
    return ranges.reshape(-1).tolist()


async def _scene(state: StateHere, avatar_id: str, clothes: Clothes, client: ClientHere) -> Scene:
    """Returns the scene of the avatar in ``clothes``."""
    size, named = clothes.size, clothes.garments.split(",") if clothes.garments else []
    sizes = size if size is None or "," not in size else [name or None for name in size.split(",")]
    return await state.scene(None, named, client, avatar=avatar_id, size=sizes, alive=clothes.alive)


def bare_skin(stored: Path, wearer: Wearer, left: Undressed) -> bytes:
    """Returns the bytes of a GLB with the skin of ``wearer`` that is seen where the clothes that ``left`` takes off are
    not drawn. ``stored`` is the wearer's file."""
    return bare_file(wearer, load_file_rig(stored), left).to_bytes()


@router.get(
    "/avatars/{avatar_id}/bare",
    response_class=Response,
    responses=responses(InputError, NotFound, TooSlow, TooLarge, kinds=(GLB,)),
)
async def avatar_bare(avatar_id: str, state: StateHere, client: ClientHere, clothes: ClothesHere) -> Response:
    """Returns the skin that is bare where the garments take off clothes of the character and its file has no skin below
    them: a GLB skinned to the character's own nodes, to be drawn beside it.
    """
    entry = await state.avatar(avatar_id, client)
    state.check_slot()
    with state.access.using(client, "clips"), state.slot():
        scene = await _scene(state, avatar_id, clothes, client)
        wearer, left = await undressed_avatar(avatar_id, scene, state, client)
        if not left.added:
            cure = "Ask only if `bare` of GET /avatars/{id}/covered is above 0."
            raise NotFound("bare", expected="bare skin that the file has not", got="none", cure=cure)
        content = await state.runtime.call_apart(bare_skin, entry.path, wearer, left)
    return Response(content, media_type=GLB)


@router.get(
    "/avatars/{avatar_id}/preview.png",
    response_class=Response,
    responses=responses(InputError, NotFound, kinds=(PNG,)) | KNOWN,
)
async def avatar_preview(
    avatar_id: str,
    request: Request,
    state: StateHere,
    client: ClientHere,
    size: Annotated[
        int, Query(ge=LEAST, le=MOST, description="The width and the height of the picture in pixels.")
    ] = USUAL,
) -> Response:
    """Returns a picture of the character in the T-pose, seen from the front and a little from the side."""
    entry = await state.avatar(avatar_id, client)

    async def make() -> bytes:
        wearer = await state.wearer(avatar_id, client)
        sitter = Sitter(wearer.vertices.astype(np.float64), wearer.faces.astype(np.int64))
        return await state.runtime.call_apart(portrait, sitter, None, size)

    made_of = f"{entry.facts.digest}-{size}".encode()
    return await state.previews.answer(made_of, make, request_headers=request.headers, kind=PNG, packed=False)


async def _pieces(path: Path) -> AsyncIterator[bytes]:
    """Yields the bytes of the file ``path`` in pieces."""
    with await asyncio.to_thread(path.open, "rb") as file:
        while piece := await asyncio.to_thread(file.read, PIECE_BYTES):
            yield piece
