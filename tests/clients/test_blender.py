"""Blender's add-on in Blender, without a window: DRAPE_BPY names a Python that has ``bpy``, unless this one has."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pytest
from numpy.testing import assert_allclose

from clients.client import DrapeClient
from drape.body.model import BodyModel
from service.settings import Settings
from tests.clients.addon import addon_zip
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.serving import serve_in_process

pytestmark = pytest.mark.long
SCRIPT = Path(__file__).with_name("blender_bakes.py")
LIMIT_S = 30.0  # of a bake of 60 frames
SKIN_M = 0.003  # cloth ends 4 mm off our body, which fits a character to some millimetres


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a service with the shipped model and garments."""
    with serve_in_process(Settings(garments_dir=tmp_path_factory.mktemp("uploads"))) as address:
        yield address


@pytest.fixture(scope="module")
def baked(url: str, body: BodyModel, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What Blender told, and the folder with what stood in its scene."""
    python = os.environ.get("DRAPE_BPY", sys.executable)
    if "DRAPE_BPY" not in os.environ and importlib.util.find_spec("bpy") is None:
        pytest.skip("No bpy: pip install bpy into an environment of its own, and name its Python as DRAPE_BPY.")
    folder = tmp_path_factory.mktemp("blender")
    (folder / "ada.glb").write_bytes(character(body, arms_rad=ARMS_DOWN_RAD, scale=0.9))
    command = [python, SCRIPT, addon_zip(folder), url, folder / "ada.glb", folder]
    resources = {"BLENDER_USER_RESOURCES": str(folder / "user")}
    run = subprocess.run(command, env=os.environ | resources, capture_output=True, text=True, timeout=600)
    assert (folder / "told.json").is_file(), run.stdout[-2000:] + run.stderr[-4000:]
    return json.loads((folder / "told.json").read_text()), folder


def y_up(points: np.ndarray) -> np.ndarray:
    """Blender's ``points`` (..., 3) in our axes."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def depths(seen: Any) -> np.ndarray:
    """How far (F, V) [m] cloth lies outside the skin in each frame."""
    frames = zip(seen["cloth"], seen["body"], strict=True)
    faces = seen["faces"].astype(np.int64)
    return np.array([igl.signed_distance(c.astype(float), b.astype(float), faces)[0] for c, b in frames])


def check_off_skin(outside: np.ndarray) -> None:
    """Cloth is outside the skin, but for a few vertices (2 in 1000) and a centimetre, as in an armpit."""
    assert (outside < -SKIN_M).mean() < 0.002 and outside.min() > -0.01


def test_sixty_frames_are_baked_in_half_a_minute(baked: tuple[dict[str, Any], Path]):
    told, _ = baked
    print({name: value for name, value in told.items() if name.endswith("_s") or name == "blender"})
    assert told["keys"] == 60 and told["uv"] == 1 and told["frame after"] == 7
    # The first bake of a character has the service fit our body to it, which is for tests of speed on a machine alone.
    assert max(told["body_s"], told["rig_again_s"]) < LIMIT_S
    assert "tshirt" in told["known"]["garments"] and "exact" not in told["known"]["tiers"]


def test_our_body_wears_what_our_client_drapes_frame_by_frame(baked: tuple[dict[str, Any], Path], url: str):
    seen = np.load(baked[1] / "body.npz")
    with DrapeClient(url) as client:
        clip = client.motion("walk").resampled(30.0)
        whole = client.drape("tshirt", clip.poses[:60], trans=clip.trans[:60])
    # Frames 0, 1, 2, 31, 60, 61: before the first and after the last the cloth stands.
    cloth, expected = y_up(seen["cloth"]), whole[[0, 0, 1, 30, 59, 59]]
    assert_allclose(cloth[:3], expected[:3], rtol=0, atol=1e-4)
    # Blender rounds rotations to float32; where a fold may fall to either side, that decides in the end.
    off = np.linalg.norm(cloth - expected, axis=-1)
    assert (np.median(off, axis=1) < 1e-4).all() and (np.quantile(off, 0.98, axis=1) < 2e-3).all()
    assert baked[0]["between_m"] < 1e-5, "halfway between two frames it is their mean"
    check_off_skin(depths(seen)[1:5])


def test_a_character_of_its_own_is_dressed_wherever_it_stands(baked: tuple[dict[str, Any], Path]):
    seen = np.load(baked[1] / "rig.npz")
    outside = depths(seen)
    check_off_skin(outside)
    assert 0.003 < np.median(outside) < 0.05
    moved = seen["body"].mean(axis=1)
    assert np.linalg.norm(moved[-1] - moved[0]) > 0.8 and (baked[1] / "tshirt.pc2").is_file()


def test_a_second_bake_keeps_the_object_and_a_bake_that_ends_early_leaves_none(baked: tuple[dict[str, Any], Path]):
    told, _ = baked
    assert told["again"] == [5, "red", 3]  # keys, material, objects: the armature, its skin, the cloth
    assert told["ended"] == [3, True]
    assert told["baked"] and not told["undone"]


@pytest.mark.parametrize(
    ("case", "sentence"),
    [
        ("nothing chosen", "garment: expected a name, got none. Connect"),
        ("no armature", "character: expected an armature, got none. Choose one"),
        ("garment gone", "garment: expected one of: circle_skirt, "),
        ("unsaved", "point cache: expected a file beside which it lies"),
        ("stretched", "scale of Armature: expected one and the same, above 0"),
        ("hidden", "Armature: expected a visible mesh that its bones move, got none. Show its mesh"),
        ("elsewhere", "network: expected leave to ask other machines, got none. Allow Online Access"),
    ],
)
def test_what_cannot_be_baked_is_refused_with_its_cure(baked: tuple[dict[str, Any], Path], case: str, sentence: str):
    assert sentence in baked[0][case]
