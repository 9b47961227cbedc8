"""Bodies, refusals and media types in the OpenAPI document that FastAPI does not read off the routes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI

from drape.errors import DrapeError, Unavailable
from service.errors import PROBLEM, Busy, Forbidden, Unauthorized, rule_for
from service.http.answers import BINARY, JSON
from service.http.schemas import Problem
from service.http.schemas import Request as Schema

REFERENCE = "#/components/schemas/{model}"
BYTES = {"type": "string", "format": "binary"}
EVERYWHERE = (Unauthorized, Forbidden, Busy, Unavailable)  # origins and hosts, keys, and a service that ends
_OURS_OF_FASTAPI = ("HTTPValidationError", "ValidationError")  # which service.errors says as problems

Responses = dict[int | str, dict[str, Any]]
KNOWN: Responses = {304: {"description": "The client's copy is current."}}


def responses(*refusals: type[DrapeError], kinds: Sequence[str] = ()) -> Responses:
    """Returns the ``responses`` of a route that may refuse as ``refusals``; ``kinds`` are the media types of its 200
    besides JSON."""
    answers: Responses = {}
    for kind in refusals:
        rule = rule_for(kind)
        titles = [answers[rule.status]["description"]] if rule.status in answers else []
        titles += [rule.title] if rule.title not in titles else []
        content = {PROBLEM: {"schema": {"$ref": REFERENCE.format(model=Problem.__name__)}}}
        answers[rule.status] = {"description": " / ".join(titles), "content": content}
    if kinds:
        answers[200] = {"content": {kind: {} if kind == JSON else {"schema": BYTES} for kind in kinds}}
    return answers


def body_schema(model: type[Schema], **others: dict[str, Any]) -> dict[str, Any]:
    """The ``openapi_extra`` of a route that reads ``model`` by itself; ``others`` are schemas by media type."""
    content = {JSON: model.model_json_schema(ref_template=REFERENCE), **others}
    return {
        "requestBody": {"content": {kind: {"schema": schema} for kind, schema in content.items()}, "required": True}
    }


def clip_schema(model: type[Schema]) -> dict[str, Any]:
    """Returns the ``body_schema`` of a route that takes the motion as a CLIP message too."""
    description = "A CLIP message (docs/reference/wire.md): the poses as float64, then all other fields as JSON."
    return body_schema(model, **{BINARY: BYTES | {"description": description}})


def install_document(app: FastAPI) -> None:
    """Makes the document of ``app`` one in which every reference leads somewhere and every refusal is a problem."""
    read_off = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            _complete(read_off())
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = document


def _complete(document: dict[str, Any]) -> None:
    named = document["components"]["schemas"]
    for name in _OURS_OF_FASTAPI:
        named.pop(name, None)
    named[Problem.__name__] = Problem.model_json_schema()
    for operation in (one for path in document["paths"].values() for one in path.values()):
        said = operation["responses"]
        if JSON in said.get("422", {}).get("content", {}):  # FastAPI's own, wherever there are parameters
            del said["422"]
        for body in operation.get("requestBody", {}).get("content", {}).values():
            named |= body["schema"].pop("$defs", {})
