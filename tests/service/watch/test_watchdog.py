"""What hangs is told by its lane, with its stack, and does not outlive the word to end."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from drape.errors import MeshError
from drape.garment.cache import Garment
from drape.stages.batch import PoseInput
from drape.wire import messages as wire
from drape.wire.options import Advanced, DrapeOptions
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.http import fit_routes
from service.server import bind_listener
from service.settings import ROOT, Settings
from service.watch import watchdog
from service.watch.probes import Lifecycle
from service.watch.prometheus import Metrics
from service.watch.watchdog import JOBS, Watchdog, WatchedJob, say_moved, spent_s, waits_for
from tests.fixtures.meshes import garment_obj
from tests.fixtures.patience import PATIENT_S, wait_until
from tests.fixtures.serving import serve, served
from tests.fixtures.streams import raw_stream


def process_of(lane: str) -> int:
    """The process that computes in ``lane``; 0 while there is none."""
    return next((one.clocks[0].args[0] for one in tuple(JOBS) if one.lane == lane), 0)  # pyright: ignore


# --- what counts as a move ---


def compute() -> None:
    """Takes 0.2 s of processor time."""
    until_s = time.thread_time() + 0.2
    while time.thread_time() < until_s:
        pass


def test_a_job_moves_by_its_word_or_by_its_time_and_otherwise_not():
    def called() -> None:
        (one,) = [found for found in JOBS if found.lane == "test"]
        JOBS.discard(one)  # the watchdog of a service in this process would look at it too
        begun_s = one.moved_s
        assert one.look(begun_s + 9.0) == 9.0
        compute()
        assert one.look(begun_s + 10.0) == 0.0, "it has computed"
        waits_for(lambda: after)
        after = 0.0
        one.look(one.moved_s + 1.0)
        after = 1.0
        assert one.look(one.moved_s + 9.0) == 0.0, "what it waits for has computed"
        say_moved()
        compute()
        assert one.look(one.moved_s + 9.0) == 9.0, "a job that says its moves is believed no others"
        one.silent = True
        assert one.look(begun_s + watchdog.MOST_S + 9.0) > watchdog.MOST_S, "it computes for ever"

    with watchdog.ThreadLane("test", 1) as lane:
        lane.submit(called).result()
        assert not [found for found in JOBS if found.lane == "test"]


def test_a_process_moves_while_it_computes():
    program = "import sys\nfor _ in sys.stdin:\n    sum(range(10**7)); print(flush=True)"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        one = WatchedJob("test", [partial(spent_s, process.pid)])
        process.stdin.write("go\n")
        process.stdin.flush()
        process.stdout.readline()
        assert one.look(one.moved_s + 2.0) == 0.0
        os.kill(process.pid, signal.SIGSTOP)
        one.look(one.moved_s + 0.1)
        assert one.look(one.moved_s + 2.0) == 2.0
        os.kill(process.pid, signal.SIGCONT)
        process.stdin.close()
    assert one.look(one.moved_s + 2.0) == 0.0, "what has ended hangs no more"


def test_a_job_that_has_not_moved_is_told():
    watching = Watchdog(Lifecycle(stuck_s=5.0), Metrics(), stuck_s=5.0, kill=lambda: None)
    watching.stop()
    waiting, free = threading.Event(), threading.Event()

    def wait() -> None:
        say_moved()
        waiting.set()
        free.wait(PATIENT_S)

    with watchdog.ThreadLane("test", 1) as lane:
        lane.submit(wait)
        waiting.wait(PATIENT_S)
        watching._look(time.monotonic() + 9.0)
        free.set()
        assert watching._life.still["test"] > 5.0
        assert "test: expected a move within 5 s, got none for " in str(watching._life.unhealthy())


def test_every_step_of_a_clip_is_a_move(make_runtime: Callable[..., DrapeRuntime], monkeypatch):
    runtime, seen = make_runtime(folds=1), []
    walk = DrapeRuntime._walk

    def seeing(self: DrapeRuntime, *arguments: Any) -> Iterator[Any]:
        for batch in walk(self, *arguments):
            (one,) = [found for found in JOBS if found.lane == "aside"]
            seen.append((one.moved_s, one.silent))
            yield batch

    monkeypatch.setattr(DrapeRuntime, "_walk", seeing)
    frames = 2 * runtime.settings.chunk_frames
    clip = PoseInput(np.zeros((frames, 24, 3)), np.zeros((frames, 3)), np.zeros(10), np.arange(frames) / 30.0)
    plan = runtime.plan(runtime.garments.entries()[0], DrapeOptions(advanced=Advanced(push_out=True)))

    asyncio.run(runtime.drape(plan, clip))
    times = [moved_s for moved_s, _ in seen]
    assert len(times) >= 4 and sorted(set(times)) == times and not any(silent for _, silent in seen)


# --- a service in which something hangs ---

HELD = threading.Event()
"""Set: what hangs may go on."""


def hangs_here(*_: Any, **__: Any) -> Any:
    HELD.wait(PATIENT_S)
    raise MeshError("this test", expected="a held job", got="one let go", cure="None is needed.")


def clip(url: str) -> None:
    httpx.post(f"{url}/drape", json={"garment": "tube", "poses": np.zeros((2, 24, 3)).tolist()}, timeout=PATIENT_S)


def stream(url: str) -> None:
    with raw_stream(url) as one:
        one.open(garment="tube")
        one.socket.send(wire.pack_pose(wire.Pose(1, 0.0, np.zeros(3), np.full((24, 3), 0.01))))
        HELD.wait(PATIENT_S)


def measures(url: str) -> None:
    httpx.get(f"{url}/bodies/{httpx.get(url + '/bodies').json()[0]['id']}/measures", timeout=PATIENT_S)


@pytest.mark.parametrize(
    ("lane", "hook", "ask"),
    [
        ("aside", (DrapeRuntime, "_walk"), clip),
        ("streams", (DrapeRuntime, "_walk"), stream),
        ("calls", (fit_routes, "_measured"), measures),
    ],
)
def test_a_thread_that_hangs_is_told_with_its_stack(
    make_settings: Callable[..., Settings], monkeypatch, caplog, lane: str, hook: tuple[Any, str], ask: Callable
):
    with served(make_settings(stuck_s=2.0)) as url:
        HELD.clear()
        asking = threading.Thread(target=ask, args=(url,))
        try:
            with monkeypatch.context() as patched:
                patched.setattr(*hook, hangs_here)
                asking.start()
                told_by(url, lane)
            # The first: other services in this process watch the same jobs, with more patience.
            said = next(one.getMessage() for one in caplog.records if "has not moved" in one.getMessage())
            assert said.startswith(f"{lane}: ") and "in hangs_here" in said
        finally:
            HELD.set()
            asking.join()
        wait_until(lambda: httpx.get(url + "/livez").status_code == 200)


def told_by(url: str, lane: str) -> None:
    """Waits until the service tells of ``lane`` in all ways."""
    answer = wait_until(lambda: (found := httpx.get(url + "/livez")).status_code == 503 and found)
    assert f"{lane}: expected a move within 2 s, got none for " in answer.json()["detail"]
    assert httpx.get(url + "/readyz").status_code == 503
    series = [line for line in httpx.get(url + "/metrics").text.splitlines() if "drape_lane_still" in line]
    (seconds,) = [float(line.split()[1]) for line in series if f'lane="{lane}"' in line]
    assert seconds > 2.0


@pytest.mark.parametrize("lane", ["intake", "exact", "constants"])
def test_a_process_that_hangs_is_told(make_settings: Callable[..., Settings], tube: Garment, caplog, lane: str):
    settings = make_settings(stuck_s=2.0)
    app = create_app(settings)
    with serve(app, settings) as url:
        asking = None
        if lane == "constants":
            app.state.drape.runtime.threads.streamed_s = math.inf  # as beside streams
            httpx.get(f"{url}/garments/tube/preview.png?size=64", timeout=PATIENT_S)
            pid = app.state.drape.runtime.constants_process._process.pid
            os.kill(pid, signal.SIGSTOP)
            asking = threading.Thread(target=httpx.get, args=(f"{url}/garments/tube/preview.png?size=65",))
            asking.start()
        elif lane == "intake":
            httpx.post(f"{url}/garments?name=t.obj", content=garment_obj(tube))
        else:
            httpx.post(f"{url}/drape", json={"garment": "tube", "tier": "exact", "poses": [[[0.0] * 3] * 24]})
        if lane != "constants":
            pid = wait_until(lambda: process_of(lane))
            os.kill(pid, signal.SIGSTOP)
        try:
            told_by(url, "apart" if lane == "constants" else lane)
        finally:
            os.kill(pid, signal.SIGCONT)
            wait_until(lambda: httpx.get(url + "/livez").status_code == 200)
            if asking is not None:
                asking.join()
    assert "a job has not moved for " in caplog.text


# --- the end ---

START = """
import ctypes, os, signal, sys, time
from service import __main__
from service.compute import processes
from service.compute.drape_runtime import DrapeRuntime

