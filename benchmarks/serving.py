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
OVERLOADED_S = 3.0  # after so long, streams that all open at once have the tier at which they stay
PAIR = ("tshirt", "dress")
POST, POSTED = "POST /drape", {"advanced": {"passes": 0, "folds": 0}}
CARRIED_PCT = 97.0  # streams with at least this goodput are carried
COLUMNS = {
    "case": "s", "server": "s", "tier": "s", "clients": "d", "fps": ".0f", "goodput_pct": ".1f", "stepped_pct": ".0f",
    "frame_age_p50_ms": ".0f", "frame_age_p99_ms": ".0f", "overhead_p50_ms": ".2f", "overhead_p99_ms": ".2f",
    "gap_max_ms": ".0f", "cpu_ms": ".2f",
}  # fmt: skip


@dataclass(eq=False)
class ClientView:
    """What a client sees of its stream: how many poses it ``sent``, of each frame when it came [s], its age [s] and its
    time in the service [ms], and how many frames were computed with less than asked (``stepped``)."""

    sent: int = 0
    came_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)
    residence_ms: list[float] = field(default_factory=list)
    stepped: int = 0


@dataclass(frozen=True)
class Server:
    """A running server: its address and the number of its process."""

    url: str
    pid: int

    def cpu_s(self) -> float:
        """Returns the processor time [s] that the server has taken so far; NaN where the system does not tell."""
        try:
            return time.clock_gettime((~self.pid << 3) | 2)  # Linux' number for the clock of another process
        except (AttributeError, OSError):
            return float("nan")


@dataclass(eq=False)
class Spent:
    """The processor time that the server ``at`` takes from ``begin`` on."""

    at: Server
    before_s: float = 0.0

    def begin(self) -> None:
        self.before_s = self.at.cpu_s()

    def ms_per_frame(self, frames: int) -> float:
        return 1e3 * (self.at.cpu_s() - self.before_s) / max(frames, 1)


@contextlib.contextmanager
def server(module: str = "service", **settings: object) -> Iterator[Server]:
    """A context in which ``python -m MODULE`` serves on a free loopback port, with ``settings`` and an empty folder of
    uploads; gives the server. Raises ``RuntimeError`` where it does not start."""
    with tempfile.TemporaryDirectory() as folder:
        named = {f"DRAPE_{name.upper()}": str(value) for name, value in settings.items()}
        environment = os.environ | {"DRAPE_GARMENTS_DIR": folder} | named
        command = [sys.executable, "-m", module, "--port", "0"]
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        try:
            assert process.stdout is not None
            address = re.search(r"http://\S+", process.stdout.readline())
            if address is None:
                raise RuntimeError(f"{module} did not start")
            yield Server(address.group(), process.pid)
        finally:
            process.terminate()
            process.wait(timeout=30)


async def client(stream: DrapeStream, clip: MotionClip, view: ClientView, begin_s: float, seconds: float) -> None:
    """Sends the poses of ``clip`` to ``stream`` at ``FPS`` and takes its frames. Fills ``view`` during ``seconds`` from
    ``begin_s`` on, a time of ``time.perf_counter``."""

    async def take() -> None:
        while True:
            received = await stream.receive()
            if time.perf_counter() < begin_s:
                continue
            view.came_s.append(time.perf_counter())
            view.age_s.append(received.age_s)
            view.residence_ms.append(1e-3 * received.frame.residence_us)
            view.stepped += received.frame.stepped

    taking = asyncio.create_task(take())
    start_s, number = time.perf_counter(), 0
    while time.perf_counter() < begin_s + seconds:
        await stream.send(clip.poses[number % len(clip.poses)])
        view.sent += time.perf_counter() >= begin_s
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
    """Returns the views of ``count`` clients that stream ``clip`` from the service at ``url`` during the same
    ``seconds``. These begin ``warm_s`` after the last stream is open, and ``begun`` is called then.

    The clients take ``garments`` in turn; ``options`` are those of each stream.
    """
    views = [ClientView() for _ in range(count)]
    named: list[dict[str, Any]] = [
        options | {"garment": garments[i % len(garments)]} if garments else options for i in range(count)
    ]
    async with contextlib.AsyncExitStack() as stack:
        streams = [await stack.enter_async_context(await DrapeStream.open(url, **own)) for own in named]
        begin_s = time.perf_counter() + warm_s

        async def call() -> None:
            await asyncio.sleep(begin_s - time.perf_counter())
            if begun is not None:
                begun()

        calls = (client(stream, clip, view, begin_s, seconds) for stream, view in zip(streams, views, strict=True))
        await asyncio.gather(call(), *calls)
    return views


def stream_figures(views: Sequence[ClientView], model_ms: np.ndarray | None) -> dict[str, float]:
    """Returns the columns of a row that follow from the clients' ``views``.

    They are the shares [%] of the poses sent whose frames came within ``LATE_S``, "goodput_pct", or at all,
    "served_pct"; the share [%] of frames that were computed with less than asked, "stepped_pct"; the age of frames,
    "frame_age_p50_ms" and "frame_age_p99_ms"; and the longest time between two frames of a client, "gap_max_ms".
    ``beside_model`` joins them where the times of the model alone ``model_ms`` (F,) are known. Where no frame came
    there is only "goodput_pct", 0.
    """
    ages = np.concatenate([view.age_s for view in views])
    inside = np.concatenate([view.residence_ms for view in views])
    gaps = [np.diff(view.came_s).max() for view in views if len(view.came_s) > 1]
    sent = sum(view.sent for view in views)
    if not len(ages):
        return {"goodput_pct": 0.0}
    return {
        "goodput_pct": 100.0 * float((ages <= LATE_S).sum()) / sent,
        "served_pct": 100.0 * len(ages) / sent,
        "stepped_pct": 100.0 * sum(view.stepped for view in views) / len(ages),
        "frame_age_p50_ms": 1e3 * float(np.median(ages)),
        "frame_age_p99_ms": 1e3 * float(np.percentile(ages, 99.0)),
        "gap_max_ms": 1e3 * float(max(gaps, default=np.nan)),
    } | ({} if model_ms is None else beside_model(inside, model_ms))


