"""What a stream waits beside other requests, each measured against the same stream without, in turn.

    python -m benchmarks.speed.beside [--quick] [--neighbours GLB uploads] [--rounds 3] [--seconds 4]

The service, the client of the stream and who asks are three processes. One stream sends ``FPS`` poses a second all the
time; the neighbour asks again and again in every second window. ``wait``: from a pose's sending until the first frame
of it or of a newer one came, so that poses that were replaced count as well. ``moved_ms``: the median over the rounds
of a window's p99 less that of the quiet window before it; ``gap``: the longest pause between two frames.
"""

from __future__ import annotations

import argparse
import asyncio
import functools
import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np

from benchmarks.shared import common
from clients.stream import DrapeStream
from drape.catalog import find_motions
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion

FPS, FRAMES, MOST_FRAMES, UPLOADS = 30.0, 300, 1200, 8
SECONDS, QUICK_SECONDS, ROUNDS, QUICK_ROUNDS = 4.0, 1.0, 3, 1
SETTLE_S = 0.5  # of a window, which do not count
BODY_BYTES = 8 * 2**20 - 1024  # of the largest body, illegal as it is
NEIGHBOURS = (
    "JSON", "binary", "GLB", "folded clip", "largest legal body", "largest illegal body", "first frame of an outfit",
    "tables of outfits", "uploads",
)  # fmt: skip
COLUMNS = {
    "neighbour": "s", "tier": "s", "asked": "d", "quiet_p50_ms": ".1f", "quiet_p99_ms": ".1f", "quiet_gap_ms": ".0f",
    "wait_p50_ms": ".1f", "wait_p99_ms": ".1f", "gap_max_ms": ".0f", "moved_ms": ".1f",
}  # fmt: skip
JSON = {"Content-Type": "application/json"}
Ask = Callable[[httpx.Client], Any]


@functools.cache
def _clip() -> MotionClip:
    clip = read_motion(find_motions(["walk"])[0])
    return clip if abs(clip.fps - FPS) < 1e-6 else clip.resampled(FPS)


def _post(document: dict[str, Any], accept: str = "*/*") -> Ask:
    content = json.dumps(document).encode()
    return lambda http: http.post("/drape", content=content, headers=JSON | {"Accept": accept})


