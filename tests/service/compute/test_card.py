"""A service with a card: folds by its lane, what it tells, and streams that go on when the card is gone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from benchmarks.cases import FPS
from benchmarks.served import plan_of
from drape.live import card_lane, card_lanes
from drape.live.card_lane import Lane
from drape.live.card_lanes import Lanes
from drape.stages.batch import PoseInput
from drape.stages.walk import run
from service.compute import drape_runtime
from service.compute.drape_runtime import DrapeRuntime, open_lane
from service.http.info_routes import card_health
from tests.fixtures.garments import shipped
from tests.fixtures.paper_card import SOURCE, driver, fails, paper_card
from tests.fixtures.poses import random_motion
from tests.fixtures.serving import bare_settings


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrapeRuntime]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card_lane, "LOST_S", 60.0)  # the emulation is slow
        patch.setattr(card_lane, "GATHERED_S", 0.3)  # and threads of a busy machine come late
        patch.setattr(drape_runtime, "open_lane", lambda: Lanes([Lane(paper_card)]))
        with closing(DrapeRuntime(bare_settings(tmp_path_factory.mktemp("none")))) as made:
            yield made


def test_streams_of_a_batch_are_drawn_together_and_outlive_their_card(runtime: DrapeRuntime):
    lane = runtime.lane
    assert lane is not None and lane.works
    plans = [plan_of(runtime, [shipped("tank")], tier=tier, motion=0.0) for tier in ("instant", "fast", "fast")]
    before = lane.report()  # preparing drew a frame
    poses, trans = random_motion(3, seed=5)
    poses *= 0.1

    def follow(frames: int) -> list[np.ndarray]:
        """Frames of two streams with one motion; first steps after a lift, those of the second, are the processor's."""
        memories, found = [{}, {}], []
        for i in range(frames):
            inputs = [
                PoseInput(poses[i : i + 1], trans[i : i + 1], np.zeros(10), np.array([i / FPS]), memories=memory)
                for memory in memories
            ]
            batch = run(plans[i], inputs)
            memories = list(batch.memories)
            found.append(batch.vertices)
        return found

    by_card = follow(3)
    told = card_health(lane)
    assert told is not None and told.frames - before.frames == 4 and told.launches - before.launches == 2
    assert told.name == "Card of paper" and told.fault == "" and told.occupied > 0
    fails("cuLaunchKernel")
    alone = follow(3)
    told = card_health(lane)
    assert told is not None and not lane.works and told.fault.startswith("Card of paper: cuLaunchKernel")
    for one, other in zip(by_card, alone, strict=False):
        assert one.tobytes() == other.tobytes()
    assert card_health(None) is None


def test_a_start_looks_for_a_card_and_goes_on_without(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setattr(card_lanes, "kernels", lambda: None)
    assert open_lane() is None  # without the extra
    monkeypatch.setattr(card_lanes, "kernels", lambda: SOURCE)
    lane = open_lane("libno_such_driver.so")
    assert lane is not None and not lane.works and lane.report().fault in caplog.text
    assert all(
        words in lane.report().fault for words in ("expected NVIDIA's driver", "frames are computed by the processor")
    )
    paper_card()
    with closing(open_lane(driver()[0])) as found:  # pyright: ignore[reportArgumentType]
        assert found.works  # pyright: ignore[reportOptionalMemberAccess]
