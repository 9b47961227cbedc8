"""A process of the intake that waits for a file: it takes one in as one that begins with it, and none is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from drape.errors import BodyError
from drape.garment.cache import Garment
from service.compute.processes import Process, kill, start_process
from service.settings import Settings
from service.uploads import spare
from service.uploads.intake_process import run_sandbox
from service.uploads.spare import Spare
from tests.fixtures.laws import each
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import wait_until

FAR = '{"trans": [1e300, 0, 0]}' + 200_000 * " "  # more than a pipe holds


def waiting() -> Process:
    return start_process("service.uploads.spare_sandbox", quiet=True)


@each(dead=(False, True))
def test_a_process_that_waits_takes_a_file_in(
    make_settings: Callable[..., Settings], tube: Garment, tmp_path: Path, dead: bool
):
    """One that has ended leaves the file to another."""
    file = tmp_path / "tube.obj"
    file.write_bytes(garment_obj(tube))
    process = waiting()
    if dead:
        kill(process)
        process.wait()
    report = asyncio.run(run_sandbox(file, "standard", tmp_path / "out", make_settings(), waiting=process))
    assert report["files"] and all((tmp_path / "out" / name).exists() for name in report["files"])
    assert process.poll() is not None


def test_it_hears_what_is_said_and_its_refusal_is_told(
    make_settings: Callable[..., Settings], tube: Garment, tmp_path: Path
):
    file = tmp_path / "tube.obj"
    file.write_bytes(garment_obj(tube))
    with pytest.raises(BodyError, match="avatar trans"):
        asyncio.run(run_sandbox(file, FAR, tmp_path / "out", make_settings(), waiting=waiting()))


def test_without_a_word_it_ends():
    process = waiting()
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(60.0) == 0


def test_one_waits_where_nothing_is_taken_in(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(spare, "AFTER_S", 0.01)
    busy = True

    async def kept() -> None:
        nonlocal busy
        one = Spare(lambda: not busy)
        one.start()
        await asyncio.sleep(0.2)
        assert one.take() is None
        busy = False
        processes = []
        for _ in range(2):  # the next begins when one is taken
            while (process := one.take()) is None:
                await asyncio.sleep(0.01)
            processes.append(process)
        kill(processes[0])
        while one._process is None:
            await asyncio.sleep(0.01)
        last = one._process
        one.stop()
        kill(processes[1])
        await asyncio.to_thread(wait_until, lambda: last.poll() is not None)
        assert one.take() is None

    asyncio.run(asyncio.wait_for(kept(), 120.0))
