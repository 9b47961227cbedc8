"""Frames from their poses on, by a card: from the same memory they are the engine's, bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.cases import FPS, at_rate
from benchmarks.served import Stream, plan_of
from drape.catalog import find_motions
from drape.live import card_lane
from drape.live.card_lane import Lane
from drape.motion.readers import read_motion
from drape.network.card_frame import FrameJob, fetched
from drape.network.frame import Drawn, FrameGarment, Moment, Past, draw
from drape.stages import frame
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.fixtures.paper_card import paper_card, turn_threads

FRAMES = 12


@pytest.fixture(scope="module")
def runtime() -> Iterator[DrapeRuntime]:
    made = DrapeRuntime(Settings(threads=1))
    yield made
    made.close()


@pytest.fixture
def lane(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lane]:
    monkeypatch.setattr(card_lane, "LOST_S", 60.0)  # the emulation is slow
    made = Lane(paper_card)
    yield made
    made.close()


def numbers_of(memory: Any) -> list[bytes]:
    """All arrays and numbers of a memory."""
    if isinstance(memory, np.ndarray):
        return [memory.tobytes()]
    if isinstance(memory, tuple):
        return [one for part in memory for one in numbers_of(part)]
    if hasattr(memory, "__dict__"):
        return [one for name, part in sorted(vars(memory).items()) if name not in ("left", "record")
                for one in numbers_of(part)]  # fmt: skip
    return [repr(memory).encode()]


class Beside:
    """Frames by the engine, and by the emulated card of ``lane`` in both orders of its threads."""

    def __init__(self, lane: Lane) -> None:
        self._lane, self.names = lane, list[str]()

    def __call__(self, worn: FrameGarment, past: Past, at: Moment, vertices: np.ndarray, steps: np.ndarray) -> Drawn:
        made = draw(worn, past, at, vertices, steps)
        assert made is not None
        for backwards in (False, True):
            turn_threads(backwards)
            job = FrameJob(worn, [past], [at])
            self._lane.draw(job)
            assert not self._lane.fault and job.drawn is not None
            (found,) = job.drawn
            assert isinstance(found, Drawn)
            assert job.vertices[0].tobytes() == vertices.tobytes()
            assert job.steps[0].tobytes() == steps.tobytes()
            assert (found.report, found.novelty) == (made.report, made.novelty)
            if len(steps):
                assert (found.low.tobytes(), found.step.tobytes()) == (made.low.tobytes(), made.step.tobytes())
            for one, other in zip(found.past, made.past, strict=True):
                assert numbers_of(fetched(one)) == numbers_of(other)
        self.names.append(getattr(found.past.folded, "name", ""))
        return made


@each(
    case=(
        ("balanced", "tshirt", 1.0, "fold_two_levels"),
        ("accurate", "tank", 0.0, "fold"),
        ("instant", "dress", 1.0, "lift_alone"),
    )
)
def test_a_frame_of_the_card_is_the_engines(runtime: DrapeRuntime, lane: Lane, monkeypatch: Any, case: Any):
    """A walk, whose first frame settles."""
    tier, garment, motion, name = case
    beside = Beside(lane)
    monkeypatch.setattr(frame, "draw", beside)
    plan = plan_of(runtime, [shipped(garment)], messages=True, tier=tier, fabric="jersey", motion=motion)
    stream = Stream(plan, runtime.body.shape_count)
    poses = at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses
    for number in range(FRAMES):
        stream.pose(poses[number], number / FPS)
    assert beside.names == [name] * FRAMES
