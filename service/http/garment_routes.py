"""Routes for garments: their facts, meshes, pictures and constants of folds, and changes by their owners."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

from drape.avatar.own_garments import MARK
from drape.errors import BodyError, InputError, NotFound, TooLarge
from drape.files.looks import media_type
from drape.garment.cache import Garment
from drape.garment.portrait import portrait, sitter_at_rest
from drape.wire.mesh_messages import pack_mesh
from drape.wire.messages import WIRE_VERSION
from drape.wire.options import Advanced, DrapeOptions, Resolution, SizeName
from service.errors import Forbidden, NotAcceptable, TooSlow
from service.http import schemas
from service.http.answers import BINARY, GLB, JSON, PNG, choose, file_answer, json_answer
from service.http.clip_files import rest_file
from service.http.fold_messages import message_key, pack_message, queried_fabric
from service.http.garment_schemas import LooksDocument
from service.http.json_body import json_text, read_document, validate_document
from service.http.kept import ASKED_AGAIN, packed_text
from service.http.openapi import KNOWN, body_schema, responses
from service.http.query import queried_shape
from service.state import ClientHere, State, StateHere

if TYPE_CHECKING:
    from drape.stages.scene import Entry
    from service.guard.key_file import Client

router = APIRouter()
LEAST, MOST, USUAL = 64, 1024, 512  # pixels along each side
PREVIEWS_KEPT = 64  # the most pictures in memory, of up to a quarter of a megabyte
SIZE = "The size of the garment. Left out: M, or the only size that the garment has."
AskedSize = Annotated[SizeName | None, Query(description=SIZE)]


class FoldsQuery(BaseModel):
    """The fabric, shape, mesh, avatar and size for which the constants of a garment's folds are computed, as query
    parameters."""

    fabric: str | None = Field(
        default=None,
        max_length=1000,
        description="The name of a fabric, or its numbers as JSON. Left out: the garment's own fabric.",
    )
    betas: str | None = Field(
        default=None, max_length=1000, description="The shape coefficients, separated by commas. Zeros if left out."
    )
    resolution: Resolution = "delivered"
    avatar: str | None = Field(
        default=None,
        max_length=120,
        description="The id of the avatar that the garment is fitted to. Left out: the standard body.",
    )
    size: SizeName | None = Field(default=None, description=SIZE)
    coarse: bool = Field(
        default=False,
        description="Whether a coarse cloth takes the steps of folds. The stream's `opened` message says which it is.",
    )
    drawn: bool = Field(
        default=False,
        description="Whether the message also holds the drawn mesh of a garment that is `hung`. It needs resolution "
        "fine.",
    )


class GarmentChange(schemas.Request):
    """A change of a garment's name or visibility. A field that is left out keeps its value."""

    name: Annotated[str, Field(min_length=1, max_length=120)] | None = None
    published: bool | None = None


@router.get("/garments")
async def garments(state: StateHere, client: ClientHere) -> list[schemas.GarmentInfo]:
    """Lists the garments that the client may drape."""
    return [schemas.GarmentInfo.of(entry, state.runtime.sizes) for entry in state.runtime.garments.visible(client.name)]


@router.get("/garments/{garment_id}", responses=responses(NotFound))
async def garment(garment_id: str, state: StateHere, client: ClientHere) -> schemas.GarmentInfo:
    """Returns the facts of one garment."""
    return schemas.GarmentInfo.of(await state.garment(garment_id, client), state.runtime.sizes)


