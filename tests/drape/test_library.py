"""``drape.load``, ``wear``, ``play``, ``pose``: garments in a program of one's own."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import drape
from drape.folders import ASSETS


@pytest.fixture(scope="module")
def opened() -> drape.Drape:
    return drape.load()


def test_a_clip_is_draped_frame_by_frame(opened: drape.Drape):
    worn = opened.wear("tank", tier="fast")
    frames = list(islice(worn.play("walk"), 10))
    assert worn.tier == "fast" and [one.name for one in worn.garments] == ["tank"]
    assert frames[0].vertices.shape == (worn.garments[0].vertex_count, 3)
    assert np.diff([one.time_s for one in frames]) == pytest.approx(1.0 / 30.0)
    assert np.abs(frames[9].vertices - frames[0].vertices).max() > 0.01


def test_poses_one_by_one_are_the_clip_and_begin_anew_when_told(opened: drape.Drape):
    worn = opened.wear("tank")
    clip = worn.placed("walk").window(0, 11)
    played = [one.vertices for one in worn.play(clip, as_recorded=True)]

    def posed() -> list[np.ndarray]:
        steps = zip(clip.poses, clip.trans, np.arange(11) / clip.fps, strict=True)
        return [worn.pose(pose, trans, time_s=time_s).vertices for pose, trans, time_s in steps]

    assert_array_equal(posed(), played)
    worn.restart()
    assert_array_equal(posed(), played)


def test_layers_come_one_after_the_other_and_hidden_ones_do_not(opened: drape.Drape):
    both = opened.wear(["shorts", "tank"], tier="fast")
    assert [one.name for one in both.garments] == ["shorts", "tank"]
    (frame,) = islice(both.play("walk"), 1)
    assert len(frame.vertices) == sum(one.vertex_count for one in both.garments)
    assert [one.name for one in opened.wear(["shorts", "tank"], hidden=("shorts",)).garments] == ["tank"]


def test_sizes_are_of_all_or_of_each_garment(opened: drape.Drape):
    medium, large = (opened.wear(["shorts", "tank"], size=[None, size]).layers for size in ("M", "XL"))
    assert medium[0].digest == large[0].digest
    assert np.ptp(large[1].vertices[:, 0]) > 1.02 * np.ptp(medium[1].vertices[:, 0])
    assert opened.wear(["shorts", "tank"], size="M").layers[1].digest == medium[1].digest
    with pytest.raises(drape.DrapeError, match="size: expected one for all, or 2"):
        opened.wear(["shorts", "tank"], size=["M"])


def test_a_file_is_worn_as_a_name_is(opened: drape.Drape):
    (path,) = (ASSETS / "garments").glob("tank-*.npz")
    (theirs,) = islice(opened.wear("tank").play("turn"), 1)
    (ours,) = islice(opened.wear(path).play("turn"), 1)
    assert_array_equal(ours.vertices, theirs.vertices)


@pytest.mark.parametrize(
    ("garments", "options", "match"),
    [
        ("tnk", {}, "Did you mean tank"),
        ([], {}, "one or more"),
        ("tank", {"tiers": "fast"}, "some of"),
        ("tank", {"tier": "best"}, "tier: expected"),
        ("tank", {"tier": "exact"}, "exact"),
        ("tank", {"advanced": {"folds": 99}}, r"^advanced\.folds: expected less than or equal to 16"),
        ("tank", {"folds": 99}, "^folds: expected less than or equal to 16"),
        ("tank", {"geometry": "jets"}, "^options: expected some of: ((?!geometry).)*, got geometry"),
        ("tank", {"fabric": "wol"}, "fabric"),
        ("tank", {"on": "nobody.glb"}, "GLB or VRM"),
        ("tank", {"betas": [1000.0]}, "betas"),
    ],
)
def test_what_cannot_be_worn_is_refused(opened: drape.Drape, garments, options, match: str):
    with pytest.raises(drape.DrapeError, match=match):
        opened.wear(garments, **options)


def test_what_is_no_motion_is_refused(opened: drape.Drape):
    worn = opened.wear("tank", tier="instant")
    with pytest.raises(drape.DrapeError, match="motion"):
        worn.placed("wlk")
    with pytest.raises(drape.DrapeError, match="radians"):
        worn.pose(np.full((24, 3), 5000.0), time_s=0.0)


def test_the_public_names_are_those_of_the_page():
    page = (ASSETS.parents[1] / "docs/reference/library.md").read_text()
    listed = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert sorted(listed) == sorted(drape.__all__) and len(listed) <= 20
    assert all(getattr(drape, name) is not None for name in listed)
