"""Under load streams step down by tier before they drop more, never above what was asked, and come up again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest
from websockets.asyncio.client import ClientConnection

from drape.wire import messages as wire
from service.settings import Settings
from service.stream import workers
from service.stream.workers import CALM_LIMIT_S, CALM_S, WINDOW_S, StepDown
from tests.fixtures.serving import served
from tests.service.stream.test_routes import opened, run, send

TOP = 2


def passed(held: StepDown, now_s: float, windows: int, *, late: int = 0, busy: float = 0.2) -> float:
    """The time after so many windows of ten frames with ``late`` poses each and a worker as ``busy`` as that."""
    for _ in range(windows):
        now_s += WINDOW_S
        held.note(now_s, frames=10, late=late, busy_s=busy * WINDOW_S)
    return now_s


CALM_WINDOWS = round(CALM_S / WINDOW_S)


def test_late_poses_step_down_at_once_and_calm_steps_up_slowly():
    held = StepDown(TOP, 0.0)
    now_s = passed(held, 0.0, 3)
    assert held.level == TOP
    now_s = passed(held, now_s, 1, late=1, busy=0.2)
    assert held.level == TOP - 1
    now_s = passed(held, now_s, 5, late=5, busy=0.2)
    assert held.level == 0, "lower there is none"
    now_s = passed(held, now_s, CALM_WINDOWS - 1)
    assert held.level == 0
    now_s = passed(held, now_s, 1)
    assert held.level == 1
    now_s = passed(held, now_s, CALM_WINDOWS - 1)
    assert held.level == 1
    passed(held, now_s, 1)
    assert held.level == TOP


def test_the_more_is_late_the_more_steps_it_goes_down():
    for late, level in ((1, 4), (2, 4), (4, 3), (10, 1), (17, 0)):
        held = StepDown(5, 0.0)
        passed(held, 0.0, 1, late=late)
        assert held.level == level
    held = StepDown(1, 0.0)
    passed(held, 0.0, 1, late=9)
    assert held.level == 0


def test_counts_wait_for_the_end_of_their_window():
    held = StepDown(TOP, 0.0)
    for _ in range(40):
        held.note(0.9 * WINDOW_S, frames=9, late=1, busy_s=0.0)
    assert held.level == TOP
    held.note(WINDOW_S, frames=1, late=0, busy_s=0.0)
    assert held.level == TOP - 1


def test_without_room_for_what_the_next_tier_takes_nothing_steps_up():
    held = StepDown(TOP, 0.0)
    now_s = passed(held, 0.0, 1, late=9, busy=1.0)  # a frame of this tier took a tenth of the window
    now_s = passed(held, now_s, 40, busy=0.5)
    assert held.level == TOP - 1, "ten frames of it would take all of the window"
    for _ in range(10):  # but two of them a fifth
        now_s += WINDOW_S
        held.note(now_s, frames=2, late=0, busy_s=0.1 * WINDOW_S)
    assert held.level == TOP


def test_a_step_up_that_failed_is_tried_again_later_and_later():
    held = StepDown(1, 0.0)
    now_s, waits = passed(held, 0.0, 4), []
    for _ in range(8):
        now_s = passed(held, now_s, 1, late=9)
        assert held.level == 0
        begun_s = now_s
        while held.level == 0:
            now_s = passed(held, now_s, 1)
        waits.append(now_s - begun_s)
    assert waits == [min(CALM_S * 2**i, CALM_LIMIT_S) for i in range(8)]


async def flood(
    socket: ClientConnection, sequence: int, seconds: float, rate: float, *, together: int = 1
) -> tuple[int, list[wire.Frame]]:
    """The next sequence after ``seconds`` of poses at ``rate``, so many ``together``, and what came meanwhile.

    One by one a quick processor would drape them all.
    """
    frames: list[wire.Frame] = []

    async def take() -> None:
        while True:
            message = await socket.recv()
            assert isinstance(message, bytes), message
            frames.append(wire.unpack_frame(message))
            await socket.send(wire.pack_ack(frames[-1].sequence))

    taking, end = asyncio.create_task(take()), time.monotonic() + seconds
    while time.monotonic() < end:
        for _ in range(together):
            await send(socket, sequence)
            sequence += 1
        await asyncio.sleep(1.0 / rate)
    taking.cancel()
    return sequence, frames


def test_a_stream_that_is_flooded_gets_less_and_later_all_again(
    make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(workers, "CALM_S", 0.5)
    with served(make_settings(stream_step_down=True)) as url:

        async def talk(socket: ClientConnection) -> None:
            assert (await opened(socket, folds=16, settle=1))["tier"] == "custom"
            sequence, flooded = await flood(socket, 1, 4.0 * WINDOW_S, 2000.0, together=16)
            assert not flooded[0].stepped and flooded[-1].stepped
            deadline = time.monotonic() + 60.0
            while time.monotonic() < deadline:
                sequence, calm = await flood(socket, sequence, WINDOW_S, 15.0)
                if calm and not calm[-1].stepped:
                    return
            raise AssertionError("it never stepped up again")

        async def least(socket: ClientConnection) -> None:
            """What has no folds has nothing to lose."""
            assert (await opened(socket, folds=0, passes=0))["folds"] == 0
            _, flooded = await flood(socket, 1, 3.0 * WINDOW_S, 2000.0, together=16)
            assert flooded and not any(one.stepped for one in flooded)

        run(url, talk)
        run(url, least)


@pytest.mark.parametrize("cloth_contact", [True, False])  # which is spared first
def test_below_the_least_tier_there_is_what_folds_can_spare(
    make_settings: Callable[..., Settings], cloth_contact: bool
):
    with served(make_settings(stream_step_down=True)) as url:

        async def talk(socket: ClientConnection) -> None:
            assert (await opened(socket, tier="fast", cloth_contact=cloth_contact))["tier"] == "fast"
            _, flooded = await flood(socket, 1, 8.0 * WINDOW_S, 2000.0, together=16)
            assert not flooded[0].stepped and flooded[-1].stepped

        run(url, talk)


def test_a_stream_that_comes_from_elsewhere_brings_its_step():
    steps = StepDown(3, 0.0)
    steps.hold(1, 10.0)
    assert steps.level == 1
    steps.hold(2, 10.0)  # never up
    assert steps.level == 1
    for i in range(1, 9):  # and up again when there is room
        steps.note(10.0 + 0.5 * i, frames=15, late=0, busy_s=0.05)
    assert steps.level > 1
