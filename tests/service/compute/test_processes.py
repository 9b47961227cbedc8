"""Processes of the service start without a handler of forks, beside whatever runs, and end with what they are for."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import subprocess
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any

import httpx
import numpy as np
import pytest

from drape.garment.cache import Garment
from service.app import create_app
from service.compute import constants_process, processes
from service.settings import Settings
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import ended_job, wait_until
from tests.fixtures.serving import serve
from tests.fixtures.streams import raw_stream

FORKS: list[int] = []
"""One for each fork of this process: those of C too, which ``os.register_at_fork`` does not see."""
_handler = ctypes.CFUNCTYPE(None)(lambda: FORKS.append(1))


@pytest.fixture(scope="module", autouse=True)
def counted_forks() -> None:
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "__register_atfork"):
        pytest.skip("No __register_atfork: of glibc and musl alone can forks be counted.")
    assert libc.__register_atfork(_handler, None, None, None) == 0  # what pthread_atfork calls
    subprocess.run(["true"], preexec_fn=int)
    assert len(FORKS) == 1, "a fork was not counted"


def test_no_work_of_clients_forks_the_service(make_settings: Callable[..., Settings], tube: Garment, monkeypatch):
    settings = make_settings()
    app, before = create_app(settings), len(FORKS)
    stop, start, started = threading.Event(), processes.start_process, []

    def recorded(module: str, *arguments: Any, **named: Any) -> processes.Process:
        started.append((module.rpartition(".")[2], start(module, *arguments, **named)))
        return started[-1][1]

    monkeypatch.setattr(processes, "start_process", recorded)
    monkeypatch.setattr(constants_process, "start_process", recorded)
    with serve(app, settings) as url, httpx.Client(base_url=url, timeout=120.0) as client:
        body = client.get("/bodies").json()[0]["id"]

        def pose() -> None:
            while not stop.is_set():
                clip = {"poses": np.zeros((5, 24, 3)).tolist(), "fps": 30}
                httpx.post(f"{url}/bodies/{body}/posed", json=clip, timeout=120.0)
                stop.wait(0.2)

        def stream() -> None:
            with raw_stream(url) as one:
                one.open(garment="tube")
                number = 0
                while not stop.is_set():
                    number += 1
                    one.message(number, np.full((24, 3), 0.1 * np.sin(number)), time_s=number / 30.0)
                    stop.wait(0.1)

        beside = [threading.Thread(target=pose), threading.Thread(target=stream)]
        for one in beside:
            one.start()
        try:
            good, bad = garment_obj(tube), b"v 0 0 0\n"
            sent = [
                client.post(f"/garments?name={i}.obj&avatar=standard", content=file)
                for i, file in enumerate((good, bad))
            ]
            sent.append(client.post("/drape", json={"garment": "tube", "tier": "exact", "poses": [[[0.0] * 3] * 24]}))
            assert client.get("/garments/tube/preview.png?size=64").status_code == 200
            jobs = [ended_job(client, one) for one in sent]
            assert [one["state"] for one in jobs] == ["done", "failed", "done"], jobs
        finally:
            stop.set()
            for one in beside:
                one.join()
    assert len(FORKS) == before
    assert sorted(name for name, _ in started) == ["block", "constants_calls", *2 * ["sandbox"]]
    assert all(process.returncode is not None for _, process in started)


def _write(content: bytes, file: IO[bytes]) -> None:
    file.write(content)


def spoken(tmp_path: Path, monkeypatch, program: str) -> str:
    """The name of a module with this program, for processes that are started next."""
    (tmp_path / "spoken.py").write_text(program)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "spoken"


def test_a_process_hears_all_and_is_killed_with_its_block_and_its_children(tmp_path: Path, monkeypatch):
    module = spoken(
        tmp_path,
        monkeypatch,
        "import signal, subprocess, sys, time\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "print(len(sys.stdin.buffer.read()), flush=True)\n"
        "print(subprocess.Popen(['sleep', '1000']).pid, flush=True)\n"
        "time.sleep(1000)\n",
    )
    threads = threading.active_count()

    async def heard() -> tuple[int, int]:
        write = partial(_write, bytes(3_000_000))
        async with processes.run_process("test", module, write=write, folder=tmp_path) as (process, said):
            assert int(await said.readline()) == 3_000_000, "more than a pipe holds"
            return int(await said.readline()), process.pid

    child, pid = asyncio.run(heard())
    wait_until(lambda: state(child) == state(pid) == "Z")
    assert threading.active_count() <= threads
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix) == ["spoken.py"]


@pytest.mark.parametrize("turns", range(4))
def test_a_process_that_is_cancelled_as_it_begins_closes_no_descriptor_twice(tmp_path: Path, monkeypatch, turns: int):
    module, start = spoken(tmp_path, monkeypatch, "import time\ntime.sleep(1000)\n"), processes.start_process
    number: list[int] = []

    def noted(*arguments: Any, **named: Any) -> processes.Process:
        process = start(*arguments, **named)
        number.append(process.stdout.fileno())  # pyright: ignore[reportOptionalMemberAccess]
        return process

    monkeypatch.setattr(processes, "start_process", noted)

    async def run() -> None:
        async with processes.run_process("test", module, write=partial(_write, b""), folder=tmp_path):
            await asyncio.Event().wait()

    async def lost() -> list[int]:
        running = asyncio.ensure_future(run())
        while not number:
            await asyncio.sleep(0.0)
        for _ in range(turns):
            await asyncio.sleep(0.0)
        running.cancel()
        await asyncio.wait([running])
        others = [os.open(os.devnull, os.O_RDONLY) for _ in range(8)]
        del running
        gc.collect()
        return [one for one in others if not closes(one)]

    uvloop = pytest.importorskip("uvloop")
    assert uvloop.run(lost()) == []


def closes(descriptor: int) -> bool:
    """Closes ``descriptor``; whether it was open until now."""
    try:
        os.close(descriptor)
    except OSError:
        return False
    return True


def state(pid: int) -> str:
    """The letter of the state of a process; Z where nothing is left of it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"
