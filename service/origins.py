"""Which web pages may use the service: its own, and those of ``allowed_origins``."""

from __future__ import annotations

from collections.abc import Mapping
from urllib.parse import urlsplit

from service.errors import Forbidden
from service.settings import Settings


def check_origin(headers: Mapping[str, str], settings: Settings) -> None:
    """Refuses a request that a page of another origin makes; programs send no Origin and pass.

    Browsers let any page open a WebSocket and send simple POSTs anywhere; middleware for
    CORS does not see them.
    """
    origin = headers.get("origin")
    if origin is None or origin in settings.allowed_origins:
        return
    if urlsplit(origin).netloc != headers.get("host"):
        raise Forbidden(
            "Origin",
            expected=f"http://{headers.get('host')} or one of DRAPE_ALLOWED_ORIGINS",
            got=origin[:120],
            cure="Add the origin to DRAPE_ALLOWED_ORIGINS.",
        )
