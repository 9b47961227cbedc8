"""Short-lived signed tickets, which a page uses in place of a key: ``Tickets``.

A ticket is ``body.signature``: base64url of JSON (the key's name, the expiry, a random number) and of its HMAC-SHA256.
A ticket opens one stream; other requests may use it until it expires.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import secrets
import time

from service.errors import Unauthorized

LIFE_S = 60.0  # how long a ticket is valid


class Tickets:
    """Makes and checks tickets signed with ``secret``; with a random secret of this process where that is None."""

    def __init__(self, secret: str | None = None) -> None:
        self._secret = secret.encode() if secret else secrets.token_bytes(32)
        self.shared = bool(secret)  # whether other processes may have the same secret
        self._spent: dict[str, float] = {}

    def make(self, name: str, *, now_s: float | None = None) -> str:
        """Returns a ticket for the key ``name``, valid for ``LIFE_S``. ``now_s`` [s since 1970] is the current time by
        default."""
        expires_s = (time.time() if now_s is None else now_s) + LIFE_S
        body = _text(json.dumps([name, expires_s, secrets.token_hex(8)]).encode())
        return f"{body}.{self._signature(body)}"

    def name(self, ticket: str, *, spend: bool = False, now_s: float | None = None) -> str:
        """Returns the name of the key that ``ticket`` was made for. With ``spend`` the ticket is used up, as it opens
        one stream only. Refuses (``Unauthorized``) a forged or expired ticket, and with ``spend`` one that is used
        up."""
        now = time.time() if now_s is None else now_s
        body, _, signature = ticket.partition(".")
        if not hmac.compare_digest(signature.encode(), self._signature(body).encode()):
            raise _refusal("one that this service did not sign")
        name, expires_s, _ = json.loads(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)))
        if now > expires_s:
            raise _refusal("one that has expired")
        self._spent = {key: until_s for key, until_s in self._spent.items() if until_s >= now}
        if spend:
            if body in self._spent:
                raise _refusal("one that was used for another stream")
            self._spent[body] = expires_s
        return name

    def sign(self, raw: bytes) -> bytes:
        """Returns the HMAC-SHA256 (32 bytes) of ``raw``, which is no ticket. It differs from a ticket's signature."""
        return hmac.new(self._secret, b"state\0" + raw, hashlib.sha256).digest()

    def _signature(self, body: str) -> str:
        return _text(hmac.new(self._secret, body.encode(), hashlib.sha256).digest())


def _text(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).rstrip(b"=").decode()


def _refusal(got: str) -> Unauthorized:
    return Unauthorized("ticket", expected="a fresh ticket of this service", got=got, cure="Ask POST /tickets for one.")
