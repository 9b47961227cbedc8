"""Keeps contents of answers that are slow to make, and answers 304 to clients that have them already."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping

from fastapi import Response

from service.http.encodings import accepts

A_DAY = "private, max-age=86400"
ASKED_AGAIN = "private, no-cache"  # for addresses whose content may change; clients ask each time and get 304
LEVEL = 6  # of gzip


class Kept:
    """The bodies of the ``most`` answers that were used last, by their ETags."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._contents: OrderedDict[str, bytes] = OrderedDict()

    def get(self, tag: str) -> bytes | None:
        if (content := self._contents.get(tag)) is not None:
            self._contents.move_to_end(tag)
        return content

    def keep(self, tag: str, content: bytes) -> None:
        self._contents[tag] = content
        while len(self._contents) > self.most:
            self._contents.popitem(last=False)

    async def answer(
        self,
        made_of: bytes,
        make: Callable[[], Awaitable[bytes]],
        *,
        request_headers: Mapping[str, str],
        kind: str,
        cache: str = A_DAY,
        packed: bool = True,
    ) -> Response:
        """Returns the response with the content for ``made_of``, of the media type ``kind``: the kept one, or else the
        one that ``make`` returns. It is 304 if ``request_headers`` say that the client has the content.

        ``made_of``: bytes that are equal only for equal contents. ``cache``: the header Cache-Control. ``packed``:
        whether ``make`` returns the content compressed (``packed_text``); a client that accepts gzip gets it as it is.
        """
        tag = f'W/"{hashlib.sha256(made_of).hexdigest()[:24]}"'
        headers = {"ETag": tag, "Cache-Control": cache} | ({"Vary": "Accept-Encoding"} if packed else {})
        if tag_is_known(tag, request_headers.get("if-none-match", "")):
            return Response(status_code=304, headers=headers)
        content = self.get(tag)
        if content is None:
            content = await make()
            self.keep(tag, content)
        if packed and accepts(request_headers.get("accept-encoding", ""), "gzip"):
            headers["Content-Encoding"] = "gzip"
        elif packed:
            content = await asyncio.to_thread(gzip.decompress, content)
        return Response(content, media_type=kind, headers=headers)


def tag_is_known(tag: str, known: str) -> bool:
    """Returns whether ``known``, the value of If-None-Match, has the ETag ``tag``, strong or weak, or is "*"."""
    tags = {entry.strip().removeprefix("W/") for entry in known.split(",")}
    return not tags.isdisjoint({tag.removeprefix("W/"), "*"})


def packed_text(content: bytes) -> bytes:
    """Returns ``content`` compressed by gzip. Equal contents give equal bytes, as no time is stored."""
    return gzip.compress(content, LEVEL, mtime=0)
