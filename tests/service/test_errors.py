"""Every refusal has a status, a close code and a problem document."""

from __future__ import annotations

import json

import pytest

from drape import errors as core
from drape.errors import DrapeError, NotFound
from service import errors
from service.errors import TABLE, InternalError, close_reason, error_message, problem_of, rule_for


def kinds(base: type[DrapeError] = DrapeError) -> list[type[DrapeError]]:
    return [base] + [kind for child in base.__subclasses__() for kind in kinds(child)]


OURS = [kind for kind in kinds() if kind.__module__ in ("drape.errors", "service.errors")]


def example(kind: type[DrapeError]) -> DrapeError:
    if kind is InternalError or kind is errors.Draining:
        return kind()  # pyright: ignore[reportCallIssue]
    return kind("poses", expected="24 joints", got="23", cure="Send 24.")


@pytest.mark.parametrize("kind", OURS, ids=lambda kind: kind.__name__)
def test_every_kind_has_a_rule_and_a_whole_document(kind: type[DrapeError]):
    rule = rule_for(kind)
    assert 400 <= rule.status < 600
    assert rule.close_code in {1009, 1011, 1012, 1013} or 4400 <= rule.close_code < 4500
    document = problem_of(example(kind))
    assert set(document) == {"type", "title", "status", "detail", "name", "expected", "got", "cure"}
    assert document["detail"] == str(example(kind))
    assert document["status"] == rule.status


def test_client_faults_are_4xx_and_ours_5xx():
    for kind, rule in TABLE.items():
        fault_of_client = issubclass(kind, core.InputError) or kind is errors.Busy
        assert (rule.status < 500) == fault_of_client, kind


def test_the_nearest_base_decides():
    class Special(NotFound):
        pass

    assert rule_for(Special) is TABLE[NotFound]


def test_close_reasons_fit_a_close_frame_and_keep_their_beginning():
    long = NotFound("garment", expected="ä" * 100, got="b" * 100, cure="c" * 100)
    reason = close_reason(long)
    assert len(reason.encode()) <= 123
    assert reason.startswith("garment: expected ä") and reason.endswith("...")
    assert close_reason(example(NotFound)) == str(example(NotFound))


def test_stream_message_names_the_kind():
    message = json.loads(error_message(example(NotFound)))
    assert message["type"] == "error"
    assert message["kind"] == "NotFound"
    assert message["status"] == 404


def test_internal_errors_tell_no_cause():
    assert "log" in InternalError().cure
    kind, arguments = InternalError().__reduce__()
    assert isinstance(kind(*arguments), InternalError)
