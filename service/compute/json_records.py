"""Records on disk as JSON. One that cannot be read, damaged or of another version, is named in the log and stops
nothing: no list, no start."""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

Kind = TypeVar("Kind")
log = logging.getLogger("drape.service")


def parsed_record(kind: type[Kind], path: Path) -> Kind:
    """Returns what the JSON at ``path`` holds as a ``kind``, a dataclass or a model. Raises ``ValueError`` where it
    does not fit, or is no JSON.
    """
    return _adapter(kind).validate_json(path.read_bytes())


def read_record(kind: type[Kind], path: Path) -> Kind | None:
    """Returns what ``parsed_record`` does. None if there is no file, or if it cannot be read, which the log then
    says."""
    try:
        return parsed_record(kind, path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        log.warning("record set aside: %s: %s", path, " ".join(str(error).split())[:200])
        return None


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
