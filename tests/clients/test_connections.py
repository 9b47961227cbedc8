"""How clients reach a service where the environment names a proxy."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest

from clients.client import AsyncDrapeClient, DrapeClient
from clients.connections import PROXIES, is_local, open_client
from clients.stream import DrapeStream
from drape.errors import InputError, Unavailable


@pytest.fixture
def nonsense(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment whose proxies are none."""
    for name in PROXIES:
        monkeypatch.setenv(name, "nonsense://nowhere")


@pytest.fixture
def proxy(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """An environment with a proxy that reaches nobody; yields what it is asked for."""
    asked: list[str] = []

    class Proxy(BaseHTTPRequestHandler):
        def _refuse(self) -> None:
            asked.append(self.path)
            self.send_error(502)

        do_GET = do_CONNECT = _refuse

        def log_message(self, format: str, *args: object) -> None:
            """Says nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for name in PROXIES:
            monkeypatch.setenv(name, f"http://127.0.0.1:{server.server_address[1]}")
        yield asked
        server.shutdown()


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://127.0.0.1:8000", True),
        ("http://localhost", True),
        ("http://[::1]:8000/", True),
        ("http://127.example.org", False),
        ("https://drape.example", False),
        ("http://[", False),
    ],
)
def test_which_addresses_are_of_this_machine(url: str, expected: bool):
    assert is_local(url) is expected


def test_a_service_on_this_machine_is_asked_directly(live: str, nonsense: None):
    with DrapeClient(live) as client:
        assert client.health()["status"] == "ok"

    async def others() -> None:
        async with AsyncDrapeClient(live) as client:
            assert (await client.health())["status"] == "ok"
        async with await DrapeStream.open(live, "tube") as stream:
            assert stream.about

    asyncio.run(others())


def test_another_one_is_asked_through_the_proxy_which_the_refusal_names(proxy: list[str]):
    async def stream() -> None:
        await DrapeStream.open("http://drape.invalid", "tube")

    with DrapeClient("https://drape.invalid") as client, pytest.raises(Unavailable, match="put the host into NO_PROXY"):
        client.health()
    with pytest.raises(Unavailable, match="put the host into NO_PROXY"):
        asyncio.run(stream())
    assert proxy == ["drape.invalid:443", "drape.invalid:80"]


@pytest.mark.parametrize(("scheme", "port"), [("http", 80), ("https", 443)])
def test_a_stream_asks_through_the_proxy_of_all_schemes_where_no_other_is_named(
    proxy: list[str], monkeypatch: pytest.MonkeyPatch, scheme: str, port: int
):
    for name in ("HTTP_PROXY", "HTTPS_PROXY"):
        monkeypatch.delenv(name)
    for host in ("drape.invalid", "other.invalid"):
        monkeypatch.setenv("NO_PROXY", "other.invalid")
        with pytest.raises(Unavailable):
            asyncio.run(DrapeStream.open(f"{scheme}://{host}", "tube"))
    assert proxy == [f"drape.invalid:{port}"]


def test_an_unusable_proxy_is_refused_by_the_name_of_its_variable(nonsense: None):
    said = "HTTP_PROXY or HTTPS_PROXY or ALL_PROXY: expected http://HOST:PORT"
    with pytest.raises(InputError, match=said):
        DrapeClient("http://drape.invalid")
    with pytest.raises(Unavailable, match="put the host into NO_PROXY"):
        asyncio.run(DrapeStream.open("http://drape.invalid", "tube"))


def test_an_address_that_is_none_is_refused():
    with pytest.raises(InputError, match="url: expected an address"):
        open_client(httpx.Client, "http://127.0.0.1:x", None, None)
