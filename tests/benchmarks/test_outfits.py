"""The outfits benchmark: its quick run on the small network, its measures, what it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks import outfits
from benchmarks.measure.skin_pixels import PosedBody
from benchmarks.outfits import COLUMNS, METHODS, Drapes, Watched, Worn, at_rest, missed
from benchmarks.scenes import Clip
from drape.body.assets import load_body
from drape.errors import InputError
from drape.garment.cache import save_garment
from drape.motion.hard_poses import HardPoses
from tests.drape.geometry.geometry_shapes import icosphere
from tests.fixtures.packed import exported, garment

BALL, FACES = icosphere(3, radius_m=0.15)


def balls() -> Any:
    """Two garments that are balls, all of the inner one covered."""
    ball = SimpleNamespace(vertices=BALL, vertex_count=len(BALL), faces=FACES)
    return SimpleNamespace(name="balls", inner=ball, outer=ball, covered=np.ones(len(FACES), bool))


def scaled(*factors: tuple[float, float]) -> Drapes:
    """Balls, the inner and the outer so many times as large, around one that is 0.9 times as large."""
    body = PosedBody.of(0.9 * BALL, FACES)
    labels = tuple(f"ball:{frame}" for frame in range(len(factors)))
    clip = SimpleNamespace(measured=np.arange(len(factors)), labels=labels)
    watched: Any = SimpleNamespace(clip=clip, bodies=(body,) * len(factors))
    vertices = np.stack([np.concatenate([inner * BALL, outer * BALL]) for inner, outer in factors])
    return Drapes.of(balls(), watched, vertices)


def test_what_shows_is_of_pixels_and_the_worst_frame_is_named():
    drapes = scaled((1.0, 1.03), (1.0, 0.98), (0.85, 0.87))
    assert_array_equal(drapes.through[[0, 2]], 0.0)  # in the last frame the body hides both
    figures = drapes.figures(balls())
    assert 80.0 < figures["through_worst_pct"] < 100.0 and figures["worst"] == "ball:1"
    assert_allclose(figures["through_pct"], figures["through_worst_pct"] / 3.0)
    assert_allclose(figures["edge_pct"], (3.0 + 2.0 + 13.0) / 3.0)
    assert figures["self_intersections"] == 0.0


def test_targets_are_for_what_is_served():
    row = {"outfit": "a+b", "clip": "walk", "method": "over", "through_pct": 0.05, "through_worst_pct": 0.5}
    assert missed([row, row | {"method": "alone", "through_pct": 9.0}]) == []
    for name in ("through_pct", "through_worst_pct"):
        assert missed([row | {name: 0.6}]) == ["a+b in walk"]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    shipped = tmp_path_factory.mktemp("shipped")
    chosen = ["--model", str(exported()[1]), "--outfits", "tank+longsleeve"]
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("DRAPE_SHIPPED_GARMENTS_DIR", str(shipped))  # all of them take 10 s to load
        return outfits.main(["--quick", "--threads", "1", *chosen])


@pytest.mark.long
def test_the_quick_run_measures_every_method_in_a_stream_and_in_poses(record: dict[str, Any]):
    rows = record["rows"]
    assert [(row["clip"], row["method"]) for row in rows] == [(c, m) for c in ("walk", "poses") for m in METHODS]
    for row in rows:
        streamed = row["clip"] == "walk"
        kept = COLUMNS.keys() - ({"times_singles"} if row["method"] != "over" else set())
        assert row.keys() == kept - (set() if streamed else {"jitter_ratio"})
        assert 0.0 <= row["through_pct"] <= row["through_worst_pct"] <= 100.0
        assert row["worst"] in record["frames"][row["clip"]] and row["processor_ms"] > 0.0
    alone, over, projected = rows[:3]
    assert max(over["through_pct"], projected["through_pct"]) < alone["through_pct"]
    assert record["frames"]["walk"] == ["walk:0", "walk:7"] and len(record["frames"]["poses"]) == 1
    assert 0.0 < record["covered_pct"]["tank+longsleeve"] < 100.0


def test_an_outfit_is_two_garments_that_overlap(tmp_path: Path):
    body = load_body()
    for text in ("tank", "tank+shorts+tshirt"):
        with pytest.raises(InputError, match="inner\\+outer"):
            Worn.of(text, body)
    worn = Worn.of("trousers+tshirt", body)
    assert (worn.inner.name, worn.outer.name) == ("trousers", "tshirt")
    height = at_rest(worn.inner)[0][worn.inner.faces].mean(axis=1)[:, 1]
    assert height[worn.covered].min() > height[~worn.covered].mean(), "the waist, not the legs"
    tank = garment("tank")
    floating = replace(tank, vertices=tank.vertices + np.array([0.0, 1.0, 0.0], np.float32))
    with pytest.raises(InputError, match="an outer garment over the inner"):
        Worn.of(f"trousers+{save_garment(floating, tmp_path)}", body)


def test_poses_have_no_past_and_are_all_measured():
    body = load_body()
    poses = Watched.of(Clip.hard(HardPoses(np.zeros((2, 24, 3)), ("a:0", "a:1")), body), streamed=False)
    assert not poses.streamed and len(poses.clip.labels) == len(poses.bodies) == 2
    assert_array_equal(poses.clip.measured, [0, 1])
