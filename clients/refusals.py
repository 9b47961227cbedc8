"""Refusals of the service as the errors of ``drape.errors``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import httpx

from drape import errors
from drape.errors import DrapeError


class ServiceError(DrapeError):
    """A refusal of a kind that this client does not know, or an answer that is none of the drape service."""


def refusal(response: httpx.Response) -> DrapeError:
    """Returns the error for the problem document in ``response``, or a ``ServiceError`` where that has none."""
    try:
        document = response.json()
        return problem_error(document)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError):
        got = f"status {response.status_code} {response.reason_phrase}"
        cure = "Check that the address is that of the drape service."
        return ServiceError(str(response.request.url), expected="an answer of the drape service", got=got, cure=cure)


def problem_error(document: Mapping[str, Any]) -> DrapeError:
    """Returns the error for a problem ``document`` of the service.

    Its class is the one of ``drape.errors`` that ``document`` names, or ``ServiceError`` where there is no such class.
    """
    name = str(document.get("kind") or document["type"]).rpartition(":")[2]
    known = getattr(errors, name, None)
    kind = known if isinstance(known, type) and issubclass(known, DrapeError) else ServiceError
    return kind(document["name"], expected=document["expected"], got=document["got"], cure=document["cure"])
