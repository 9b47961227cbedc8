"""Whether anybody still waits for what is computed: ``go_on``, which long loops call."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

WANTED: ContextVar[Callable[[], bool]] = ContextVar("wanted", default=lambda: True)


class Unwanted(Exception):
    """Raised inside a computation whose result nobody waits for any more."""


def go_on() -> None:
    """Returns nothing; raises ``Unwanted`` if the function in the context variable ``WANTED`` says that nobody waits
    for the result of the caller."""
    if not WANTED.get()():
        raise Unwanted
