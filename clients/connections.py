"""How the clients reach a service. One on this machine is asked directly: no proxy of the network knows of it."""

from __future__ import annotations

import os
import re
from typing import Literal, TypeVar
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx

from clients.calls import key_headers
from drape.errors import InputError, Unavailable

# A clip of a thousand frames takes a while on a small machine; connecting does not.
TIMEOUT = httpx.Timeout(300.0, connect=5.0)
Kind = TypeVar("Kind", httpx.Client, httpx.AsyncClient)
PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")


def is_local(url: str) -> bool:
    """Returns whether ``url`` is an address of this machine."""
    try:
        name = urlsplit(url).hostname or ""
    except ValueError:
        return False
    return name in ("localhost", "::1") or bool(re.fullmatch(r"127(\.\d+){3}", name))


def open_client(
    kind: type[Kind], url: str, key: str | None, transport: httpx.BaseTransport | httpx.AsyncBaseTransport | None
) -> Kind:
    """Returns httpx's client of the class ``kind`` for the service at ``url``, with the API ``key`` in its headers.

    ``transport`` takes the place of the network, None for the network. Refuses (``InputError``) a ``url`` or a proxy of
    the environment that is no address.
    """
    try:
        base = httpx.URL(url)
    except httpx.InvalidURL as error:
        cure = "Give one such as http://127.0.0.1:8000."
        raise InputError("url", expected="an address", got=f"{url[:120]} ({error})", cure=cure) from error
    try:
        return kind(
            base_url=base,
            timeout=TIMEOUT,
            headers=key_headers(key),
            transport=transport,  # pyright: ignore[reportArgumentType]
            trust_env=not is_local(url),
        )
    except (ValueError, ImportError, httpx.InvalidURL) as error:
        raise _no_proxy(error) from error


def _no_proxy(error: Exception) -> InputError:
    named = [name for name in PROXIES if os.environ.get(name) or os.environ.get(name.lower())]
    cure = "Correct or unset it, or name the service in NO_PROXY."
    return InputError(" or ".join(named) or "proxy", expected="http://HOST:PORT", got=str(error), cure=cure)


def stream_proxy(url: str) -> str | Literal[True] | None:
    """Returns the proxy of a stream to the service at ``url``, as the argument of websockets' ``connect``: None for a
    service on this machine, the environment's ALL_PROXY, which websockets does not read, where no other fits, and
    otherwise True."""
    if is_local(url):
        return None
    proxies, of_scheme = getproxies(), ("wss",) if url.startswith("https:") else ("ws", "http")
    every = proxies.get("all")
    if every is None or any(name in proxies for name in (*of_scheme, "socks", "https")):
        return True
    return True if proxy_bypass(urlsplit(url).netloc) else every


def unreachable(url: object, error: Exception) -> Unavailable:
    """Returns the refusal for a request to ``url`` that ended in ``error`` and not in an answer."""
    reason = str(error) or type(error).__name__
    cure = "Start it (make serve), or give the address at which it runs."
    if getproxies() and not is_local(str(url)):
        cure += f" {' or '.join(PROXIES)} names a proxy: where that must not be asked, put the host into NO_PROXY."
    return Unavailable(f"service at {url}", expected="an answer", got=reason, cure=cure)
