"""The stream under load: goodput, age of frames and gaps, of the service and of a naive twin.

    python -m benchmarks.serving [--quick] [--garment dress] [--seconds 8] [--save]

Each case starts a service in a process of its own and speaks to it from this one, over loopback. A client sends a
clip's poses at 30 a second, takes and acknowledges frames, and does nothing with them. ``goodput_pct``: frames that
came within ``LATE_S`` of their pose, of the poses that were sent. ``frame_age``: from the pose's sending to its frame's
arrival. ``gap_max_ms``: the longest pause between two frames of any client, after the first second. ``overhead``: what
a frame takes in the service beyond the model's own time, measured alone before (``model_ms`` of the record).

Cases: ``streams`` of each tier, ``overload`` (three times the streams that ``accurate`` carries, with and without the
step down), ``beside`` other requests, and the streams of the ``twin``.
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
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np

from benchmarks.shared import common
from clients.stream import DrapeStream
from drape.catalog import find_motions
from drape.errors import DrapeError
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion
from drape.wire.options import DrapeOptions
from service.costs import Probe
from service.drapery import Drapery
from service.settings import Settings

FPS, LATE_S, WARM_S = 30.0, 0.1, 1.0
SECONDS, QUICK_SECONDS = 8.0, 1.5
CLIENTS, QUICK_CLIENTS = (1, 2, 4, 8), (1,)
CARRIED_PCT = 97.0  # goodput of streams that are carried
COLUMNS = {
    "case": "s", "server": "s", "tier": "s", "clients": "d", "fps": ".0f", "goodput_pct": ".1f", "stepped_pct": ".0f",
    "frame_age_p50_ms": ".0f", "frame_age_p99_ms": ".0f", "overhead_p50_ms": ".2f", "overhead_p99_ms": ".2f",
    "gap_max_ms": ".0f",
}  # fmt: skip


@dataclass(eq=False)
class Seen:
    """What one client saw: poses sent, and of each frame when it came [s], its age, its time in the service."""

    sent: int = 0
    came_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)
    residence_ms: list[float] = field(default_factory=list)
    stepped: int = 0


@contextlib.contextmanager
def server(module: str = "service", **settings: object) -> Iterator[str]:
    """The address of ``python -m module`` on a free loopback port, with ``settings`` and no garments of anybody's."""
    with tempfile.TemporaryDirectory() as folder:
        named = {f"DRAPE_{name.upper()}": str(value) for name, value in settings.items()}
        environment = os.environ | {"DRAPE_GARMENTS_DIR": folder} | named
        command = [sys.executable, "-m", module, "--port", "0"]
        process = subprocess.Popen(
            command, cwd=common.ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        try:
            assert process.stdout is not None
            said = re.search(r"http://\S+", process.stdout.readline())
            if said is None:
                raise RuntimeError(f"{module} did not start")
            yield said.group()
        finally:
            process.terminate()
            process.wait(timeout=30)


async def client(url: str, clip: MotionClip, seen: Seen, seconds: float, options: dict[str, Any]) -> None:
    """Sends ``clip`` at ``FPS`` for ``seconds`` and fills ``seen``, after a second that does not count."""
    async with await DrapeStream.open(url, **options) as stream:

        async def take() -> None:
            while True:
                received = await stream.receive()
                if time.perf_counter() < begin_s:
                    continue
                seen.came_s.append(time.perf_counter())
                seen.age_s.append(received.age_s)
                seen.residence_ms.append(1e-3 * received.frame.residence_us)
                seen.stepped += received.frame.stepped

        start_s = time.perf_counter()
        begin_s, end_s = start_s + WARM_S, start_s + WARM_S + seconds
        taking = asyncio.create_task(take())
        number = 0
        while time.perf_counter() < end_s:
            await stream.send(clip.poses[number % len(clip.poses)])
            seen.sent += time.perf_counter() >= begin_s
            number += 1
            await asyncio.sleep(max(0.0, start_s + number / FPS - time.perf_counter()))
        await asyncio.sleep(2.0 * LATE_S)
        taking.cancel()
        with contextlib.suppress(asyncio.CancelledError, DrapeError):
            await taking


async def crowd(url: str, clip: MotionClip, count: int, seconds: float, **options: Any) -> list[Seen]:
    """What ``count`` clients saw at the same time."""
    seen = [Seen() for _ in range(count)]
    await asyncio.gather(*(client(url, clip, one, seconds, options) for one in seen))
    return seen


def figures(seen: Sequence[Seen], model_ms: float) -> dict[str, float]:
    """The columns of what clients saw."""
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
        "overhead_p50_ms": float(np.median(inside)) - model_ms,
        "overhead_p99_ms": float(np.percentile(inside, 99.0)) - model_ms,
        "gap_max_ms": 1e3 * float(max(gaps, default=np.nan)),
    }


