"""The format of an answer, by the Accept header."""

from __future__ import annotations

from collections.abc import Sequence

from service.errors import NotAcceptable

BINARY = "application/octet-stream"
JSON = "application/json"
GLB = "model/gltf-binary"
PC2 = "application/x-pc2"
USDA = "model/vnd.usda"


def choose(accept: str | None, offered: Sequence[str]) -> str:
    """The offered type that ``accept`` prefers, the first of ``offered`` among equals; refuses if there is none."""
    if accept is None or not accept.strip():
        return offered[0]
    ranges = [_parse(part) for part in accept.split(",") if part.strip()]
    best, best_quality = offered[0], 0.0
    for kind in offered:
        # The most specific range that covers the type counts (RFC 9110, 12.5.1).
        fitting = [(specificity, quality) for pattern, quality in ranges if (specificity := _covers(pattern, kind))]
        quality = max(fitting)[1] if fitting else 0.0
        if quality > best_quality:
            best, best_quality = kind, quality
    if best_quality <= 0.0:
        raise NotAcceptable(
            "Accept", expected=f"one of {', '.join(offered)}", got=accept[:120], cure="Ask for one of these."
        )
    return best


def _parse(part: str) -> tuple[str, float]:
    pattern, *parameters = (piece.strip() for piece in part.split(";"))
    quality = 1.0
    for parameter in parameters:
        key, _, value = parameter.partition("=")
        if key.strip().lower() == "q":
            try:
                quality = min(max(float(value), 0.0), 1.0)
            except ValueError:
                quality = 0.0
    return pattern.lower(), quality


def _covers(pattern: str, kind: str) -> int:
    """How specifically ``pattern`` names ``kind``: 3 exactly, 2 by its family, 1 by any, 0 not at all."""
    if pattern == kind:
        return 3
    if pattern == kind.partition("/")[0] + "/*":
        return 2
    return 1 if pattern == "*/*" else 0
