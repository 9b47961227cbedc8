"""The stream under load: goodput, age of frames and gaps.

    python -m benchmarks.serving [--quick] [--garment dress] [--seconds 8] [--save]

Each case starts a service in a process of its own and speaks to it from this one, over loopback. A client sends a
clip's poses at 30 a second, takes and acknowledges frames, and does nothing with them. ``goodput_pct``: frames that
came within ``LATE_S`` of their pose, of the poses that were sent. ``frame_age``: from the pose's sending to its frame's
arrival. ``gap_max_ms``: the longest pause between two frames of any client, after the first second. ``overhead``: what
a frame takes in the service beside the model's own time, median to median and percentile to percentile: that is of the
same clip at the same rate, measured alone before (``model_ms`` and ``model_p99_ms`` of the record).

``cpu_ms``: processor time of the server's process per pose that was sent.

Cases: ``streams`` of each tier; single frames by ``POST /drape``; streams of ``two
garments``; a ``still`` body beside a ``moving`` one; ``overload``, three times the streams that ``accurate`` carries,
with and without the step down.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from http.client import HTTPConnection
from typing import Any

import numpy as np

from benchmarks.cases import FPS, at_rate
from benchmarks.harness import ROOT, Benchmark, Option, Run
from benchmarks.served import Stream
from benchmarks.tables import Row
from clients.stream import DrapeStream
from drape.catalog import find_motions
from drape.errors import DrapeError
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion
from drape.stages.encode import REST_S
from drape.stages.plan import Plan
from drape.stages.tiers import NAMES
from drape.wire.clip_message import pack_clip
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

LATE_S, WARM_S = 0.1, 1.0
OVERLOADED_S = 3.0  # until streams that all come at once are held where they stay
PAIR = ("tshirt", "dress")
POST, POSTED = "POST /drape", {"advanced": {"passes": 0, "folds": 0}}
CARRIED_PCT = 97.0  # goodput of streams that are carried
COLUMNS = {
    "case": "s", "server": "s", "tier": "s", "clients": "d", "fps": ".0f", "goodput_pct": ".1f", "stepped_pct": ".0f",
    "frame_age_p50_ms": ".0f", "frame_age_p99_ms": ".0f", "overhead_p50_ms": ".2f", "overhead_p99_ms": ".2f",
    "gap_max_ms": ".0f", "cpu_ms": ".2f",
}  # fmt: skip


@dataclass(eq=False)
class ClientView:
    """One client's view: how many poses it sent, and when each frame came [s], its age, its time in the service."""

    sent: int = 0
    came_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)
    residence_ms: list[float] = field(default_factory=list)
    stepped: int = 0


@dataclass(frozen=True)
class Server:
    """A running server: its address and its process."""

    url: str
    pid: int

    def cpu_s(self) -> float:
        """Processor time [s] that it has taken; NaN where the system does not tell."""
        try:
            return time.clock_gettime((~self.pid << 3) | 2)  # Linux' number for the clock of another process
        except (AttributeError, OSError):
            return float("nan")


@dataclass(eq=False)
class Spent:
    """Processor time of a server from ``begin`` on."""

    at: Server
    before_s: float = 0.0

    def begin(self) -> None:
        self.before_s = self.at.cpu_s()

    def ms_per_frame(self, frames: int) -> float:
        return 1e3 * (self.at.cpu_s() - self.before_s) / max(frames, 1)


@contextlib.contextmanager
def server(module: str = "service", **settings: object) -> Iterator[Server]:
    """``python -m module`` on a free loopback port, with ``settings`` and an empty folder of uploads."""
    with tempfile.TemporaryDirectory() as folder:
        named = {f"DRAPE_{name.upper()}": str(value) for name, value in settings.items()}
        environment = os.environ | {"DRAPE_GARMENTS_DIR": folder} | named
        command = [sys.executable, "-m", module, "--port", "0"]
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        try:
            assert process.stdout is not None
            said = re.search(r"http://\S+", process.stdout.readline())
            if said is None:
                raise RuntimeError(f"{module} did not start")
            yield Server(said.group(), process.pid)
        finally:
            process.terminate()
            process.wait(timeout=30)


async def client(stream: DrapeStream, clip: MotionClip, seen: ClientView, begin_s: float, seconds: float) -> None:
    """Sends ``clip`` at ``FPS``, and fills ``seen`` from ``begin_s`` on for ``seconds``."""

    async def take() -> None:
        while True:
            received = await stream.receive()
            if time.perf_counter() < begin_s:
                continue
            seen.came_s.append(time.perf_counter())
            seen.age_s.append(received.age_s)
            seen.residence_ms.append(1e-3 * received.frame.residence_us)
            seen.stepped += received.frame.stepped

    taking = asyncio.create_task(take())
    start_s, number = time.perf_counter(), 0
    while time.perf_counter() < begin_s + seconds:
        await stream.send(clip.poses[number % len(clip.poses)])
        seen.sent += time.perf_counter() >= begin_s
        number += 1
        await asyncio.sleep(max(0.0, start_s + number / FPS - time.perf_counter()))
    await asyncio.sleep(2.0 * LATE_S)
    taking.cancel()
    with contextlib.suppress(asyncio.CancelledError, DrapeError):
        await taking


