"""Uvicorn as the stream needs it: no compression, small buffers, and connections that can be aborted."""

from __future__ import annotations

import asyncio
import errno
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.http11 import Request

from drape.errors import InputError, Unavailable
from service.guard.connection_times import http_protocol
from service.settings import Settings
from service.stream.routes import ABORT
from service.watch.watchdog import end_when_told, told_to_end

SEND_BUFFER_BYTES = 256 * 1024  # what the kernel may buffer for a slow reader
MESSAGE_BYTES = 64 * 1024  # the longest message from a client
END_S = 14  # from the beginning of the shutdown until the process is ended by force
LOOK_S = 0.25  # between two looks at whether the service should end


class StreamProtocol(WebSocketsSansIOProtocol):
    """Uvicorn's protocol of one WebSocket, with ``transport.abort`` in the scope, under ``extensions``.

    A client that has stopped reading would keep its connection open for ever: closing waits for what is buffered, and
    an application that is stuck answers no pings.
    """

    def handle_connect(self, event: Request) -> None:
        super().handle_connect(event)
        scope = getattr(self, "scope", None)
        if scope is not None:
            scope["extensions"][ABORT] = {"call": self.transport.abort}


def bind_listener(host: str, port: int) -> socket.socket:
    """Returns a socket that listens on ``host`` and ``port`` (0: a free one). Refuses (``Unavailable``) a port that is
    taken, and (``InputError``) an address that this machine does not have."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except OSError as error:
        raise InputError(
            "host", expected="an address of this machine", got=host, cure=f"Check --host ({error.strerror})."
        ) from error
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Accepted connections inherit it.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        listener.bind(address)
        listener.listen(256)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise Unavailable(
                f"port {port}",
                expected="a free port",
                got="one that another program listens on",
                cure="Stop that program, or choose another: --port 8123.",
            ) from error
        raise InputError(
            f"{host}:{port}",
            expected="an address that can be bound",
            got=str(error.strerror),
            cure="Check --host and --port.",
        ) from error
    return listener


class DrainingServer(uvicorn.Server):
    """A Uvicorn server that drains the application before it closes connections: its streams are told to connect
    again."""

    async def main_loop(self) -> None:
        """Runs until the server is told to end, which it looks for every ``LOOK_S``. Uvicorn's own loop turns ten times
        a second, which costs a fifth of a stream of a body that stands still."""
        while not await self.on_tick(0):
            await asyncio.sleep(LOOK_S)
            if told_to_end():
                self.handle_exit(signal.SIGTERM, None)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        with super().capture_signals():
            if threading.current_thread() is threading.main_thread():
                end_when_told()
            yield

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stops listening, drains the application (``State.drain``) and closes ``sockets`` and all connections: within
        10 s, or by force within 15 where something hangs."""
        if threading.current_thread() is threading.main_thread() and not told_to_end():
            signal.alarm(END_S)  # after Ctrl-C; SIGTERM has set an alarm
        for server in self.servers:
            server.close()
        app = self.config.app
        if isinstance(app, FastAPI):
            await app.state.drape.drain()
        await super().shutdown(sockets)


def make_server(app: FastAPI, settings: Settings) -> uvicorn.Server:
    """Returns a server for ``app`` that has not begun. ``run(sockets=[...])`` serves on listening sockets until it is
    told to end."""
    return DrainingServer(
        uvicorn.Config(
            app,
            http=http_protocol(settings),
            ws=StreamProtocol,
            ws_per_message_deflate=False,  # 40 times slower for a few per cent
            ws_max_size=MESSAGE_BYTES,
            ws_ping_interval=20.0,
            ws_ping_timeout=20.0,
            log_level="info",
            access_log=False,
            server_header=False,
            log_config=None,  # service.watch.logs has set up logging
            timeout_graceful_shutdown=5,
        )
    )
