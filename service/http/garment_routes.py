"""REST: the garments of a service, their meshes and pictures, and what their owners change of them."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field

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
PREVIEWS_KEPT = 64  # pictures, of up to a quarter of a megabyte
SIZE = "The size of the garment. Left out: M, or the only size that the garment has."
AskedSize = Annotated[SizeName | None, Query(description=SIZE)]


class FoldsAsked(BaseModel):
    """The fabric, shape, mesh, avatar and size that the constants of a garment's folds are made for."""

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
        description="Whether what is drawn comes too, of a garment that says `hung`. It takes resolution fine.",
    )


class GarmentChange(schemas.Request):
    """A change of a garment's name or visibility. A field that is left out keeps its value."""

    name: Annotated[str, Field(min_length=1, max_length=120)] | None = None
    published: bool | None = None


@router.get("/garments")
async def garments(state: StateHere, client: ClientHere) -> list[schemas.GarmentInfo]:
    """Lists the garments that can be draped."""
    return [schemas.GarmentInfo.of(entry, state.runtime.sizes) for entry in state.runtime.garments.visible(client.name)]


@router.get("/garments/{garment_id}", responses=responses(NotFound))
async def garment(garment_id: str, state: StateHere, client: ClientHere) -> schemas.GarmentInfo:
    """Returns one garment."""
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
    """Returns the garment's mesh at rest on the standard body as JSON: the delivered mesh, or with ``resolution`` fine
    the finer one. With the right Accept header it returns a GLB, or a MESH message (docs/reference/wire.md) that holds
    the triangles alone.
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
        return await state.meshes.answer(mesh_of, make, asked=request.headers, kind=kind, cache=ASKED_AGAIN)
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
    """Returns how the garment's materials look: colours, and the numbers of their textures."""
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
    """Returns a picture of the garment's materials, PNG or JPEG."""
    pictures = (await state.garment(garment_id, client)).garment.surface.looks.pictures
    if number >= len(pictures):
        cure = "GET /garments/{id}/looks tells their numbers."
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
    """Returns a LAYOUT message (docs/reference/wire.md). A client needs it to compute the garment's vertices from its
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
    garment_id: str, request: Request, state: StateHere, client: ClientHere, asked: Annotated[FoldsAsked, Query()]
) -> Response:
    """Returns a FOLDS message (docs/reference/wire.md). A client needs it to compute swing and folds by itself."""
    kind = choose(request.headers.get("accept"), (BINARY,))
    runtime = state.runtime
    scene = await state.scene(garment_id, None, client, avatar=asked.avatar, size=asked.size)
    chosen = {"resolution": asked.resolution, "fabric": queried_fabric(asked.fabric), "advanced": Advanced(folds=1)}
    plan = runtime.plan(scene, DrapeOptions(geometry="jets", folds_by="client", **chosen))  # may refuse
    (own,), worn, body = scene.layers, plan.scene.layers[0].garment, runtime.on(scene).body
    hung = own.garment.drawer if asked.drawn and own.garment.drawn is not None and worn.drawn is None else None
    folded = worn, body, plan.fabrics[0], queried_shape(asked.betas, body), asked.coarse, hung
    make = partial(runtime.call_apart, pack_message, *folded)
    return await state.fold_messages.answer(message_key(*folded), make, asked=request.headers, kind=kind)


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
    """Returns a picture of the garment in its own colours at rest on the standard body, from the front and a little
    from the side."""
    garment, body = (await state.garment(garment_id, client)).garment, state.runtime.body

    def drawn() -> bytes:
        skin = None if alone else (body.rest_vertices(np.zeros(body.shape_count)), body.faces.astype(np.int64))
        return state.runtime.constants_process.call(portrait, sitter_at_rest(garment), skin, size)

    make = partial(state.runtime.threads.apart, drawn)
    drawn_of = f"{garment.digest}-{alone}-{size}".encode()
    return await state.previews.answer(drawn_of, make, asked=request.headers, kind=PNG, packed=False)


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
    asked = validate_document(GarmentChange, read_document(await json_text(request)))
    if asked.name is None and asked.published is None:
        raise InputError("garment", expected="name or published", got="neither", cure='Send {"published": true}.')
    changed = state.runtime.garments.change(entry, name=asked.name, published=asked.published)
    return schemas.GarmentInfo.of(changed, state.runtime.sizes)


@router.delete("/garments/{garment_id}", status_code=204, responses=responses(NotFound))
async def delete_garment(garment_id: str, state: StateHere, client: ClientHere) -> None:
    """Removes an uploaded garment from the service and its disk. Streams that wear it are closed with code 4404."""
    entry = await _own(garment_id, client, state)
    state.runtime.garments.withdraw(entry)  # who is told that it is gone finds it gone
    state.streams.end_wearing(entry)
    await asyncio.shield(state.runtime.threads.aside(state.runtime.garments.remove, entry))


async def _own(garment_id: str, client: Client, state: State) -> Entry:
    """The garment, if it is the client's; refuses unknown and foreign ones."""
    entry = await state.garment(garment_id, client)
    if entry.source == "shipped" or entry.owner != client.name:
        whose = "a shipped one" if entry.source == "shipped" else "one of somebody else"
        cure = "Only who uploaded a garment may change it."
        raise Forbidden("garment", expected="one of your own", got=whose, cure=cure)
    return entry