async def crowd(
    url: str, clip: MotionClip, count: int, seconds: float, warm_s: float = WARM_S,
    *, begun: Callable[[], None] | None = None, garments: Sequence[str] = (), **options: Any,
) -> list[ClientView]:  # fmt: skip
    """Returns what each of ``count`` clients saw of its stream during the same ``seconds``.

    These begin ``warm_s`` after the last stream is open, and ``begun`` is called then. Clients take ``garments`` in
    turn.
    """
    seen = [ClientView() for _ in range(count)]
    named: list[dict[str, Any]] = [
        options | {"garment": garments[i % len(garments)]} if garments else options for i in range(count)
    ]
    async with contextlib.AsyncExitStack() as kept:
        streams = [await kept.enter_async_context(await DrapeStream.open(url, **own)) for own in named]
        begin_s = time.perf_counter() + warm_s

        async def call() -> None:
            await asyncio.sleep(begin_s - time.perf_counter())
            if begun is not None:
                begun()

        calls = (client(stream, clip, one, begin_s, seconds) for stream, one in zip(streams, seen, strict=True))
        await asyncio.gather(call(), *calls)
    return seen


def stream_figures(seen: Sequence[ClientView], model_ms: np.ndarray | None) -> dict[str, float]:
    """The columns of what clients saw, beside the model's frames alone, ``model_ms`` (F,), where known."""
    ages = np.concatenate([one.age_s for one in seen])
    inside = np.concatenate([one.residence_ms for one in seen])
    gaps = [np.diff(one.came_s).max() for one in seen if len(one.came_s) > 1]
    sent = sum(one.sent for one in seen)
    if not len(ages):
        return {"goodput_pct": 0.0}
    return {
        "goodput_pct": 100.0 * float((ages <= LATE_S).sum()) / sent,
        "served_pct": 100.0 * len(ages) / sent,
        "stepped_pct": 100.0 * sum(one.stepped for one in seen) / len(ages),
        "frame_age_p50_ms": 1e3 * float(np.median(ages)),
        "frame_age_p99_ms": 1e3 * float(np.percentile(ages, 99.0)),
        "gap_max_ms": 1e3 * float(max(gaps, default=np.nan)),
    } | ({} if model_ms is None else beside_model(inside, model_ms))


def beside_model(inside_ms: np.ndarray, model_ms: np.ndarray) -> dict[str, float]:
    """How much longer frames are in the service than the model takes."""
    return {
        "overhead_p50_ms": float(np.median(inside_ms) - np.median(model_ms)),
        "overhead_p99_ms": float(np.percentile(inside_ms, 99.0) - np.percentile(model_ms, 99.0)),
    }


def model_times(garment: str, clip: MotionClip, seconds: float) -> dict[str, np.ndarray]:
    """Time [ms] (F,) of each frame of ``clip`` at ``FPS`` alone in this process, stages without serving.

    By tier, and for ``POST``: warm frames of its options.
    """
    drapery = DrapeRuntime(Settings())
    entry, shapes = drapery.garments.get(garment), drapery.body.shape_count
    asked = {tier.name: DrapeOptions.model_validate({"tier": tier.name}) for tier in drapery.tiers}
    found = {
        name: alone(drapery.plan(entry, options, messages=True), shapes, clip, seconds)
        for name, options in asked.items()
    }
    found[POST] = alone(drapery.plan(entry, DrapeOptions.model_validate(POSTED)), shapes, clip, seconds, warm=True)
    drapery.close()
    return found


def alone(plan: Plan, shape_count: int, clip: MotionClip, seconds: float, *, warm: bool = False) -> np.ndarray:
    """Time [ms] (F,) of each frame of ``clip`` under ``plan``.

    Frames come with the pauses of a stream, for what a pause leaves of the processor's caches is the frame's to pay;
    ``warm`` frames come one right after the other, and have no past.
    """
    stream, begin_s = Stream(plan, shape_count), time.perf_counter()
    for frame in range(1 + max(2, int(seconds * FPS))):
        stream.pose(clip.poses[frame % len(clip.poses)], frame / FPS)
        if warm:
            stream.forget()
        else:
            time.sleep(max(0.0, begin_s + (frame + 1) / FPS - time.perf_counter()))
    return np.array(stream.clock.wall_ms[1:])  # the first pays for what is made once


