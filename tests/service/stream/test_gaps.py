"""No request keeps the streams waiting: the longest gap of a stream beside it, of a service in its own process."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator

import httpx
import numpy as np
import pytest

from service.http.json_body import clip_marks
from service.settings import Settings
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import serve_in_process
from tests.fixtures.stream_gap import gaps_beside

MIB = 2**20
TRIES = 5


@pytest.fixture(scope="module")
def url(make_settings: Callable[..., Settings]) -> Iterator[str]:
    with serve_in_process(make_settings()) as address:
        yield address


def through(url: str, ask: Callable[[], httpx.Response], *, within_s: float | None = None) -> httpx.Response:
    """The answer of ``ask``; fails where a stream waits for it each time, as it does not for a busy machine."""
    found = []
    for _ in range(TRIES):
        answer, gaps = gaps_beside(url, ask)
        if gaps.beside_s < (gaps.bound_s if within_s is None else within_s):
            return answer
        found.append(gaps)
    raise AssertionError(f"a stream waited: {found}")


def beside(url: str, path: str, content: bytes, *, accept: str = "*/*") -> httpx.Response:
    headers = {"Content-Type": "application/json", "Accept": accept}
    return through(url, lambda: httpx.post(url + path, content=content, headers=headers, timeout=300.0))


def many(item: bytes, size: int) -> bytes:
    return b",".join([item] * (size // (len(item) + 1)))


MOST = clip_marks(Settings().max_frames)
FEWER = {  # as many as are parsed
    "empty frames": b'{"poses":[' + b",".join([b"[]"] * (MOST // 2 - 2)) + b"]}",
    "empty garments": b'{"garments":[' + b",".join([b'""'] * (MOST - 3)) + b"]}",
    "unknown fields": b"{" + b",".join(b'"%d":0' % i for i in range(MOST // 2 - 1)) + b"}",
}
MORE = {
    "empty frames": b'{"poses":[' + many(b"[]", 2 * MIB) + b"]}",
    "nested": b'{"poses":' + b"[" * (2 * MIB),
    "betas": b'{"poses":[],"betas":[' + many(b"0", 2 * MIB) + b"]}",
}


@pytest.mark.parametrize("kind", FEWER)
def test_mistakes_without_number(url: str, kind: str):
    answer = beside(url, "/drape", FEWER[kind])
    assert answer.status_code in (400, 422) and "more)" not in answer.json()["detail"].replace("(and 1 more)", "")


@pytest.mark.parametrize("kind", MORE)
def test_lists_without_end(url: str, kind: str):
    answer = beside(url, "/bodies/anny_default/posed", MORE[kind])
    assert answer.status_code == 413
    assert f"at most {MOST} commas, colons and opening brackets" in answer.json()["detail"]


def test_a_json_answer_of_millions_of_numbers(url: str):
    poses = np.random.default_rng(0).normal(scale=0.2, size=(40, 24, 3))
    asked = json.dumps({"poses": poses.tolist()}).encode()
    answer = beside(url, "/bodies/anny_default/posed", asked, accept="application/json")
    binary = httpx.post(url + "/bodies/anny_default/posed", content=asked, headers={"Content-Type": "application/json"})
    positions = np.array(answer.json()["positions"], np.float32)
    assert positions.size > 1_500_000
    assert positions.tobytes() == binary.content


def test_a_clip_lets_streams_through_however_long_its_chunks_may_be(make_settings: Callable[..., Settings]):
    poses, _ = random_motion(256)
    content = json.dumps({"garment": "tube", "poses": poses.tolist()}).encode()
    headers = {"Content-Type": "application/json"}
    with serve_in_process(make_settings(chunk_frames=256)) as url:

        def ask() -> httpx.Response:
            return httpx.post(url + "/drape", content=content, headers=headers, timeout=300.0)

        ask()  # lazy set-up
        start_s = time.monotonic()
        whole = ask()
        answer = through(url, ask, within_s=0.5 * (time.monotonic() - start_s))
    assert answer.content == whole.content, "bits must not depend on the chunks"
