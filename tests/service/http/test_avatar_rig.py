"""Characters of users in poses of their own rigs: clips, files, streams, and what is refused."""

from __future__ import annotations

import json

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.motion.rig_poses import poses_to_rig
from drape.wire import messages as wire
from drape.wire.clip_message import pack_clip
from drape.wire.rig_pose_message import RigPose, pack_rig_pose
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.avatar_calls import NUMBERS, POSES, draped, posed, stream_of
from tests.fixtures.glb_reader import Reader
from tests.fixtures.streams import PROTOCOLS


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


def test_quaternions_are_checked_for_their_length(api: httpx.Client, avatar: str):
    count = len(api.get(f"/avatars/{avatar}").json()["nodes"])
    half = matrix_to_quaternion(rotvec_to_matrix(np.zeros((count, 3))))[:, [1, 2, 3, 0]] * 0.5
    answer = api.post("/drape", json={"garment": "tube", "avatar": avatar, "rig_poses": [half.tolist()]})
    assert answer.status_code == 422 and "unit quaternions" in answer.json()["expected"]