def posts(url: str, garment: str, clip: MotionClip, seconds: float) -> np.ndarray:
    """Time [ms] (F,) of ``POST /drape`` of one frame, binary there and back, one right after the other.

    The client is the standard library's, which has less of its own than others.
    """
    took_ms: list[float] = []
    headers: dict[str, str] = dict.fromkeys(("Content-Type", "Accept"), "application/octet-stream")
    with contextlib.closing(HTTPConnection(url.partition("://")[2])) as connection:
        for frame in range(1 + max(2, int(seconds * FPS))):
            body = pack_clip({"garment": garment} | POSTED, clip.poses[frame % len(clip.poses)][None], None)
            start_s = time.perf_counter()
            connection.request("POST", "/drape", body, headers)
            answer = connection.getresponse()
            answer.read()
            if answer.status != HTTPStatus.OK:
                raise RuntimeError(f"the service answered {answer.status}")
            took_ms.append(1e3 * (time.perf_counter() - start_s))
    return np.array(took_ms[1:])


@dataclass(eq=False)
class ServingBench:
    """The clip, garment and times that all cases share; their rows go to ``run``."""

    run: Run
    clip: MotionClip
    garment: str
    seconds: float
    model_ms: dict[str, np.ndarray]
    warm_s: float = WARM_S

    def measure(self, case: str, at: Server, tier: str, count: int = 1, **others: Any) -> Row:
        """Adds the row of ``count`` clients of ``tier``; ``others`` are more of their options."""
        spent, options = Spent(at), {"garment": self.garment, "tier": tier} | others
        seen = asyncio.run(crowd(at.url, self.clip, count, self.seconds, self.warm_s, begun=spent.begin, **options))
        row = {"case": case, "server": "service", "tier": tier, "clients": count, "fps": FPS}
        alone = self.model_ms[tier] if not others and len(self.clip.poses) > 1 else None
        row |= stream_figures(seen, alone) | {"cpu_ms": spent.ms_per_frame(sum(one.sent for one in seen))}
        self.run.add([row])
        return row

    def posted(self, at: Server) -> None:
        """Adds the row of single frames, one request each: ages are from request to answer."""
        took_ms = posts(at.url, self.garment, self.clip, self.seconds)
        row = {"case": POST, "server": "service", "tier": "", "clients": 1, "fps": FPS, "goodput_pct": 100.0}
        row["frame_age_p50_ms"] = float(np.median(took_ms))
        row["frame_age_p99_ms"] = float(np.percentile(took_ms, 99.0))
        self.run.add([row | beside_model(took_ms, self.model_ms[POST])])

    def carried(self, at: Server, tier: str, counts: Sequence[int]) -> int:
        """How many of ``counts`` clients the server carries; adds their rows."""
        rows = [self.measure("streams", at, tier, count) for count in counts]
        return max((row["clients"] for row in rows if row["goodput_pct"] >= CARRIED_PCT), default=0)

    def standing(self) -> ServingBench:
        """Returns the same bench with a body that stands still in a pose from the middle of the clip."""
        poses = self.clip.poses[len(self.clip.poses) // 2][None]
        return replace(self, clip=MotionClip(poses, np.zeros((1, 3)), FPS, "still"), warm_s=1.5 * REST_S)


def measure_streams(bench: ServingBench, options: argparse.Namespace) -> dict[str, int]:
    """Fills the rows of ``bench``; how many clients each server carries by tier."""
    carried: dict[str, int] = {}
    with server(stream_step_down=False) as at:
        for tier in reversed(NAMES):
            carried[f"service {tier}"] = bench.carried(at, tier, options.clients)
        still = bench.standing()
        bench.posted(at)
        bench.measure("two garments, folds 2", at, "balanced", 2, garments=PAIR, advanced={"folds": 2})
        bench.measure("moving", at, "balanced")
        still.measure("still", at, "balanced")
    if options.quick:
        return carried
    most, crowded = max(1, carried["service accurate"]), replace(bench, warm_s=OVERLOADED_S)
    for step_down in (False, True):
        with server(stream_step_down=step_down) as at:
            crowded.measure(f"overload, step down {'on' if step_down else 'off'}", at, "accurate", 3 * most)
    return carried


@Benchmark(
    "serving",
    "The stream under load.",
    COLUMNS,
    Option("--garment", "tshirt", "what is streamed"),
    Option("--seconds", 8.0, "of each case", 1.5),
    Option("--clients", (1, 2, 4, 8), "of streams at the same time", (1,)),
)
def main(run: Run) -> None:
    """Measures every case and adds its rows to ``run``."""
    options, load = run.options, os.getloadavg()[0]
    clip = at_rate(read_motion(find_motions(["walk"])[0]), FPS)
    model_ms = model_times(options.garment, clip, options.seconds)
    bench = ServingBench(run, clip, options.garment, options.seconds, model_ms)
    run.extra |= {
        "max_clients": measure_streams(bench, options),
        "load_before": load,
        "model_ms": {tier: float(np.median(ms)) for tier, ms in model_ms.items()},
        "model_p99_ms": {tier: float(np.percentile(ms, 99.0)) for tier, ms in model_ms.items()},
        "seconds": options.seconds,
        "late_ms": 1e3 * LATE_S,
    }


if __name__ == "__main__":
    main.command()