MUTEX = ctypes.create_string_buffer(64)

def hangs_here(*_, **__):
    {hang}

def stopped(*arguments, **named):
    process = start(*arguments, **named)
    while os.getpriority(os.PRIO_PROCESS, process.pid) == os.nice(0):
        time.sleep(0.01)  # until its program has begun
    os.kill(process.pid, signal.SIGSTOP)
    print(process.pid, flush=True)
    return process

start, processes.start_process = processes.start_process, stopped
DrapeRuntime.{hook} = hangs_here
sys.exit(__main__.main(["--port", "0"]))
"""
STATES = {  # where what hangs is, what it does, the request that it answers, and the status of the process's end
    "lane": ("_walk", "time.sleep(1e6)", "/drape", 1),
    "loop": ("check_body_id", "time.sleep(1e6)", "/bodies/any", 1),
    "lock": (
        "check_body_id",
        "[ctypes.PyDLL(None).pthread_mutex_lock(MUTEX) for _ in range(2)]",
        "/bodies/any",
        signal.SIGALRM,
    ),
}


class Hung:
    """A service in a process of its own that hangs in the state ``name``, with a process of its own that hangs too."""

    def __init__(self, name: str, settings: Settings, port: int) -> None:
        hook, hang, path, self.status = STATES[name]
        chosen = settings.model_dump(mode="json", exclude_unset=True) | {"probe_port": port}
        environment = os.environ | {f"DRAPE_{key.upper()}": str(value) for key, value in chosen.items()}
        command = [sys.executable, "-c", START.format(hook=hook, hang=hang)]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(command, cwd=ROOT, env=environment, **pipes)
        self.path, self.port = path, port

    def hang(self) -> None:
        assert self.process.stdout is not None
        url = self.process.stdout.readline().split()[2]
        assert httpx.post(f"{url}/garments?name=t.obj", content=b"v 0 0 0\n", timeout=PATIENT_S).status_code == 202
        self.child = int(self.process.stdout.readline())
        asked: dict[str, Any] = {"json": {"garment": "tube", "poses": [[[0.0] * 3] * 24]}}
        method, more = ("POST", asked) if self.path == "/drape" else ("GET", {})
        with pytest.raises(httpx.ReadTimeout):
            httpx.request(method, url + self.path, timeout=3.0, **more)


@pytest.mark.long
def test_the_word_to_end_ends_whatever_hangs_and_its_processes(make_settings: Callable[..., Settings]):
    with ExitStack() as opened:
        listeners = [opened.enter_context(bind_listener("127.0.0.1", 0)) for _ in STATES]
        ports = [one.getsockname()[1] for one in listeners]
        opened.close()
        all_hung = {n: Hung(n, make_settings(stuck_s=2.0), port) for n, port in zip(STATES, ports, strict=True)}
        for one in all_hung.values():
            opened.callback(one.process.kill)
        for one in all_hung.values():
            one.hang()
        for name in ("lane", "loop"):  # a held lock holds the probes too
            probe = f"http://127.0.0.1:{all_hung[name].port}/livez"
            wait_until(lambda probe=probe: httpx.get(probe, timeout=PATIENT_S).status_code == 503)
        for one in all_hung.values():
            one.process.send_signal(signal.SIGTERM)
        for name, one in all_hung.items():
            _, said = one.process.communicate(timeout=PATIENT_S)
            assert one.process.returncode == one.status, (name, said)
            assert "hangs_here" in said
            wait_until(lambda one=one: not Path(f"/proc/{one.child}").exists() or is_dead(one.child))
            if name != "lock":
                lines = [json.loads(line)["message"] for line in said.splitlines()]
                lane = "aside" if name == "lane" else "event loop"
                assert any(line.startswith(f"{lane}: a job has not moved for ") for line in lines), name
                assert "told to end" in lines[-1] and "hangs_here" in lines[-1]


LATE = """
import asyncio, signal
from fastapi import FastAPI
from uvicorn.lifespan.off import LifespanOff
from service.server import END_S, make_server
from service.settings import Settings
from service.watch.watchdog import end_when_told

async def left_s(before_s: int) -> int:
    server = make_server(FastAPI(), Settings())
    server.config.app, server.servers, server.lifespan = None, [], LifespanOff(server.config)  # nothing drains
    signal.alarm(before_s)
    await server.shutdown()
    return signal.alarm(0)

end_when_told()
assert asyncio.run(left_s(0)) >= END_S - 2
assert 1 <= asyncio.run(left_s(5)) <= 5
"""


def test_a_shutdown_that_begins_late_gets_no_more_time():
    run = subprocess.run([sys.executable, "-c", LATE], cwd=ROOT, capture_output=True, text=True, timeout=PATIENT_S)
    assert run.returncode == 0, run.stderr


def is_dead(pid: int) -> bool:
    """Whether a process has ended, though nobody has asked for its status."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_an_alarm_of_others_is_no_word_to_end():
    assert not watchdog.told_to_end(), "no alarm of others counts where no service has asked for one"
    signal.setitimer(signal.ITIMER_REAL, 1000.0)
    try:
        assert not watchdog.told_to_end()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
