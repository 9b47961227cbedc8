"""Answers: the formats of clips, what positions count from, and pieces that keep no stream waiting."""

from __future__ import annotations

import asyncio
import io
import json
import sys
import time
import zipfile
from pathlib import Path
from threading import Event

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients.client import DrapeClient
from drape.body.model import BodyModel
from drape.errors import Unavailable
from drape.export.glb_file import PIECE_BYTES, GlbFile
from drape.stages.placing import Placed
from service.compute import threads
from service.compute.threads import SlicedThread
from service.http.answers import (
    PC2,
    PIECE_NUMBERS,
    USDA,
    USDZ,
    VAT,
    file_answer,
    json_pieces,
    messages_answer,
    number_pieces,
)
from service.http.clip_files import check_package
from tests.fixtures.exports import Usd, UsdGeom, played, read_pc2, read_usda
from tests.fixtures.poses import random_motion

SHAPES = [
    (0,),
    (0, 3),
    (5,),
    (PIECE_NUMBERS + 1,),
    (3, 0),
    (7, 3),
    (PIECE_NUMBERS, 3),
    (2, 9, 3),
    (3, PIECE_NUMBERS, 3),
]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_the_pieces_of_an_array_are_its_lists(shape: tuple[int, ...], dtype: type, rng: np.random.Generator):
    array = (1000.0 * rng.normal(size=shape)).astype(dtype)
    pieces = list(number_pieces(array))
    found = json.loads(b"".join(pieces))
    assert found == array.tolist()
    assert max(piece.count(b",") for piece in pieces) <= PIECE_NUMBERS


def test_a_document_keeps_its_fields_and_every_bit_of_its_numbers(rng: np.random.Generator):
    array = np.concatenate([rng.normal(size=50_000), [0.0, -0.0, 1e-45, 3.4e38, 1e-7]]).astype(np.float32)
    document = {"fps": 29.97, "garments": [{"id": "ä", "vertices": 3}], "positions": array, "uv": [], "n": None}
    found = json.loads(b"".join(json_pieces(document)))
    assert list(found) == list(document)
    assert np.float32(found["positions"]).tobytes() == array.tobytes()
    assert {key: found[key] for key in ("fps", "garments", "uv", "n")} == {
        key: document[key] for key in ("fps", "garments", "uv", "n")
    }


def test_other_work_comes_between_pieces_and_two_are_never_done_at_once():
    sliced_thread, at_work, most = SlicedThread(), 0, 0

    def work() -> None:
        nonlocal at_work, most
        at_work += 1
        most = max(most, at_work)
        time.sleep(0.001)
        at_work -= 1

    async def long(name: str, done: list[str]) -> None:
        async for _ in sliced_thread.run_pieces(work() for _ in range(50)):
            done.append(name)

    async def both() -> list[str]:
        done: list[str] = []
        await asyncio.gather(long("a", done), long("b", done))
        return done

    done = asyncio.run(both())
    sliced_thread.close()
    assert most == 1
    assert done.count("a") == done.count("b") == 50
    assert {"a", "b"} == set(done[:10]) == set(done[45:55])


def test_no_piece_begins_while_a_frame_is_computed():
    sliced_thread, done = SlicedThread(), []

    async def held() -> None:
        async def pieces() -> None:
            async for piece in sliced_thread.run_pieces(iter(range(9))):
                done.append(piece)

        with sliced_thread.hold_back():
            task = asyncio.create_task(pieces())
            await asyncio.sleep(0.05)
            assert done == []
        await task

    asyncio.run(held())
    sliced_thread.close()
    assert done == list(range(9))


