"""Under which names the service may be asked, and which web pages may ask it: ``OriginGuard``, for REST as for streams.

Browsers let any page open a WebSocket and send simple requests anywhere, and a page whose host name turns to this
machine's address counts as one of ours (DNS rebinding). Programs send no Origin and pass.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from drape.errors import DrapeError
from service.errors import Forbidden, problem_response

if TYPE_CHECKING:
    from service.settings import Settings


def check_host(headers: Mapping[str, str], settings: Settings) -> None:
    """Refuses a request that was sent to a host name that is not ours.

    Addresses pass: a page of another site cannot make a browser send one in place of its own name.
    """
    host = headers.get("host")
    if host is None or "*" in settings.allowed_hosts:
        return
    try:
        name = (urlsplit(f"//{host}").hostname or "").removesuffix(".")
    except ValueError:
        name = ""
    ours = {"localhost", settings.host.lower(), socket.gethostname().lower(), *map(str.lower, settings.allowed_hosts)}
    if name in ours or _is_address(name):
        return
    raise Forbidden(
        "Host",
        expected="an address, localhost, this machine's name or one of DRAPE_ALLOWED_HOSTS",
        got=host[:120],
        cure="Add the name to DRAPE_ALLOWED_HOSTS.",
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def check_origin(headers: Mapping[str, str], settings: Settings) -> None:
    """Refuses a request that a page of another origin makes."""
    origin = headers.get("origin")
    if origin is None or origin in settings.allowed_origins:
        return
    if urlsplit(origin).netloc != headers.get("host"):
        raise Forbidden(
            "Origin",
            expected=f"http://{headers.get('host')} or one of DRAPE_ALLOWED_ORIGINS",
            got=origin[:120],
            cure="Add the origin to DRAPE_ALLOWED_ORIGINS.",
        )


class OriginGuard:
    """Lets in what ``check_host`` and ``check_origin`` let pass."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            try:
                check_host(headers, self._settings)
                check_origin(headers, self._settings)
            except DrapeError as error:
                answer = problem_response(error)
                if scope["type"] == "websocket":
                    await WebSocket(scope, receive, send).send_denial_response(answer)
                else:
                    await answer(scope, receive, send)
                return
        await self.app(scope, receive, send)