@router.get(
    "/garments/{garment_id}/mesh",
    response_model=schemas.MeshDocument,
    responses=responses(InputError, NotFound, NotAcceptable, kinds=(GLB, BINARY)) | KNOWN,
)
async def garment_mesh(
    garment_id: str,
    request: Request,
    state: StateHere,
    client: ClientHere,
    resolution: Resolution = "delivered",
    size: AskedSize = None,
) -> Response:
    """Returns the garment's mesh at rest on the standard body [m]: the delivered mesh, or with ``resolution`` fine the
    finer one. The Accept header chooses JSON, a GLB, or a MESH message (docs/reference/wire.md) without materials.
    """
    (entry,) = (await state.scene(garment_id, None, client, size=size)).layers
    entry = entry.fine if resolution == "fine" else entry
    garment = entry.garment
    surface = garment.surface
    kind = choose(request.headers.get("accept"), (JSON, GLB, BINARY))
    if kind == GLB:
        return file_answer(*await asyncio.to_thread(rest_file, garment), state.sliced_thread, {})
    if kind == BINARY:
        make = partial(state.runtime.threads.apart, _mesh_message, garment)
        mesh_of = f"mesh {WIRE_VERSION} {garment.digest} {surface is garment}".encode()
        return await state.meshes.answer(mesh_of, make, request_headers=request.headers, kind=kind, cache=ASKED_AGAIN)
    document = {
        "id": entry.id,
        "vertices": garment.drawn_at_rest(),
        "faces": surface.faces,
        "uv": surface.uv.astype(np.float32),
        "uv_faces": surface.uv_faces,
        "materials": surface.material_names,
        "face_material": surface.face_material,
    }
    return json_answer(document, state.sliced_thread)


@router.get("/garments/{garment_id}/looks", responses=responses(InputError, NotFound))
async def garment_looks(
    garment_id: str, state: StateHere, client: ClientHere, resolution: Resolution = "delivered"
) -> LooksDocument:
    """Returns how the garment's materials look: their colours, the numbers of their textures, and which faces have
    which material.
    """
    entry = await state.garment(garment_id, client)
    return LooksDocument.of((entry.fine if resolution == "fine" else entry).garment.surface)


@router.get(
    "/garments/{garment_id}/textures/{number}",
    response_class=Response,
    responses=responses(InputError, NotFound, kinds=(PNG, "image/jpeg")),
)
async def garment_texture(
    garment_id: str, number: Annotated[int, Path(ge=0, le=10_000)], state: StateHere, client: ClientHere
) -> Response:
    """Returns one of the texture pictures of the garment's materials, PNG or JPEG. ``number`` is that in the garment's
    looks.
    """
    pictures = (await state.garment(garment_id, client)).garment.surface.looks.pictures
    if number >= len(pictures):
        cure = "GET /garments/{id}/looks has their numbers."
        raise NotFound("texture", expected=f"a number below {len(pictures)}", got=f"{number}", cure=cure)
    picture = pictures[number]
    return Response(picture, media_type=media_type(picture), headers={"X-Content-Type-Options": "nosniff"})


def _mesh_message(garment: Garment) -> bytes:
    surface = garment.surface
    return packed_text(pack_mesh(garment.drawn_at_rest(), surface.faces, surface.uv, surface.uv_faces))


@router.get(
    "/garments/{garment_id}/jets",
    response_class=Response,
    responses=responses(InputError, NotFound, NotAcceptable, TooLarge, kinds=(BINARY,)),
)
async def garment_jets(
    garment_id: str,
    request: Request,
    state: StateHere,
    client: ClientHere,
    resolution: Resolution = "delivered",
    avatar: Annotated[
        str | None,
        Query(
            max_length=120,
            description="The id of the avatar that the garment is fitted to. Left out: the standard body.",
        ),
    ] = None,
    size: AskedSize = None,
) -> Response:
    """Returns a LAYOUT message (docs/reference/wire.md), from which a client computes the garment's vertices out of its
    jets.
    """
    (entry,) = (await state.scene(garment_id, None, client, avatar=avatar, size=size)).layers
    entry = entry.fine if resolution == "fine" else entry
    kind = choose(request.headers.get("accept"), (BINARY,))
    headers = {"X-Drape-Vertices": str(entry.vertex_count), "X-Drape-Patches": str(entry.patch_count)}
    return Response(entry.jet_layout, media_type=kind, headers=headers)


