"""Stills that are kept as numbers, and rows of streams beside them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import moving, stills
from benchmarks.scenes import FPS, Clip
from drape.body.model import BodyModel
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.garments import shipped


@pytest.fixture(scope="module")
def drapery() -> DrapeRuntime:
    return DrapeRuntime(Settings(threads=1))


@pytest.fixture(scope="module")
def clip(body: BodyModel) -> Clip:
    """A body that bows."""
    poses = np.zeros((12, 24, 3))
    poses[:, 3, 0] = np.linspace(0.0, 0.5, 12)
    return Clip.of("bow", FPS, poses, body)


def test_a_still_is_made_once_and_then_read(drapery: DrapeRuntime, clip: Clip, tmp_path: Path):
    garment, path = shipped("tank"), tmp_path / "stills.json"
    (row,) = stills.Stills(drapery, path).of([garment], clip, 11)
    assert row["curvature"] > 1.0 and 0.1 < row["area_m2"] < 2.0
    path.write_text(json.dumps({"rows": [row | {"curvature": -1.0}]}))
    kept = stills.Stills(drapery, path)
    assert kept.of([garment], clip, 11)[0]["curvature"] == -1.0
    assert stills.Stills(drapery, path, anew=True).rows == {}
    assert kept.of([garment], clip, 6)[0]["curvature"] > 0.0  # another pose is made


def test_an_exact_drape_is_made_when_asked_for(drapery: DrapeRuntime, clip: Clip, tmp_path: Path):
    garment, kept = shipped("tank"), stills.Stills(drapery, tmp_path / "stills.json")
    assert kept.exact_of(garment, clip, 11) is None
    row, (settled,) = kept.exact_of(garment, clip, 11, made=True), kept.of([garment], clip, 11)
    assert row is not None and row == kept.exact_of(garment, clip, 11)
    assert row["crossings"] == 0 and row["force_share"] < 0.02
    assert 0.0 < abs(row["curvature"] / settled["curvature"] - 1.0) < 0.2


def test_crumpled_cloth_has_more_curvature_than_its_still(drapery: DrapeRuntime, clip: Clip, rng: np.random.Generator):
    garment, skin = shipped("tank"), moving.Skin(clip)
    vertices, told = moving.streamed(drapery, [garment], clip, "balanced")
    assert told["resets"] == 0 and vertices.shape == (12, garment.vertex_count, 3)
    looks = stills.looks_of(garment)
    at_rest = {11: stills.figures(looks, vertices[11].astype(float))}
    same = moving.moving_row(looks, np.repeat(vertices[11:], 12, axis=0).astype(float), _standing(skin), at_rest, {})
    assert np.isnan(same["exact"])
    assert same["curvature"] == pytest.approx(1.0) and same["area"] == pytest.approx(1.0)
    shaken = vertices[11].astype(float) + rng.normal(0.0, 0.002, vertices[11].shape)
    crumpled = moving.moving_row(looks, np.repeat(shaken[None], 12, axis=0), _standing(skin), at_rest, at_rest)
    assert crumpled["exact"] == pytest.approx(crumpled["dihedral"])
    assert crumpled["curvature"] > 2.0 and crumpled["strain_pct"] > same["strain_pct"]


def _standing(skin: moving.Skin) -> moving.Skin:
    """The skin of a body that only trembles, so that jitter has a measure."""
    clip = skin.clip
    poses = np.repeat(clip.poses[11:], 12, axis=0)
    poses[:, 18, 0] += 0.1 * np.sin(np.arange(12.0) ** 2)
    return moving.Skin(replace(clip, poses=poses))
