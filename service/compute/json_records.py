"""Reads records that are stored as JSON. A record that is damaged or of another version is logged and left out."""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

Kind = TypeVar("Kind")
log = logging.getLogger("drape.service")


def parsed_record(kind: type[Kind], path: Path) -> Kind:
    """Returns the JSON in the file ``path`` as an instance of ``kind``, a dataclass or a pydantic model. Raises
    ``ValueError`` where it is no JSON or does not fit, and ``OSError`` where the file cannot be read."""
    return _adapter(kind).validate_json(path.read_bytes())


def read_record(kind: type[Kind], path: Path) -> Kind | None:
    """Returns the JSON in the file ``path`` as an instance of ``kind``. None if there is no file, or if it cannot be
    read or does not fit, which is logged."""
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
