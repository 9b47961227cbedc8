"""Closes connections that do nothing, and ends requests whose client has gone.

Uvicorn limits only the pause between two requests. ``http_protocol`` also limits the time for the head of a request,
for the rest of a body after its answer and for the reading of an answer, and the number of connections, in all and by
address. ``EndsWithClient`` ends a request with its connection.
"""

from __future__ import annotations

import asyncio
import json
import select
from typing import TYPE_CHECKING, Any, ClassVar

from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from drape.errors import DrapeError, TooLarge
from drape.wanted import WANTED, Unwanted
from service.errors import PROBLEM, Busy, TooSlow, problem_of
from service.guard.limits import STORED_PATHS

if TYPE_CHECKING:
    from service.settings import Settings

HEAD_BYTES = 64 * 1024  # the longest request line with its headers
HEAD_S = 10.0  # the time for the head of a request
READ_S = 10.0  # the time in which a client must read some of an answer
REST_S = 2.0  # the time for the rest of a body after its answer
LOOK_S = 0.25  # between two looks at a client from which nothing is read
LEFT = "drape.left"  # the extension of a request's scope: a future that is done when the connection is lost


class LimitedHttp(HttpToolsProtocol):
    """Uvicorn's protocol of one HTTP connection, with limits of time and number until it becomes a WebSocket."""

    settings: ClassVar[Settings]
    _head: asyncio.TimerHandle | None = None
    _rest: asyncio.TimerHandle | None = None
    _reading: asyncio.TimerHandle | None = None
    _looking: asyncio.TimerHandle | None = None
    _head_bytes = 0
    _upgraded = False

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._left: asyncio.Future[None] = self.loop.create_future()
        self._cycles: list[RequestResponseCycle] = []  # requests without their answer's end
        limits = self.settings
        clients = [getattr(connection, "client", None) for connection in self.connections]
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
        for cycle in self._cycles:
            cycle.disconnected = not cycle.response_complete
        self._left.set_result(None)
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
            self._await_head()  # bytes between two requests have ended the pause but begun no request

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self.scope["extensions"] = {LEFT: self._left}  # pyright: ignore
        if self._head is None:
            self._await_head()

    def on_headers_complete(self) -> None:
        self._head = _cancel(self._head)
        super().on_headers_complete()
        if self.cycle is not None:
            self._cycles = [*(cycle for cycle in self._cycles if not cycle.response_complete), self.cycle]
            self._looking = self._looking or self.loop.call_later(LOOK_S, self._look)

    def handle_websocket_upgrade(self) -> None:
        self._drop_timers()
        self._upgraded = True
        super().handle_websocket_upgrade()

    def on_message_complete(self) -> None:
        self._rest = _cancel(self._rest)
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
            # The request was refused before its body was read. Closing at once would reset the connection, and the
            # client would lose the answer.
            self._rest = self.loop.call_later(REST_S, self.transport.close)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch_reading(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        self._reading = _cancel(self._reading)
        super().resume_writing()

    def _watch_reading(self, before: int) -> None:
        def look() -> None:
            size = self.transport.get_write_buffer_size()
            if size >= before:
                self.transport.abort()  # closing would wait for the reader
            else:
                self._watch_reading(size)

        self._reading = self.loop.call_later(READ_S, look)

    def _look(self) -> None:
        """Aborts the connection if its client has gone. The loop does not see that while reading is paused, because a
        body or another request waits."""
        self._looking, poll = None, select.poll()
        poll.register(self.transport.get_extra_info("socket").fileno(), getattr(select, "POLLRDHUP", 0))
        if self.flow.read_paused and poll.poll(0):
            self.transport.abort()
        elif not self.cycle.response_complete:
            self._looking = self.loop.call_later(LOOK_S, self._look)

    def _await_head(self) -> None:
        self._head_bytes = 0
        self._head = self.loop.call_later(HEAD_S, self._late)

    def _late(self) -> None:
        limit = f"a whole head within {HEAD_S:g} s"
        self._refuse(TooSlow("request head", expected=limit, got="a part", cure="Send the request at once."))

    def _refuse(self, error: DrapeError) -> None:
        """Answers with ``error`` and closes the connection. Nothing more is read from it."""
        self._drop_timers()
        self._unset_keepalive_if_required()
        document = problem_of(error)
        content = json.dumps(document).encode()
        head = f"HTTP/1.1 {document['status']} {document['title']}\r\nContent-Type: {PROBLEM}\r\n"
        head += f"Content-Length: {len(content)}\r\nConnection: close\r\n\r\n"
        self.transport.write(head.encode() + content)
        self.transport.close()

    def _drop_timers(self) -> None:
        timers = self._head, self._rest, self._reading, self._looking
        self._head, self._rest, self._reading, self._looking = map(_cancel, timers)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()


def http_protocol(settings: Settings) -> type[LimitedHttp]:
    """Returns the class of connections with the limits of ``settings``, for uvicorn's ``Config(http=...)``."""
    return type("Http", (LimitedHttp,), {"settings": settings})


class EndsWithClient:
    """A middleware that cancels a request whose connection is lost, since nobody can read its answer. Requests that
    change something go on: uploads, PATCH and DELETE. So do calls inside ``asyncio.shield``."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        lost, work = scope.get("extensions", {}).get(LEFT), asyncio.current_task()
        changes = scope.get("method") in ("PATCH", "DELETE") or scope.get("path") in STORED_PATHS
        if lost is None or work is None or changes:
            await self.app(scope, receive, send)
            return

        def end(_: object) -> None:
            work.cancel()

        async def send_on(message: Message) -> None:
            if message["type"] == "http.response.body" and not message.get("more_body"):
                lost.remove_done_callback(end)  # the answer is whole, so the connection may end
            await send(message)

        WANTED.set(lambda: not lost.done())
        lost.add_done_callback(end)
        try:
            await self.app(scope, receive, send_on)
        except (asyncio.CancelledError, Unwanted):
            if lost.done():
                raise ClientDisconnect from None
            raise
        finally:
            lost.remove_done_callback(end)
