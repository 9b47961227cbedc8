"""POST /drape and /bodies/{id}/posed answer with the right numbers in the right formats."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.geometry.closest import signed_distance
from service.drapery import Draped, Drapery, PoseInput
from service.push import MOVED_M
from service.settings import Settings
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import expected_vertices

BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"
ROUNDING_M = 2e-6  # float32 in the graph, a few metres from the origin


def ask(api: httpx.Client, accept: str | None = None, path: str = "/drape", **fields: object) -> httpx.Response:
    document = {"garment": "tube", **fields} if path == "/drape" else fields
    return api.post(path, json=document, headers={} if accept is None else {"Accept": accept})


def vertices_of(response: httpx.Response) -> np.ndarray:
    assert response.status_code == 200, response.text
    shape = int(response.headers["X-Drape-Frames"]), int(response.headers["X-Drape-Vertices"]), 3
    return np.frombuffer(response.content, "<f4").reshape(shape)


def test_answer_is_the_closed_form(api: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = random_motion(11)
    betas = np.random.default_rng(1).normal(size=10)
    response = ask(api, poses=poses.tolist(), trans=trans.tolist(), betas=betas.tolist(), push_out=False)
    assert response.headers["content-type"] == BINARY
    assert response.headers["X-Drape-Push-Out"] == "0"
    expected = expected_vertices(body, tube, poses, trans, betas)
    assert_allclose(vertices_of(response), expected, rtol=0, atol=ROUNDING_M)


def test_rest_pose_without_translation_is_the_rest_mesh_lifted(api: httpx.Client, body: BodyModel, tube: Garment):
    poses = np.zeros((1, 24, 3))
    vertices = vertices_of(ask(api, poses=poses.tolist(), push_out=False))
    assert_allclose(vertices, expected_vertices(body, tube, poses, np.zeros((1, 3))), rtol=0, atol=ROUNDING_M)


def test_a_body_that_moves_away_keeps_its_precision(api: httpx.Client):
    poses, _ = random_motion(1)
    far = vertices_of(ask(api, poses=poses.tolist(), trans=[[1000.0, 0.0, 0.0]], push_out=False))
    near = vertices_of(ask(api, poses=poses.tolist(), push_out=False))
    half_step_m = 0.5 * float(np.spacing(np.float32(1000.0)))  # 0.03 mm
    assert_allclose(far - [1000.0, 0.0, 0.0], near, rtol=0, atol=half_step_m + ROUNDING_M)


@pytest.mark.parametrize("accept", [None, "*/*", BINARY, "application/*;q=0.9, model/gltf-binary;q=0.1"])
def test_binary_is_what_everybody_gets_who_does_not_ask(api: httpx.Client, accept: str | None):
    response = ask(api, accept, poses=np.zeros((2, 24, 3)).tolist())
    assert response.headers["content-type"] == BINARY
    assert len(response.content) == 2 * 216 * 12


def test_json_holds_the_same_numbers(api: httpx.Client):
    poses, trans = random_motion(3)
    fields = {"poses": poses.tolist(), "trans": trans.tolist(), "fps": 24.0}
    document = ask(api, JSON, **fields).json()
    assert (document["fps"], document["frames"], document["vertices"]) == (24.0, 3, 216)
    assert_array_equal(np.float32(document["positions"]), vertices_of(ask(api, BINARY, **fields)))


def test_glb_is_a_glb(api: httpx.Client):
    response = ask(api, f"{JSON};q=0.5, {GLB}", poses=np.zeros((2, 24, 3)).tolist(), body=True)
    assert response.headers["content-type"] == GLB
    assert response.content[:4] == b"glTF"
    assert int.from_bytes(response.content[8:12], "little") == len(response.content)


def test_posed_body_is_the_body(api: httpx.Client, body: BodyModel):
    poses, trans = random_motion(3)
    betas = [0.5, -1.0]
    path = f"/bodies/{body.name}/posed"
    response = ask(api, path=path, poses=poses.tolist(), trans=trans.tolist(), betas=betas)
    expected = body.posed_vertices(poses, trans, np.array(betas))
    assert_allclose(vertices_of(response), expected, rtol=0, atol=ROUNDING_M)
    assert ask(api, GLB, path=path, poses=poses.tolist()).content[:4] == b"glTF"
    assert ask(api, JSON, path=path, poses=poses[:1].tolist()).json()["vertices"] == body.vertex_count


@pytest.fixture(scope="module")
def drapery(make_settings: Callable[..., Settings]) -> Drapery:
    return Drapery(make_settings())


def test_push_out_brings_cloth_out_of_the_body_and_says_how_far(drapery: Drapery, body: BodyModel):
    poses, trans = random_motion(4, spread_rad=0.35)
    entry, betas = drapery.garments.get("tube"), np.zeros(10)
    plain = drapery.compute(entry, [PoseInput(poses, trans, betas, False)])
    pushed = drapery.compute(entry, [PoseInput(poses, trans, betas, True)])
    posed = body.posed_vertices(poses, trans, betas)

    def inside(draped: Draped) -> np.ndarray:
        world = draped.vertices + draped.root[:, None]
        return np.stack([signed_distance(x, b, body.faces) for x, b in zip(world, posed, strict=True)]) < 0.0

    before, after = inside(plain), inside(pushed)
    assert before.any(axis=1).sum() >= 3, "the fixture must collide for the test to mean something"
    assert after.mean() < 0.25 * before.mean()
    way = np.linalg.norm(pushed.vertices - plain.vertices, axis=-1)
    assert_allclose(pushed.push_max_m, way.max(axis=1), rtol=1e-3, atol=1e-6)
    assert_allclose(pushed.pushed_share, (way > MOVED_M).mean(axis=1), rtol=0, atol=0.01)
    assert not plain.pushed and (plain.push_max_m == 0.0).all()


def test_frames_do_not_depend_on_their_company(drapery: Drapery):
    """Alone, in a batch with other shapes, or in chunks of any size: the same bits."""
    poses, trans = random_motion(6)
    entry = drapery.garments.get("tube")
    shapes = [np.zeros(10), np.full(10, 0.5), np.linspace(-1, 1, 10)]
    inputs = [PoseInput(poses[i : i + 2], trans[i : i + 2], shapes[i // 2], i != 2) for i in (0, 2, 4)]
    together = drapery.compute(entry, inputs)
    alone = [drapery.compute(entry, [one]) for one in inputs]
    assert_array_equal(together.vertices, np.concatenate([one.vertices for one in alone]))
    assert_array_equal(together.root, np.concatenate([one.root for one in alone]))
    assert_array_equal(together.push_max_m, np.concatenate([one.push_max_m for one in alone]))


@pytest.mark.parametrize("chunk", [1, 4, 64])
def test_chunks_join_seamlessly(make_settings: Callable[..., Settings], api: httpx.Client, chunk: int):
    import asyncio

    poses, trans = random_motion(9)
    drapery = Drapery(make_settings(chunk_frames=chunk))
    draped = asyncio.run(drapery.drape(drapery.garments.get("tube"), PoseInput(poses, trans, np.zeros(10), True)))
    assert_array_equal(draped.world(), vertices_of(ask(api, poses=poses.tolist(), trans=trans.tolist(), push_out=True)))
    drapery.close()
