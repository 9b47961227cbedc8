"""Answers that count from the root: the same garment anywhere in the world, and an answer that says which it is."""

from __future__ import annotations

import json

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients.client import DrapeClient
from drape.body.model import BodyModel
from service.stages.placing import Placed
from tests.fixtures.poses import random_motion

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
