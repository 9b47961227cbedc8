"""What holds the event loop is counted by its cause, and a watched task is the task that it was."""

from __future__ import annotations

import asyncio
import gc
import inspect
import time
import warnings
from types import SimpleNamespace

import pytest

from service.watch.logs import ASKER, Asker
from service.watch.prometheus import Metrics
from service.watch.turns import BRIEF_S, COLLECTOR, LoopWatch

HELD_S = 5.0 * BRIEF_S


def held(metrics: Metrics, cause: str, state: str) -> tuple[float, float]:
    """How often ``cause`` held the loop, and how long [s]."""
    end = {"cause": cause, "state": state}
    count, total = (
        metrics.registry.get_sample_value(f"drape_loop_held_seconds_{what}", end) for what in ("count", "sum")
    )
    return count or 0.0, total or 0.0


def compute() -> None:
    """Takes ``HELD_S`` of a processor, in whatever time."""
    until_s = time.thread_time() + HELD_S
    while time.thread_time() < until_s:
        pass


async def computing() -> None:
    compute()
    await asyncio.sleep(0.0)


async def blocking() -> None:
    time.sleep(HELD_S)


async def beside(work) -> Metrics:
    """What was counted while ``work`` ran in a task of its own."""
    metrics = Metrics()
    watch = LoopWatch(metrics)
    with watch.watching():
        await asyncio.create_task(work)
        watch.late(0.0)
    return metrics


def test_a_task_that_computes_is_the_cause():
    metrics = asyncio.run(beside(computing()))
    count, total_s = held(metrics, "computing", "ran")
    assert count == 1.0 and total_s >= HELD_S  # its second step is brief


def test_a_task_that_waits_on_the_loop_is_the_cause_and_no_processor_is():
    metrics = asyncio.run(beside(blocking()))
    count, total_s = held(metrics, "blocking", "waited")
    assert count == 1.0 and total_s >= HELD_S - BRIEF_S
    assert held(metrics, "blocking", "ran")[1] < total_s


def test_what_a_request_does_is_caused_by_its_path_also_in_its_tasks():
    async def answering() -> None:
        ASKER.set(Asker("id", "client", {"type": "http", "route": SimpleNamespace(path="/garments/{garment_id}")}))
        await asyncio.create_task(computing())

    metrics = asyncio.run(beside(answering()))
    assert held(metrics, "/garments/{garment_id}", "ran")[0] == 1.0
    assert held(metrics, "computing", "ran")[0] == 0.0


def test_the_collector_is_a_cause_in_whichever_thread():
    async def collecting() -> None:
        full = [[] for _ in range(300_000)]  # more than it looks through in a brief time
        await asyncio.to_thread(gc.collect)
        full.clear()

    assert held(asyncio.run(beside(collecting())), COLLECTOR, "ran")[0] >= 1.0


def test_nothing_is_watched_any_more_at_the_end():
    before = list(gc.callbacks)

    async def through() -> None:
        await beside(computing())
        assert asyncio.get_running_loop().get_task_factory() is None

    asyncio.run(through())
    assert gc.callbacks == before


def test_a_watched_task_answers_fails_and_is_cancelled_as_any_other():
    async def answer() -> int:
        return 7

    async def fail() -> None:
        await asyncio.sleep(0.0)
        raise KeyError("mine")

    async def catch() -> str:
        try:
            await asyncio.sleep(1000.0)
        except asyncio.CancelledError:
            return "caught"
        return ""

    async def through() -> None:
        with LoopWatch(Metrics()).watching():
            assert await asyncio.create_task(answer(), name="named") == 7
            with pytest.raises(KeyError, match="mine"):
                await asyncio.create_task(fail())
            late = asyncio.create_task(catch())
            assert inspect.getcoroutinestate(late.get_coro()) == inspect.CORO_CREATED  # pyright: ignore
            await asyncio.sleep(0.0)
            late.cancel()
            assert await late == "caught"
            never = asyncio.create_task(catch())
            never.cancel()  # before its first step
            await asyncio.gather(never, return_exceptions=True)
            assert never.cancelled()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asyncio.run(through())
