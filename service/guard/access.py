"""Who asks, and how much of everything they may have: ``Access``.

A key or a ticket comes as ``Authorization: Bearer``; a stream of a page, which can set no header, offers
``ticket.TICKET`` among its sub-protocols. It is never echoed.
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
BURST_S = 2.0


class Access:
    """Keys, tickets, and what each key has in use. Without a file of keys everybody is ``ANYONE``, without limits."""

    def __init__(self, settings: Settings) -> None:
        self._clients = load_keys(settings.keys_file) if settings.keys_file else {}
        self._names = {client.name: client for client in self._clients.values()}
        secret = settings.ticket_secret
        self.tickets = Tickets(secret.get_secret_value() if secret else None)
        self._used: Counter[tuple[str, str]] = Counter()
        self._buckets: dict[str, tuple[float, float]] = {}  # tokens, and when [s] they were counted

    def client(self, name: str | None) -> Client:
        """The client of the key ``name``; of one that is gone its name alone."""
        return ANYONE if name is None else self._names.get(name, Client(name))

    def admit(self, headers: Headers, offered: Sequence[str] = (), *, stream: bool = False) -> Client:
        """Returns the client that asks. Refuses (``Unauthorized``) one without a key or ticket, and (``Busy``) one that
        asks too often."""
        if not self._clients:
            return ANYONE
        scheme, _, said = headers.get("authorization", "").partition(" ")
        tickets = [one.removeprefix(OFFER) for one in offered if one.startswith(OFFER)]
        if scheme.lower() == "bearer" and said:
            client = self._client(said.strip(), stream=stream)
        elif tickets:
            client = self._client(tickets[0], stream=stream)
        else:
            raise _unknown("none")
        self._count(client)
        return client

    def _client(self, said: str, *, stream: bool) -> Client:
        if (client := self._clients.get(key_digest(said))) is not None:
            return client
        if "." not in said:
            raise _unknown("one that this service does not know")
        client = self._names.get(self.tickets.name(said, spend=stream))
        if client is None:
            raise _unknown("a ticket of a key that is gone")
        return client

    def _count(self, client: Client) -> None:
        """Takes one of the client's requests a second."""
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
        """Counts one of the client's ``what`` as in use during the block. Refuses (``Busy``) if its key has no more."""
        if client.limits is None or client.name is None:
            yield
            return
        held, most = (client.name, what), getattr(client.limits, what)
        if self._used[held] >= most:
            cure = "Close one, or try again in a second."
            raise Busy(what, expected=f"at most {most} of one key at a time", got="one more", cure=cure)
        self._used[held] += 1
        try:
            yield
        finally:
            self._used[held] -= 1


def _unknown(got: str) -> Unauthorized:
    cure = "Send Authorization: Bearer KEY; a stream of a page offers a ticket of POST /tickets."
    return Unauthorized("key", expected="an API key or a ticket", got=got, cure=cure)
