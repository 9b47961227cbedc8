"""What a running service holds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from service.access import Access
from service.drapery import Drapery
from service.errors import Busy
from service.jobs import Uploads
from service.piecework import Piecework
from service.sessions import Streams


@dataclass(eq=False)
class State:
    """Body, model and garments; uploads; streams; the thread for JSON; and how many clips are being computed."""

    drapery: Drapery
    uploads: Uploads
    streams: Streams
    piecework: Piecework
    access: Access
    clips: int = 0

    def check_slot(self) -> None:
        """Refuses when all places for clips are taken, so that waiting answers cannot fill the memory."""
        limit = self.drapery.settings.max_clips
        if self.clips >= limit:
            raise Busy(
                "clips", expected=f"fewer than {limit} at a time", got=str(self.clips), cure="Try again in a second."
            )

    @contextmanager
    def slot(self) -> Iterator[None]:
        """A place for one clip; refuses when all are taken."""
        self.check_slot()
        self.clips += 1
        try:
            yield
        finally:
            self.clips -= 1


def _state(request: Request) -> State:
    return request.app.state.drape


StateHere = Annotated[State, Depends(_state)]
