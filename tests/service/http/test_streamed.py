"""Clips in pieces are the undivided clip, and frames leave as they are ready."""

from __future__ import annotations

import asyncio
import json
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import NotFound
from drape.stages.batch import PoseInput
from drape.wire.jets import split_jets
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.http import continuations
from service.http.continuations import Continuation
from service.settings import Settings
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import served
from tests.fixtures.tiny_model import TINY_DYNAMIC

FRAMES = 9
TIMES_S = np.arange(FRAMES) / 30.0
POSES, TRANS = smooth_motion(TIMES_S)


@pytest.fixture(scope="module")
def own(make_settings: Callable[..., Settings]) -> Iterator[httpx.Client]:
    """A client of a service with the dynamic model, which takes few frames and bytes at once."""
    with (
        served(
            make_settings(model=TINY_DYNAMIC, max_frames=FRAMES, max_answer_bytes=216 * 12 * 4, chunk_frames=2)
        ) as url,
        httpx.Client(base_url=url, timeout=60.0) as client,
    ):
        yield client


def asked(rows: slice = slice(None), **fields: object) -> dict[str, object]:
    clip = {"poses": POSES[rows].tolist(), "trans": TRANS[rows].tolist()}
    return {"garment": "tube", "streamed": True, **clip, **fields}


def drape(own: httpx.Client, rows: slice = slice(None), **fields: Any) -> httpx.Response:
    response = own.post("/drape", json=asked(rows, **fields))
    assert response.status_code == 200, response.text
    return response


def vertices(response: httpx.Response) -> np.ndarray:
    frames = int(response.headers["X-Drape-Frames"])
    return np.frombuffer(response.content, "<f4", frames * 216 * 3).reshape(frames, 216, 3)


def test_a_streamed_answer_has_no_limit_and_the_same_bits(own: httpx.Client):
    whole = drape(own)
    assert own.post("/drape", json=asked(streamed=False)).status_code == 413
    parts = [vertices(own.post("/drape", json=asked(slice(0, n), streamed=False))) for n in (1, 3)]
    for part in parts:
        assert_array_equal(vertices(whole)[: len(part)], part)
    assert whole.headers["X-Drape-Tier"] and "X-Drape-Pushed-Share" not in whole.headers
    assert len(whole.content) == int(whole.headers["Content-Length"]) == FRAMES * 216 * 12


def test_roots_follow_a_streamed_answer(own: httpx.Client):
    rooted = drape(own, slice(0, 5), origin="root")
    roots = np.frombuffer(rooted.content, "<f8", offset=5 * 216 * 12).reshape(5, 3)
    assert_allclose(vertices(rooted) + roots[:, None], vertices(drape(own, slice(0, 5))), rtol=0, atol=1e-6)


@pytest.mark.parametrize(("folds", "streamed"), [(0, True), (1, False)])
def test_pieces_are_the_whole_clip(own: httpx.Client, folds: int, streamed: bool):
    whole, found, past = vertices(drape(own, folds=folds)), [], {}
    for rows in (slice(0, 3), slice(3, 4), slice(4, 7), slice(7, 9)):
        answer = drape(own, rows, folds=folds, keep=True, streamed=streamed, **past)
        past = {"past": answer.headers["X-Drape-Past"]}
        found.append(vertices(answer))
    if folds:  # rarely an ulp differs beside other work
        assert_allclose(np.concatenate(found), whole, rtol=0, atol=1e-6)
    else:
        assert_array_equal(np.concatenate(found), whole)
    anew = vertices(drape(own, slice(4, 7), folds=folds))
    assert np.abs(anew - whole[4:7]).max() > 1e-4, "without a past the cloth hangs otherwise"


def test_the_past_is_there_for_who_leaves_with_the_last_byte(own: httpx.Client):
    whole = vertices(drape(own))
    for _ in range(10):  # the request after the last byte would be the first to come too early
        past, found = {}, []
        for rows in (slice(0, 8), slice(8, 9)):
            body = json.dumps(asked(rows, keep=True, **past)).encode()
            headers = {"Content-Type": "application/json", "Connection": "close"}
            with urllib.request.urlopen(urllib.request.Request(f"{own.base_url}/drape", body, headers)) as answer:
                past = {"past": answer.headers["X-Drape-Past"]}
                found.append(np.frombuffer(answer.read(int(answer.headers["Content-Length"])), "<f4"))
        assert_array_equal(np.concatenate(found), whole.reshape(-1))


