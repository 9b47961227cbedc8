"""Blender's add-on as far as it needs no Blender: requests, the character's file, the start of a service, the zip."""

from __future__ import annotations

import ast
import http.server
import os
import sys
import threading
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients.client import DrapeClient
from drape.avatar.character import character_in
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import InputError
from drape.files.gltf import GltfFile
from drape.wire.clip_message import pack_clip
from service.settings import Settings
from tests.clients.addon import ADDON, addon_module, addon_zip
from tests.fixtures.patience import wait_until
from tests.fixtures.poses import smooth_motion

calls, local, files = (addon_module(name) for name in ("service_calls", "local_service", "character_file"))
BODY_FILES = ("armature.py", "bake.py", "garment_object.py", "our_body.py", "__init__.py")
FRAMES = 50  # more than the service takes at once


@pytest.fixture(scope="module")
def service(api: httpx.Client) -> Any:
    return calls.Service(str(api.base_url))


@contextmanager
def answering(answer: bytes) -> Iterator[str]:
    """The address of a server that gives every request the same bytes, and leaves."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.wfile.write(answer)

        do_POST = do_GET

        def log_message(self, *words: object) -> None: ...

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_clip_is_packed_as_the_wire_has_it():
    draw = np.random.default_rng(0)
    for turns in (draw.normal(size=(3, 24, 3)), draw.normal(size=(3, 7, 4))):
        places = draw.normal(size=(3, 3))
        assert calls.packed_clip({"garment": "a"}, turns, places) == pack_clip({"garment": "a"}, turns, places)


def test_joints_have_their_order_and_refusals_their_sentence():
    source = (ADDON / "armature.py").read_text(encoding="utf-8")
    (told,) = [n.value for n in ast.parse(source).body if isinstance(n, ast.Assign) and "JOINTS" in ast.unparse(n)]
    assert ast.literal_eval(told) == JOINT_NAMES
    words = {"expected": "b", "got": "c", "cure": "D."}
    assert str(calls.Refusal("a", **words)) == str(InputError("a", **words))


def test_a_long_clip_is_draped_in_pieces_as_by_our_client(service: Any, settings: Settings, api: httpx.Client):
    poses, trans = smooth_motion(np.arange(FRAMES) / 30.0)
    assert settings.max_frames < FRAMES
    heard: list[float] = []
    about = {"garment": "tube", "fps": 30.0}
    found = calls.draped(service, about, poses, trans, lambda share, words: heard.append(share))
    with DrapeClient(str(api.base_url)) as client:
        parts = client.drape_frames("tube", poses, trans=trans, at_once=settings.max_frames)
        assert_array_equal(found, np.concatenate([layers[0] for layers in parts]))
    assert heard == sorted(heard) and heard[0] == 0.0 and 0.5 < heard[-1] <= 1.0


def test_what_hears_of_the_drape_may_end_it(service: Any):
    poses, trans = smooth_motion(np.arange(9) / 30.0)

    def told(share: float, words: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calls.draped(service, {"garment": "tube"}, poses, trans, told)


def test_refusals_are_the_services_own_sentences(service: Any, api: httpx.Client):
    told = api.get("/garments/gone/mesh").json()["detail"]
    with pytest.raises(calls.Refusal) as refused:
        service.json("garments", "gone", "mesh")
    assert str(refused.value) == told
    with pytest.raises(calls.Refusal, match=r"blender_a: skin|expected .* got"):
        calls.avatar_of(service, b"no character", "blender_a", lambda share, words: None)


@pytest.mark.parametrize("url", ["", "drape", "ftp://127.0.0.1", "http://"])
def test_what_is_no_address_is_refused(url: str):
    with pytest.raises(calls.Refusal, match=r"address: expected one such as http://127\.0\.0\.1:8000"):
        calls.Service(url)


def test_another_machine_is_told_from_this_one():
    urls = ("http://127.0.0.1:1", "http://localhost:1", "http://[::1]:1", "https://drape.example")
    assert [calls.Service(url).is_local for url in urls] == [True, True, True, False]


HEAD = b"HTTP/1.0 200 OK\r\nX-Drape-Vertices: 4\r\nContent-Length: 96\r\n\r\n"


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (b"HTTP/1.0 200 OK\r\n\r\n<html>", "expected an answer of the drape service, got another. Check"),
        (b"HTTP/1.0 500 Broken\r\n\r\n<html>", "expected an answer of the drape service, got status 500. Check"),
        (b'HTTP/1.0 404 No\r\n\r\n{"detail": "no"}', "expected an answer of the drape service, got status 404. Check"),
        (b"", "expected an answer, got .+ Start it"),
        (HEAD + b"only a few", "expected an answer, got one that broke off. Start it"),
    ],
)
def test_strangers_and_broken_answers_are_refused_in_a_sentence(answer: bytes, sentence: str):
    def ask() -> None:
        other = calls.Service(url)
        if answer.startswith(HEAD):
            other.json = lambda *names: {"max_frames": 9, "max_body_bytes": 2**20}
            calls.draped(other, {}, np.zeros((2, 24, 3)), np.zeros((2, 3)), lambda share, words: None)
        other.json("health")

    with answering(answer) as url, pytest.raises(calls.Refusal, match=sentence):
        ask()
    with pytest.raises(calls.Refusal, match=r"service at http.*: expected an answer, got .*refused"):
        calls.Service(url).json("health")


def test_the_characters_file_is_read_as_it_was_written(body: BodyModel):
    names, parents = ("hip", "leg", "hip surface"), (-1, 0, 0)
    places = np.array([[0.0, 1.0, 0.0], [0.1, 0.5, 0.0], [0.0, 1.5, 0.2]])
    weights = np.zeros((len(body.v_template), 4))
    weights[:, 0], weights[:, 1] = 0.75, 0.25
    joints = np.zeros(weights.shape, int)
    joints[:, 1] = 1 + np.arange(len(joints)) % 2
    surface = body.v_template, body.faces, joints, weights
    read = character_in(GltfFile(files.character_glb(names, parents, places, surface), label="it"))
    order = [read.names.index(name) for name in names]
    assert [read.parents[place] for place in order] == [-1, order[0], order[0]]
    assert_allclose(read.places[order], places, rtol=0, atol=1e-6)
    assert_allclose(np.sort(read.vertices, axis=0), np.sort(body.v_template, axis=0), rtol=0, atol=1e-6)
    assert_allclose(read.weights[:, order[0]].toarray(), 0.75, rtol=0, atol=1e-6)
    assert len(read.faces) == len(body.faces) and len(read.names) == 4  # the last one holds the surface


@pytest.mark.parametrize("given", ["", "  ", "/nowhere/at/all", str(ADDON)])
def test_what_is_no_environment_is_refused(given: str):
    with pytest.raises(local.Refusal, match="environment: expected one of Python"):
        local.python_of(given)


def test_an_environment_is_named_by_its_folder_or_its_interpreter(tmp_path: Path):
    folder = "Scripts/python.exe" if os.name == "nt" else "bin/python"
    python = tmp_path / ".venv" / folder
    python.parent.mkdir(parents=True)
    python.touch()
    assert {local.python_of(str(path)) for path in (tmp_path, tmp_path / ".venv", python)} == {python}


def test_an_interpreter_that_does_not_start_and_one_without_the_product_are_refused(tmp_path: Path):
    file = tmp_path / "python"
    file.write_text("no program")
    with pytest.raises(local.Refusal, match=r"environment: expected a Python that starts, got .*python: "):
        local.LocalService(str(file))
    bare = tmp_path / "bare"
    bare.write_text(f"#!/bin/sh\nexec {sys.executable} -I -S -c 'import service'\n")
    bare.chmod(0o755)
    with pytest.raises(local.Refusal, match=r'service: expected one that runs, got "ModuleNotFoundError.*Its log is'):
        wait_until(local.LocalService(str(bare)).ready)


def test_a_service_starts_answers_and_ends(make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch):
    for name, value in make_settings().model_dump(mode="json", exclude_unset=True).items():
        monkeypatch.setenv(f"DRAPE_{name.upper()}", str(value))
    started = local.LocalService(sys.executable)
    try:
        wait_until(started.ready)
        assert calls.Service(started.url).json("health")["status"] == "ok"
    finally:
        started.end()
    with pytest.raises(local.Refusal, match="service: expected one that runs"):
        started.ready()


def test_the_zip_has_all_and_says_what_it_is_under(tmp_path: Path):
    path = addon_zip(tmp_path / "one")
    assert path.read_bytes() == addon_zip(tmp_path / "two").read_bytes(), "the same sources, the same bytes"
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    sources = {file.name for file in ADDON.glob("*.py")}
    assert names == sources | {"blender_manifest.toml", "README.md", "LICENSE"} and "__init__.py" in sources
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"] and manifest["blender_version_min"] == "4.2.0"
    assert all(len(words) <= 64 and words[-1].isalnum() for words in manifest["permissions"].values())
    for name in sources:
        said = (ADDON / name).read_text(encoding="utf-8").splitlines()[0]
        either = " OR GPL-3.0-or-later" if name in BODY_FILES else ""
        assert said == f"# SPDX-License-Identifier: Apache-2.0{either}", name