def _asked(http: httpx.Client, names: Sequence[str]) -> dict[str, Callable[[], Ask]]:
    """Requests by the name of the neighbour, each made where it is first wanted."""
    garment = names[0]

    def plain(frames: int, accept: str) -> Ask:
        rows = np.resize(_clip().poses, (frames, 24, 3)).round(6).tolist()
        return _post({"garment": garment, "poses": rows, "folds": 0, "passes": 0}, accept)

    def folded() -> Ask:
        return _post({"garment": garment, "poses": np.resize(_clip().poses, (100, 24, 3)).tolist()})

    def illegal() -> Ask:
        content = b'{"garment":"' + garment.encode() + b'","poses":[' + b"[]," * (BODY_BYTES // 3 - 20) + b"[]]}"
        return lambda http: http.post("/drape", content=content, headers=JSON)

    def uploads() -> Ask:
        file = http.get(f"/garments/{garment}/mesh", headers={"Accept": "model/gltf-binary"}).content

        def send(http: httpx.Client) -> None:
            for number in range(UPLOADS):
                http.post("/garments", params={"name": f"beside-{number}.glb"}, content=file)
            time.sleep(0.5)

        return send

    def outfit() -> Ask:
        return _post({"garments": list(names[:2]), "poses": _clip().poses[:1].tolist()})

    def outfits() -> Ask:
        pairs = itertools.cycle(itertools.permutations(names, 2))
        return lambda http: _post({"garments": list(next(pairs)), "poses": _clip().poses[:1].tolist()})(http)

    return {
        "JSON": lambda: plain(FRAMES, "application/json"),
        "binary": lambda: plain(FRAMES, "application/octet-stream"),
        "GLB": lambda: plain(FRAMES, "model/gltf-binary"),
        "folded clip": folded,
        "largest legal body": lambda: plain(MOST_FRAMES, "application/octet-stream"),
        "largest illegal body": illegal,
        "first frame of an outfit": outfit,
        "tables of outfits": outfits,
        "uploads": uploads,
    }


def ask(url: str, name: str, garments: Sequence[str]) -> None:
    """Says ``ready``; asks between a line and the next of standard input, and after that says how often it did."""
    going, ended, idle = threading.Event(), threading.Event(), threading.Event()
    idle.set()
    asked = 0

    def work() -> None:
        nonlocal asked
        with httpx.Client(base_url=url, timeout=300.0) as http:
            request = _asked(http, garments)[name]()
            request(http)  # what is lazily set up the first time
            print("ready", flush=True)
            while not ended.is_set():
                if going.wait(0.05):
                    idle.clear()
                    request(http)
                    asked += 1
                    idle.set()

    threading.Thread(target=work, daemon=True).start()
    for number, _ in enumerate(sys.stdin):
        if number % 2 == 0:
            going.set()
        else:
            going.clear()
            idle.wait()
            print(asked, flush=True)
    ended.set()


@dataclass(eq=False)
class Watched:
    """One stream, all the time: when each pose was sent and when each frame came [s], with the pose's number."""

    sent_s: list[float] = field(default_factory=list)
    came_s: list[float] = field(default_factory=list)
    number: list[int] = field(default_factory=list)

    async def run(self, stream: DrapeStream, clip: MotionClip) -> None:
        """Until it is cancelled."""

        async def take() -> None:
            while True:
                received = await stream.receive()
                self.came_s.append(time.perf_counter())
                self.number.append(received.frame.sequence - 1)

        taking = asyncio.create_task(take())
        try:
            start_s = time.perf_counter()
            for number in itertools.count():
                self.sent_s.append(time.perf_counter())
                await stream.send(clip.poses[number % len(clip.poses)])
                await asyncio.sleep(max(0.0, start_s + (number + 1) / FPS - time.perf_counter()))
        finally:
            taking.cancel()

    def window(self, begin_s: float, end_s: float) -> dict[str, float]:
        """Of the poses sent between the two times: median and p99 of their waits, and the longest gap [ms]."""
        sent, came = np.array(self.sent_s), np.array(self.came_s)
        rows = np.flatnonzero((sent >= begin_s) & (sent < end_s))
        first = np.searchsorted(np.array(self.number), rows)  # the frame that answers each
        rows, first = rows[first < len(came)], first[first < len(came)]
        waits = 1e3 * (came[first] - sent[rows])
        inside = came[(came >= begin_s) & (came < end_s)]
        return {
            "p50": float(np.median(waits)),
            "p99": float(np.percentile(waits, 99.0)),
            "gap": 1e3 * float(np.diff(inside).max(initial=0.0)),
        }


@dataclass(eq=False)
class Neighbour:
    """The process that asks."""

    process: subprocess.Popen[str]

    def line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def turn(self) -> None:
        """Begins to ask, or ends."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()


async def beside(
    url: str, name: str, garments: Sequence[str], clip: MotionClip, *, tier: str, rounds: int, seconds: float
) -> dict[str, Any]:
    """The row of one neighbour: ``rounds`` times ``seconds`` without it and ``seconds`` with it."""
    command = [sys.executable, "-m", "benchmarks.speed.beside", "--ask", url, name, *garments]
    process = subprocess.Popen(command, cwd=common.ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    neighbour, quiet, busy, asked = Neighbour(process), [], [], "0"
    try:
        if neighbour.line() != "ready":
            raise RuntimeError(f"{name}: nothing can be asked")
        async with await DrapeStream.open(url, garments[0], tier=tier) as stream:
            watched = Watched()
            task = asyncio.create_task(watched.run(stream, clip))
            await asyncio.sleep(1.0)
            spans: list[tuple[float, float, float, float]] = []
            for _ in range(rounds):
                await asyncio.sleep(SETTLE_S)
                quiet_s = time.perf_counter()
                await asyncio.sleep(seconds)
                neighbour.turn()
                begin_s = time.perf_counter()
                await asyncio.sleep(seconds)
                end_s = time.perf_counter()
                neighbour.turn()
                asked = await asyncio.to_thread(neighbour.line)
                spans.append((quiet_s, begin_s, begin_s, end_s))
            await asyncio.sleep(0.5)
            task.cancel()
        for first, last, begin, end in spans:
            quiet.append(watched.window(first, last))
            busy.append(watched.window(begin, end))
    finally:
        process.kill()
        process.wait()

    def middle(windows: list[dict[str, float]], key: str) -> float:
        return float(np.median([window[key] for window in windows]))

    return {
        "neighbour": name, "tier": tier, "asked": int(asked),
        "quiet_p50_ms": middle(quiet, "p50"), "quiet_p99_ms": middle(quiet, "p99"),
        "quiet_gap_ms": max(window["gap"] for window in quiet),
        "wait_p50_ms": middle(busy, "p50"), "wait_p99_ms": middle(busy, "p99"),
        "gap_max_ms": max(window["gap"] for window in busy),
        "moved_ms": float(np.median([b["p99"] - a["p99"] for a, b in zip(quiet, busy, strict=True)])),
    }  # fmt: skip


def measure(
    url: str, names: Sequence[str], *, garment: str, tier: str, rounds: int, seconds: float
) -> Iterator[dict[str, Any]]:
    """The rows of the neighbours ``names`` at the service of ``url``; uploads last, which go on after it."""
    clip = _clip()
    with httpx.Client(base_url=url) as http:
        ids = [entry["id"] for entry in http.get("/garments").json()]
    ids = [garment, *(one for one in ids if one != garment)]
    for name in sorted(names, key=NEIGHBOURS.index):
        yield asyncio.run(beside(url, name, ids, clip, tier=tier, rounds=rounds, seconds=seconds))


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    from benchmarks.serving import server  # which has these rows in its own record

    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.beside", description=__doc__)
    parser.add_argument("--garment", default="tshirt")
    parser.add_argument("--tier", default="fast")
    parser.add_argument("--neighbours", nargs="+", choices=NEIGHBOURS, default=list(NEIGHBOURS))
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--seconds", type=float)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    rounds = options.rounds or (QUICK_ROUNDS if options.quick else ROUNDS)
    seconds = options.seconds or (QUICK_SECONDS if options.quick else SECONDS)
    rows = []
    with server() as at:
        for row in measure(
            at.url, options.neighbours, garment=options.garment, tier=options.tier, rounds=rounds, seconds=seconds
        ):
            rows.append(row)
            common.print_table([row], COLUMNS)
    return common.finish("beside", rows, options, seconds=seconds, rounds=rounds)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--ask"]:
        ask(sys.argv[2], sys.argv[3], sys.argv[4:])
    else:
        main()
