"""API keys and what each may do: ``load_keys(path)``; ``python -m service.keys NAME`` makes one (``service.keys``).

The file holds hashes only: ``{"shop": {"sha256": "...", "streams": 8}}``. Keys are 32 random bytes, so a plain hash of
one cannot be turned back.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from drape.errors import InputError

NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,39}")
CURE = "Make one with python -m service.keys NAME; see docs/guide/operate.md."


class Limits(BaseModel):
    """The limits of one key: requests a second (twice as many at once), streams and clips at a time, garments."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate: float = Field(default=20.0, gt=0.0)
    streams: int = Field(default=16, ge=0)
    clips: int = Field(default=4, ge=0)
    garments: int = Field(default=100, ge=0)
    bytes: int = Field(default=2**30, ge=0)


class _Kept(Limits):
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


@dataclass(frozen=True)
class Client:
    """Who asks: the name of a key, None where none is asked for, and its limits."""

    name: str | None = None
    limits: Limits | None = field(default=None, compare=False)


ANYONE = Client()


def key_digest(key: str) -> str:
    """The hash of ``key`` that the file holds."""
    return hashlib.sha256(key.encode()).hexdigest()


def load_keys(path: Path) -> dict[str, Client]:
    """Clients by the digest of their key; raises ``InputError`` for a file that cannot be used."""
    label = f"keys {path.name}"
    try:
        kept = TypeAdapter(dict[str, _Kept]).validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(label, expected="a readable file", got=str(error.strerror), cure=CURE) from error
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(label, expected=first["msg"], got=f"something else in {place}", cure=CURE) from error
    for name in kept:
        if not NAME.fullmatch(name):
            expected = "names of at most 40 small letters, digits and dashes"
            raise InputError(label, expected=expected, got=name[:60], cure=CURE)
    if not kept:
        raise InputError(label, expected="at least one key", got="none", cure=CURE)
    return {one.sha256: Client(name, Limits(**one.model_dump(exclude={"sha256"}))) for name, one in kept.items()}