def model_times(garment: str) -> dict[str, float]:
    """What a frame of each tier takes alone in this process [ms]: the stages, without serving."""
    drapery, found = Drapery(Settings()), {}
    for tier in drapery.tiers:
        plan = drapery.plan(drapery.garments.get(garment), DrapeOptions(tier=tier.name), messages=True)  # type: ignore[arg-type]
        for stage in plan.stages:
            stage.prepare(plan)
        probe = Probe(plan, drapery.body, frames=60)
        while not probe.done:
            probe.step()
        found[tier.name] = probe.frame_ms()
    drapery.close()
    return found


def beside(url: str, clip: MotionClip, garment: str) -> dict[str, Callable[[httpx.Client], Any]]:
    """Requests that others make meanwhile, by name."""
    rows = np.resize(clip.poses, (300, 24, 3)).tolist()
    document = {"garment": garment, "poses": rows, "folds": 0, "passes": 0}
    return {
        "JSON of 300 frames": lambda http: http.post("/drape", json=document, headers={"Accept": "application/json"}),
        "GLB of 300 frames": lambda http: http.post("/drape", json=document, headers={"Accept": "model/gltf-binary"}),
        "illegal body": lambda http: http.post("/drape", content=b'{"garment":"' + garment.encode() + b'","poses":['
                                              + b"[]," * 2_000_000 + b"[]]}"),
        "opening an outfit": lambda http: http.post(
            "/drape", json={"garments": ["trousers", "tshirt"], "poses": rows[:1]}
        ),
    }  # fmt: skip


async def with_others(
    url: str, clip: MotionClip, seconds: float, ask: Callable[[httpx.Client], Any], **options: Any
) -> list[Seen]:
    """What one client sees while ``ask`` is asked again and again."""
    end = asyncio.Event()

    def asking() -> None:
        with httpx.Client(base_url=url, timeout=120.0) as http:
            while not end.is_set():
                ask(http)

    other = asyncio.create_task(asyncio.to_thread(asking))
    try:
        return await crowd(url, clip, 1, seconds, **options)
    finally:
        end.set()
        await other


def measure(options: argparse.Namespace) -> tuple[list[dict[str, Any]], dict[str, int], dict[str, float]]:
    """The rows, how many clients each server carries, and the model's own times."""
    clip = read_motion(find_motions(["walk"])[0])
    clip = clip if abs(clip.fps - FPS) < 1e-6 else clip.resampled(FPS)
    model_ms, rows, carried = model_times(options.garment), [], {}

    def add(case: str, name: str, tier: str, seen: list[Seen], model: float) -> dict[str, Any]:
        row = {"case": case, "server": name, "tier": tier, "clients": len(seen), "fps": FPS, **figures(seen, model)}
        rows.append(row)
        common.print_table([row], COLUMNS)
        return row

    def streams(url: str, name: str, tier: str, counts: Sequence[int]) -> None:
        key = f"{name} {tier}"
        carried[key] = 0
        for count in counts:
            seen = asyncio.run(crowd(url, clip, count, options.seconds, garment=options.garment, tier=tier))
            row = add("streams", name, tier, seen, model_ms[tier])
            if row["goodput_pct"] >= CARRIED_PCT:
                carried[key] = count

    with server(stream_step_down=False) as url:
        for tier in reversed(model_ms):
            streams(url, "service", tier, options.clients)
    most = max(1, carried["service accurate"])
    if not options.quick:
        with server("benchmarks.speed.twin") as url:
            streams(url, "twin", "balanced", options.clients[:3])
        for step_down in (False, True):
            with server(stream_step_down=step_down) as url:
                seen = asyncio.run(
                    crowd(url, clip, 3 * most, options.seconds, garment=options.garment, tier="accurate")
                )
            add(
                f"overload, step down {'on' if step_down else 'off'}", "service", "accurate", seen, model_ms["accurate"]
            )
        with server() as url:
            for name, ask in beside(url, clip, options.garment).items():
                seen = asyncio.run(with_others(url, clip, options.seconds, ask, garment=options.garment, tier="fast"))
                add(f"beside {name}", "service", "fast", seen, model_ms["fast"])
    return rows, carried, model_ms


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.serving", description="The stream under load.")
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--seconds", type=float, help=f"of each case (default {SECONDS}, quick {QUICK_SECONDS})")
    parser.add_argument("--clients", nargs="+", type=int)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.seconds = options.seconds or (QUICK_SECONDS if options.quick else SECONDS)
    options.clients = options.clients or (QUICK_CLIENTS if options.quick else CLIENTS)
    load = os.getloadavg()[0]
    rows, carried, model_ms = measure(options)
    print()
    common.print_table(rows, COLUMNS)
    return common.finish(
        "serving", rows, options, max_clients=carried, model_ms=model_ms, load_before=load, seconds=options.seconds,
        late_ms=1e3 * LATE_S,
    )  # fmt: skip
