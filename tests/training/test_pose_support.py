"""The command that keeps the poses of training beside a model."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from drape.artifacts import MODELS_DIR, load_manifest
from drape.body.pose_distance import read_pose_support
from drape.errors import ArtifactError, NotFound
from tests.fixtures.poses import smooth_motion
from training import pose_support
from training.poses import mirror_poses


def poses(frames: int, start_s: float = 0.0) -> np.ndarray:
    return smooth_motion(start_s + np.arange(frames) / 30.0)[0]


def test_the_furthest_points_come_first_and_copies_never():
    rows = np.array([[0.0], [1.0], [5.0], [5.0], [3.0]])
    assert pose_support.spread_rows(rows, 3).ravel().tolist() == [0.0, 5.0, 3.0]
    assert len(pose_support.spread_rows(rows, 9)) == 4


def test_seen_poses_and_their_mirror_images_are_within_and_so_are_99_of_100_unseen_ones():
    seen, unseen = poses(200), poses(400, 7.0)
    made = pose_support.support_of(seen, unseen)
    assert (made.novelty(unseen) <= 1.0).mean() >= pose_support.PASSING
    few = pose_support.support_of(seen, unseen, counts={"legs": 200, "trunk": 200, "tilt": 400})
    assert few.distances(mirror_poses(seen[:1])).max() <= few.distances(unseen).max()
    shares = pose_support.shares_beyond(made, {"seen": seen})
    assert shares["uniform to 3.1 rad"] == 1.0


def test_it_goes_into_the_manifest_and_a_changed_file_is_refused(tmp_path: Path, monkeypatch):
    folder = Path(shutil.copytree(MODELS_DIR / "onefit", tmp_path / "onefit"))
    made = pose_support.support_of(poses(20), poses(20, 3.0))
    pose_support.write_support(folder, made)
    spec = load_manifest(folder).poses
    assert spec is not None and np.array_equal(read_pose_support(folder / spec.file).legs, made.legs)
    (folder / spec.file).write_bytes(b"changed")
    with pytest.raises(ArtifactError, match=r"poses.npz sha256"):
        load_manifest(folder)
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    with pytest.raises(NotFound, match="DRAPE_DATA"):
        pose_support.main(["--model", "onefit"])
