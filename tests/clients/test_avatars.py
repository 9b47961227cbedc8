"""Characters of users through the Python client and the command line."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from clients.cli import main
from clients.client import DrapeClient
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.errors import InputError, NotFound, Unavailable
from tests.clients.node import answer_of
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.dressed_characters import dressed_character, dressed_parts
from tests.fixtures.glb_reader import Reader

BETAS = np.array([-1.0, *np.zeros(9)])  # a smaller body


@pytest.fixture(scope="module")
def file(body: BodyModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A character in a file."""
    path = tmp_path_factory.mktemp("characters") / "ada.vrm"
    path.write_bytes(character(body, betas=BETAS, vrm="1", arms_rad=ARMS_DOWN_RAD))
    return path


@pytest.fixture(scope="module")
def client(live: str) -> Iterator[DrapeClient]:
    with DrapeClient(live) as opened:
        yield opened


@pytest.fixture(scope="module")
def ada(client: DrapeClient, file: Path) -> Iterator[str]:
    """The character's id, while it is in the service."""
    yield (name := client.avatar(file).id)
    client.remove_avatar(name)


def test_a_character_wears_and_plays_in_a_line(client: DrapeClient, ada: str):
    (cloth,) = client.avatar(ada).wear("tube", folds=0).play("walk")
    clip = client.motion("walk", avatar=ada)
    assert_array_equal(cloth, client.drape("tube", clip, avatar=ada, folds=0))
    surface = client.avatar(ada).surface(clip)
    assert len(cloth) == len(surface) == clip.frame_count
    assert (np.abs(cloth.mean(axis=1) - surface.mean(axis=1)) < 0.5).all()


def test_a_glb_comes_on_its_own_rig(client: DrapeClient, ada: str):
    clip = client.motion("walk", avatar=ada).poses[:2]
    dressed = client.avatar(ada).wear("tube", folds=0)
    (cloth,) = dressed.play(clip)
    shown = Reader(dressed.glb(clip)).skinned(2)[:, : cloth.shape[1]]
    assert np.abs(shown - cloth).max() < 1e-6
    with pytest.raises(InputError, match="rig: expected at most"):
        client.drape_glb("tube", np.zeros((1300, 24, 3)), avatar=ada, rig=True)


def test_poses_of_its_own_rig_go_by_clip_and_by_stream(client: DrapeClient, ada: str):
    dressed = client.avatar(ada).wear("tube", folds=0)
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, len(dressed.nodes), 1))
    arms = [dressed.nodes.index(f"bone {side}_shoulder") for side in ("left", "right")]
    turns[:, arms] = Rotation.from_rotvec([[0.0, 0.0, -0.3], [0.0, 0.0, 0.4]]).as_quat()
    places = np.array([[0.0, 1.0, 0.0], [0.5, 1.0, 0.0]])
    (cloth,) = dressed.play(turns, trans=places)
    surface = dressed.surface(turns, trans=places)
    assert np.abs(cloth.mean(axis=1) - surface.mean(axis=1)).max() < 0.5
    assert_allclose(surface[1] - surface[0], np.broadcast_to([0.5, 0.0, 0.0], surface[0].shape), atol=1e-5)

    async def streamed() -> tuple[np.ndarray, np.ndarray]:
        async with await dressed.stream() as stream:
            await stream.send_rig(turns[0], places[0])
            first = (await stream.receive()).frame.vertices()
            await stream.reopen("tube", folds=0)
            with pytest.raises(Unavailable, match="poses of a rig"):
                await stream.send_rig(turns[0], places[0])
            return first, (await stream.reopen("tube", folds=0, avatar=ada))["nodes"]

    first, nodes = asyncio.run(streamed())
    assert nodes == len(dressed.nodes)
    assert_allclose(first, cloth[0], atol=1e-4)


def test_a_clip_of_a_file_is_placed_for_it(client: DrapeClient, ada: str):
    clip = client.motion("walk")
    ours, theirs = client.placed(clip), client.placed(clip, avatar=ada)
    assert not np.allclose(ours.trans, theirs.trans, atol=0.01)
    assert ada in [avatar["id"] for avatar in client.avatars()]


