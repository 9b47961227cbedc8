"""Whether the service lives and whether it takes work: ``Lifecycle``.

The event loop says that it turns, a few times a second. Who asks from another thread (``service.watch.probes``) sees a
loop that has stopped turning, which no answer of the loop itself could say.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from drape.errors import DrapeError, Unavailable

TICK_S = 0.25


class Lifecycle:
    """Loading, ready or draining, and when the event loop last came round; read from any thread."""

    def __init__(self, *, stuck_s: float) -> None:
        self._stuck_s = stuck_s
        self._ready = self.draining = False
        self.hurried = False  # what is not through by now is told to come again
        self._turned_s: float | None = None
        self.works: dict[str, Callable[[], bool]] = {}  # what must be running, by name

    def ready(self) -> None:
        """Says that everything is loaded."""
        self._ready = True

    async def tick(self, lag: Callable[[float], None]) -> None:
        """Says again and again that the loop turns, and tells ``lag`` how late [s] it came round."""
        while True:
            begun_s = self._turned_s = time.monotonic()
            await asyncio.sleep(TICK_S)
            lag(max(0.0, time.monotonic() - begun_s - TICK_S))

    def ended(self) -> None:
        """Says that the loop has ended in good order: it need not turn any more."""
        self._turned_s = None

    def unhealthy(self) -> DrapeError | None:
        """Why the process should be replaced; None while it lives."""
        waited_s = 0.0 if self._turned_s is None else time.monotonic() - self._turned_s
        if waited_s <= self._stuck_s:
            return None
        return Unavailable(
            "event loop",
            expected=f"a turn within {self._stuck_s:g} s",
            got=f"none for {waited_s:.1f} s",
            cure="Restart the service and keep its log.",
        )

    def unready(self) -> DrapeError | None:
        """Why no work should be sent here; None while it is welcome."""
        stopped = [name for name, runs in self.works.items() if not runs()]
        for got, reason in (("one that drains", self.draining), ("one that still loads", not self._ready)):
            if reason:
                cure = "Ask another replica, or again in a few seconds."
                return Unavailable("service", expected="one that takes work", got=got, cure=cure)
        if stopped:
            cure = "Restart the service; its log has the cause."
            return Unavailable("service", expected=f"running {stopped[0]}", got="one that has stopped", cure=cure)
        return self.unhealthy()
