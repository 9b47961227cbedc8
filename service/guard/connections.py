"""Connections that may not be held open for nothing: ``http_protocol(settings)``.

Uvicorn has a time for the pause between two requests only. Here the head of a request, what is left of a body after its
answer, and the reading of an answer have theirs too, and connections are counted, in all and by address.
"""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any, ClassVar

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from drape.errors import DrapeError
from service.errors import PROBLEM, Busy, TooLarge, TooSlow, problem

if TYPE_CHECKING:
    from service.settings import Settings

HEAD_BYTES = 64 * 1024  # of a request line and its headers
REST_S = 2.0  # for what is left of a body after its answer


class LimitedHttp(HttpToolsProtocol):
    """One connection, until it becomes a WebSocket."""

    settings: ClassVar[Settings]
    _head: asyncio.TimerHandle | None = None
    _rest: asyncio.TimerHandle | None = None
    _reading: asyncio.TimerHandle | None = None
    _head_bytes = 0
    _upgraded = False

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        limits = self.settings
        clients = [getattr(one, "client", None) for one in self.connections]
        mine = sum(client is not None and self.client is not None and client[0] == self.client[0] for client in clients)
        for most, count, whose in (
            (limits.max_connections, len(self.connections), "in all"),
            (limits.max_connections_per_address, mine, "from one address"),
        ):
            if count > most:
                expected, got = f"at most {most} {whose}", "one more"
                self._refuse(Busy("connections", expected=expected, got=got, cure="Close some, or try again later."))
                return
        self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        self._drop_timers()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._head_bytes += len(data)
        super().data_received(data)
        if self._upgraded or self.transport.is_closing():
            return
        if self._head is not None:
            if self._head_bytes > HEAD_BYTES:
                cure = "Send less in headers and query."
                self._refuse(TooLarge("request head", expected=f"at most {HEAD_BYTES} bytes", got="more", cure=cure))
        elif (
            (self.cycle is None or self.cycle.response_complete) and not self.timeout_keep_alive_task and not self._rest
        ):
            self._await_head()  # bytes between two requests ended the pause and began nothing

    def on_message_begin(self) -> None:
        super().on_message_begin()
        if self._head is None:
            self._await_head()

    def on_headers_complete(self) -> None:
        self._head = _ended(self._head)
        super().on_headers_complete()

    def handle_websocket_upgrade(self) -> None:
        self._drop_timers()
        self._upgraded = True
        super().handle_websocket_upgrade()

    def on_message_complete(self) -> None:
        self._rest = _ended(self._rest)
        self._head_bytes = 0
        if self.cycle is None:  # a WebSocket begins
            super().on_message_complete()
            return
        more, self.cycle.more_body = self.cycle.more_body, False
        super().on_message_complete()
        if more and self.cycle.response_complete and not self.transport.is_closing():
            self._await_head()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle.response_complete and self.cycle.more_body and not self.transport.is_closing():
            # Refused before its body was read. Closing at once would reset the line and take the answer with it.
            self._rest = self.loop.call_later(REST_S, self.transport.close)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch_reading(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        self._reading = _ended(self._reading)
        super().resume_writing()

    def _watch_reading(self, before: int) -> None:
        def look() -> None:
            left = self.transport.get_write_buffer_size()
            if left >= before:
                self.transport.abort()  # closing would wait for the reader
            else:
                self._watch_reading(left)

        self._reading = self.loop.call_later(self.settings.read_s, look)

    def _await_head(self) -> None:
        self._head_bytes = 0
        self._head = self.loop.call_later(self.settings.head_s, self._late)

    def _late(self) -> None:
        limit = f"a whole head within {self.settings.head_s:g} s"
        self._refuse(TooSlow("request head", expected=limit, got="a part", cure="Send the request at once."))

    def _refuse(self, error: DrapeError) -> None:
        """Answers with ``error`` and closes; nothing of this connection is read any more."""
        self._drop_timers()
        self._unset_keepalive_if_required()
        document = problem(error)
        content = json.dumps(document).encode()
        head = f"HTTP/1.1 {document['status']} {document['title']}\r\nContent-Type: {PROBLEM}\r\n"
        head += f"Content-Length: {len(content)}\r\nConnection: close\r\n\r\n"
        self.transport.write(head.encode() + content)
        self.transport.close()

    def _drop_timers(self) -> None:
        self._head, self._rest, self._reading = (_ended(one) for one in (self._head, self._rest, self._reading))


def _ended(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()


def http_protocol(settings: Settings) -> type[LimitedHttp]:
    """The protocol class with the limits of ``settings``, as uvicorn wants it."""
    return type("Http", (LimitedHttp,), {"settings": settings})
