# SPDX-License-Identifier: Apache-2.0
"""Requests to a drape service with Python's own HTTP client; those of ``clients/`` need packages that Blender lacks."""

from __future__ import annotations

import http.client
import json
import struct
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import numpy as np

BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"
OPTION_BYTES = 16384  # room in a request for all but its frames
PIECE_BYTES = 1 << 18  # an answer is read in pieces of at most so many
ANSWER_S, POLL_S = 120.0, 0.25
MAGIC, VERSION, CLIP, PLACED = 0x45505244, 1, 6, 1  # docs/reference/wire.md
_HEAD = struct.Struct("<IBBHIIII")

Progress = Callable[[float, str], None]
"""It is called with the share that is done, 0 to 1, and words on what goes on; an exception that it raises ends the
work."""


class Refusal(Exception):
    """A refusal of the add-on or of the service. ``str()`` says what was expected, what came, and what cures it."""

    def __init__(self, name: str, *, expected: str, got: str, cure: str) -> None:
        super().__init__(f"{name}: expected {expected}, got {got}. {cure}")


def refusal_of(document: Mapping[str, str]) -> Refusal:
    """Returns the refusal in a problem ``document`` of the service."""
    return Refusal(document["name"], **{key: document[key] for key in ("expected", "got", "cure")})


class Service:
    """A service at ``url``; ``key`` is the API key, empty where the service asks for none. ``is_local``: whether it is
    on this machine. Refuses (``Refusal``) a ``url`` that is no address."""

    def __init__(self, url: str, key: str = "") -> None:
        self.url, parts = url.strip().rstrip("/"), urlsplit(url.strip())
        if parts.scheme not in ("http", "https") or not parts.hostname:
            cure = "Correct it in the preferences of the add-on, or start a service."
            raise Refusal("address", expected="one such as http://127.0.0.1:8000", got=repr(url), cure=cure)
        self.is_local = parts.hostname in ("127.0.0.1", "::1", "localhost")
        self._headers = {"Authorization": f"Bearer {key}"} if key else {}
        # A proxy of the network does not reach services on this machine.
        self._opener = urllib.request.build_opener(*([urllib.request.ProxyHandler({})] if self.is_local else []))

    @contextmanager
    def request(self, method: str, path: str, content: bytes | None = None, *, accept: str = JSON) -> Iterator[Any]:
        """A context with the open response to a request. Raises the service's refusal (``Refusal``), and one where no
        whole response comes."""
        headers = {**self._headers, "Accept": accept, "Content-Type": BINARY}
        request = urllib.request.Request(self.url + path, content, headers, method=method)
        try:
            with self._opener.open(request, timeout=ANSWER_S) as answer:
                yield answer
        except urllib.error.HTTPError as error:
            try:
                raise refusal_of(json.loads(error.read())) from error
            except (ValueError, KeyError, TypeError):
                raise self._stranger(f"status {error.code}") from error
        except (OSError, http.client.HTTPException) as error:
            broken = isinstance(error, http.client.IncompleteRead)
            got = "one that broke off" if broken else str(getattr(error, "reason", None) or error)
            cure = "Start it (again) in the panel, or correct its address in the preferences of the add-on."
            raise Refusal(f"service at {self.url}", expected="an answer", got=got, cure=cure) from error

    def json(self, *names: str, method: str = "GET", content: bytes | None = None, **query: str) -> Any:
        """Returns the parsed JSON of the response at the path made of ``names``, with the parameters ``query``; None if
        it is empty. Raises what ``request`` does."""
        path = "".join(f"/{quote(name, safe='')}" for name in names) + (f"?{urlencode(query)}" if query else "")
        with self.request(method, path, content) as answer:
            text = answer.read()
        try:
            return json.loads(text or b"null")
        except ValueError as error:
            raise self._stranger("another") from error

    def _stranger(self, got: str) -> Refusal:
        cure = "Check that the address is that of the drape service."
        return Refusal(self.url, expected="an answer of the drape service", got=got, cure=cure)


def avatar_of(service: Service, glb: bytes, name: str, progress: Progress) -> dict[str, Any]:
    """Returns the service's document of the avatar called ``name``: id, joints, nodes, scale. If there is none, the
    character ``glb`` is uploaded first. Raises ``Refusal``."""
    for avatar in service.json("avatars"):
        if avatar["name"] == name:
            return avatar
    job = service.json("avatars", method="POST", content=glb, name=f"{name}.glb")
    try:
        while job["state"] in ("queued", "running"):
            progress(job["share"] or 0.0, "The service takes the character in")
            time.sleep(POLL_S)
            job = service.json("jobs", job["id"])
    except Exception:
        service.json("jobs", job["id"], method="DELETE")
        raise
    if job["state"] == "failed":
        raise refusal_of(job["problem"])
    if job["state"] != "done":
        raise Refusal(name, expected="a character that is taken in", got=f"one {job['state']}", cure="Bake again.")
    return service.json("avatars", job["avatar"])


def draped(
    service: Service, about: dict[str, Any], turns: np.ndarray, places: np.ndarray, progress: Progress
) -> np.ndarray:
    """Returns the vertices [m] (F, V, 3) float32 of a garment over a clip, y up.

    ``about`` are the JSON fields of the request. ``turns`` are poses (F, 24, 3) [rad], or local quaternions (F, N, 4),
    x, y, z, w, of an avatar's nodes. ``places`` (F, 3) [m] are the root translations of poses, or the positions of the
    node of the avatar's pelvis. A clip that is longer than a request may be goes in pieces. Raises ``Refusal``.
    """
    health = service.json("health")
    frame_bytes = 8 * (turns[0].size + 3)
    most = max(1, min(health["max_frames"], (health["max_body_bytes"] - OPTION_BYTES) // frame_bytes))
    parts, past, total = [], {}, len(turns)
    for start in range(0, total, most):
        rows = slice(start, start + most)
        fields = {**about, **past, "streamed": True, "keep": rows.stop < total}
        clip = packed_clip(fields, turns[rows], places[rows])
        with service.request("POST", "/drape", clip, accept=BINARY) as answer:
            frames = np.empty((len(turns[rows]), int(answer.headers["X-Drape-Vertices"]), 3), "<f4")
            past, room, end = {"past": answer.headers["X-Drape-Past"]}, frames.data.cast("B"), 0
            while end < len(room):
                progress((start + len(frames) * end / len(room)) / total, "Draping")
                if not (piece := answer.read1(PIECE_BYTES)):
                    raise http.client.IncompleteRead(b"", len(room) - end)
                room[end : end + len(piece)] = piece
                end += len(piece)
        parts.append(frames)
    return np.concatenate(parts)


def packed_clip(about: Mapping[str, Any], turns: np.ndarray, places: np.ndarray) -> bytes:
    """Returns the CLIP message (docs/reference/wire.md) of the JSON fields ``about``, ``turns`` (F, 24, 3) [rad] or
    (F, N, 4), and ``places`` (F, 3) [m]."""
    text = json.dumps(about, separators=(",", ":"), allow_nan=False).encode()
    nodes = turns.shape[1] if turns.shape[2] == 4 else 0
    head = _HEAD.pack(MAGIC, VERSION, CLIP, PLACED, 0, len(turns), len(text), nodes)
    return head + np.asarray(places, "<f8").tobytes() + np.asarray(turns, "<f8").tobytes() + text
