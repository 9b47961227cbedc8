"""Characters of users by REST: sent, worn, corrected, removed, and what is refused on the way."""

from __future__ import annotations

import json

import httpx
import numpy as np
import pytest
from websockets.sync.client import connect

from drape.avatar.covered import DEEPER_M
from drape.body.model import BodyModel
from drape.geometry.closest import signed_distance
from service.compute import avatars as in_service
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.avatar_calls import BETAS, POSES, draped, ended, posed, sent, stream_of
from tests.fixtures.serving import files_in
from tests.fixtures.streams import PROTOCOLS


def test_an_avatar_is_told_of(api: httpx.Client, avatar: str):
    found = api.get(f"/avatars/{avatar}").json()
    assert {key: held for key, held in found.items() if key not in ("wears", "wears_why")} in api.get("/avatars").json()
    assert found["wears"]["tube"] is True and found["wears_why"] == {}
    assert sum(part["faces"] for part in found["parts"]) == len(api.get(f"/avatars/{avatar}/mesh").json()["faces"])
    assert {part["kind"] for part in found["parts"]} <= {"skin", "face"}
    assert found["joints"]["left_knee"] == "bone left_knee" and "bone left_knee" in found["nodes"]
    assert (found["found_by"], found["confidence"], found["notes"]) == ("vrm", 1.0, [])
    assert found["fit"]["median_mm"] < 2.5 and found["vrm"] == "0" and found["scale"] == 0.01
    mesh = api.get(f"/avatars/{avatar}/mesh").json()
    assert len(mesh["vertices"]) == found["vertices"]
    picture = api.get(f"/avatars/{avatar}/preview.png", params={"size": 64})
    assert picture.content[:4] == b"\x89PNG"
    again = api.get(
        f"/avatars/{avatar}/preview.png", params={"size": 64}, headers={"If-None-Match": picture.headers["ETag"]}
    )
    assert again.status_code == 304


def test_a_garment_on_it_is_its_size(api: httpx.Client, avatar: str, body: BodyModel):
    ours, theirs = draped(api, poses=POSES.tolist()), draped(api, avatar=avatar, poses=POSES.tolist())
    assert ours.shape == theirs.shape
    grown = np.ptp(theirs[0], axis=0) / np.ptp(ours[0], axis=0)
    wanted = np.ptp(body.rest_joints(BETAS)[:10], axis=0)[1] / np.ptp(body.joints_template[:10], axis=0)[1]
    assert grown[1] == pytest.approx(wanted, rel=0.05)
    surface = posed(api, avatar)
    faces = np.array(api.get(f"/avatars/{avatar}/mesh").json()["faces"])
    assert (signed_distance(theirs[0], surface[0], faces) < -0.01).mean() < 0.02


def test_faces_under_a_garment_are_told(api: httpx.Client, avatar: str):
    answer = api.get(f"/avatars/{avatar}/covered", params={"garments": "tube"})
    assert answer.status_code == 200, answer.text
    found = answer.json()
    mesh = api.get(f"/avatars/{avatar}/mesh").json()
    runs = np.reshape(found["ranges"], (-1, 2))
    faces = np.concatenate([np.arange(begin, begin + count) for begin, count in runs])
    assert 0 < len(faces) == pytest.approx(found["share"] * len(mesh["faces"]), abs=1.0)
    assert found["deeper_m"] == DEEPER_M
    (primitive,) = found["primitives"]
    assert sum(primitive["ranges"][1::2]) == len(faces) <= primitive["triangles"]
    places = np.array(mesh["vertices"])[np.array(mesh["faces"])[faces]].reshape(-1, 3)
    heights = draped(api, avatar=avatar, poses=np.zeros((1, 24, 3)).tolist())[0][:, 1]
    assert heights.min() < places[:, 1].min() and places[:, 1].max() < heights.max()
    refused = api.get(f"/avatars/{avatar}/covered", params={"garments": "tub"})
    assert refused.status_code == 404 and "tube" in refused.json()["cure"]
    none = api.get(f"/avatars/{avatar}/bare", params={"garments": "tube"})
    assert none.status_code == 404 and none.json()["got"] == "none", "it came in no clothes"