def test_jets_come_streamed_and_in_pieces_too(own: httpx.Client):
    whole = split_jets(drape(own, geometry="jets").content)
    first = drape(own, slice(0, 4), keep=True, geometry="jets")
    rest = drape(own, slice(4, 9), past=first.headers["X-Drape-Past"], geometry="jets")
    pieces = split_jets(first.content) + split_jets(rest.content)
    assert [frame.sequence for frame in pieces] == list(range(FRAMES))
    for one, other in zip(pieces, whole, strict=True):
        assert one.client_time_s == other.client_time_s
        assert_array_equal(one.jet, other.jet)


def test_a_past_is_followed_twice_but_by_no_other_clip(own: httpx.Client):
    token = drape(own, slice(0, 4), keep=True).headers["X-Drape-Past"]
    first, second = (vertices(drape(own, slice(4, 9), past=token)) for _ in range(2))
    assert_array_equal(first, second)
    for fields in ({"fps": 24.0}, {"betas": [1.0]}, {"push_out": False}):
        response = own.post("/drape", json=asked(slice(4, 9), past=token, **fields))
        assert response.status_code == 400
        assert "past: expected a clip of the same garments, options, shape" in response.json()["detail"]
    response = own.post("/drape", json=asked(past="never"))
    assert response.status_code == 404 and "past: expected one of the last 120 s" in response.json()["detail"]


def test_streamed_json_is_refused(own: httpx.Client):
    response = own.post("/drape", json=asked(), headers={"Accept": "application/json"})
    assert response.status_code == 406


def test_a_stream_that_is_given_up_frees_its_place(make_settings: Callable[..., Settings]):
    settings = make_settings(max_clips=1, chunk_frames=1)
    poses = np.zeros((400, 24, 3)).tolist()
    with served(settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        document = {"garment": "tube", "streamed": True, "poses": poses}
        for _ in range(3):
            while True:
                with client.stream("POST", "/drape", json=document) as answer:
                    if answer.status_code == 200:
                        next(answer.iter_raw())
                        break
                    assert answer.status_code == 429


@pytest.fixture(scope="module")
def runtime(make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    return make_runtime(chunk_frames=2)


def test_a_chunk_is_computed_when_the_last_was_taken(runtime: DrapeRuntime):
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions())
    clip = PoseInput(POSES, TRANS, np.zeros(10), TIMES_S)

    async def first() -> float:
        before = runtime.metrics.frames._value.get()
        parts = runtime.parts(plan, clip)
        await anext(parts)
        await asyncio.sleep(0.05)
        return runtime.metrics.frames._value.get() - before

    assert asyncio.run(first()) == 2.0


def test_pasts_are_private_few_and_short_lived(runtime: DrapeRuntime, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(continuations, "MOST", 3)
    past = Continuation(runtime.plan(runtime.garments.get("tube"), DrapeOptions()), np.zeros(10), 30.0, 4, {})
    kept = continuations.Continuations()
    tokens = [kept.token() for _ in range(4)]
    for token, owner in zip(tokens, ("shop", "shop", "mill", "shop"), strict=True):
        kept.put(token, past, owner)
    assert len(kept) == 3 and kept.get(tokens[2], "mill") is past
    for token, owner in ((tokens[0], "shop"), (tokens[2], "shop"), (tokens[1], None)):
        with pytest.raises(NotFound, match="past: expected one of the last 120 s, got one that is not kept"):
            kept.get(token, owner)
    kept._entries[tokens[1]] = replace(kept._entries[tokens[1]], until_s=0.0)
    with pytest.raises(NotFound):
        kept.get(tokens[1], "shop")
    assert kept.get(tokens[3], "shop").frames == 4
