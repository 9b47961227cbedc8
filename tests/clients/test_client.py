"""The Python clients against a running service."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients import calls
from clients.client import AsyncDrapeClient, DrapeClient
from clients.job_steps import check_deadline, finished_id
from clients.refusals import ServiceError, problem_error
from clients.stream import DrapeStream
from drape.body.model import BodyModel
from drape.errors import BodyError, DrapeError, InputError, MeshError, MotionError, NotFound, Unavailable
from drape.garment.cache import Garment
from drape.motion import samples
from drape.motion.clip import MotionClip
from drape.wire.clip_message import unpack_clip
from drape.wire.options import options_document
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import ROUNDING_M, expected_vertices


def asked(url: str, call: Callable[[AsyncDrapeClient], Awaitable[Any]], **options: Any) -> Any:
    """What an asynchronous client of ``url`` answers to ``call``."""

    async def whole() -> Any:
        async with AsyncDrapeClient(url, **options) as client:
            return await call(client)

    return asyncio.run(whole())


def streamed(url: str, talk: Callable[[DrapeStream], Awaitable[None]], **options: Any) -> None:
    """Has ``talk`` over a stream of the tube."""

    async def whole() -> None:
        async with await DrapeStream.open(url, "tube", **options) as stream:
            await talk(stream)

    asyncio.run(whole())


def test_sync_and_async_say_the_same(live: str, body: BodyModel, tube: Garment):
    poses, trans = random_motion(3)
    betas = np.linspace(-1, 1, 10)
    clip = MotionClip(poses, trans, 30.0, "random")
    with DrapeClient(live) as client:
        assert client.health()["status"] == "ok"
        assert [garment["id"] for garment in client.garments()] == ["tube"]
        assert "walk" in [motion["id"] for motion in client.motions()]
        assert [tier["id"] for tier in client.tiers()] == ["instant", "fast", "balanced", "accurate"]
        assert_array_equal(client.mesh("tube")["faces"], tube.faces)
        vertices = client.drape("tube", clip, betas=betas, push_out=False)
        again = client.drape("tube", poses, trans=trans, betas=betas, push_out=False)
        file = client.drape_glb("tube", clip, body=True)
        assert_array_equal(client.body_mesh(body.name)["faces"], body.faces)
        posed = client.posed_body(body.name, clip)
        walk = client.motion("walk")

    async def same(client: AsyncDrapeClient) -> None:
        assert (await client.health())["status"] == "ok"
        assert await client.bodies() == [
            {"id": body.name, "digest": body.digest, "vertices": 13348, "faces": 26692, "shapes": 10}
        ]
        assert len(await client.garments()) == 1 and len(await client.motions()) > 3
        assert_array_equal((await client.mesh("tube"))["faces"], tube.faces)
        assert_array_equal(await client.drape("tube", clip, betas=betas, push_out=False), vertices)
        assert_array_equal(await client.posed_body(body.name, clip), posed)
        assert (await client.drape_glb("tube", clip, body=True))[:4] == file[:4] == b"glTF"
        assert_array_equal((await client.motion("walk")).poses, walk.poses)
        assert_allclose((await client.placed(samples.walk())).trans, walk.trans, rtol=0, atol=1e-5)

    asked(live, same)
    with DrapeClient(live) as client:
        assert len(client.drape_glb("tube", clip, body=True, quantised=False)) > len(file)
    assert_array_equal(vertices, again)
    assert_allclose(vertices, expected_vertices(body, tube, poses, trans, betas), rtol=0, atol=ROUNDING_M)
    assert_allclose(posed, body.posed_vertices(poses, trans), rtol=0, atol=2e-6)


def test_measures_become_a_shape_on_which_a_garment_tells_its_fit(live: str, body: BodyModel, tube: Garment):
    pose = np.full((24, 3), 0.01)
    with DrapeClient(live) as client:
        shape = client.shape(height_m=1.75, waist_m=0.85)
        betas = np.array(shape["betas"])
        assert client.measures(betas)["measures"] == shape["measures"]
        assert_allclose([shape["measures"][name] for name in ("height_m", "waist_m")], [1.75, 0.85], atol=2e-3)
        found = client.fit("tube", betas=betas, pose=pose, fabric=None, vertices=True)
        assert len(found["weft"]) == len(tube.vertices) and found["words"]
        assert "weft" not in client.fit("tube")
        with pytest.raises(BodyError, match=r"height_m: expected 1\.259 to 2\.408 m"):
            client.shape(height_m=175.0)
    assert asked(live, lambda client: client.shape(height_m=1.75, waist_m=0.85)) == shape
    assert asked(live, lambda client: client.fit("tube", betas=betas, pose=pose, vertices=True)) == found


def test_a_clip_from_a_file_is_placed_like_the_shipped_one(live: str):
    betas = np.array([1.0, -1.0])
    with DrapeClient(live) as client:
        placed = client.placed(samples.walk(), betas)
        assert_allclose(placed.trans, client.motion("walk", betas).trans, rtol=0, atol=1e-5)


def test_refusals_come_back_as_themselves(live: str, tmp_path: Path):
    with DrapeClient(live) as client:
        with pytest.raises(NotFound, match="garment: expected one of: tube, got cape"):
            client.drape("cape", np.zeros((1, 24, 3)))
        with pytest.raises(MotionError, match=r"poses: expected shape \(any, 24, 3\), got shape \(1, 23, 3\)"):
            client.drape("tube", np.zeros((1, 23, 3)))
        with pytest.raises(MotionError, match="poses: expected finite"):
            client.drape("tube", np.full((1, 24, 3), np.nan))
        with pytest.raises(NotFound, match="motion"):
            client.motion("swim")
        noise = tmp_path / "noise.obj"
        noise.write_bytes(b"nothing here\n")
        with pytest.raises(MeshError):
            client.upload_garment(noise, {"betas": [0.0]})
        with pytest.raises(InputError, match=r"one of \.obj"):
            client.upload_garment(tmp_path / "shirt.dae")
        with pytest.raises(InputError, match="a file that can be read"):
            client.upload_garment(tmp_path / "absent.obj")
        with pytest.raises(Unavailable, match="within 0 s"):
            client.upload_garment(noise, "standard", name="later", wait_s=0.0)


def test_an_upload_that_is_left_while_it_waits_is_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    job = {"id": "1", "name": "shirt", "state": "running", "garment": None, "problem": None}
    requests: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        requests.append(f"{request.method} {request.url.path}")
        return httpx.Response(200, json=job)

    def left(client: AsyncDrapeClient) -> Awaitable[str]:
        return asyncio.wait_for(client.upload_garment(tmp_path / "shirt.obj", "standard"), 0.1)

    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    (tmp_path / "shirt.obj").write_bytes(b"")
    with pytest.raises(TimeoutError):
        asked("http://example", left, transport=httpx.MockTransport(answer))
    monkeypatch.setattr("clients.client.time.sleep", interrupted)
    with (
        DrapeClient("http://example", transport=httpx.MockTransport(answer)) as client,
        pytest.raises(KeyboardInterrupt),
    ):
        client.upload_garment(tmp_path / "shirt.obj", "standard")
    assert requests == ["POST /garments", "DELETE /jobs/1"] * 2


def test_no_service_is_said_with_its_cure():
    with DrapeClient("http://127.0.0.1:9") as client, pytest.raises(Unavailable, match=r"service at .*make serve"):
        client.health()
    with pytest.raises(Unavailable, match="make serve"):
        asked("http://127.0.0.1:9", lambda client: client.health())
    with pytest.raises(Unavailable, match="make serve"):
        asyncio.run(DrapeStream.open("http://127.0.0.1:9", "tube"))


def test_an_answer_of_another_program_is_told_apart():
    transport = httpx.MockTransport(lambda request: httpx.Response(502, text="<html>bad gateway"))
    with DrapeClient("http://example", transport=transport) as client, pytest.raises(ServiceError, match="status 502"):
        client.health()
    unknown = {"type": "urn:drape:Novelty", "name": "a", "expected": "b", "got": "c", "cure": "d"}
    assert type(problem_error(unknown)) is ServiceError
    assert type(problem_error(unknown | {"type": "urn:drape:MeshError"})) is MeshError
    assert type(problem_error(unknown | {"type": "urn:drape:annotations"})) is ServiceError


def test_jobs_end_in_a_garment_or_a_refusal():
    job = {"id": "1", "name": "shirt", "state": "running", "garment": None, "problem": None}
    assert finished_id(job) is None
    assert finished_id(job | {"state": "done", "garment": "shirt"}) == "shirt"
    problem = {"type": "urn:drape:MeshError", "name": "shirt", "expected": "b", "got": "c", "cure": "d"}
    with pytest.raises(MeshError, match="shirt"):
        finished_id(job | {"state": "failed", "problem": problem})
    with pytest.raises(Unavailable, match="upload shirt: expected its end, got one that was cancelled"):
        finished_id(job | {"state": "cancelled"})
    with pytest.raises(Unavailable, match="GET /jobs/1"):
        check_deadline(job, deadline=0.0, wait_s=0.0)


def test_the_stream_client_gets_its_frames(live: str, body: BodyModel, tube: Garment):
    poses, trans = random_motion(5)

    async def talk(stream: DrapeStream) -> None:
        assert stream.about["vertices"] == 216
        for pose, place in zip(poses, trans, strict=True):
            sequence = await stream.send(pose, place)
            received = await stream.receive()
            assert received.frame.sequence == sequence
            assert 0.0 < received.age_s < PATIENT_S
            expected = expected_vertices(body, tube, pose[None], place[None])[0]
            assert_allclose(received.frame.vertices(), expected, rtol=0, atol=5e-5)
        assert (await stream.reopen("tube", push_out=True))["push_out"] is True
        await stream.send(poses[0])
        assert (await stream.receive()).frame.pushed

    streamed(live, talk, betas=np.zeros(10), push_out=False)


def test_knob_and_passes_reach_the_service(live: str):
    """What is refused, and by which name, tells what was sent; a static model has knob 0."""
    poses, trans = random_motion(2)
    words = {"knob": (3.0, "motion: expected"), "passes": (2, "passes: expected 0 to 1")}

    with DrapeClient(live) as client:
        for name, (value, sentence) in words.items():
            options = {name: value}
            for call in (client.drape, client.drape_jets, client.drape_glb):
                with pytest.raises(InputError, match=sentence):
                    call("tube", poses, **options)
            with pytest.raises(InputError, match=sentence):
                client.drape_outfit(["tube"], poses, **options)
            with pytest.raises(InputError, match=sentence):
                asked(live, lambda client, chosen=options: client.drape("tube", poses, **chosen))
            with pytest.raises(InputError, match=sentence):
                asyncio.run(DrapeStream.open(live, "tube", **options))
        still = client.drape("tube", poses, trans=trans, knob=0.0)
        assert_array_equal(still, client.drape("tube", poses, trans=trans))  # a static model


def test_a_call_leaves_to_the_service_what_was_not_chosen():
    assert options_document({"push_out": None, "passes": None}) == {}
    chosen = {"push_out": False, "knob": 0.0, "passes": 0, "geometry": "jets"}
    assert options_document(chosen) == {"push_out": False, "motion": 0.0, "passes": 0, "geometry": "jets"}


def test_an_option_that_there_is_not_is_a_mistake_of_the_program():
    said = r"no such option: pushout\. Did you mean push_out\? There are"
    with DrapeClient("http://example") as client, pytest.raises(TypeError, match=said):
        client.drape("tube", np.zeros((1, 24, 3)), pushout=False)


def test_the_stream_client_hears_why_it_ended(live: str):
    async def senseless(stream: DrapeStream) -> None:
        await stream.send(np.full((24, 3), np.nan))
        await stream.receive()

    async def told(stream: DrapeStream) -> None:
        await stream._connection.send(b"noise")
        await stream.receive()

    async def closed(stream: DrapeStream) -> None:
        await stream._connection.send(b"noise")
        await stream._connection.wait_closed()  # so that sending is what fails
        await stream.send(np.zeros((24, 3)))

    async def too_long(stream: DrapeStream) -> None:
        await stream._connection.send(b"\0" * 100_000)
        await stream.receive()

    with pytest.raises(NotFound, match="cape"):
        asyncio.run(DrapeStream.open(live, "cape"))
    for talk, sentence in ((senseless, "finite"), (told, "at least 16 bytes"), (closed, "at least 16 bytes")):
        with pytest.raises(InputError, match=sentence):
            streamed(live, talk)
    with pytest.raises(DrapeError, match="close 1009"):  # without a word it is told by its code
        streamed(live, too_long)


def test_requests_carry_their_poses_in_binary_and_the_rest_as_json():
    call = calls.drape_call(
        calls.read_vertices, "tube", np.zeros((1, 24, 3), np.float32), calls.BodyShape(), {"folds": 0}
    )
    arguments = call.arguments()
    assert arguments["headers"]["Content-Type"] == "application/octet-stream" and arguments["json"] is None
    text, poses, trans = unpack_clip(arguments["content"])
    assert json.loads(text) == {"garment": "tube", "fps": 30.0, "folds": 0, "streamed": True}
    assert poses.shape == (1, 24, 3) and trans is None
