"""Whether anybody still waits for what is computed: ``go_on``, which long loops call."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

WANTED: ContextVar[Callable[[], bool]] = ContextVar("wanted", default=lambda: True)


class Unwanted(Exception):
    """Nobody waits for the result any more."""


def go_on() -> None:
    """Raises ``Unwanted`` where ``WANTED`` of the caller's context says that nobody waits."""
    if not WANTED.get()():
        raise Unwanted
