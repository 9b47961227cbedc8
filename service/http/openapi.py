"""Adds to the OpenAPI document what FastAPI does not read from the routes: bodies, refusals and media types."""

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
EVERYWHERE = (Unauthorized, Forbidden, Busy, Unavailable)  # the refusals that every route may have
_UNUSED = ("HTTPValidationError", "ValidationError")  # FastAPI's models; this service answers with problems instead

Responses = dict[int | str, dict[str, Any]]
KNOWN: Responses = {304: {"description": "The client's copy is current."}}


def responses(*refusals: type[DrapeError], kinds: Sequence[str] = ()) -> Responses:
    """Returns the argument ``responses`` of a route of FastAPI: a problem for the status of each class of ``refusals``,
    and a 200 with the media types ``kinds``, if there are any."""
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
    """Returns the argument ``openapi_extra`` of a route that reads its body itself: ``model`` as JSON, or ``others``,
    schemas by their media types."""
    content = {JSON: model.model_json_schema(ref_template=REFERENCE), **others}
    return {
        "requestBody": {"content": {kind: {"schema": schema} for kind, schema in content.items()}, "required": True}
    }


def clip_schema(model: type[Schema]) -> dict[str, Any]:
    """Returns the ``body_schema`` of a route whose body is ``model`` as JSON or a CLIP message."""
    description = "A CLIP message (docs/reference/wire.md): the poses as float64, then all other fields as JSON."
    return body_schema(model, **{BINARY: BYTES | {"description": description}})


def install_document(app: FastAPI) -> None:
    """Replaces ``app.openapi`` by a function that completes FastAPI's document: it has the schemas of all bodies, and
    every refusal is a problem."""
    make_document = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            _complete(make_document())
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = document


def _complete(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    for name in _UNUSED:
        schemas.pop(name, None)
    schemas[Problem.__name__] = Problem.model_json_schema()
    for operation in (operation for path in document["paths"].values() for operation in path.values()):
        answers = operation["responses"]
        if JSON in answers.get("422", {}).get("content", {}):  # FastAPI adds it wherever there are parameters
            del answers["422"]
        for body in operation.get("requestBody", {}).get("content", {}).values():
            schemas |= body["schema"].pop("$defs", {})
