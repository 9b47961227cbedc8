"""POST /drape and /bodies/{id}/posed answer with the right numbers in the right formats."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.contact.projection import MOVED_M
from drape.garment.cache import Garment
from drape.garment.files.gltf_mesh import read_glb
from drape.geometry.closest import signed_distance
from drape.stages.batch import Batch, PoseInput
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions, FabricNumbers, Geometry
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import vertices_of
from tests.fixtures.tiny_model import ROUNDING_M, expected_vertices

BINARY, GLB, JSON = "application/octet-stream", "model/gltf-binary", "application/json"


def ask(api: httpx.Client, accept: str | None = None, path: str = "/drape", **fields: object) -> httpx.Response:
    document = {"garment": "tube", **fields} if path == "/drape" else fields
    return api.post(path, json=document, headers={} if accept is None else {"Accept": accept})


def test_answer_is_that_of_the_readable_graph(api: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = random_motion(11)
    betas = np.random.default_rng(1).normal(size=10)
    response = ask(api, poses=poses.tolist(), trans=trans.tolist(), betas=betas.tolist(), push_out=False)
    assert response.headers["content-type"] == BINARY
    assert response.headers["X-Drape-Push-Out"] == "0"
    expected = expected_vertices(body, tube, poses, trans, betas)
    assert_allclose(vertices_of(response), expected, rtol=0, atol=ROUNDING_M)


@pytest.mark.parametrize("accept", [None, "*/*", "application/*", "application/*;q=0.9, model/gltf-binary;q=0.1"])
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


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_quantised_glb_shows_what_float32_does_in_half_the_bytes(api: httpx.Client, origin: str):
    poses, trans = random_motion(9)
    fields = {"poses": poses.tolist(), "trans": np.add(trans, [5.0, 0.0, 2.0]).tolist(), "origin": origin}
    small, large = (ask(api, GLB, quantised=quantised, **fields).content for quantised in (True, False))
    read, plain = (read_glb(content, name="clip", vertex_limit=1000).vertices for content in (small, large))
    assert_allclose(read, plain, rtol=0, atol=2e-5)  # a step of the box of a metre, and float32 at 5 m
    assert len(large) - len(small) > 0.4 * 8 * 216 * 24


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
def runtime(make_settings: Callable[..., Settings]) -> DrapeRuntime:
    return DrapeRuntime(make_settings())


def test_push_out_brings_cloth_out_of_the_body_and_says_how_far(runtime: DrapeRuntime, body: BodyModel):
    poses, trans = random_motion(4, spread_rad=0.35)
    entry, clip = runtime.garments.get("tube"), PoseInput(poses, trans, np.zeros(10), np.arange(4) / 30.0)
    plain, pushed = (
        run(runtime.plan(entry, DrapeOptions(advanced=Advanced(push_out=push))), [clip]) for push in (False, True)
    )
    posed = body.posed_vertices(poses, trans, clip.betas)

    def inside(draped: Batch) -> np.ndarray:
        world = draped.vertices + draped.root[:, None]
        return np.stack([signed_distance(x, b, body.faces) for x, b in zip(world, posed, strict=True)]) < 0.0

    before, after = inside(plain), inside(pushed)
    assert before.any(axis=1).sum() >= 3, "the fixture must collide for the test to mean something"
    assert after.mean() < 0.4 * before.mean()
    way = np.linalg.norm(pushed.vertices - plain.vertices, axis=-1)
    assert_allclose(pushed.quality.push_max_m, way.max(axis=1), rtol=1e-3, atol=1e-6)
    assert_allclose(pushed.quality.pushed_share, (way > MOVED_M).mean(axis=1), rtol=0, atol=0.01)
    assert (plain.quality.push_max_m == 0.0).all()


@pytest.mark.parametrize(("worn", "geometry"), [(["tube", "coat"], "vertices"), (["tube"], "jets")])
def test_frames_do_not_depend_on_their_company(outfit_settings: Settings, worn: list[str], geometry: Geometry):
    """Alone, or in a batch with other shapes: the same bits."""
    runtime = DrapeRuntime(outfit_settings)
    poses, trans = random_motion(6)
    options = DrapeOptions(advanced=Advanced(push_out=True), geometry=geometry)
    plan = runtime.plan(runtime.garments.scene(None, worn), options)
    shapes = [np.zeros(10), np.full(10, 0.5), np.linspace(-1, 1, 10)]
    inputs = [PoseInput(poses[i : i + 2], trans[i : i + 2], shapes[i // 2], np.zeros(2)) for i in (0, 2, 4)]
    together, alone = run(plan, inputs), [run(plan, [one]) for one in inputs]
    if geometry == "jets":
        for name, array in vars(together.jets).items():
            assert_array_equal(array, np.concatenate([getattr(one.jets, name) for one in alone]))
    assert_array_equal(together.vertices, np.concatenate([one.vertices for one in alone]))
    assert_array_equal(together.root, np.concatenate([one.root for one in alone]))
    for name, array in vars(together.quality).items():
        assert_array_equal(array, np.concatenate([getattr(one.quality, name) for one in alone]))
    runtime.close()


def test_chunks_join_seamlessly(make_runtime: Callable[..., DrapeRuntime], api: httpx.Client):
    poses, trans = random_motion(9)
    runtime = make_runtime(chunk_frames=4)
    clip = PoseInput(poses, trans, np.zeros(10), np.arange(9) / 30.0)
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=True)))
    draped = asyncio.run(runtime.drape(plan, clip))
    assert_array_equal(draped.world(), vertices_of(ask(api, poses=poses.tolist(), trans=trans.tolist(), push_out=True)))


def test_a_request_names_a_fabric_of_the_table_or_gives_numbers(api: httpx.Client, body: BodyModel, tube: Garment):
    poses, trans = random_motion(2)
    fields = {"poses": poses.tolist(), "trans": trans.tolist(), "push_out": False}
    listed = {row["id"]: row for row in api.get("/fabrics").json()}
    assert api.get("/health").json()["fabrics"] is True
    assert len(listed) >= 10 and listed["denim"]["source"]
    numbers = {name: listed["denim"][name] for name in FabricNumbers.model_fields}
    expected = expected_vertices(body, tube, poses, trans, fabric=fabric("denim"))
    assert_allclose(vertices_of(ask(api, **fields, fabric=numbers)), expected, rtol=0, atol=ROUNDING_M)
    refused = ask(api, **fields, fabric={"warp_n_per_m": 1.0})
    assert refused.status_code == 400 and "weft_n_per_m" in refused.text
