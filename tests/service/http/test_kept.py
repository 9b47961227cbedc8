"""Answers that are made once: kept, compressed for who takes that, and not sent to who has them."""

from __future__ import annotations

import gzip

import pytest
from fastapi.testclient import TestClient

from service.http.kept import Kept, tag_is_known

BYTES = {"Accept": "application/octet-stream"}


def test_the_ones_asked_for_last_are_kept():
    kept = Kept(2)
    kept.keep("a", b"1")
    kept.keep("b", b"2")
    assert kept.get("a") == b"1"
    kept.keep("c", b"3")
    assert kept.get("b") is None and kept.get("a") == b"1" and kept.get("c") == b"3"


@pytest.mark.parametrize(
    ("known", "is_known"), [("", False), ('W/"b"', False), ('"a"', True), ('"b", W/"a"', True), ("*", True)]
)
def test_a_tag_is_known_weak_or_strong(known: str, is_known: bool):
    assert tag_is_known('W/"a"', known) is is_known


@pytest.mark.parametrize("path", ["/garments/tube/mesh", "/bodies/{body}/mesh", "/motions/walk"])
def test_meshes_and_motions_are_compressed_and_told_to_be_known(api: TestClient, path: str):
    path = path.format(body=api.get("/health").json()["body"])
    plain = api.get(
        path, headers=BYTES | {"Accept-Encoding": "identity"} if "mesh" in path else {"Accept-Encoding": "identity"}
    )
    assert plain.status_code == 200 and "content-encoding" not in plain.headers
    asked = (BYTES if "mesh" in path else {}) | {"Accept-Encoding": "br, gzip"}
    with api.stream("GET", path, headers=asked) as packed:
        raw = b"".join(packed.iter_raw())
    assert packed.headers["content-encoding"] == "gzip" and gzip.decompress(raw) == plain.content
    assert len(raw) < 0.6 * len(plain.content) and packed.headers["vary"] == "Accept-Encoding"
    again = api.get(path, headers=asked | {"If-None-Match": packed.headers["etag"]})
    assert again.status_code == 304 and not again.content


def test_another_shape_is_another_body(api: TestClient):
    path = f"/bodies/{api.get('/health').json()['body']}/mesh"
    usual, taller = (api.get(path, params={"betas": betas}, headers=BYTES) for betas in ("", "1.0"))
    assert usual.headers["etag"] != taller.headers["etag"] and usual.content != taller.content
