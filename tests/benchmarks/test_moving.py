"""Stills that are kept as numbers, and rows of streams beside them."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from benchmarks import moving, stills
from benchmarks.cases import FPS, CaseClip, lively_clips
from benchmarks.harness import RESULTS_DIR, commit_of_tree
from drape.body.model import BodyModel
from drape.motion.clip import MotionClip
from service.compute.drape_runtime import DrapeRuntime
from tests.fixtures.garments import shipped
from tests.fixtures.serving import bare_settings


@pytest.fixture(scope="module")
def drapery(tmp_path_factory: pytest.TempPathFactory) -> DrapeRuntime:
    return DrapeRuntime(bare_settings(tmp_path_factory.mktemp("none")))


@pytest.fixture(scope="module")
def clip(body: BodyModel) -> CaseClip:
    """A body that bows."""
    poses = np.zeros((12, 24, 3))
    poses[:, 3, 0] = np.linspace(0.0, 0.5, 12)
    return CaseClip.of("bow", FPS, poses, body)


def test_a_still_is_made_once_and_then_read(drapery: DrapeRuntime, clip: CaseClip, tmp_path: Path):
    garment, path = shipped("tank"), tmp_path / "stills.json"
    (row,) = stills.Stills(drapery, path).of([garment], clip, 11)
    assert row["curvature"] > 1.0 and 0.1 < row["area_m2"] < 2.0 and row["commit"] == commit_of_tree()
    path.write_text(json.dumps({"rows": [row | {"curvature": -1.0}]}))
    kept = stills.Stills(drapery, path)
    assert kept.of([garment], clip, 11)[0]["curvature"] == -1.0
    assert stills.Stills(drapery, path, anew=True).rows == {}
    assert kept.of([garment], clip, 6)[0]["curvature"] > 0.0  # another pose is made


def test_an_exact_drape_is_made_when_asked_for(drapery: DrapeRuntime, clip: CaseClip, tmp_path: Path):
    garment, kept = shipped("tank"), stills.Stills(drapery, tmp_path / "stills.json")
    assert kept.exact_of(garment, clip, 11) is None
    row, (settled,) = kept.exact_of(garment, clip, 11, computes=True), kept.of([garment], clip, 11)
    assert row is not None and row == kept.exact_of(garment, clip, 11)
    assert row["crossings"] == 0 and row["force_share"] < 0.02
    assert 0.0 < abs(row["curvature"] / settled["curvature"] - 1.0) < 0.2


def test_crumpled_cloth_has_more_curvature_than_its_still(
    drapery: DrapeRuntime, clip: CaseClip, rng: np.random.Generator
):
    garment, skin = shipped("tank"), _standing(moving.ClipSkin(clip))
    vertices, told = moving.streamed(drapery, [garment], clip, "balanced")
    assert told["resets"] == 0 and vertices.shape == (12, garment.vertex_count, 3)
    looks = stills.looks_of(garment)
    at_rest = {11: stills.still_figures(looks, vertices[11].astype(float))}
    stays = np.repeat(vertices[11:], 12, axis=0).astype(float)
    same = moving.shares_of(looks, stays, [at_rest], {})
    assert np.isnan(same["exact"])
    assert same["curvature"] == pytest.approx(1.0) and same["area"] == pytest.approx(1.0)
    shaken = stays + rng.normal(0.0, 0.002, vertices[11].shape)
    crumpled = moving.shares_of(looks, shaken, [at_rest], at_rest)
    assert crumpled["exact"] == pytest.approx(crumpled["dihedral"])
    assert crumpled["curvature"] > 2.0
    strains = [moving.moving_row(looks, x, skin)["strain_pct"] for x in (stays, shaken)]
    assert strains[1] > strains[0]


def test_each_frame_is_beside_the_still_of_its_own_pose(
    drapery: DrapeRuntime, clip: CaseClip, rng: np.random.Generator
):
    """Cloth that always lies as its still does, crumpled at first and ever smoother: shares of 1 of its own stills,
    more of the last one.
    """
    looks = stills.looks_of(shipped("tank"))
    noise = rng.normal(0.0, 0.002, looks.place.shape)
    vertices = looks.place + np.linspace(1.0, 0.0, 12)[:, None, None] * noise
    own = [{frame: stills.still_figures(looks, vertices[frame]) for frame in near} for near in stills.posed_at(clip)]
    row = moving.shares_of(looks, vertices, own, own[-1])
    for name in (*moving.SHARES, "exact"):
        assert row[name] == pytest.approx(1.0), name
    over_last = [still["curvature"] / near[max(near)]["curvature"] for near in own for still in near.values()]
    assert row["curvature_last"] == pytest.approx(np.mean(over_last)) and row["curvature_last"] > 1.5


def test_a_place_of_a_clip_is_measured_at_few_frames_up_to_it(clip: CaseClip, body: BodyModel):
    assert stills.posed_at(clip) == [[0, 3, 6], [2, 5, 8, 11]]  # no frame is before the first one
    long = CaseClip.of("long", FPS, np.zeros((120, 24, 3)), body)
    assert stills.posed_at(long) == [[56, 59, 62, 65], [110, 113, 116, 119]]


def test_the_record_has_the_still_of_every_measured_pose(body: BodyModel):
    """What the record of moving cloth was measured against does not move with the engine."""
    moved, kept = (json.loads((RESULTS_DIR / f"{name}.json").read_text()) for name in ("moving", "stills"))
    known = {tuple(row[name] for name in stills.KEY) for row in kept["rows"]}
    digests = {name: shipped(name).digest[:8] for name in {row["garment"] for row in moved["rows"]}}
    captured = moving.main.parse([]).captured_frames
    for garment, name in {(row["garment"], row["clip"]) for row in moved["rows"]}:
        frames = captured if "@" in name else moved["frames"]
        clip = CaseClip.of(name, FPS, np.zeros((frames, 24, 3)), body)
        keys = {(garment, digests[garment], name, frame, stills.SETTLED) for frame in chain(*stills.posed_at(clip))}
        assert keys <= known, f"{garment} in {name}: python -m benchmarks.stills --save"


def test_cloth_in_the_body_is_counted(clip: CaseClip):
    garment, skin = shipped("tank"), _standing(moving.ClipSkin(clip), 0)
    worn, looks = garment.vertices[: garment.vertex_count].astype(float), stills.looks_of(garment)
    outside, inside = (
        moving.moving_row(looks, np.repeat(x[None], 12, axis=0), skin) for x in (worn, worn - [0.0, 0.0, 0.05])
    )
    assert outside["inside"] == outside["inside_worst"] == 0.0
    assert inside["inside_worst"] >= inside["inside"] > 100.0 and inside["depth_mm"] > moving.DEEP_MM


def test_of_captured_clips_the_liveliest_frames_are_worn(body: BodyModel, tmp_path: Path):
    """An arm swings in the second of three seconds; what the head does is no movement of limbs."""
    poses = np.zeros((90, 24, 3))
    poses[30:60, 16, 0] = np.sin(np.arange(30.0))
    poses[60:, 15, 0] = 2.0 * np.sin(np.arange(30.0))
    MotionClip(poses, np.zeros((90, 3)), FPS, "swung").save(tmp_path / "swung.npz")
    (clip,) = lively_clips([str(tmp_path / "swung.npz")], 32, body)
    assert clip.name in ("swung@28", "swung@29", "swung@30") and len(clip.poses) == 32
    assert len(lively_clips([str(tmp_path)], 500, body)[0].poses) == 90
    assert lively_clips([], 32, body) == []


@pytest.mark.usefixtures("few_garments")
def test_captured_clips_have_means_of_their_own(tmp_path: Path):
    poses = np.zeros((12, 24, 3))
    poses[:, 16, 2] = np.linspace(0.0, -0.5, 12)
    MotionClip(poses, np.zeros((12, 3)), FPS, "raised").save(tmp_path / "raised.npz")
    words = ["--garments", "tank", "--motions", "walk", "--frames", "5", "--tiers", "fast"]
    record = moving.main([*words, "--captured", str(tmp_path), "--captured-garments", "tank", "--captured-frames", "5"])
    (walk,), (raised,) = ([row for row in record["rows"] if row["clip"].startswith(one)] for one in ("walk", "raised@"))
    for means, row in (("means", walk), ("captured", raised)):
        assert record[means][0]["curvature"] == pytest.approx(row["curvature"], rel=1e-5)


def _standing(skin: moving.ClipSkin, frame: int = 11) -> moving.ClipSkin:
    """The skin of a body that only trembles, so that jitter has a measure."""
    clip = skin.clip
    poses = np.repeat(clip.poses[frame : frame + 1], 12, axis=0)
    poses[:, 18, 0] += 0.1 * np.sin(np.arange(12.0) ** 2)
    return moving.ClipSkin(replace(clip, poses=poses))
