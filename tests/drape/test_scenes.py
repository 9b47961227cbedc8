"""Garments and the character that wears them as scenes and textures, in a program and on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drape
from drape.avatar import wears
from drape.command import main
from drape.errors import BodyError
from drape.motion.clip import MotionClip
from drape.scenes import scene
from tests.drape.test_distilling import clip, me, opened
from tests.fixtures.exports import Usd, UsdGeom, played
from tests.fixtures.glb_reader import Reader

__all__ = ["me", "opened"]  # fixtures


@pytest.fixture(scope="module")
def short() -> MotionClip:
    whole = clip(2)
    return MotionClip(whole.poses[:3], whole.trans[:3], 30.0, "short")


@pytest.fixture(scope="module")
def worn(opened: drape.Drape, me: Path) -> drape.Worn:
    return opened.wear("tank", on=me, tier="instant")


def test_a_scene_has_the_skin_below_the_cloth_and_the_frames_of_both(
    worn: drape.Worn, short: MotionClip, tmp_path: Path
):
    skin, cloth = scene(worn, short)
    frames = np.stack([frame.vertices for frame in worn.play(short)])
    assert_array_equal(cloth.vertices, frames)
    (tmp_path / "me.usdz").write_bytes(drape.usd(worn, short))
    stage = Usd.Stage.Open(str(tmp_path / "me.usdz"))
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    for mesh, given in zip(meshes, (skin, cloth), strict=True):
        assert_array_equal(np.stack([mesh.GetPointsAttr().Get(frame) for frame in range(3)]), given.vertices)
    files = drape.vat(worn, short, name="me")
    places, _, mesh = played(files, "me")
    both = np.concatenate([skin.vertices, cloth.vertices], axis=1)
    assert_allclose(places[:, : both.shape[1]], both, rtol=0, atol=1e-5)
    assert len(mesh.json["meshes"]) == 1


def test_a_character_that_cannot_wear_a_garment_refuses_it_at_once(
    opened: drape.Drape, me: Path, monkeypatch: pytest.MonkeyPatch
):
    """As a service does, and before anything is cut."""
    monkeypatch.setattr(wears, "THICKEST", 0.01)
    with pytest.raises(BodyError, match=r"trousers on .* at most 0.01 times"):
        opened.wear("trousers", on=me)


def test_without_a_character_the_garments_are_alone(opened: drape.Drape, short: MotionClip):
    (cloth,) = scene(opened.wear("tank", tier="instant"), short)
    assert cloth.surface.name == "tank" and cloth.vertices.shape[0] == 3


def test_the_command_writes_the_character_too(me: Path, short: MotionClip, tmp_path: Path):
    np.savez(tmp_path / "short.npz", poses=short.poses.reshape(3, -1), trans=short.trans, mocap_framerate=30.0)
    words = ["wear", "tank", str(tmp_path / "short.npz"), "--on", str(me), "--tier", "instant", "--rig", "--out"]
    assert main([*words, str(tmp_path / "me.usdc")]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "me.usdc"))
    assert sum(prim.IsA(UsdGeom.Mesh) for prim in stage.Traverse()) == 2


def test_the_command_writes_the_rig_in_float32_if_asked(me: Path, short: MotionClip, tmp_path: Path):
    np.savez(tmp_path / "short.npz", poses=short.poses.reshape(3, -1), trans=short.trans, mocap_framerate=30.0)
    words = ["wear", "tank", str(tmp_path / "short.npz"), "--on", str(me), "--tier", "instant", "--rig", "--out"]
    required = []
    for name, more in (("small.glb", []), ("plain.glb", ["--float32"])):
        assert main([*words, str(tmp_path / name), *more]) == 0
        required.append(Reader((tmp_path / name).read_bytes()).json.get("extensionsRequired", []))
    assert required == [["KHR_mesh_quantization"], []]
