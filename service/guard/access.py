"""Identifies clients by key or ticket, and counts what each has in use: ``Access``.

A key or a ticket comes as ``Authorization: Bearer``. A page cannot set that header for a stream, so it offers
``ticket.TICKET`` among the sub-protocols, which the answer never repeats.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from starlette.datastructures import Headers

from service.errors import Busy, Unauthorized
from service.guard.key_file import ANYONE, Client, key_digest, load_keys
from service.guard.tickets import Tickets

if TYPE_CHECKING:
    from service.settings import Settings

OFFER = "ticket."
BURST_S = 2.0  # a key may make the requests of so many seconds at once


class Access:
    """The keys and tickets of a service, and what each key has in use. Without a file of keys every client is
    ``ANYONE``, which has no limits."""

    def __init__(self, settings: Settings) -> None:
        self._clients = load_keys(settings.keys_file) if settings.keys_file else {}
        self._names = {client.name: client for client in self._clients.values()}
        secret = settings.ticket_secret
        self.tickets = Tickets(secret.get_secret_value() if secret else None)
        self._used: Counter[tuple[str, str]] = Counter()
        self._buckets: dict[str, tuple[float, float]] = {}  # tokens, and when [s] they were counted

    def client(self, name: str | None) -> Client:
        """Returns the client with the key ``name``, without limits if there is no such key any more; ``ANYONE`` for
        None."""
        return ANYONE if name is None else self._names.get(name, Client(name))

    def admit(self, headers: Headers, offered: Sequence[str] = (), *, stream: bool = False) -> Client:
        """Returns the client that sent a request, and counts the request. Its key or ticket is in ``headers``, or among
        ``offered``, the sub-protocols that a WebSocket offers. ``stream`` says whether it opens a stream, which uses a
        ticket up. Refuses (``Unauthorized``) a client without a valid key or ticket, and (``Busy``) one that asks too
        often."""
        if not self._clients:
            return ANYONE
        scheme, _, credential = headers.get("authorization", "").partition(" ")
        tickets = [protocol.removeprefix(OFFER) for protocol in offered if protocol.startswith(OFFER)]
        if scheme.lower() == "bearer" and credential:
            client = self._client(credential.strip(), stream=stream)
        elif tickets:
            client = self._client(tickets[0], stream=stream)
        else:
            raise _unknown("none")
        self._count(client)
        return client

    def _client(self, credential: str, *, stream: bool) -> Client:
        if (client := self._clients.get(key_digest(credential))) is not None:
            return client
        if "." not in credential:
            raise _unknown("one that this service does not know")
        client = self._names.get(self.tickets.name(credential, spend=stream))
        if client is None:
            raise _unknown("a ticket of a key that no longer exists")
        return client

    def _count(self, client: Client) -> None:
        """Counts one request of ``client``. Refuses (``Busy``) more than its rate (a token bucket of ``BURST_S``)."""
        assert client.name is not None and client.limits is not None
        rate, now = client.limits.rate, time.monotonic()
        most = max(1.0, BURST_S * rate)
        tokens, before_s = self._buckets.get(client.name, (most, now))
        tokens = min(most, tokens + rate * (now - before_s))
        self._buckets[client.name] = max(tokens - 1.0, 0.0) if tokens >= 1.0 else tokens, now
        if tokens < 1.0:
            cure = "Ask less often, or in larger pieces."
            raise Busy("requests", expected=f"at most {rate:g} a second", got="more", cure=cure)

    @contextmanager
    def using(self, client: Client, what: Literal["streams", "clips"]) -> Iterator[None]:
        """Counts one more of ``what`` as in use by the key of ``client`` while the block runs. Refuses (``Busy``) more
        than the key's limit."""
        if client.limits is None or client.name is None:
            yield
            return
        counter, most = (client.name, what), getattr(client.limits, what)
        if self._used[counter] >= most:
            cure = "Close one, or try again in a second."
            raise Busy(what, expected=f"at most {most} of one key at a time", got="one more", cure=cure)
        self._used[counter] += 1
        try:
            yield
        finally:
            self._used[counter] -= 1


def _unknown(got: str) -> Unauthorized:
    cure = "Send the header Authorization: Bearer KEY. A page opens a stream with a ticket of POST /tickets."
    return Unauthorized("key", expected="an API key or a ticket", got=got, cure=cure)
