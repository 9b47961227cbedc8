"""FOLDS messages: made and compressed in a second, kept for a while, and not sent again to who has them."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping

import numpy as np
from fastapi import Response

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.engine.flat_records import flat_records
from drape.engine.records import HASH
from drape.garment.cache import Garment
from drape.live.fold_records import fold_records
from drape.wire.folds import pack_folds
from drape.wire.messages import WIRE_VERSION
from drape.wire.options import FabricChoice, FabricNumbers
from service.http.json_body import document_of, validated

KEPT = 8  # messages of some 3 MB, compressed
LEVEL = 6  # of compression: to half of the size
Folded = tuple[Garment, BodyModel, Fabric | None, np.ndarray, bool]


class FoldMessages:
    """The messages that were asked for last, ``KEPT`` of them, by their tag."""

    def __init__(self) -> None:
        self._made: OrderedDict[str, bytes] = OrderedDict()

    def get(self, tag: str) -> bytes | None:
        return self._made.get(tag)

    def keep(self, tag: str, message: bytes) -> None:
        self._made[tag] = message
        while len(self._made) > KEPT:
            self._made.popitem(last=False)


def queried_fabric(text: str | None) -> FabricChoice | None:
    """The fabric that a query names, or whose numbers it has as a JSON object; refuses other JSON."""
    if not text:
        return None
    return validated(FabricNumbers, document_of(text.encode())) if text.startswith("{") else text


def packed(worn: Garment, body: BodyModel, fabric: Fabric | None, shape: np.ndarray, coarse: bool) -> bytes:
    """The message of the garment ``worn`` on ``body`` of a ``shape``, of ``fabric`` or else its own, where a ``coarse``
    cloth takes the steps or the fine one; compressed."""
    message = pack_folds(*flat_records(fold_records(worn, body, fabric, shape, coarse=coarse)))
    return gzip.compress(message, LEVEL, mtime=0)


async def fold_message(
    kept: FoldMessages, folded: Folded, *, asked: Mapping[str, str], kind: str, make: Callable[..., Awaitable[bytes]]
) -> Response:
    """The answer with the message of ``folded``, which ``make`` makes where it is not ``kept``; 304 where the headers
    ``asked`` say that the client has it. It is compressed for who takes that."""
    worn, body, fabric, shape, coarse = folded
    made_of = "" if fabric is None else fabric.digest
    said = "|".join((str(WIRE_VERSION), f"{HASH:x}", worn.digest, body.digest, made_of, str(coarse)))
    tag = f'W/"{hashlib.sha256(said.encode() + shape.tobytes()).hexdigest()[:24]}"'
    headers = {"ETag": tag, "Cache-Control": "private, max-age=86400", "Vary": "Accept-Encoding"}
    known = asked.get("if-none-match")
    if known is not None and {tag.removeprefix("W/"), "*"} & {
        one.strip().removeprefix("W/") for one in known.split(",")
    }:
        return Response(status_code=304, headers=headers)
    message = kept.get(tag)
    if message is None:
        message = await make(packed, *folded)
        kept.keep(tag, message)
    if "gzip" not in asked.get("accept-encoding", ""):
        return Response(await asyncio.to_thread(gzip.decompress, message), media_type=kind, headers=headers)
    return Response(message, media_type=kind, headers=headers | {"Content-Encoding": "gzip"})