def beside_model(inside_ms: np.ndarray, model_ms: np.ndarray) -> dict[str, float]:
    """Returns how much longer [ms] frames are in the service (``inside_ms``) than the model takes for them alone
    (``model_ms``): "overhead_p50_ms", median less median, and "overhead_p99_ms", 99th percentile less 99th
    percentile."""
    return {
        "overhead_p50_ms": float(np.median(inside_ms) - np.median(model_ms)),
        "overhead_p99_ms": float(np.percentile(inside_ms, 99.0) - np.percentile(model_ms, 99.0)),
    }


def model_times(garment: str, clip: MotionClip, seconds: float) -> dict[str, np.ndarray]:
    """Returns the wall times [ms] (F,) of frames of ``garment`` that the stages alone take in this process, by tier: of
    ``clip`` at ``FPS`` during ``seconds``. Under ``POST`` are those of single frames, one right after the other."""
    drapery = DrapeRuntime(Settings())
    entry, shapes = drapery.garments.get(garment), drapery.body.shape_count
    tiers = {tier.name: DrapeOptions.model_validate({"tier": tier.name}) for tier in drapery.tiers}
    times = {
        name: alone(drapery.plan(entry, options, messages=True), shapes, clip, seconds)
        for name, options in tiers.items()
    }
    times[POST] = alone(drapery.plan(entry, DrapeOptions.model_validate(POSTED)), shapes, clip, seconds, warm=True)
    drapery.close()
    return times


def alone(plan: Plan, shape_count: int, clip: MotionClip, seconds: float, *, warm: bool = False) -> np.ndarray:
    """Returns the wall time [ms] (F,) of each frame of ``clip`` under ``plan``, as many as a stream has in ``seconds``.

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
    return np.array(stream.clock.wall_ms[1:])  # the first pays for what is computed once


def posts(url: str, garment: str, clip: MotionClip, seconds: float) -> np.ndarray:
    """Returns the wall times [ms] (F,) from request to answer of ``POST /drape`` of one frame, binary in both
    directions, one right after the other: as many as a stream has frames in ``seconds``.

    The client is the standard library's, which takes less time itself than others.
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
    """What all cases share: the ``run`` that gets their rows, clip, garment, the ``seconds`` of each, the times of the
    model alone ``model_ms`` (``model_times``), and the seconds before measuring begins."""

    run: Run
    clip: MotionClip
    garment: str
    seconds: float
    model_ms: dict[str, np.ndarray]
    warm_s: float = WARM_S

    def measure(self, case: str, at: Server, tier: str, count: int = 1, **others: Any) -> Row:
        """Measures ``count`` clients of ``tier``, with ``others`` among their options, and adds their row to the run.
        Returns the row."""
        spent, options = Spent(at), {"garment": self.garment, "tier": tier} | others
        views = asyncio.run(crowd(at.url, self.clip, count, self.seconds, self.warm_s, begun=spent.begin, **options))
        row = {"case": case, "server": "service", "tier": tier, "clients": count, "fps": FPS}
        alone = self.model_ms[tier] if not others and len(self.clip.poses) > 1 else None
        row |= stream_figures(views, alone) | {"cpu_ms": spent.ms_per_frame(sum(view.sent for view in views))}
        self.run.add([row])
        return row

    def posted(self, at: Server) -> None:
        """Measures single frames, one request each, and adds their row to the run: ages are from request to answer."""
        took_ms = posts(at.url, self.garment, self.clip, self.seconds)
        row = {"case": POST, "server": "service", "tier": "", "clients": 1, "fps": FPS, "goodput_pct": 100.0}
        row["frame_age_p50_ms"] = float(np.median(took_ms))
        row["frame_age_p99_ms"] = float(np.percentile(took_ms, 99.0))
        self.run.add([row | beside_model(took_ms, self.model_ms[POST])])

    def carried(self, at: Server, tier: str, counts: Sequence[int]) -> int:
        """Measures each of ``counts`` clients of ``tier`` and adds their rows to the run. Returns the largest of
        ``counts`` whose goodput is at least ``CARRIED_PCT``, 0 if there is none."""
        rows = [self.measure("streams", at, tier, count) for count in counts]
        return max((row["clients"] for row in rows if row["goodput_pct"] >= CARRIED_PCT), default=0)

    def standing(self) -> ServingBench:
        """Returns the same bench with a body that stands still in a pose from the middle of the clip."""
        poses = self.clip.poses[len(self.clip.poses) // 2][None]
        return replace(self, clip=MotionClip(poses, np.zeros((1, 3)), FPS, "still"), warm_s=1.5 * REST_S)


def measure_streams(bench: ServingBench, options: argparse.Namespace) -> dict[str, int]:
    """Measures all cases and adds their rows to the run of ``bench``. Returns how many clients a service carries, under
    "service TIER"."""
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
    """Adds to ``run`` the rows of every case, and to its record what is carried and the times of the model alone."""
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
