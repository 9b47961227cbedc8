"""Characters of users by REST: sent, worn, corrected, removed, and what is refused on the way."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from benchmarks.measure.dressed_characters import dressed_character, dressed_parts
from drape.avatar import wears
from drape.avatar.character import character_in
from drape.avatar.covered import DEEPER_M
from drape.avatar.own_clothes import Halves
from drape.avatar.wearer import Wearer, read_wearer, save_wearer
from drape.avatar.wears import Reach
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.errors import BodyError
from drape.files.gltf import GltfFile
from drape.geometry.closest import signed_distance
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.motion.rig_poses import poses_to_rig
from drape.wire import messages as wire
from drape.wire.clips import pack_clip
from drape.wire.rig_poses import RigPose, pack_rig_pose
from service.compute import avatars as in_service
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.glb_reader import Reader
from tests.fixtures.patience import PATIENT_S
from tests.fixtures.serving import files_in
from tests.fixtures.streams import PROTOCOLS

BETAS = np.array([1.0, -1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
OWN = {"top": "tshirt", "trousers": "trousers"}
NUMBERS = {"Accept": "application/octet-stream"}
POSES = np.zeros((2, 24, 3))
POSES[:, 16:18, 2] = [-0.9, 0.9]


def ended(api: httpx.Client, answer: httpx.Response) -> dict:
    assert answer.status_code == 202, answer.text
    assert answer.headers["Location"] == f"/jobs/{answer.json()['id']}"
    deadline = time.monotonic() + PATIENT_S
    while (job := api.get(answer.headers["Location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return job


def sent(api: httpx.Client, payload: bytes, name: str) -> dict:
    return ended(api, api.post("/avatars", params={"name": name}, content=payload))


@pytest.fixture(scope="module")
def avatar(api: httpx.Client, body: BodyModel) -> str:
    """Our body in another shape and an A-pose, in centimetres, facing -z: its id in the service."""
    payload = character(body, betas=BETAS, vrm="0", arms_rad=ARMS_DOWN_RAD, scale=100.0, yaw_rad=np.pi)
    job = sent(api, payload, "Me.vrm")
    assert (job["state"], job["garment"], job["share"], job["notes"]) == ("done", None, 1.0, []), job
    return job["avatar"]


def draped(api: httpx.Client, **asked: object) -> np.ndarray:
    answer = api.post("/drape", json={"garment": "tube", **asked}, headers=NUMBERS)
    assert answer.status_code == 200, answer.text
    return np.frombuffer(answer.content, "<f4").reshape(int(answer.headers["X-Drape-Frames"]), -1, 3).astype(float)


def posed(api: httpx.Client, avatar: str) -> np.ndarray:
    answer = api.post(f"/avatars/{avatar}/posed", json={"poses": POSES.tolist()}, headers=NUMBERS)
    assert answer.status_code == 200, answer.text
    return np.frombuffer(answer.content, "<f4").reshape(len(POSES), -1, 3).astype(float)


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


def test_poses_of_its_own_rig_do_as_ours(api: httpx.Client, avatar: str, runtime_of_api: DrapeRuntime):
    wearer = runtime_of_api.avatars.wearer(avatar)
    quaternions = poses_to_rig(wearer.rig, POSES)[..., [1, 2, 3, 0]]
    own = draped(api, avatar=avatar, rig_poses=quaternions.tolist())
    place = wearer.scale * wearer.rig.rest_positions[wearer.rig.sources["pelvis"]]
    ours = draped(
        api, avatar=avatar, poses=POSES.tolist(), trans=[(place - wearer.body.joints_template[0]).tolist()] * 2
    )
    # Our poses stand towards +z, and so do its own of them; folds of a millimetre differ with the rig's rounding.
    assert_allclose(own, ours, atol=5e-3)


def test_a_glb_on_its_own_rig_is_what_a_stream_shows(api: httpx.Client, avatar: str, runtime_of_api: DrapeRuntime):
    wearer = runtime_of_api.avatars.wearer(avatar)
    quaternions, places = wearer.to_rig(POSES, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 2.0]]))
    toe = wearer.nodes.index("bone left_foot")
    quaternions[1, toe] = [0.0, np.sin(0.5), 0.0, np.cos(0.5)]  # what ours do not say is kept
    asked = {"avatar": avatar, "rig_poses": quaternions.tolist(), "trans": places.tolist()}
    shown, answer = draped(api, **asked), api.post(
        "/drape", json={"garment": "tube", "rig": True, **asked}, headers={"Accept": "model/gltf-binary"}
    )  # fmt: skip
    file = Reader(answer.content)
    found = file.skinned(2)[:, : shown.shape[1]] * wearer.scale
    assert np.abs(found - shown).max() < 5e-6
    names = [node.get("name") for node in file.json["nodes"]]
    assert_allclose(file.channel(names.index("bone left_foot"), "rotation")[1][1], quaternions[1, toe], atol=1e-7)
    assert_allclose(file.world(2)[:, names.index("bone pelvis"), :3, 3] * wearer.scale, places, atol=1e-6)


def test_a_glb_on_joints_is_near_what_a_stream_shows_and_has_no_targets(
    api: httpx.Client, avatar: str, runtime_of_api: DrapeRuntime
):
    asked = {"avatar": avatar, "poses": POSES.tolist()}
    shown, answer = draped(api, **asked), api.post(
        "/drape", json={"garment": "tube", "rig": True, "joints": 6, **asked}, headers={"Accept": "model/gltf-binary"}
    )  # fmt: skip
    assert answer.status_code == 200, answer.text
    file = Reader(answer.content)
    found = file.skinned(2)[:, : shown.shape[1]] * runtime_of_api.avatars.wearer(avatar).scale
    assert np.sqrt(((found - shown) ** 2).sum(axis=-1).mean()) < 6e-3
    assert all("targets" not in one for one in file.json["meshes"][0]["primitives"])
    assert sum(node.get("name", "").startswith("tube_") for node in file.json["nodes"]) == 6


@pytest.fixture(scope="module")
def runtime_of_api(api: httpx.Client, settings: Settings, make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    """A second service with the folder of the first, as after a new start."""
    return make_runtime(garments_dir=settings.garments_dir)


def test_a_stream_shows_it(api: httpx.Client, avatar: str):
    with connect(stream_of(api), subprotocols=PROTOCOLS) as socket:
        socket.send(json.dumps({"type": "open", "garment": "tube", "avatar": avatar}))
        opened = json.loads(socket.recv(60.0))
        assert opened["type"] == "opened" and opened["body"] == "me"


def test_a_stream_takes_poses_of_its_own_rig(api: httpx.Client, avatar: str, runtime_of_api: DrapeRuntime):
    """They come to what our poses come to; a binary clip of them to what a JSON one comes to."""
    wearer = runtime_of_api.avatars.wearer(avatar)
    quaternions, places = wearer.to_rig(POSES, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 2.0]]))
    poses, trans = wearer.from_rig(quaternions.astype(np.float32), places)
    with connect(stream_of(api), subprotocols=PROTOCOLS) as socket:
        opening = json.dumps({"type": "open", "garment": "tube", "avatar": avatar, "folds": 0})
        frames = []
        for ours in (False, True):
            socket.send(opening)  # again, so that no frame follows another
            assert json.loads(socket.recv(60.0))["nodes"] == len(wearer.nodes)
            pose = wire.Pose(1, 0.0, trans[1], poses[1])
            socket.send(wire.pack_pose(pose) if ours else pack_rig_pose(RigPose(1, 0.0, places[1], quaternions[1])))
            message = socket.recv(60.0)
            assert isinstance(message, bytes)
            frames.append(wire.unpack_frame(message))
            socket.send(wire.pack_ack(1))
    assert_allclose(frames[0].vertices(), frames[1].vertices(), atol=3e-5)
    assert_allclose(frames[0].root, trans[1] + wearer.body.joints_template[0], atol=1e-9)
    about = {"garment": "tube", "avatar": avatar, "folds": 0}
    headers = NUMBERS | {"Content-Type": NUMBERS["Accept"]}

    def sent(path: str, body: dict) -> httpx.Response:
        return api.post(path, content=pack_clip(body, quaternions, places), headers=headers)

    answer = sent("/drape", about)
    clip = draped(api, **about, rig_poses=quaternions.tolist(), trans=places.tolist())
    assert answer.content == clip.astype("<f4").tobytes()
    surface = sent(f"/avatars/{avatar}/posed", {})
    assert_allclose(np.frombuffer(surface.content, "<f4").reshape(2, -1, 3)[0], posed(api, avatar)[0], atol=1e-4)
    for path, body in (("/drape", {"garment": "tube"}), ("/bodies/anny_default/posed", {})):
        refused = sent(path, body)
        assert (refused.status_code, refused.json()["name"]) == (400, "avatar"), refused.text


def stream_of(api: httpx.Client) -> str:
    return str(api.base_url).replace("http", "ws").rstrip("/") + "/stream"


def bad_rig_pose(nodes: int, *, turn: float = 1.0, place: float = 0.0, kept: slice = slice(None)) -> bytes:
    quaternions = np.tile([0.0, 0.0, 0.0, turn], (nodes, 1))
    return pack_rig_pose(RigPose(1, 0.0, np.array([place, 0.0, 0.0]), quaternions))[kept]


@pytest.mark.parametrize(
    ("worn", "more", "changes", "code", "said"),
    [
        (True, 0, {"turn": np.nan}, 4400, "NaN or infinity in the quaternion of node 0"),
        (True, 0, {"turn": 3e38}, 4422, "expected unit quaternions"),
        (True, 0, {"turn": 0.0}, 4422, "lengths 0 of node 0"),
        (True, 0, {"place": np.inf}, 4400, "its time or its place"),
        (True, 0, {"place": 1e8}, 4422, "at most 1e+06 m"),
        (True, 1, {}, 4400, "one a node of the avatar"),
        (True, 3000, {}, 4400, "one a node of the avatar"),
        (True, 0, {"kept": slice(0, -4)}, 4400, "bytes for"),
        (True, 0, {"kept": slice(0, 20)}, 4400, "at least 48 bytes"),
        (False, 0, {}, 4400, "expected a stream on an avatar"),
    ],
)
def test_a_pose_of_a_rig_that_is_wrong_closes_with_a_sentence(
    api: httpx.Client, avatar: str, worn: bool, more: int, changes: dict, code: int, said: str
):
    nodes = len(api.get(f"/avatars/{avatar}").json()["nodes"]) + more
    with connect(stream_of(api), subprotocols=PROTOCOLS) as socket:
        socket.send(json.dumps({"type": "open", "garment": "tube"} | ({"avatar": avatar} if worn else {})))
        assert json.loads(socket.recv(60.0))["type"] == "opened"
        socket.send(bad_rig_pose(nodes, **changes))
        assert said in json.loads(socket.recv(60.0))["detail"]
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(60.0)
    assert closed.value.rcvd is not None and closed.value.rcvd.code == code
    assert api.get("/health").json()["status"] == "ok"


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
        ({"avatar": "me", "poses": POSES.tolist(), "joints": 6}, "rig: true with it"),
        ({}, "a value"),
    ],
)
def test_a_drape_that_makes_no_sense_is_refused(api: httpx.Client, avatar: str, asked: dict, said: str):
    answer = api.post("/drape", json={"garment": "tube", **asked})
    assert answer.status_code in (400, 404, 413, 422) and said in answer.json()["expected"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({}, "a rig of its own"),
        ({"avatar": "me", "body": True}, "alone"),
        ({"avatar": "me", "origin": "root"}, "alone"),
    ],
)
def test_a_rig_that_makes_no_sense_is_refused(api: httpx.Client, avatar: str, asked: dict, said: str):
    body = {"garment": "tube", "poses": POSES.tolist(), "rig": True, **asked}
    answer = api.post("/drape", json=body, headers={"Accept": "model/gltf-binary"})
    assert answer.status_code == 400 and said in answer.json()["expected"]


def test_a_file_that_is_no_character_leaves_nothing(api: httpx.Client, settings: Settings):
    before = set(files_in(settings.garments_dir))
    job = sent(api, b"glTF" + bytes(100), "broken.glb")
    assert job["state"] == "failed" and "GLB" in job["problem"]["expected"]
    assert api.post("/avatars", content=b"glTF").json()["expected"] == "the avatar's name"
    empty = api.post("/avatars?name=me.vrm", content=b"")
    assert empty.status_code == 422 and empty.json()["expected"] == "the bytes of a character's file"
    assert set(files_in(settings.garments_dir)) == before


def test_avatars_are_there_after_a_new_start(avatar: str, runtime_of_api: DrapeRuntime, settings: Settings):
    assert runtime_of_api.avatars.get(avatar).told.vrm == "0"
    folder = settings.garments_dir / in_service.FOLDER
    (folder / "bad.json").write_text("{}")
    assert len(in_service.Avatars(runtime_of_api.body, settings, runtime_of_api.stages_on).visible(None)) == 1
    (folder / "bad.json").unlink()


@pytest.fixture(scope="module")
def wearers(body: BodyModel) -> list[Wearer]:
    """Two wearers of one name."""
    one = read_wearer(character(body), name="twin", body=body)
    return [one, replace(one, digest=one.digest[::-1])]


def add(avatars: in_service.Avatars, wearer: Wearer, folder: Path, owner: str | None) -> in_service.AvatarEntry:
    file = folder / "sent.glb"
    file.write_bytes(b"")
    made = save_wearer(wearer, folder)
    entry = avatars.add(made, file, owner)
    assert not made.exists() and not file.exists()
    return entry


def test_two_of_one_name_have_two_ids_and_one_of_a_key_is_its_own(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path
):
    avatars = make_runtime().avatars
    one, other = (add(avatars, wearer, tmp_path, None) for wearer in wearers)
    own = add(avatars, wearers[0], tmp_path, "alice")
    assert one.id == "twin" and other.id == f"twin-{wearers[1].digest[:8]}" and own.id.startswith("twin-")
    assert avatars.visible("alice") == [one, other, own] and avatars.visible("bob") == [one, other]
    for entry in (one, other, own):
        avatars.remove(entry)
    assert not avatars.visible("alice") and not [path for path in own.path.parent.iterdir() if path.is_file()]


def test_what_is_done_with_avatars_in_one_service_the_other_takes_over(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path
):
    runtime = make_runtime()
    here = runtime.avatars
    there = in_service.Avatars(runtime.body, runtime.settings, runtime.stages_on)
    entry = add(here, wearers[0], tmp_path, "alice")
    assert not there.visible("alice")
    there.follow()
    assert there.get(entry.id, "alice") == entry
    tube = runtime.garments.get("tube")
    before = there.dress(entry.id, tube)
    there.follow()
    assert there.dress(entry.id, tube) is before, "nothing changed"
    here.replaced(entry, save_wearer(replace(wearers[0], median_mm=3.0), tmp_path))
    there.follow()
    assert there.get(entry.id, "alice").told.fit["median_mm"] == 3.0 and there.wearer(entry.id).median_mm == 3.0
    assert not there.worn or there.dress(entry.id, tube) is not before
    there.remove(there.get(entry.id, "alice"))
    here.follow()
    assert not here.visible("alice") and not here.worn


def test_few_avatars_are_kept_dressed(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    monkeypatch.setattr(in_service, "MOST_WORN", 1)
    for wearer in wearers:
        entry = add(runtime.avatars, wearer, tmp_path, None)
        runtime.avatars.dress(entry.id, runtime.garments.get("tube"))
    assert len(runtime.avatars.worn) == 1


def test_quaternions_are_checked_for_their_length(api: httpx.Client, avatar: str):
    count = len(api.get(f"/avatars/{avatar}").json()["nodes"])
    half = matrix_to_quaternion(rotvec_to_matrix(np.zeros((count, 3))))[:, [1, 2, 3, 0]] * 0.5
    answer = api.post("/drape", json={"garment": "tube", "avatar": avatar, "rig_poses": [half.tolist()]})
    assert answer.status_code == 422 and "unit quaternions" in answer.json()["expected"]


@pytest.fixture(scope="module")
def dressed(api: httpx.Client, body: BodyModel) -> str:
    """Our body in a T-shirt and trousers of its own, without skin below, with a rucksack: its id in the service."""
    garments = {kind: open_garment(find_garments([name])[0], body) for kind, name in OWN.items()}
    payload = dressed_character(body, dressed_parts(body, garments, cut_away=True))
    job = sent(api, payload, "dressed.vrm")
    assert job["state"] == "done", job
    return job["avatar"]


def test_own_clothes_come_off_and_the_skin_below_is_there(api: httpx.Client, dressed: str, avatar: str):
    """The tube lies on the trunk alone: the T-shirt goes with the rucksack, and the trousers stay."""
    parts = {part["kind"]: part for part in api.get(f"/avatars/{dressed}").json()["parts"]}
    assert parts["carried"]["bulky"] and not parts["hair"]["bulky"]
    found = api.get(f"/avatars/{dressed}/covered", params={"garments": "tube"}).json()
    assert sum(found["hidden"][1::2]) == parts["top"]["faces"] + parts["carried"]["faces"]
    gone = [sum(one["hidden"][1::2]) for one in found["primitives"]]
    assert sum(gone) == sum(found["hidden"][1::2]) and set(gone) == {
        0,
        parts["top"]["faces"],
        parts["carried"]["faces"],
    }
    bare = api.get(f"/avatars/{dressed}/bare", params={"garments": "tube"})
    assert bare.status_code == 200, bare.text
    skin = character_in(GltfFile(bare.content))
    assert len(skin.faces) == found["bare"] > 500
    none = api.get(f"/avatars/{avatar}/bare", params={"garments": "tube"})
    assert none.status_code == 404 and none.json()["got"] == "none"


def test_a_part_is_corrected(api: httpx.Client, dressed: str):
    before = {part["name"]: part for part in api.get(f"/avatars/{dressed}").json()["parts"]}
    name = next(key for key, part in before.items() if part["kind"] == "top")
    job = ended(api, api.patch(f"/avatars/{dressed}", json={"parts": {name: "skin"}}))
    assert job["state"] == "done", job
    told = api.get(f"/avatars/{dressed}").json()
    after = {part["name"]: part for part in told["parts"]}
    assert (after[name]["kind"], after[name]["sure"], told["found_by"]) == ("skin", 1.0, "names")
    assert after.keys() == before.keys()
    assert api.patch(f"/avatars/{dressed}", json={"parts": {name: "wig"}}).status_code == 400
    assert api.delete(f"/avatars/{dressed}").status_code == 204


def test_what_an_avatar_cannot_wear_is_told_before_and_in_the_same_words(
    make_runtime: Callable[..., DrapeRuntime], wearers: list[Wearer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    runtime = make_runtime()
    entry, tube = add(runtime.avatars, wearers[0], tmp_path, None), runtime.garments.get("tube")
    assert runtime.avatars.wears(entry.id, [tube]) == {"tube": None}
    monkeypatch.setattr(in_service, "reach_of", lambda garment, body: Reach(Halves(False, True), True))
    monkeypatch.setattr(wears, "THICKEST", 0.01)
    avatars = runtime.avatars
    avatars._reaches.clear()
    why = avatars.wears(entry.id, [tube])["tube"]
    assert why is not None and "times as thick as long" in why
    with pytest.raises(BodyError) as refused:
        avatars.dress(entry.id, tube)
    assert str(refused.value) == why


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