def test_other_files_and_unknown_ones_are_refused(client: DrapeClient, tmp_path: Path):
    with pytest.raises(InputError, match=r"\.glb, \.vrm"):
        client.upload_avatar(tmp_path / "me.fbx")
    with pytest.raises(InputError, match="can be read"):
        client.upload_avatar(tmp_path / "me.vrm")
    with pytest.raises(NotFound, match="avatar"):
        client.avatar("nobody").wear("tube").play("walk")


@pytest.mark.long
def test_own_clothes_are_worn_by_a_program_and_by_the_command(
    live: str, client: DrapeClient, body: BodyModel, tmp_path: Path
):
    """A tank top of its own, and a tube of ours that takes its place."""
    payload = dressed_character(body, dressed_parts(body, {"top": open_garment(find_garments(["tank"])[0], body)}))
    (tmp_path / "doll.glb").write_bytes(payload)
    doll = client.avatar(tmp_path / "doll.glb", alive=True)
    clip = client.motion("walk", avatar=doll.id).poses[:2]
    (own,), (tube,) = (doll.wear(*named, alive=True, folds=0).play(clip) for named in ((), ("tube",)))
    assert own.shape[1] == len(client.mesh(f"{doll.id}~top")["vertices"]) != tube.shape[1]
    out = tmp_path / "out.npy"
    words = ["drape", "--url", live, "--on", doll.id, "--motion", "walk", "--fps", "5", "--folds", "0"]
    assert main([*words, "--alive", "--out", str(out)]) == 0
    assert np.load(out).shape[1] == own.shape[1]
    assert main([*words, "--out", str(out)]) == 2, "nothing to wear"
    assert main([*words, "--alive", "--out", str(out.with_suffix(".pc2"))]) == 2
    client.remove_avatar(doll.id)


@pytest.mark.long
def test_the_command_line_adds_wears_lists_and_removes(
    live: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    named = file.with_name("bob.vrm")
    named.write_bytes(file.read_bytes())
    assert main(["avatars", "--url", live, "--add", str(named)]) == 0
    name = capsys.readouterr().out.strip()
    out = tmp_path / "out.glb"
    asked = ["--garment", "tube", "--on", name, "--motion", "walk", "--fps", "5", "--out", str(out)]
    assert main(["drape", "--url", live, *asked]) == 0 and out.stat().st_size > 1000
    assert main(["drape", "--url", live, *asked, "--rig"]) == 0
    assert "bone left_hip" in str(Reader(out.read_bytes()).json["nodes"])
    assert main(["avatars", "--url", live]) == 0
    assert name in capsys.readouterr().out
    assert main(["avatars", "--url", live, "--remove", name]) == 0
    assert main(["avatars", "--url", live]) == 0
    assert name not in capsys.readouterr().out


LIBRARY = """
import { readFileSync } from "node:fs";
import { connect } from "./core.js";
const drape = await connect(input.url, { worker: null });
const id = await drape.avatar(readFileSync(input.file), "eve.vrm");
const layouts = [await drape.rest.jetLayout("tube", { avatar: id }), await drape.rest.jetLayout("tube")];
const ours = await drape.body();
const theirs = await drape.body([], id);
const [clip, other] = [await drape.motion("walk", [], id), await drape.motion("walk")];
let refused = null;
await drape.avatar(new Uint8Array(40), "broken.glb").catch((error) => (refused = error.expected));
drape.close();
const known = (await drape.avatars()).map((one) => one.id);
console.log(JSON.stringify({ id, refused, known, joints: theirs.joints.length,
  smaller: theirs.floor_m > ours.floor_m, placed: clip.trans[0][1] !== other.trans[0][1],
  cut: Buffer.compare(...layouts.map((one) => Buffer.from(one))) !== 0 }));
"""


def test_the_web_library_sends_a_character(live: str, client: DrapeClient, file: Path, tmp_path: Path):
    told = answer_of(LIBRARY, {"url": live, "file": str(file)}, tmp_path)
    assert told["id"] in told["known"] and told["joints"] == 24
    assert told["smaller"] and told["placed"] and told["cut"]
    assert "GLB" in told["refused"]
    client.remove_avatar(told["id"])
