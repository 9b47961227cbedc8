"""The service does what its OpenAPI document says, on requests that schemathesis draws from it, in process."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import given
from hypothesis import strategies as st
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.result import Ok
from schemathesis.generation.case import Case
from schemathesis.python.asgi import HOST, shutdown_lifespans
from schemathesis.schemas import APIOperation, BaseSchema
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from drape.body.model import BodyModel
from service.app import create_app
from service.errors import PROBLEM
from service.http.clip_routes import FILES
from service.settings import Settings
from tests.fixtures.fuzzing import examples
from tests.fixtures.patience import PATIENT_S

# Not positive_data_acceptance: no schema says that there are as many translations as poses.
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    negative_data_rejection,
]
LEGAL, ILLEGAL = GenerationMode.POSITIVE, GenerationMode.NEGATIVE
MEDIA_TYPES = (None, "*/*", "application/json", *FILES, "image/png")


@pytest.fixture(scope="module")
def schema(make_settings: Callable[..., Settings]) -> Iterator[BaseSchema]:
    """The document of a service that takes the host name which schemathesis gives it."""
    app = create_app(make_settings(max_frames=40, intake_queue=1, allowed_hosts=(HOST,)))
    yield schemathesis.openapi.from_asgi("/openapi.json", app)
    shutdown_lifespans()


def operations(schema: BaseSchema) -> Iterator[APIOperation]:
    for one in schema.get_all_operations():
        assert isinstance(one, Ok), one
        yield one.ok()


def requests_of(operation: APIOperation, mode: GenerationMode, known: dict[str, str]) -> st.SearchStrategy[Case]:
    """Requests to ``operation``, half of them for what is there."""
    ids = {one.name: known[one.name] for one in operation.path_parameters if one.name in known}
    drawn = [operation.as_strategy(mode)]
    return st.one_of(drawn + ([operation.as_strategy(mode, path_parameters=ids)] if ids else []))


def plain_answer(operation: APIOperation, known: dict[str, str]) -> int:
    """The status of what is there, asked for without a query; drawn names of sizes hardly ever are some that it has."""
    case = operation.Case(path_parameters={one.name: known[one.name] for one in operation.path_parameters})
    response = case.call(timeout=PATIENT_S)  # schemathesis cancels a request after 10 s, and the service says 503
    case.validate_response(response, checks=CHECKS[:-1])
    return response.status_code


def ways(operation: APIOperation) -> tuple[GenerationMode, ...]:
    """Every text is a name, so only a query or a body can be illegal."""
    return (LEGAL, ILLEGAL) if operation.body or list(operation.query) else (LEGAL,)


def conform(requests: st.SearchStrategy[Case], few: int) -> Counter[int]:
    """How many answers had which status; every one of ``requests`` gets what the document declares."""
    counted: Counter[int] = Counter()

    @given(case=requests, accept=st.sampled_from(MEDIA_TYPES))
    @examples(few)
    def ask(case: Case, accept: str | None) -> None:
        response = case.call(headers={"Accept": accept} if accept else {}, timeout=PATIENT_S)
        counted[response.status_code] += 1
        case.validate_response(response, checks=CHECKS)

    ask()
    return counted


def test_answers_are_those_that_the_document_declares(schema: BaseSchema, body: BodyModel, subtests: Any):
    known = {"garment_id": "tube", "body_id": body.name, "motion_id": "walk"}
    answered = set()
    for operation in operations(schema):
        for mode in ways(operation):
            with subtests.test(operation.label, mode=mode.value):
                counted = conform(requests_of(operation, mode, known), 2)
                answered |= {operation.label} if counted[200] else set()
    # Refusals alone would say nothing of answers.
    assert "GET /health" in answered
    for path in ("/bodies/{body_id}", "/garments/{garment_id}/mesh"):
        assert plain_answer(schema[path]["GET"], known) == 200


def test_every_reference_leads_somewhere_and_every_refusal_is_a_problem(schema: BaseSchema):
    document = schema.raw_schema

    def references(part: Any) -> Iterator[str]:
        if isinstance(part, dict):
            yield from ([part["$ref"]] if isinstance(part.get("$ref"), str) else [])
        for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
            yield from references(inner)

    found = set(references(document))
    assert "#/components/schemas/FabricNumbers" in found  # which only bodies that routes read by themselves have
    for reference in found:
        place = document
        for name in reference.removeprefix("#/").split("/"):
            place = place[name]
    refusals = [
        (path, status, list(answer["content"]))
        for path, methods in document["paths"].items()
        for operation in methods.values()
        for status, answer in operation["responses"].items()
        if int(status) >= 400
    ]
    assert refusals and all(kinds == [PROBLEM] for _, _, kinds in refusals)
    assert "HTTPValidationError" not in document["components"]["schemas"]


def test_drawn_motions_are_draped(schema: BaseSchema):
    """With as many translations as poses a motion within the document's limits is draped."""
    kept = ("poses", "betas", "fps", "origin", "push_out", "body")

    def for_the_tube(case: Case) -> Case:
        assert isinstance(case.body, dict) and isinstance(case.body["poses"], list)
        trans: Any = [[1e6, 0.0, -1e6]] * len(case.body["poses"])
        case.body = {key: value for key, value in case.body.items() if key in kept} | {
            "garment": "tube",
            "trans": trans,
        }
        return case

    drawn = schema["/drape"]["POST"].as_strategy(LEGAL).filter(lambda case: isinstance(case.body, dict))
    counted = conform(drawn.map(for_the_tube), 5)
    assert counted[200] and set(counted) <= {200, 406}


def test_the_answers_of_tier_exact_are_declared(schema: BaseSchema):
    answers = schema.raw_schema["paths"]["/drape"]["post"]["responses"]
    assert answers["202"]["content"]["application/json"]["schema"] == {"$ref": "#/components/schemas/JobInfo"}
    assert PROBLEM in answers["507"]["content"]
