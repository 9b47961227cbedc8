"""Requests that are refused, each with its sentence; and the reference page, which asks no other host."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drape.wire.clip_message import pack_clip
from service import app as application
from service.app import make_state
from service.compute.drape_runtime import DrapeRuntime
from service.errors import Busy
from service.guard.access import Access
from service.http import pages
from service.http.json_body import clip_marks
from service.settings import Settings
from service.watch.probes import Lifecycle
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import served

REST = np.zeros((1, 24, 3)).tolist()


def refused(response: httpx.Response, status: int, *words: str) -> dict[str, object]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document = response.json()
    assert document["status"] == status
    for word in words:
        assert word in document["detail"], document["detail"]
    for part in ("name", "expected", "got", "cure"):
        assert document[part] in document["detail"]
    return document


def drape(api: httpx.Client, **fields: object) -> httpx.Response:
    # By hand, since httpx refuses NaN.
    content = json.dumps({"garment": "tube", "poses": REST} | fields)
    return api.post("/drape", content=content, headers={"Content-Type": "application/json"})


@pytest.mark.parametrize(
    ("fields", "status", "words"),
    [
        ({"poses": [[[0, 0, 0]] * 23]}, 422, ["poses[0]: expected 24 joints, got 23."]),
        ({"poses": [*REST, [[0, 0, 0]] * 25]}, 422, ["poses[1]: expected 24 joints, got 25."]),
        ({"poses": [[[0, 0]] + [[0, 0, 0]] * 23]}, 422, ["poses[0][0]: expected 3 numbers [rad], got 2"]),
        ({"poses": []}, 422, ["poses: expected at least 1 frame, got 0"]),
        ({"poses": None}, 422, ["poses: expected a list of frames, got None"]),
        ({"poses": [[[float("nan"), 0, 0]] * 24]}, 422, ["poses[0][0][0]: expected a finite number [rad], got nan"]),
        ({"poses": [[["0", 0, 0]] * 24]}, 422, ["poses[0][0][0]: expected a finite number [rad], got '0'"]),
        ({"poses": [[[1e300, 0, 0]] * 24]}, 422, ["poses[0][0][0]: expected at most 1000 rad, got 1e+300"]),
        ({"trans": [[0, 0]]}, 422, ["trans[0]: expected 3 numbers [m], got 2"]),
        ({"trans": [[0, 0, float("inf")]]}, 422, ["trans[0][2]: expected a finite number [m]"]),
        ({"trans": [[0, 0, 1e9]]}, 422, ["trans[0][2]: expected at most 1e+06 m"]),
        ({"trans": [[0, 0, 0]] * 2}, 422, ["trans: expected one translation per frame, 1, got 2"]),
        ({"betas": [0.0] * 11}, 422, ["betas: expected at most 10 numbers, got 11"]),
        ({"betas": [float("nan")]}, 422, ["betas[0]: expected a finite number"]),
        ({"betas": [99.0]}, 422, ["betas[0]: expected at most 20, got 99"]),
        ({"fps": 0}, 400, ["fps: expected greater than or equal to 0.001, got 0."]),
        ({"garment": "cape"}, 404, ["garment: expected one of: tube, got cape.", "GET /garments"]),
        ({"garment": ""}, 400, ["garment: expected at least 1 character, got ''."]),
        ({"colour": "red"}, 400, ["colour: expected no such field"]),
        ({"motion": 0.5, "colour": "red"}, 400, ["colour: expected no such field"]),  # an alias is a known name
        ({"fold": 1}, 400, ["fold: expected no such field, got one. Did you mean folds? See"]),
        ({"garment": "tubes"}, 404, ["Did you mean tube? GET /garments"]),
        ({"fabric": "Denin"}, 404, ["fabric: expected one of", "Did you mean denim?"]),
        ({"poses": [[[30, 0, 0]] * 24]}, 422, ["poses: expected rotation vectors in radians", "look like degrees"]),
        ({"push_out": "maybe"}, 400, ["push_out: expected a valid boolean, unable"]),
        ({"advanced": {"push_out": "maybe"}}, 400, ["advanced.push_out: expected a valid boolean, unable"]),
        ({"advanced": {"fold": 1}}, 400, ["advanced.fold: expected no such field, got one."]),
        (
            {"advanced": {"folds": 1}, "folds": 2},
            400,
            ["folds: expected the value of advanced.folds, or one of the two"],
        ),
        ({"advanced": 3}, 400, ["advanced: expected a valid dictionary"]),
        ({"poses": REST * 41}, 413, ["poses: expected at most 40 frames, got 41. Send the clip in pieces."]),
    ],
)
def test_what_is_wrong_is_named(api: httpx.Client, fields: dict, status: int, words: list[str]):
    refused(drape(api, **fields), status, *words)


def test_feet_that_are_not_on_the_floor_are_noted(api: httpx.Client, body):
    stands = [[0.0, -float(body.v_template[:, 1].min()), 0.0]]
    for trans, said in (
        (None, ""),
        (stands, ""),
        ([[0.0, 0.0, 0.0]], "below the floor"),
        ([[0, 3, 0]], "above the floor"),
    ):
        answer = drape(api, **({} if trans is None else {"trans": trans}))
        assert said in answer.headers.get("X-Drape-Note", "") and (said == "") == ("X-Drape-Note" not in answer.headers)


def test_more_than_a_clip_can_hold_is_refused_before_it_is_parsed(api: httpx.Client, settings: Settings):
    most = clip_marks(settings.max_frames)
    for values in ("[]," * most, "[" * (most + 1)):
        response = api.post("/drape", content="[" + values, headers={"Content-Type": "application/json"})
        refused(response, 413, f"request body: expected at most {most} commas, colons and opening brackets, got")
    longest = drape(api, poses=REST * settings.max_frames, trans=[[0, 0, 0]] * settings.max_frames)
    assert longest.status_code == 200


def test_of_many_mistakes_one_is_told(api: httpx.Client):
    refused(drape(api, poses=[[]] * 3000), 422, "poses[0]: expected 24 joints, got 0. Send")
    refused(drape(api, trans=[[]] * 3000), 422, "trans[0]: expected 3 numbers [m], got 0. Send")
    refused(drape(api, garments=[""] * 50), 400, "garments[0]: expected at least 1 character, got ''. See")
    refused(drape(api, garments=["a"] * 65), 400, "garments: expected at most 64 items")
    refused(drape(api, **{f"k{i}": i for i in range(5000)}), 400, "k0: expected no such field, got one. See")
    refused(drape(api, **{"k" * 5000: 1}), 400, f"{'k' * 57}...: expected no such field, got one.")
    refused(drape(api, garment="g" * 5000), 400, f"garment: expected at most 120 characters, got '{'g' * 56}....")


def test_the_reference_says_what_a_body_holds(api: httpx.Client):
    paths = api.get("/openapi.json").json()["paths"]
    for path, field in (("/drape", "garments"), ("/bodies/{body_id}/posed", "trans")):
        body = paths[path]["post"]["requestBody"]
        assert body["required"] and {"poses", "fps", field} <= set(
            body["content"]["application/json"]["schema"]["properties"]
        )
        binary = body["content"]["application/octet-stream"]["schema"]
        assert binary["format"] == "binary" and "CLIP" in binary["description"]


def clip(api: httpx.Client, path: str = "/drape", content: bytes | None = None, **fields: Any) -> httpx.Response:
    """``drape`` with the poses in binary."""
    about = {key: value for key, value in fields.items() if key not in ("poses", "trans")}
    about = about if "bodies" in path else {"garment": "tube", **about}
    message = pack_clip(about, fields.get("poses", np.zeros((1, 24, 3))), fields.get("trans"))
    kind = {"Content-Type": "application/octet-stream"}
    return api.post(path, content=message if content is None else content, headers=kind)


def test_options_of_experts_give_the_same_bits_at_their_old_place(api: httpx.Client):
    poses, trans = random_motion(3)
    moving = {"poses": poses.tolist(), "trans": trans.tolist(), "motion": 1.0}
    chosen = {"passes": 0, "folds": 1, "coarse": False, "safe_folds": 2, "settle": 2, "cloth_contact": False,
              "push_out": False, "inertia": "mesh"}  # fmt: skip
    flat, deep, other = (drape(api, **moving, **more) for more in (chosen, {"advanced": chosen}, {}))
    assert flat.status_code == deep.status_code == 200
    assert flat.content == deep.content != other.content
    told = ("x-drape-tier", "x-drape-passes", "x-drape-folds", "x-drape-safe-folds", "x-drape-push-out")
    assert [flat.headers[name] for name in told] == [deep.headers[name] for name in told]


def test_binary_poses_give_the_bits_that_json_gives(api: httpx.Client, body):
    poses, trans = random_motion(4)
    fields = {"betas": [0.5, -0.5], "fps": 24.0, "push_out": True}
    said = drape(api, poses=poses.tolist(), trans=trans.tolist(), **fields)
    sent = clip(api, poses=poses, trans=trans, **fields)
    assert sent.status_code == said.status_code == 200
    assert sent.content == said.content
    assert clip(api, poses=poses).content == drape(api, poses=poses.tolist()).content
    path = f"/bodies/{body.name}/posed"
    assert clip(api, path, poses=poses).content == api.post(path, json={"poses": poses.tolist()}).content


@pytest.mark.parametrize(
    ("fields", "status", "words"),
    [
        ({"poses": np.zeros((0, 24, 3))}, 422, ["poses: expected at least 1 frame, got 0"]),
        (
            {"poses": np.zeros((41, 24, 3))},
            413,
            ["poses: expected at most 40 frames, got 41. Send the clip in pieces."],
        ),
        ({"poses": np.full((1, 24, 3), np.nan)}, 422, ["poses[0][0][0]: expected at most 1000 rad, got nan"]),
        ({"trans": np.full((1, 3), np.inf)}, 422, ["trans[0][0]: expected at most 1e+06 m, got inf"]),
        ({"colour": "red"}, 400, ["colour: expected no such field"]),
        ({"betas": [99.0]}, 422, ["betas[0]: expected at most 20"]),
        ({"content": b"noise"}, 400, ["clip message: expected at least 24 bytes, got 5 bytes"]),
        ({"content": pack_clip({}, np.zeros((1, 24, 3)), None)[:-2] + b"[["}, 400, ["is not JSON. End the CLIP"]),
        ({"content": pack_clip({"poses": []}, np.zeros((1, 24, 3)), None)}, 400, ["poses: expected no such field"]),
        ({"content": pack_clip({"k": [0] * 10_001}, np.zeros((1, 24, 3)), None)}, 413, ["at most 10000 commas"]),
    ],
)
def test_what_is_wrong_with_a_binary_clip_is_named(api: httpx.Client, fields: dict, status: int, words: list[str]):
    refused(clip(api, **fields), status, *words)


def test_a_missing_field_is_named(api: httpx.Client):
    refused(api.post("/drape", json={"garment": "tube"}), 400, "poses: expected a value, got nothing")


@pytest.mark.parametrize(
    ("content", "content_type", "word"),
    [
        (b'{"garment": "tube", "poses": [', "application/json", "text that is not JSON"),
        (b"[]", "application/json", "a list of 0"),
        (b"", "application/json", "got nothing"),
        (b"[" * 10_000, "application/json", "text that is not JSON"),
        (b'{"poses": 1' + b"0" * 5000 + b"}", "application/json", "text that is not JSON"),
        (b"{}", "text/plain", "another type"),
    ],
)
def test_what_is_no_json_object_is_refused(api: httpx.Client, content: bytes, content_type: str, word: str):
    refused(api.post("/drape", content=content, headers={"Content-Type": content_type}), 400, word)


def test_unknown_names_and_paths_are_not_found(api: httpx.Client):
    refused(api.get("/garments/cape"), 404, "garment")
    refused(api.get("/garments/cape/mesh"), 404, "garment")
    refused(api.get("/motions/swim"), 404, "motion: expected one of: reach, ", "GET /motions")
    refused(api.get("/bodies/atlas"), 404, "body: expected anny_default, got atlas")
    refused(api.get("/bodies/atlas/mesh"), 404, "body")
    refused(api.post("/bodies/atlas/posed", json={"poses": REST}), 404, "body")
    refused(api.get("/jobs/none"), 404, "job")
    refused(api.get("/nothing"), 404, "GET /nothing")
    refused(api.delete("/health"), 405, "DELETE /health")
    for path in ("/drape", "/bodies/anny_default/posed"):
        response = api.get(path)
        refused(response, 405, f"expected a method that this path has, got GET {path}.")
        assert response.headers["Allow"] == "POST"
    refused(api.get("/bodies/anny_default?betas=1,x"), 400, "betas: expected comma-separated numbers")


@pytest.mark.parametrize("accept", ["image/png", "application/json;q=0", "model/gltf-binary;q=none", "text/*"])
def test_formats_that_are_not_ours_are_refused(api: httpx.Client, accept: str):
    response = api.post("/drape", json={"garment": "tube", "poses": REST}, headers={"Accept": accept})
    refused(response, 406, "Accept: expected one of application/octet-stream")


def test_too_large_a_body_is_refused_before_it_is_read(api: httpx.Client, settings: Settings):
    size = settings.max_body_bytes + 1
    refused(api.post("/drape", content=b" " * size), 413, "request body", f"at most {settings.max_body_bytes} bytes")

    def pieces(limit: int) -> Iterator[bytes]:
        for _ in range(limit // 65536 + 2):
            yield b" " * 65536

    for path, limit in (("/drape", settings.max_body_bytes), ("/garments?name=a.obj", settings.max_upload_bytes)):
        refused(api.post(path, content=pieces(limit)), 413, "request body", f"at most {limit} bytes")


def test_too_large_an_answer_is_refused(make_settings: Callable[..., Settings]):
    with served(make_settings(max_answer_bytes=216 * 12 * 3)) as url:
        glb = "model/gltf-binary"
        for frames, accept, status in ((3, "*/*", 200), (4, "*/*", 413), (3, glb, 200), (4, glb, 413), (2, glb, 413)):
            document = {"garment": "tube", "poses": REST * frames, "quantised": frames > 2}
            response = httpx.post(url + "/drape", json=document, headers={"Accept": accept})
            assert response.status_code == status
        refused(response, 413, "answer", "Send the clip in pieces.")


def test_more_clips_than_places_are_refused(make_runtime: Callable[..., DrapeRuntime]):
    runtime = make_runtime(max_clips=1)
    state = make_state(runtime, Access(runtime.settings), Lifecycle(stuck_s=9.0))
    with state.slot(), pytest.raises(Busy, match="fewer than 1 at a time"), state.slot():
        pass
    with state.slot():
        assert state.clips == 1
    assert state.clips == 0


def test_the_page_that_is_not_built_says_how_to_build_it(settings: Settings, tmp_path, monkeypatch):
    monkeypatch.setattr(application, "PAGE", tmp_path / "none")
    with served(settings) as url:
        response = httpx.get(url + "/")
        assert response.status_code == 503
        assert "make page" in response.text
        (tmp_path / "none").mkdir()
        (tmp_path / "none/index.html").write_text("built")
        page = httpx.get(url + "/")
        assert page.text == "built"
        assert "script-src 'self' 'wasm-unsafe-eval';" in page.headers["Content-Security-Policy"]
        (tmp_path / "none/tracker.html").write_text("a frame")
        frame = httpx.get(url + "/tracker.html").headers["Content-Security-Policy"]
        assert "sandbox allow-scripts" in frame and "connect-src blob: data:;" in frame, "foreign code reaches nothing"


def test_answers_of_a_whole_service(api: httpx.Client, body, tube):
    health = api.get("/health").json()
    assert health["status"] == "ok"
    assert (health["model"], health["body"], health["garments"]) == ("tiny", body.name, 1)
    assert (health["passes"], health["layers"]) == (1, 4)
    assert health["provider"] == "CPUExecutionProvider"
    assert health["compiled"] is True
    assert health["elsewhere"] == 0
    (garment,) = api.get("/garments").json()
    assert garment == api.get("/garments/tube").json()
    assert (garment["vertices"], garment["patches"], garment["source"]) == (216, 12, "shipped")
    (found,) = api.get("/bodies").json()
    assert (found["id"], found["vertices"]) == (body.name, body.vertex_count)
    mesh = api.get("/garments/tube/mesh").json()
    np.testing.assert_array_equal(mesh["faces"], tube.faces)
    np.testing.assert_array_equal(np.float32(mesh["vertices"]), tube.vertices)
    np.testing.assert_array_equal(mesh["uv_faces"], tube.uv_faces)
    assert mesh["materials"] == ["cotton", "trim"]
    document = api.get(f"/bodies/{body.name}?betas=1").json()
    np.testing.assert_allclose(document["joints"], body.rest_joints(np.array([1.0])), rtol=0, atol=1e-9)


def test_sample_clips_stand_on_the_ground(api: httpx.Client, body):
    ids = {clip["id"] for clip in api.get("/motions").json()}
    assert {"walk", "turn", "reach", "squat"} <= ids
    for betas in ("", "2", "-2"):
        clip = api.get(f"/motions/walk?betas={betas}").json()
        shape = np.array([float(betas)]) if betas else None
        poses, trans = np.array(clip["poses"])[::24], np.array(clip["trans"])[::24]
        lowest = body.posed_vertices(poses, trans, shape)[..., 1].min(axis=1)
        assert np.abs(lowest).max() < 0.03


numbers = st.one_of(st.floats(), st.integers(), st.none(), st.text(max_size=3), st.booleans())
nested = st.recursive(
    numbers, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=2)
)


@given(poses=nested, trans=nested, betas=nested, fps=nested)
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_noise_in_a_request_is_refused_politely(api: httpx.Client, poses, trans, betas, fps):
    response = drape(api, poses=poses, trans=trans, betas=betas, fps=fps)
    assert response.status_code in (400, 413, 422)
    assert set(response.json()) >= {"detail", "cure"}


@given(content=st.binary(max_size=200), kind=st.sampled_from(["application/json", "", "application/octet-stream"]))
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_noise_as_a_body_is_refused_politely(api: httpx.Client, content: bytes, kind: str):
    for path in ("/drape", "/bodies/anny_default/posed", "/garments"):
        response = api.post(path, content=content, headers={"Content-Type": kind})
        assert response.status_code in (400, 422)


def test_the_reference_and_its_files_come_from_this_service(api: httpx.Client):
    page = api.get("/docs")
    assert page.status_code == 200 and "/openapi.json" in page.text
    assert re.findall(r"https?://", page.text) == []
    for name in pages.REFERENCE_FILES:
        assert f"/docs/{name}" in page.text
        assert api.get(f"/docs/{name}").status_code == 200
    assert api.get("/docs/other.js").status_code == 404
    assert api.get("/redoc").status_code == 404


def test_without_the_package_a_sentence_says_so(make_settings, monkeypatch: pytest.MonkeyPatch):

    monkeypatch.setattr(pages, "REFERENCE_PACKAGE", "no_such_package")
    assert pages.files_folder() is None
    with served(make_settings()) as url:
        for path in ("/docs", f"/docs/{pages.REFERENCE_FILES[0]}"):
            response = httpx.get(url + path)
            assert response.status_code == 503 and "fastapi-offline" in response.text
