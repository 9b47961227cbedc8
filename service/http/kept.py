"""Answers that are made once, kept for a while, and not sent again to who has them."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping

from fastapi import Response

from service.http.encodings import accepts

A_DAY = "private, max-age=86400"
ASKED_AGAIN = "private, no-cache"  # what is meant by an address may become another: 304 is brief
LEVEL = 6  # of compression


class Kept:
    """The contents that were asked for last, ``most`` of them, by their tags."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._made: OrderedDict[str, bytes] = OrderedDict()

    def get(self, tag: str) -> bytes | None:
        if (found := self._made.get(tag)) is not None:
            self._made.move_to_end(tag)
        return found

    def keep(self, tag: str, content: bytes) -> None:
        self._made[tag] = content
        while len(self._made) > self.most:
            self._made.popitem(last=False)

    async def answer(
        self,
        made_of: bytes,
        make: Callable[[], Awaitable[bytes]],
        *,
        asked: Mapping[str, str],
        kind: str,
        cache: str = A_DAY,
        packed: bool = True,
    ) -> Response:
        """Returns an answer of the media type ``kind``, whose content is kept, or else made by ``make``; 304 if the
        headers ``asked`` say that the client has it.

        ``made_of``: all that the content depends on. ``cache``: the header Cache-Control. ``packed``: ``make`` returns
        compressed content (``packed_text``), which is sent as it is to a client that takes it.
        """
        tag = f'W/"{hashlib.sha256(made_of).hexdigest()[:24]}"'
        headers = {"ETag": tag, "Cache-Control": cache} | ({"Vary": "Accept-Encoding"} if packed else {})
        if tag_is_known(tag, asked.get("if-none-match", "")):
            return Response(status_code=304, headers=headers)
        content = self.get(tag)
        if content is None:
            content = await make()
            self.keep(tag, content)
        if packed and accepts(asked.get("accept-encoding", ""), "gzip"):
            headers["Content-Encoding"] = "gzip"
        elif packed:
            content = await asyncio.to_thread(gzip.decompress, content)
        return Response(content, media_type=kind, headers=headers)


def tag_is_known(tag: str, known: str) -> bool:
    """Whether ``known``, the header If-None-Match, names ``tag``; strong and weak are alike."""
    tags = {one.strip().removeprefix("W/") for one in known.split(",")}
    return not tags.isdisjoint({tag.removeprefix("W/"), "*"})


def packed_text(content: bytes) -> bytes:
    """Returns ``content`` compressed; the same content gives the same bytes every time."""
    return gzip.compress(content, LEVEL, mtime=0)
