"""Who may ask: names of the host, and web pages of other origins, for REST as for streams."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

from drape.wire import messages as wire
from service.errors import Forbidden
from service.guard.origin_guard import check_host
from service.settings import Settings
from tests.fixtures.serving import served

PAGE = "http://localhost:5173"


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8000", "localhost", "LOCALHOST:1", "[::1]:80", "10.1.2.3", "drape.example", None]
)
def test_addresses_and_our_names_are_let_in(host: str | None):
    check_host({} if host is None else {"host": host}, Settings(allowed_hosts=("Drape.example",)))


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8000", "localhost.evil.example", "", "[::1"])
def test_other_names_are_refused_until_all_are_allowed(host: str):
    with pytest.raises(Forbidden, match="Host: expected an address, localhost"):
        check_host({"host": host}, Settings())
    check_host({"host": host}, Settings(allowed_hosts=("*",)))


def test_every_path_is_behind_the_doors(api: httpx.Client):
    for path in ("/garments", "/health", "/", "/metrics", "/openapi.json"):
        foreign = api.get(path, headers={"Host": "evil.example"})
        assert foreign.status_code == 403 and "DRAPE_ALLOWED_HOSTS" in foreign.json()["cure"]
        other = api.get(path, headers={"Origin": "https://elsewhere.example"})
        assert other.status_code == 403 and "DRAPE_ALLOWED_ORIGINS" in other.json()["cure"]
    assert api.post("/drape", json={}, headers={"Origin": "null"}).status_code == 403
    own = str(api.base_url).rstrip("/")
    assert api.get("/garments", headers={"Origin": own}).status_code == 200


def status_of_stream(url: str, origin: str | None) -> int:
    async def shake() -> int:
        try:
            async with connect(
                url.replace("http", "ws") + "/stream",
                subprotocols=[Subprotocol(wire.SUBPROTOCOL)],
                origin=None if origin is None else Origin(origin),
            ):
                return 101
        except InvalidStatus as refused:
            cure = json.loads(refused.response.body)["cure"]
            return refused.response.status_code if "DRAPE_ALLOWED_ORIGINS" in cure else 0

    return asyncio.run(shake())


def test_a_developers_page_on_another_port(make_settings: Callable[..., Settings]):
    with served(make_settings(allowed_origins=(PAGE,))) as url:
        asked = {
            "Origin": PAGE,
            "Access-Control-Request-Method": "POST",
            "Access-Control-Request-Headers": "content-type",
        }
        before = httpx.options(url + "/drape", headers=asked)
        assert before.status_code == 200 and before.headers["Access-Control-Allow-Origin"] == PAGE
        answer = httpx.get(url + "/garments", headers={"Origin": PAGE})
        assert answer.headers["Access-Control-Allow-Origin"] == PAGE
        exposed = answer.headers["Access-Control-Expose-Headers"]
        assert {"X-Request-Id", "X-Drape-Frames", "Location"} <= set(exposed.split(", "))
        assert status_of_stream(url, PAGE) == status_of_stream(url, None) == 101
        assert status_of_stream(url, "http://localhost:5174") == 403
        refused = httpx.options(url + "/drape", headers=asked | {"Origin": "http://localhost:5174"})
        assert refused.status_code == 403