@router.get(
    "/garments/{garment_id}/folds",
    response_class=Response,
    responses=responses(InputError, NotFound, NotAcceptable, BodyError, kinds=(BINARY,)) | KNOWN,
)
async def garment_folds(
    garment_id: str, request: Request, state: StateHere, client: ClientHere, asked: Annotated[FoldsQuery, Query()]
) -> Response:
    """Returns a FOLDS message (docs/reference/wire.md) with the constants from which a client computes swing and folds
    by itself.
    """
    kind = choose(request.headers.get("accept"), (BINARY,))
    runtime = state.runtime
    scene = await state.scene(garment_id, None, client, avatar=asked.avatar, size=asked.size)
    chosen = {"resolution": asked.resolution, "fabric": queried_fabric(asked.fabric), "advanced": Advanced(folds=1)}
    plan = runtime.plan(scene, DrapeOptions(geometry="jets", folds_by="client", **chosen))  # may refuse
    (own,), worn, body = scene.layers, plan.scene.layers[0].garment, runtime.on(scene).body
    hung = own.garment.drawer if asked.drawn and own.garment.drawn is not None and worn.drawn is None else None
    folded = worn, body, plan.fabrics[0], queried_shape(asked.betas, body), asked.coarse, hung
    make = partial(runtime.call_apart, pack_message, *folded)
    return await state.fold_messages.answer(message_key(*folded), make, request_headers=request.headers, kind=kind)


@router.get(
    "/garments/{garment_id}/preview.png",
    response_class=Response,
    responses=responses(InputError, NotFound, kinds=(PNG,)) | KNOWN,
)
async def garment_preview(
    garment_id: str,
    request: Request,
    state: StateHere,
    client: ClientHere,
    size: Annotated[
        int, Query(ge=LEAST, le=MOST, description="The width and the height of the picture in pixels.")
    ] = USUAL,
    alone: Annotated[bool, Query(description="Whether the picture leaves the body out.")] = False,
) -> Response:
    """Returns a picture of the garment in its own colours at rest on the standard body, seen from the front and a
    little from the side.
    """
    garment, body = (await state.garment(garment_id, client)).garment, state.runtime.body

    def draw() -> bytes:
        skin = None if alone else (body.rest_vertices(np.zeros(body.shape_count)), body.faces.astype(np.int64))
        return state.runtime.constants_process.call(portrait, sitter_at_rest(garment), skin, size)

    make = partial(state.runtime.threads.apart, draw)
    made_of = f"{garment.digest}-{alone}-{size}".encode()
    return await state.previews.answer(made_of, make, request_headers=request.headers, kind=PNG, packed=False)


@router.patch(
    "/garments/{garment_id}",
    openapi_extra=body_schema(GarmentChange),
    responses=responses(InputError, NotFound, TooSlow, TooLarge),
)
async def change_garment(
    garment_id: str, request: Request, state: StateHere, client: ClientHere
) -> schemas.GarmentInfo:
    """Renames an uploaded garment, or publishes it to all keys. Its id stays the same."""
    entry = await _own(garment_id, client, state)
    change = validate_document(GarmentChange, read_document(await json_text(request)))
    if change.name is None and change.published is None:
        raise InputError("garment", expected="name or published", got="neither", cure='Send {"published": true}.')
    changed = state.runtime.garments.change(entry, name=change.name, published=change.published)
    return schemas.GarmentInfo.of(changed, state.runtime.sizes)


@router.delete("/garments/{garment_id}", status_code=204, responses=responses(NotFound))
async def delete_garment(garment_id: str, state: StateHere, client: ClientHere) -> None:
    """Removes an uploaded garment and its files from the service. Streams that wear it are closed with code 4404."""
    entry = await _own(garment_id, client, state)
    state.runtime.garments.withdraw(entry)  # before streams end, whose clients may ask for it again
    state.streams.end_wearing(entry)
    await asyncio.shield(state.runtime.threads.aside(state.runtime.garments.remove, entry))


async def _own(garment_id: str, client: Client, state: State) -> Entry:
    """Returns the entry of the garment. Refuses (``NotFound``) an unknown one, and (``Forbidden``) a shipped one, one
    that another key has uploaded, and one that an avatar came in."""
    entry = await state.garment(garment_id, client)
    if MARK in entry.id:
        cure = "Correct or delete the avatar: PATCH or DELETE /avatars/ID."
        raise Forbidden("garment", expected="one that was uploaded", got="one that an avatar came in", cure=cure)
    if entry.source == "shipped" or entry.owner != client.name:
        whose = "a shipped one" if entry.source == "shipped" else "one of another key"
        cure = "Only the key that uploaded a garment may change it."
        raise Forbidden("garment", expected="one of your own", got=whose, cure=cure)
    return entry