def test_a_stream_shows_it(api: httpx.Client, avatar: str):
    with connect(stream_of(api), subprotocols=PROTOCOLS) as socket:
        socket.send(json.dumps({"type": "open", "garment": "tube", "avatar": avatar}))
        opened = json.loads(socket.recv(60.0))
        assert opened["type"] == "opened" and opened["body"] == "me"


def test_a_clip_is_placed_for_its_legs(api: httpx.Client, avatar: str):
    ours, theirs = (api.get("/motions/walk", params=one).json() for one in ({}, {"avatar": avatar}))
    assert ours["poses"] == theirs["poses"] and ours["trans"] != theirs["trans"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"avatar": "nobody", "poses": POSES.tolist()}, "one of: me"),
        ({"avatar": "me", "betas": [1.0], "poses": POSES.tolist()}, "its own shape"),
        ({"avatar": "me", "rig_poses": [[[0, 0, 0, 1]]], "poses": POSES.tolist()}, "no such field"),
        ({"avatar": "me", "rig_poses": [[[0, 0, 0, 1]]]}, "one for each of the avatar's nodes"),
        ({"avatar": "me", "rig_poses": [[[0, 0, 0, 1]]], "trans": []}, "one a frame"),
        ({"avatar": "me", "rig_poses": [[[0, 0, 0, 1]]] * 41}, "at most 40 frames"),
        ({"rig_poses": [[[0, 0, 0, 1]]]}, "a value"),
        ({"avatar": "me", "poses": POSES.tolist(), "rig": True}, "Accept: model/gltf-binary"),
        ({"avatar": "me", "poses": POSES.tolist(), "joints": 6}, "rig: true beside it"),
        ({}, "a value"),
    ],
)
def test_a_drape_that_makes_no_sense_is_refused(api: httpx.Client, avatar: str, asked: dict, said: str):
    answer = api.post("/drape", json={"garment": "tube", **asked})
    assert answer.status_code in (400, 404, 413, 422) and said in answer.json()["expected"]


def test_a_file_that_is_no_character_leaves_nothing(api: httpx.Client, settings: Settings):
    before = set(files_in(settings.garments_dir))
    job = sent(api, b"glTF" + bytes(100), "broken.glb")
    assert job["state"] == "failed" and "GLB" in job["problem"]["expected"]
    assert api.post("/avatars", content=b"glTF").json()["expected"] == "the avatar's name"
    empty = api.post("/avatars?name=me.vrm", content=b"")
    assert empty.status_code == 422 and empty.json()["expected"] == "the bytes of a character's file"
    assert set(files_in(settings.garments_dir)) == before


def test_avatars_are_there_after_a_new_start(avatar: str, runtime_of_api: DrapeRuntime, settings: Settings):
    assert runtime_of_api.avatars.get(avatar).facts.vrm == "0"
    folder = settings.garments_dir / in_service.FOLDER
    (folder / "bad.json").write_text("{}")
    assert len(in_service.Avatars(runtime_of_api.body, settings, runtime_of_api.stages_on).visible(None)) == 1
    (folder / "bad.json").unlink()


def test_joints_are_corrected_and_an_avatar_is_removed(api: httpx.Client, avatar: str, settings: Settings):
    refused = api.patch(f"/avatars/{avatar}", json={"joints": {}})
    assert refused.status_code == 400 and refused.json()["expected"] == "joints or parts"
    job = ended(api, api.patch(f"/avatars/{avatar}", json={"joints": {"spine3": "nothing"}}))
    assert job["state"] == "failed" and "a node" in job["problem"]["expected"]
    job = ended(api, api.patch(f"/avatars/{avatar}", json={"joints": {"spine3": "bone spine2"}}))
    assert (job["state"], job["avatar"]) == ("done", avatar), job
    assert api.get(f"/avatars/{avatar}").json()["joints"]["spine3"] == "bone spine2"
    assert api.delete(f"/avatars/{avatar}").status_code == 204
    assert api.get(f"/avatars/{avatar}").status_code == 404 and not files_in(settings.garments_dir)
