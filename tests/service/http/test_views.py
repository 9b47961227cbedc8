"""Only what a scene needs: far-away views, and that a plan holds no stage and no output that nobody asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.wire import messages as wire
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.compute.tiers import FAR_PIXELS_PER_M, TIERS, chosen
from service.graphs.engine import PACKED, SKIN
from service.settings import Settings
from service.stages import run
from service.stages.batch import Batch, PoseInput
from tests.fixtures.poses import smooth_motion
from tests.fixtures.tiny_model import TINY_DYNAMIC

FAR = 0.5 * FAR_PIXELS_PER_M
POSES, TRANS = smooth_motion(np.arange(3) / 30.0)


@pytest.fixture
def runtime(make_settings: Callable[..., Settings]) -> Iterator[DrapeRuntime]:
    """Anew for each test, so that what it opened is what the test asked for."""
    made = DrapeRuntime(make_settings(model=TINY_DYNAMIC, folds=None))
    yield made
    made.close()


def draped(runtime: DrapeRuntime, **options: object) -> Batch:
    plan = runtime.plan(runtime.garments.get("tube"), DrapeOptions.model_validate(options), messages=True)
    for stage in plan.stages:
        stage.prepare(plan)
    return run(plan, [PoseInput(POSES, TRANS, np.zeros(10), np.arange(3) / 30.0)])


@pytest.mark.parametrize(
    ("asked", "want"),
    [
        ({"pixels_per_m": FAR}, (0, 0, 8)),
        ({"pixels_per_m": FAR, "tier": "accurate"}, (0, 0, 8)),
        ({"pixels_per_m": FAR, "folds": 1}, (1, 0, 8)),
        ({"pixels_per_m": FAR, "passes": 2, "bits": 16}, (0, 2, None)),
        ({"pixels_per_m": FAR_PIXELS_PER_M}, (2, 0, None)),
        ({"pixels_per_m": FAR, "geometry": "jets"}, (0, 0, None)),
        ({"bits": 8}, (2, 0, 8)),
    ],
)
def test_what_is_far_away_has_no_folds_and_8_bits_but_for_what_is_named(asked: dict, want: tuple):
    found = chosen(DrapeOptions(**asked), TIERS, Settings(), 4)
    assert (found.folds, found.passes, found.bits) == want
    assert found.pixels_per_m is None, "distances on one side of the limit are one plan"


def test_frames_of_8_bits_are_those_of_16_to_half_a_step_at_half_the_bytes(runtime: DrapeRuntime):
    near, far = (draped(runtime, folds=0, bits=bits) for bits in (16, 8))
    assert_array_equal(near.vertices, far.vertices)
    for fine, coarse, vertices in zip(near.messages, far.messages, far.vertices, strict=True):
        frame = wire.unpack_frame(coarse)
        assert (np.abs(frame.positions - vertices) <= 0.501 * frame.box_step).all()
        payload = len(fine) - wire.FRAME_HEADER_BYTES
        assert frame.bits == 8 and len(coarse) - wire.FRAME_HEADER_BYTES == payload / 2


@pytest.mark.parametrize(
    ("asked", "stages"),
    [
        ({"inertia": "mesh"}, "network swing folds encode"),
        ({"inertia": "network"}, "motion network folds encode"),
        ({"motion": 0.0}, "network folds encode"),
        ({"motion": 0.0, "pixels_per_m": FAR}, "network collision encode"),
        ({"motion": 0.0, "pixels_per_m": FAR, "push_out": False}, "network encode"),
        ({"motion": 0.0, "geometry": "jets", "push_out": False}, "network encode"),
    ],
)
def test_a_plan_holds_nothing_that_nobody_asked_for(runtime: DrapeRuntime, asked: dict, stages: str):
    before = set(runtime.engine._opened)
    batch = draped(runtime, **asked)
    assert " ".join(stage.name for stage in batch.plan.stages) == stages
    outputs = {name for key in set(runtime.engine._opened) - before if key[0] == PACKED for name in key[1]}
    if not {"swing", "folds", "collision"} & set(stages.split()):
        assert SKIN not in outputs and batch.skin is None
    assert (batch.codes is not None) == ("motion" in stages)
    assert {key[0] for key in batch.memories[0]} == {"motion", "swing", "folds"} & set(stages.split())
