"""Refuses requests to other host names and from pages of other origins, for REST and streams: ``OriginGuard``.

Browsers let any page open a WebSocket and send simple requests to any host. A page whose host name is made to resolve
to this machine even counts as the service's own (DNS rebinding). Programs send no Origin and are let through.
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
    """Refuses (``Forbidden``) a request whose header Host is another name than this service's.

    An IP address is let through: a page of another site cannot make a browser send one in place of its own name.
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
    """Refuses (``Forbidden``) a request with the Origin of a page that neither this service nor an allowed site has
    served. A request without Origin is let through."""
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
    """A middleware that answers requests and handshakes with the refusals of ``check_host`` and ``check_origin``."""

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
