"""Poses unlike training: they are told, and folds have the steps of the safe tier."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import httpx
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.wire import messages as wire
from drape.wire.jets import unpack_jets
from drape.wire.options import DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.compute.tiers import TIERS, capped, chosen
from service.settings import Settings
from service.stages import run
from service.stages.batch import Batch, PoseInput
from tests.fixtures.poses import smooth_motion
from tests.fixtures.serving import serve
from tests.fixtures.tiny_model import write_tiny_model
from training.pose_support import support_of, write_support

SEEN = smooth_motion(np.arange(60) / 30.0)[0]
ABSURD = np.random.default_rng(0).uniform(-2.0, 2.0, (1, 24, 3))
MIXED = np.concatenate([SEEN[:2], ABSURD, SEEN[2:3]])


@pytest.fixture(scope="module")
def runtime(make_settings: Callable[..., Settings], body, tmp_path_factory) -> Iterator[DrapeRuntime]:
    """Of a model that knows its poses."""
    folder = tmp_path_factory.mktemp("novelty")
    write_support(write_tiny_model(folder, body), support_of(SEEN, SEEN))
    made = DrapeRuntime(make_settings(models_dir=folder, folds=None))
    yield made
    made.close()


def draped(runtime: DrapeRuntime, poses: np.ndarray, **options: object) -> Batch:
    asked = DrapeOptions.model_validate({"settle": 1} | options)
    plan = runtime.plan(runtime.garments.get("tube"), asked, messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    return run(plan, [PoseInput(poses, np.zeros((len(poses), 3)), np.zeros(10), np.arange(len(poses)) / 30.0)])


@pytest.mark.parametrize(
    ("asked", "want"),
    [
        ({}, (2, 4)),
        ({"tier": "fast"}, (1, 4)),
        ({"tier": "accurate"}, (4, 4)),
        ({"folds": 2}, (2, 2)),
        ({"budget_ms": 9.0}, (2, 2)),
        ({"folds": 3, "safe_folds": 9}, (3, 9)),
        ({"folds": 3, "safe_folds": 0}, (3, 3)),
        ({"folds": 0, "safe_folds": 9}, (0, 0)),
        ({"geometry": "jets"}, (0, 0)),
    ],
)
def test_steps_of_unlike_poses_are_the_last_tiers_where_the_service_chooses(asked: dict, want: tuple):
    found = chosen(DrapeOptions(**asked), TIERS, Settings(), 4)
    assert (found.folds, found.safe_folds) == want


def test_under_load_a_lower_tier_holds_safe_steps_too():
    asked = chosen(DrapeOptions(), TIERS, Settings(), 4)
    assert [capped(asked, tier).safe_folds for tier in TIERS] == [1, 4, 4]


def test_only_the_frame_unlike_training_gets_more_steps(runtime: DrapeRuntime):
    mixed, plain = draped(runtime, MIXED), draped(runtime, MIXED, safe_folds=0)
    assert (mixed.quality.novelty > 1.0).tolist() == [False, False, True, False]
    assert_array_equal(mixed.vertices[:2], plain.vertices[:2])
    assert np.abs(mixed.vertices[2] - plain.vertices[2]).max() > 0.0
    all_safe = draped(runtime, ABSURD, folds=4)
    assert_array_equal(draped(runtime, ABSURD).vertices, all_safe.vertices)


def test_messages_tell_the_score_and_whether_it_is_beyond(runtime: DrapeRuntime):
    batch = draped(runtime, MIXED)
    for frame, message in enumerate(batch.messages):
        novelty, flags = batch.quality.novelty[frame], message[6]
        assert bool(flags & wire.FLAG_UNLIKE) == (frame == 2)
        assert abs(wire.unpack_frame(message).novelty - min(novelty, 255 / 32)) <= 0.5 / 32
    (jets,) = draped(runtime, ABSURD, geometry="jets").messages
    assert unpack_jets(jets).novelty > 1.0


def test_a_clip_and_a_model_without_poses_say_so_in_headers(runtime: DrapeRuntime, make_settings):
    asked = {"garment": "tube", "poses": MIXED.tolist()}
    with serve(create_app(runtime.settings, runtime=runtime), runtime.settings) as url:
        headers = httpx.post(url + "/drape", json=asked).headers
    assert float(headers["X-Drape-Novelty"]) > 1.0
    assert (headers["X-Drape-Unlike"], headers["X-Drape-Safe-Folds"], headers["X-Drape-Folds"]) == ("1", "4", "2")
    plain = DrapeRuntime(make_settings(folds=None))
    assert plain.plan(plain.garments.get("tube"), DrapeOptions()).stages[0].name == "network"
    assert draped(plain, ABSURD).quality.novelty.tolist() == [0.0]
    plain.close()
