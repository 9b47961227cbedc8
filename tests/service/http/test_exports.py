"""Files for programs of animation over REST."""

from __future__ import annotations

from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.fixtures.exports import read_pc2, read_usda
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import outfit_settings, outfit_url

__all__ = ["outfit_settings", "outfit_url"]  # fixtures
PC2, USDA, BINARY = "application/x-pc2", "model/vnd.usda", "application/octet-stream"
POSES, TRANS = random_motion(3)


def ask(url: str, accept: str, **fields: object) -> httpx.Response:
    asked = {"garments": ["coat", "tube"], "poses": POSES.tolist(), "trans": (10.0 + TRANS).tolist(), "fps": 25.0}
    answer = httpx.post(url + "/drape", json=asked | fields, headers={"Accept": accept}, timeout=60.0)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == accept
    return answer


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_point_cache_has_the_layers_one_after_the_other(outfit_url: str, tmp_path: Path, origin: str):
    plain = np.frombuffer(ask(outfit_url, BINARY).content, "<f4").reshape(3, 432, 3)
    rooted = ask(outfit_url, BINARY, origin="root").content
    first = np.frombuffer(rooted, "<f8", offset=3 * 432 * 12)[:3] if origin == "root" else np.zeros(3)
    for streamed in (False, True):
        path = tmp_path / "clip.pc2"
        path.write_bytes(ask(outfit_url, PC2, origin=origin, streamed=streamed).content)
        assert_allclose(read_pc2(path) + first, plain, rtol=0, atol=2e-6 if origin == "root" else 0)


@pytest.mark.parametrize("origin", ["world", "root"])
def test_a_scene_has_a_mesh_for_each_layer(outfit_url: str, origin: str):
    plain = np.frombuffer(ask(outfit_url, BINARY).content, "<f4").reshape(3, 432, 3)
    scene = read_usda(ask(outfit_url, USDA, origin=origin).text)
    assert scene.head["timeCodesPerSecond"] == "25.0"
    assert (np.abs(scene.translate) > 5.0).any() == (origin == "root")
    assert list(scene.meshes) == ["coat", "tube"]
    for mesh, own in zip(scene.meshes.values(), np.split(plain, 2, axis=1), strict=True):
        assert_allclose(mesh.points + scene.translate, own, rtol=0, atol=1e-5)


def test_a_scene_cannot_be_streamed_nor_jets_be_a_cache(api: httpx.Client):
    asked = {"garment": "tube", "poses": POSES.tolist(), "streamed": True}
    assert api.post("/drape", json=asked, headers={"Accept": USDA}).status_code == 406
    asked |= {"streamed": False, "geometry": "jets"}
    assert api.post("/drape", json=asked, headers={"Accept": PC2}).status_code == 406


def test_binary_stays_the_default_among_the_new_kinds(api: httpx.Client):
    asked = {"garment": "tube", "poses": POSES.tolist()}
    answers = [api.post("/drape", json=asked, headers={"Accept": accept}) for accept in ("*/*", "application/*")]
    assert [answer.headers["content-type"] for answer in answers] == [BINARY, BINARY]
    assert answers[0].content == answers[1].content
