"""Refusals of the service as the errors of ``drape.errors``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import httpx

from drape import errors
from drape.errors import DrapeError


class ServiceError(DrapeError):
    """A refusal of the service of a kind that this client does not know."""


def refusal(response: httpx.Response) -> DrapeError:
    """The error that a problem document stands for."""
    try:
        document = response.json()
        return problem_error(document)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError):
        got = f"status {response.status_code} {response.reason_phrase}"
        cure = "Check that the address is that of the drape service."
        return ServiceError(str(response.request.url), expected="an answer of the drape service", got=got, cure=cure)


def problem_error(document: Mapping[str, Any]) -> DrapeError:
    """Returns the error that a problem document of the service stands for.

    Its class is that of ``drape.errors`` which ``document`` names, or ``ServiceError`` where there is no such class.
    """
    name = str(document.get("kind") or document["type"]).rpartition(":")[2]
    known = getattr(errors, name, None)
    kind = known if isinstance(known, type) and issubclass(known, DrapeError) else ServiceError
    return kind(document["name"], expected=document["expected"], got=document["got"], cure=document["cure"])
