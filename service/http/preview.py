"""``GET /garments/{id}/preview.png``: a garment at rest on its body."""

from __future__ import annotations

import asyncio
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Header, Query, Response

from drape.errors import InputError, NotFound
from service.guard.access import ClientHere
from service.http.openapi import Responses, responses
from service.http.pictures import picture
from service.state import StateHere

router = APIRouter()
LEAST, MOST, USUAL = 64, 1024, 512  # pixels along each side
PNG = "image/png"
KNOWN: Responses = {304: {"description": "The picture that the client has is this one."}}


@router.get(
    "/garments/{garment_id}/preview.png",
    response_class=Response,
    responses=responses(InputError, NotFound, kinds=(PNG,)) | KNOWN,
)
async def garment_preview(
    garment_id: str,
    state: StateHere,
    client: ClientHere,
    size: Annotated[int, Query(ge=LEAST, le=MOST, description="Pixels along each side.")] = USUAL,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """A picture of the delivered mesh at rest on the standard body, from the front and a little from the side."""
    garment, body = (await state.garment(garment_id, client)).garment, state.runtime.body
    tag = f'"{garment.digest[:16]}-{size}"'
    headers = {"ETag": tag, "Cache-Control": "private, max-age=86400"}
    if if_none_match is not None and {tag, "*"} & {one.strip().removeprefix("W/") for one in if_none_match.split(",")}:
        return Response(status_code=304, headers=headers)
    made = state.previews.get(garment.digest, size)
    if made is None:
        cloth = garment.vertices[: garment.vertex_count].astype(np.float64)
        faces = garment.faces.astype(np.int64)
        skin = body.rest_vertices(np.zeros(body.shape_count))
        made = await asyncio.to_thread(
            state.runtime.constants_process.call, picture, (cloth, faces), (skin, body.faces.astype(np.int64)), size
        )
        state.previews.keep(garment.digest, size, made)
    return Response(made, media_type=PNG, headers=headers)
