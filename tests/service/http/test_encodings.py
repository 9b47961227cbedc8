"""What is compressed on the way: short JSON in one piece, for who takes it, and files that lie there compressed."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.responses import JSONResponse, PlainTextResponse, StreamingResponse
from fastapi.testclient import TestClient

from service.http.encodings import LEAST, MOST, BriefJson, accepts
from service.http.pages import Page

TAKES = {"Accept-Encoding": "gzip, br"}


@pytest.mark.parametrize(
    ("asked", "taken"),
    [
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("", False),
        ("br", False),
        ("gzip;q=0", False),
        ("gzip; q=0.000", False),
    ],
)
def test_an_encoding_is_taken_that_is_named_and_not_refused(asked: str, taken: bool):
    assert accepts(asked, "gzip") is taken


@pytest.fixture(scope="module")
def brief() -> TestClient:
    app = FastAPI()
    app.add_middleware(BriefJson)

    @app.get("/json/{size}")
    async def of_size(size: int) -> JSONResponse:
        return JSONResponse("a" * size)

    @app.get("/pieces")
    async def pieces() -> StreamingResponse:
        return StreamingResponse(iter([b'"', b"a" * LEAST, b'"']), media_type="application/json")

    @app.get("/text")
    async def text() -> PlainTextResponse:
        return PlainTextResponse("a" * LEAST)

    return TestClient(app)


@pytest.mark.parametrize(
    ("path", "packed"),
    [(f"/json/{LEAST}", True), (f"/json/{MOST - 2}", True), ("/json/10", False), (f"/json/{MOST}", False),
     ("/pieces", False), ("/text", False)],
)  # fmt: skip
def test_json_in_one_brief_piece_is_compressed_and_nothing_else(brief: TestClient, path: str, packed: bool):
    with brief.stream("GET", path, headers=TAKES) as answer:
        raw = b"".join(answer.iter_raw())
    assert ("content-encoding" in answer.headers) is packed
    if "content-length" in answer.headers:
        assert answer.headers["content-length"] == str(len(raw))
    plain = brief.get(path, headers={"Accept-Encoding": "identity"})
    assert (gzip.decompress(raw) if packed else raw) == plain.content and "content-encoding" not in plain.headers


@pytest.mark.parametrize(("taken", "sent"), [("gzip, br", "br"), ("gzip", "gzip"), ("identity", None)])
def test_a_file_is_sent_as_the_build_has_compressed_it(tmp_path: Path, taken: str, sent: str | None):
    files = {
        "part-A.js": b"plain",
        "part-A.js.br": b"by brotli",
        "part-A.js.gz": gzip.compress(b"plain"),
        "index.html": b"<p>",
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    app = FastAPI()
    app.mount("/", Page(tmp_path))
    with TestClient(app).stream("GET", "/part-A.js", headers={"Accept-Encoding": taken}) as answer:
        raw = b"".join(answer.iter_raw())
    suffix = {"br": ".br", "gzip": ".gz", None: ""}[sent]
    assert answer.headers.get("content-encoding") == sent and raw == files[f"part-A.js{suffix}"]
    assert answer.headers["content-type"].startswith("text/javascript") and answer.headers["vary"] == "Accept-Encoding"
    assert "immutable" in answer.headers["cache-control"]
    page = TestClient(app).get("/", headers={"Accept-Encoding": taken})
    assert page.content == b"<p>" and page.headers["cache-control"] == "no-cache"
