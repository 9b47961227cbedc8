"""Changing and removing garments: ``PATCH`` and ``DELETE /garments/{id}``."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import Field

from drape.errors import InputError, NotFound
from service.compute.garments import Entry
from service.errors import Forbidden, TooLarge, TooSlow
from service.guard.access import ClientHere
from service.guard.keys import Client
from service.http import schemas
from service.http.json_body import document_of, json_text, validated
from service.http.openapi import body_schema, responses
from service.state import State, StateHere
from service.uploads.shared_folder import end_streams

router = APIRouter()


class GarmentChange(schemas.Request):
    """What may be changed of a garment; what is left out stays."""

    name: Annotated[str, Field(min_length=1, max_length=120)] | None = None
    published: bool | None = None


async def _own(garment_id: str, client: Client, state: State) -> Entry:
    """The garment, if it is the client's; refuses unknown and foreign ones."""
    entry = await state.garment(garment_id, client)
    if entry.source == "shipped" or entry.owner != client.name:
        whose = "a shipped one" if entry.source == "shipped" else "one of somebody else"
        cure = "Only who uploaded a garment may change it."
        raise Forbidden("garment", expected="one of your own", got=whose, cure=cure)
    return entry


@router.patch(
    "/garments/{garment_id}",
    openapi_extra=body_schema(GarmentChange),
    responses=responses(InputError, NotFound, TooSlow, TooLarge),
)
async def change_garment(
    garment_id: str, request: Request, state: StateHere, client: ClientHere
) -> schemas.GarmentInfo:
    """Gives an uploaded garment another name, or publishes it to all keys; its id stays."""
    entry = await _own(garment_id, client, state)
    asked = validated(GarmentChange, document_of(await json_text(request)))
    if asked.name is None and asked.published is None:
        raise InputError("garment", expected="name or published", got="neither", cure='Send {"published": true}.')
    changed = state.runtime.garments.change(entry, name=asked.name, published=asked.published)
    return schemas.GarmentInfo.of(changed)


@router.delete("/garments/{garment_id}", status_code=204, responses=responses(NotFound))
async def delete_garment(garment_id: str, state: StateHere, client: ClientHere) -> None:
    """Removes an uploaded garment from the service and its disk; streams that wear it are ended (4404)."""
    entry = await _own(garment_id, client, state)
    end_streams(entry, state.streams)
    await asyncio.shield(state.runtime.aside(state.runtime.garments.remove, entry))
