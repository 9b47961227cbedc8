"""Garments of a character as joints, in a program and on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import drape
from drape.body.model import BodyModel
from drape.command import main
from drape.distilling import Joints
from drape.motion.clip import MotionClip
from tests.drape.avatar.test_worn_file import listed
from tests.fixtures.characters import character
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.poses import smooth_motion

FRAMES, COUNT = 12, 6


def clip(seed: int) -> MotionClip:
    poses, trans = smooth_motion(np.arange(FRAMES) / 30.0, seed=seed)
    return MotionClip(0.7 * poses, 0.3 * trans, 30.0, f"sway {seed}")


@pytest.fixture(scope="module")
def opened() -> drape.Drape:
    return drape.load()


@pytest.fixture(scope="module")
def me(body: BodyModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("me") / "me.vrm"
    path.write_bytes(character(body, vrm="1", change=listed))
    return path


@pytest.fixture(scope="module")
def dressed(opened: drape.Drape, me: Path) -> drape.Worn:
    return opened.wear(["tank", "shorts"], on=me, tier="instant")


@pytest.fixture(scope="module")
def made(dressed: drape.Worn) -> Joints:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drape.distilling.POSES", 4)
        return drape.distil(dressed, [clip(0)], joints=COUNT)


def test_both_files_hold_the_character_and_each_garment(made: Joints, me: Path, tmp_path: Path):
    was = Reader(me.read_bytes()).json
    for content in (made.glb(clip(1)), made.vrm()):
        file = Reader(content).json
        assert [one["name"] for one in file["meshes"][len(was["meshes"]) :]] == ["tank", "shorts"]
        names = [node.get("name", "") for node in file["nodes"]]
        if "animations" in file:  # on springs only some joints are left
            assert all(f"{garment}_{COUNT - 1:02d}" in names for garment in ("tank", "shorts"))
        assert file["extensions"]["VRMC_vrm"] == was["extensions"]["VRMC_vrm"]
        before = {one["code"] for one in khronos_complaints(me.read_bytes(), tmp_path)}
        assert {one["code"] for one in khronos_complaints(content, tmp_path)} <= before


def test_a_clip_that_nobody_draped_before_is_near_its_drape(made: Joints):
    for one in made.errors_mm(clip(1)):
        assert one["tracks"] < 12.0 and one["tracks"] < one["carried"] < 60.0
        assert one["springs"] < 1.3 * one["carried"]


def test_the_standard_body_has_no_rig_and_counts_have_limits(opened: drape.Drape, dressed: drape.Worn):
    with pytest.raises(drape.DrapeError, match="garments on a character"):
        drape.distil(opened.wear("tank", tier="instant"), [clip(0)])
    with pytest.raises(drape.DrapeError, match="1 to 64"):
        drape.distil(dressed, [clip(0)], joints=0)


def test_the_command_refuses_a_vrm_of_a_plain_glb_before_it_works(body: BodyModel, tmp_path: Path, capsys):
    plain = tmp_path / "plain.glb"
    plain.write_bytes(character(body))
    words = ["wear", "tank", "walk", "--on", str(plain), "--joints", "4", "--tier", "instant"]
    assert main([*words, "--out", str(tmp_path / "x.vrm")]) == 2
    assert "a .glb, as the character is one" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_the_character_in_its_garments(me: Path, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr("drape.distilling.POSES", 4)
    monkeypatch.setattr("drape.catalog.MOTIONS_DIR", tmp_path)  # of no clip but the one that is named
    out, one, path = tmp_path / "dressed.vrm", clip(1), tmp_path / "clips" / "sway.npz"
    path.parent.mkdir()
    np.savez(path, poses=one.poses.reshape(FRAMES, -1), trans=one.trans, mocap_framerate=30.0)
    words = ["wear", "tank", str(path), "--on", str(me), "--joints", "4", "--tier", "instant", "--out", str(out)]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bytes"] == out.stat().st_size and told["joints"] == 4
    (garment,) = told["garments"]
    assert garment["name"] == "tank" and garment["tracks"] < garment["carried"]
