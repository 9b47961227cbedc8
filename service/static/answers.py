"""Answers of a service that listens nowhere: its application is asked in this process."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from fastapi import FastAPI

from drape.errors import InputError


async def answer(app: FastAPI, path: str, kind: str) -> bytes:
    """The body, of the media type ``kind``, of the answer of ``app`` to GET ``path``; raises its refusal."""
    address, _, query = path.partition("?")
    scope = {
        "type": "http",
        "method": "GET",
        "path": address,
        "raw_path": address.encode(),
        "query_string": query.encode(),
        "headers": [(b"host", b"127.0.0.1"), (b"accept", kind.encode())],
        "client": ("127.0.0.1", 0),
        "server": ("127.0.0.1", 80),
        "scheme": "http",
        "http_version": "1.1",
        "root_path": "",
        "asgi": {"version": "3.0"},
    }
    sent: list[dict[str, Any]] = []
    asked = iter([{"type": "http.request", "body": b"", "more_body": False}])

    async def receive() -> dict[str, Any]:
        for message in asked:
            return message
        return await asyncio.Future()  # who asks does not go away

    async def send(message: Any) -> None:
        sent.append(message)

    await app(scope, receive, send)
    body = b"".join(message.get("body", b"") for message in sent)
    if sent[0]["status"] != 200:
        problem = json.loads(body)
        words = {name: str(problem.get(name, "")) for name in ("expected", "got", "cure")}
        raise InputError(str(problem.get("name", path)), **words)
    return body