def test_a_frame_that_hangs_keeps_neither_pieces_nor_clips(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(threads, "STREAM_PAUSE_S", 0.01)
    sliced_thread, let_go = SlicedThread(), Event()
    compute = threads.ComputeThreads(stream_threads=1, chunk_frames=8, clip_wait_s=1.0)

    async def beside() -> tuple[list[int], str]:
        with sliced_thread.hold_back():
            hangs = asyncio.create_task(compute.for_streams(let_go.wait))
            found = (
                [piece async for piece in sliced_thread.run_pieces(iter(range(9)))],
                await compute.aside(lambda: "a step"),
            )
            let_go.set()
            await hangs
        return found

    try:
        assert asyncio.run(beside()) == (list(range(9)), "a step")
    finally:
        let_go.set()
        sliced_thread.close()
        compute.close()


@pytest.mark.parametrize("sizes", [(), (5,), (PIECE_BYTES, 3), (10_000,) * 100])
def test_messages_are_sent_a_few_at_a_time(sizes: tuple[int, ...]):
    messages = [bytes([i % 251]) * size for i, size in enumerate(sizes)]
    sliced_thread, pieces = SlicedThread(), []

    async def read() -> None:
        answer = messages_answer(messages, sliced_thread, {"X-Drape-Frames": "1"})
        assert answer.headers["Content-Length"] == str(sum(sizes)) and answer.headers["X-Drape-Frames"] == "1"
        pieces.extend([piece async for piece in answer.body_iterator])

    asyncio.run(read())
    sliced_thread.close()
    assert b"".join(pieces) == b"".join(messages)
    assert all(len(piece) <= PIECE_BYTES for piece in pieces)


def test_a_file_is_sent_as_it_would_be_written(rng: np.random.Generator):
    file, sliced_thread, pieces = GlbFile(), SlicedThread(), []
    arrays = [rng.normal(size=(count, 3)).astype(np.float32) for count in (50_000, 1, 7)]
    indices = [file.array(array) for array in [*arrays, np.arange(3, dtype=np.uint8), arrays[1]]]

    async def read() -> None:
        answer = file_answer(file, file.head(), sliced_thread, {})
        pieces.extend([piece async for piece in answer.body_iterator])
        assert answer.headers["Content-Length"] == str(sum(len(piece) for piece in pieces))

    asyncio.run(read())
    sliced_thread.close()
    whole = b"".join(pieces)
    assert whole == file.to_bytes() and max(len(piece) for piece in pieces[1:]) <= PIECE_BYTES
    for array, index in zip(arrays, indices, strict=False):
        view = file.json["bufferViews"][file.json["accessors"][index]["bufferView"]]
        start = len(pieces[0]) + view["byteOffset"]
        assert whole[start : start + view["byteLength"]] == array.tobytes()


BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"
FAR_M = (1e4, 9.9e5)


def ask(api: httpx.Client, accept: str, path: str = "/drape", **fields: object) -> httpx.Response:
    poses, trans = random_motion(3)
    asked = {"poses": poses.tolist(), "trans": trans.tolist(), **fields}
    if path == "/drape":
        asked |= {"garment": "tube", "folds": 0}
    return api.post(path, json=asked, headers={"Accept": accept}).raise_for_status()


def moved(far_m: float) -> list[list[float]]:
    return (random_motion(3)[1] + np.array([far_m, 0.0, -far_m])).tolist()


def parts(response: httpx.Response) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and roots of a binary answer."""
    frames, vertices = (int(response.headers[f"X-Drape-{name}"]) for name in ("Frames", "Vertices"))
    assert len(response.content) == 12 * frames * vertices + 24 * frames
    first = np.frombuffer(response.content, "<f4", 3 * frames * vertices).reshape(frames, vertices, 3)
    return first, np.frombuffer(response.content, "<f8", offset=first.nbytes).reshape(frames, 3)


def glb_json(response: httpx.Response) -> dict:
    return json.loads(response.content[20 : 20 + int.from_bytes(response.content[12:16], "little")])


@pytest.mark.parametrize("far_m", FAR_M)
@pytest.mark.parametrize("path", ["/drape", "/bodies/{body}/posed"])
def test_a_shape_is_the_same_at_any_root(api: httpx.Client, body: BodyModel, path: str, far_m: float):
    """Guards against edges that float32 world coordinates stretch: to more than twice at 1e6 m."""
    path = path.format(body=body.name)
    near, roots = parts(ask(api, BINARY, path, origin="root"))
    far, far_roots = parts(ask(api, BINARY, path, origin="root", trans=moved(far_m)))
    assert_array_equal(far, near)
    assert_allclose(far_roots - roots, np.tile([far_m, 0.0, -far_m], (3, 1)), rtol=0.0, atol=1e-9)
    world = np.frombuffer(ask(api, BINARY, path).content, "<f4").reshape(near.shape)
    assert_allclose(near + roots[:, None], world, rtol=0.0, atol=1e-6)


def test_an_answer_says_what_it_counts_from_and_how_far_it_is_rounded(api: httpx.Client):
    """Guards against a client that adds the root twice, or takes a rounded garment for the drape."""
    for origin, far_m, step_m in (("world", 9.9e5, 0.03125), ("world", 0.0, 1.2e-7), ("root", 9.9e5, 1.2e-7)):
        headers = ask(api, BINARY, origin=origin, trans=moved(far_m)).headers
        assert headers["X-Drape-Origin"] == origin
        assert float(headers["X-Drape-Rounding-M"]) <= step_m
    assert ask(api, BINARY, trans=moved(9.9e5)).headers["X-Drape-Rounding-M"] == "0.0312"
    assert ask(api, BINARY, geometry="jets").headers["X-Drape-Origin"] == "root"


def test_json_holds_the_roots_beside_the_positions(api: httpx.Client):
    vertices, roots = parts(ask(api, BINARY, origin="root", trans=moved(9.9e5)))
    document = ask(api, JSON, origin="root", trans=moved(9.9e5)).json()
    assert document["origin"] == "root"
    assert_array_equal(np.float32(document["positions"]), vertices)
    assert_array_equal(document["roots"], roots)
    plain = ask(api, JSON).json()
    assert plain["origin"] == "world" and "roots" not in plain


@pytest.mark.parametrize("with_body", [False, True])
def test_a_glb_stands_under_a_node_at_the_first_root(api: httpx.Client, with_body: bool):
    """Guards against a GLB whose positions are rounded: float64 is only in its JSON."""
    near, far = (ask(api, GLB, origin="root", trans=moved(m), body=with_body) for m in (0.0, 9.9e5))
    (top, *others), nodes = glb_json(far)["scenes"][0]["nodes"], glb_json(far)["nodes"]
    assert nodes[top]["name"] == "root"
    assert_allclose(
        nodes[top]["translation"], parts(ask(api, BINARY, origin="root", trans=moved(9.9e5)))[1][0], rtol=0.0
    )
    assert len(nodes[top]["children"]) == 1 + with_body and ["skin" in nodes[i] for i in others] == [True] * with_body
    for a, b in zip(glb_json(near)["accessors"], glb_json(far)["accessors"], strict=True):
        if "min" in a:
            assert_allclose(a["min"] + a["max"], b["min"] + b["max"], rtol=0.0, atol=1e-6)


def test_a_posed_body_is_a_glb_at_its_root(api: httpx.Client, body: BodyModel):
    path = f"/bodies/{body.name}/posed"
    nodes = glb_json(ask(api, GLB, path, origin="root", trans=moved(9.9e5)))["nodes"]
    placed = next(node for node in nodes if node["name"] == "root")
    expected = moved(9.9e5)[0] + body.rest_joints()[0]
    assert_allclose(placed["translation"], expected, rtol=0.0, atol=1e-9)


def test_the_client_gives_vertices_and_roots(api: httpx.Client):
    poses, _ = random_motion(3)
    with DrapeClient(str(api.base_url)) as client:
        vertices, roots = client.drape_at_root("tube", poses, trans=np.array(moved(9.9e5)), folds=0)
        near = client.drape("tube", poses, trans=np.array(moved(0.0)), folds=0)
    assert vertices.dtype == np.float32 and roots.dtype == np.float64
    assert_allclose(vertices + (roots - [9.9e5, 0.0, -9.9e5])[:, None], near, rtol=0.0, atol=1e-6)


def test_another_origin_is_refused(api: httpx.Client):
    answer = api.post("/drape", json={"garment": "tube", "poses": random_motion(1)[0].tolist(), "origin": "moon"})
    assert answer.status_code == 400 and answer.json()["name"] == "origin"


def test_a_clip_counts_from_its_first_root_where_it_has_one():
    placed = Placed(np.zeros((2, 1, 3), np.float32), np.array([[1e6, 0.0, 0.0], [1e6 + 0.25, 0.0, 0.0]]))
    vertices, point = placed.from_first()
    assert_array_equal(vertices[:, 0, 0], [0.0, 0.25])
    assert_array_equal(point, [1e6, 0.0, 0.0])
    assert_array_equal(Placed(placed.vertices).from_first()[1], np.zeros(3))


EXPORTS_BINARY = "application/octet-stream"
POSES, TRANS = random_motion(3)


def exports_ask(url: str, accept: str, **fields: object) -> httpx.Response:
    asked = {"garments": ["coat", "tube"], "poses": POSES.tolist(), "trans": (10.0 + TRANS).tolist(), "fps": 25.0}
    answer = httpx.post(url + "/drape", json=asked | fields, headers={"Accept": accept}, timeout=60.0)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == accept
    return answer


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_point_cache_has_the_layers_one_after_the_other(outfit_url: str, tmp_path: Path, origin: str):
    plain = np.frombuffer(exports_ask(outfit_url, EXPORTS_BINARY).content, "<f4").reshape(3, 432, 3)
    rooted = exports_ask(outfit_url, EXPORTS_BINARY, origin="root").content
    first = np.frombuffer(rooted, "<f8", offset=3 * 432 * 12)[:3] if origin == "root" else np.zeros(3)
    for streamed in (False, True):
        path = tmp_path / "clip.pc2"
        path.write_bytes(exports_ask(outfit_url, PC2, origin=origin, streamed=streamed).content)
        assert_allclose(read_pc2(path) + first, plain, rtol=0, atol=2e-6 if origin == "root" else 0)


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_scene_has_a_mesh_for_each_layer(outfit_url: str, origin: str):
    plain = np.frombuffer(exports_ask(outfit_url, EXPORTS_BINARY).content, "<f4").reshape(3, 432, 3)
    scene = read_usda(exports_ask(outfit_url, USDA, origin=origin).text)
    assert scene.stage.GetTimeCodesPerSecond() == 25.0
    assert (np.abs(scene.translate) > 5.0).any() == (origin == "root")
    assert list(scene.meshes) == ["coat", "tube"]
    for mesh, own in zip(scene.meshes.values(), np.split(plain, 2, axis=1), strict=True):
        assert_allclose(mesh.points + scene.translate, own, rtol=0, atol=1e-5)


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_scene_in_one_file_and_a_texture_have_the_frames(outfit_url: str, tmp_path: Path, origin: str):
    plain = np.frombuffer(exports_ask(outfit_url, EXPORTS_BINARY).content, "<f4").reshape(3, 432, 3)
    (tmp_path / "clip.usdz").write_bytes(exports_ask(outfit_url, USDZ, origin=origin).content)
    stage = Usd.Stage.Open(str(tmp_path / "clip.usdz"))
    assert stage.GetTimeCodesPerSecond() == 25.0 and stage.GetEndTimeCode() == 2.0
    meshes = [UsdGeom.Mesh(stage.GetPrimAtPath(f"/clip/{name}")) for name in ("coat", "tube")]
    place = UsdGeom.XformCache(0).GetLocalToWorldTransform(meshes[0].GetPrim()).ExtractTranslation()
    for frame, given in enumerate(plain):
        found = np.concatenate([np.array(mesh.GetPointsAttr().Get(frame)) for mesh in meshes])
        assert_allclose(found + np.array(place), given, rtol=0, atol=2e-6)
    with zipfile.ZipFile(io.BytesIO(exports_ask(outfit_url, VAT, origin=origin).content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    places, _, _ = played(files, "coat_tube")
    first = np.zeros(3) if origin == "world" else np.array(place)
    assert_allclose(places[:, :432] + first, plain, rtol=0, atol=3e-6)


@pytest.mark.parametrize(("kind", "package"), [(USDZ, "pxr.Usd"), (VAT, "OpenEXR")])
def test_a_kind_whose_package_is_missing_is_refused(kind: str, package: str, monkeypatch: pytest.MonkeyPatch):
    check_package(kind)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(Unavailable, match="got none"):
        check_package(kind)


def test_a_scene_cannot_be_streamed_nor_jets_be_a_cache(api: httpx.Client):
    asked = {"garment": "tube", "poses": POSES.tolist(), "streamed": True}
    assert api.post("/drape", json=asked, headers={"Accept": USDA}).status_code == 406
    asked |= {"streamed": False, "geometry": "jets"}
    assert api.post("/drape", json=asked, headers={"Accept": PC2}).status_code == 406
