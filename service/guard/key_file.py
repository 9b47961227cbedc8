"""Reads the file of API keys and their limits; ``python -m service.keys NAME`` makes a key.

The file holds hashes only: ``{"shop": {"sha256": "...", "streams": 8}}``. A key is 32 random bytes, so nobody can find
it from a plain hash.
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
    """The limits of one key: ``rate``, the requests a second (twice as many at once); ``streams`` and ``clips`` at a
    time; stored ``garments``, and the ``bytes`` of their files."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate: float = Field(default=20.0, gt=0.0)
    streams: int = Field(default=16, ge=0)
    clips: int = Field(default=4, ge=0)
    garments: int = Field(default=100, ge=0)
    bytes: int = Field(default=2**30, ge=0)


class _Key(Limits):
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


@dataclass(frozen=True)
class Client:
    """The client of a request: the name of its key and the key's limits. Both are None where no keys are asked for."""

    name: str | None = None
    limits: Limits | None = field(default=None, compare=False)


ANYONE = Client()


def key_digest(key: str) -> str:
    """Returns the SHA-256 of ``key`` as 64 hexadecimal digits, as the file holds it."""
    return hashlib.sha256(key.encode()).hexdigest()


def load_keys(path: Path) -> dict[str, Client]:
    """Returns the clients in the file ``path`` by the digest of their key. Raises ``InputError`` for a file that cannot
    be read, has no key, or holds something else."""
    label = f"keys {path.name}"
    try:
        keys = TypeAdapter(dict[str, _Key]).validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(label, expected="a readable file", got=str(error.strerror), cure=CURE) from error
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        raise InputError(label, expected=first["msg"], got=f"something else in {place}", cure=CURE) from error
    for name in keys:
        if not NAME.fullmatch(name):
            expected = "names of at most 40 small letters, digits and dashes"
            raise InputError(label, expected=expected, got=name[:60], cure=CURE)
    if not keys:
        raise InputError(label, expected="at least one key", got="none", cure=CURE)
    return {key.sha256: Client(name, Limits(**key.model_dump(exclude={"sha256"}))) for name, key in keys.items()}
