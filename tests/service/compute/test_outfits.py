"""Outfits over REST and stream: layers in order, out of each other, single garments as before, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from drape.body.assets import load_body
from drape.cloth import metrics
from drape.errors import InputError, NotFound
from drape.garment.cache import Garment
from drape.wire import messages as wire
from service.compute.drape_runtime import DrapeRuntime
from service.compute.garments import Outfit
from service.errors import TooLarge
from service.graphs.engine import Engine
from service.graphs.push import KEPT_OUTFITS, Pusher
from service.settings import Settings
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import outfit_settings, outfit_url
from tests.fixtures.tiny_model import TINY
from tests.service.graphs.test_push import added

BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"
__all__ = ["outfit_settings", "outfit_url"]  # fixtures
POSES = random_motion(2, spread_rad=0.2)[0]


@pytest.fixture(scope="module")
def client(outfit_url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=outfit_url, timeout=60.0) as made:
        yield made


def ask(client: httpx.Client, accept: str = BINARY, **fields: object) -> httpx.Response:
    document = {"poses": POSES.tolist(), **fields}
    return client.post("/drape", json=document, headers={"Accept": accept})


def vertices_of(response: httpx.Response) -> np.ndarray:
    assert response.status_code == 200, response.text
    shape = int(response.headers["X-Drape-Frames"]), int(response.headers["X-Drape-Vertices"]), 3
    return np.frombuffer(response.content, "<f4").reshape(shape)


def test_layers_come_one_after_the_other_and_out_of_each_other(client: httpx.Client, tube: Garment):
    response = ask(client, garments=["tube", "coat"])
    count, faces = tube.vertex_count, tube.faces.astype(np.int64)
    assert response.headers["X-Drape-Garments"] == f"tube:{count},coat:{count}"
    whole = vertices_of(response).astype(np.float64)
    inner, outer = whole[:, :count], whole[:, count:]
    alone = [vertices_of(ask(client, garment=name)).astype(np.float64) for name in ("tube", "coat")]
    assert_array_equal(inner, alone[0])  # what lies over it does not move the innermost
    before, after = metrics.through_pct(alone[1], inner, faces), metrics.through_pct(outer, inner, faces)
    assert before.min() > 10.0, "must be through for the test to mean something"
    assert (after < 0.1 * before).all()  # triangles of 5 x 8 cm are coarser than the samples can follow
    assert float(response.headers["X-Drape-Pushed-Share"]) > 0.1


def test_without_push_out_the_layers_are_the_garments_alone(client: httpx.Client):
    whole = vertices_of(ask(client, garments=["tube", "coat"], push_out=False))
    alone = [vertices_of(ask(client, garment=name, push_out=False)) for name in ("tube", "coat")]
    assert_array_equal(whole, np.concatenate(alone, axis=1))


def test_one_garment_is_answered_as_ever_however_it_is_named(client: httpx.Client):
    one, listed = ask(client, JSON, garment="coat"), ask(client, JSON, garments=["coat"])
    assert one.content == listed.content
    assert set(one.json()) == {"fps", "frames", "vertices", "positions", "origin"}
    assert "X-Drape-Garments" not in one.headers


def test_json_and_glb_hold_every_layer(client: httpx.Client, tube: Garment):
    document = ask(client, JSON, garments=["coat", "tube"]).json()
    count = tube.vertex_count
    assert document["garments"] == [{"id": "coat", "vertices": count}, {"id": "tube", "vertices": count}]
    whole = vertices_of(ask(client, garments=["coat", "tube"]))
    assert_array_equal(np.float32(document["positions"]), whole)
    content = ask(client, GLB, garments=["coat", "tube"]).content
    size = int.from_bytes(content[12:16], "little")
    parsed = json.loads(content[20 : 20 + size])
    assert [mesh["name"] for mesh in parsed["meshes"]] == ["coat", "tube"]
    colours = [material["pbrMetallicRoughness"]["baseColorFactor"] for material in parsed["materials"]]
    assert colours[0] == colours[1] != colours[2] == colours[3]


@pytest.mark.parametrize(
    ("fields", "status", "kind", "word"),
    [
        ({"garments": ["tube", "coat", "tube"]}, 400, "InputError", "tube twice"),
        ({"garments": ["tube", "coat", "cape", "cloak"]}, 413, "TooLarge", "at most 3 layers"),
        ({"garments": ["tube", "hat"]}, 404, "NotFound", "hat"),
        ({"garments": []}, 400, "InputError", "garments"),
        ({"garment": "tube", "garments": ["coat"]}, 400, "InputError", "both"),
        ({}, 400, "InputError", "nothing"),
    ],
)
def test_outfits_that_make_no_sense_are_refused(client: httpx.Client, fields: dict, status: int, kind: str, word: str):
    response = ask(client, **fields)
    assert response.status_code == status
    problem = response.json()
    assert problem["type"] == f"urn:drape:{kind}" and word in problem["detail"]


def test_passes_that_the_model_does_not_have_are_refused(client: httpx.Client, outfit_settings: Settings):
    response = ask(client, garment="tube", passes=2)
    assert response.status_code == 400 and "passes: expected 0 to 1" in response.json()["detail"]
    fewer, every, left_out = (ask(client, garment="tube", passes=passes) for passes in (0, 1, None))
    assert [one.headers["X-Drape-Passes"] for one in (fewer, every, left_out)] == ["0", "1", "1"]
    assert every.content == left_out.content != fewer.content
    assert "passes" in ask(client, garment="tube", passes=-1).json()["name"]
    with pytest.raises(InputError, match="passes"):
        DrapeRuntime(outfit_settings.model_copy(update={"passes": 2}))


def opened(socket: ClientConnection, **fields: object) -> dict:
    socket.send(json.dumps({"type": "open", **fields}))
    return json.loads(socket.recv(timeout=20.0))


def frame_of(socket: ClientConnection, sequence: int) -> wire.Frame:
    socket.send(wire.pack_pose(wire.Pose(sequence, 0.0, np.zeros(3), POSES[0])))
    message = socket.recv(timeout=20.0)
    assert isinstance(message, bytes), message
    return wire.unpack_frame(message)


def test_a_stream_opens_an_outfit_and_turns_back_to_one_garment(outfit_url: str, client: httpx.Client, tube: Garment):
    count = tube.vertex_count
    expected = vertices_of(ask(client, garments=["tube", "coat"]))[0]
    with connect(outfit_url.replace("http", "ws") + "/stream", subprotocols=[Subprotocol(wire.SUBPROTOCOL)]) as socket:
        about = opened(socket, garments=["tube", "coat"])
        assert about["garments"] == [{"id": "tube", "vertices": count}, {"id": "coat", "vertices": count}]
        assert about["vertices"] == 2 * count and "garment" not in about
        frame = frame_of(socket, 1)
        assert np.abs(frame.vertices() - expected).max() < 1e-4 and frame.pushed
        socket.send(wire.pack_ack(1))
        about = opened(socket, garment="tube")
        assert about["garment"] == "tube" and about["vertices"] == count and "garments" not in about
        assert len(frame_of(socket, 2).positions) == count


@pytest.mark.parametrize("garments", [["tube", "tube"], ["tube", "coat", "cape", "cloak"], ["tube", "hat"]])
def test_a_stream_of_no_outfit_is_refused(outfit_url: str, garments: list[str]):
    with connect(outfit_url.replace("http", "ws") + "/stream", subprotocols=[Subprotocol(wire.SUBPROTOCOL)]) as socket:
        said = opened(socket, garments=garments)
        assert said["type"] == "error" and said["kind"] in ("InputError", "TooLarge", "NotFound")


def test_an_outfit_is_its_layers_in_their_order(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    scene = runtime.garments.scene(None, ["coat", "tube", "cape"])
    assert isinstance(scene, Outfit) and scene == runtime.garments.scene(None, ["coat", "tube", "cape"])
    assert scene != runtime.garments.scene(None, ["tube", "coat", "cape"])
    runtime.close()


def test_what_a_registry_refuses(outfit_settings: Settings):
    runtime = DrapeRuntime(outfit_settings)
    registry = runtime.garments
    with pytest.raises(InputError, match="both"):
        registry.scene("tube", ["coat"])
    with pytest.raises(InputError, match="a value"):
        registry.scene(None, None)
    with pytest.raises(TooLarge, match="3 layers"):
        registry.scene(None, ["tube", "coat", "cape", "cloak"])
    with pytest.raises(InputError, match="each garment once"):
        registry.scene(None, ["coat", "coat"])
    runtime.close()


def test_constants_of_outfits_are_kept_and_bounded(tiny_folder: Path, tube: Garment, monkeypatch):
    pusher = added(Pusher(Engine(tiny_folder / "models" / TINY), load_body()), tube, replace(tube, digest="b"))
    first = pusher._layer((tube.digest, "b"))
    pusher.prepare((tube.digest, "b"))
    assert pusher._layer((tube.digest, "b")) is first
    monkeypatch.setattr("service.graphs.push.KEPT_OUTFITS", 1)
    pusher.prepare(("b", tube.digest))
    assert list(pusher._layers) == [("b", tube.digest)] and KEPT_OUTFITS > 1
    with pytest.raises(NotFound, match="hat"):
        pusher.prepare((tube.digest, "hat"))
