"""How late the frames of streams are, over minutes: the delay of a frame beyond its pose's sending.

    python -m benchmarks.lateness [--streams 2 8] [--seconds 300] [--runs 3] [--beside previews] [--quick] [--save]

Each run starts a service in a process of its own, opens streams of one tier over loopback, and sends each the poses of
a clip at 30 a second, with phases drawn by run. The delay of a frame is the time from the moment before its pose is
written to the socket to the moment at which the kernel has received the frame's last byte (``SO_TIMESTAMPNS``): a
client that wakes late, to send or to read, adds nothing. The client is one thread, which looks at no vertex and
collects no garbage. The first ``WARM_S`` do not count.

``delay``: percentiles and the most of all frames' delays. Its parts: ``coming`` until the pose is in the service's
mailbox, ``inside`` until the frame is packed, ``going`` until it has arrived. ``own``: the delay less the time for
which the service's loop, and one more of its threads at most, was ready to run and had no processor (``schedstat``).
What is left is the service's own; what goes is of other programs, or of too many streams. ``late``: how late the client
sent. ``lost``: poses without a frame.

Below undisturbed streams and the medians of their runs is the first count of streams beside a neighbour in a process of
its own: ``previews`` that nobody has drawn before, one ``upload`` after the other, ``metrics`` four times a second,
``clips`` of 60 frames; ``done``: how many.
"""

from __future__ import annotations

import gc
import heapq
import json
import multiprocessing  # noqa: TID251 - it spawns
import os
import random
import selectors
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.client import ClientProtocol
from websockets.frames import Opcode
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.scenes import FPS, at_rate
from benchmarks.serving import Server, server
from benchmarks.tables import Row
from drape.catalog import find_motions
from drape.errors import Unavailable
from drape.motion.readers import read_motion
from drape.wire import messages as wire
from drape.wire.clips import pack_clip

SO_TIMESTAMPNS, STAMP = 35, struct.Struct("qq")  # Linux' number, and seconds and nanoseconds
FRAME = wire.record(wire.LAYOUTS["FRAME"])
WARM_S, END_S = 3.0, 1.0
NEIGHBOURS = ("previews", "upload", "metrics", "clips")
MEASURES = ("delay", "coming", "inside", "going", "own", "late")
TOLD = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
SHOWN = ("delay_p50", "delay_p99", "delay_p999", "delay_max", "coming_p999", "inside_p999", "going_p999", "own_p999",
         "own_max", "late_max")  # fmt: skip
COLUMNS = {
    "beside": "s", "streams": "d", "tier": "s", "run": "s", "frames": "d", "lost": "d", "done": "d",
    **{f"{name}_ms": ".1f" for name in SHOWN},
}  # fmt: skip


class Queued:
    """How long [ns] each thread of a service has waited for a processor, its loop's first."""

    def __init__(self, pid: int) -> None:
        self._tasks, self._loop = Path(f"/proc/{pid}/task"), str(pid)
        self.settle()

    def settle(self) -> None:
        """Looks at all threads that there are by now."""
        names = sorted((one.name for one in self._tasks.iterdir()), key=lambda name: name != self._loop)
        self._files = [(self._tasks / name / "schedstat").open("rb", buffering=0) for name in names]

    def read(self) -> list[int]:
        return [int(os.pread(file.fileno(), 64, 0).split()[1]) for file in self._files]

    def waited_s(self, before: list[int]) -> float:
        """How long [s] the loop, and one other thread at most, have waited since ``before`` was read."""
        loop, *others = (now - then for now, then in zip(self.read(), before, strict=False))
        return 1e-9 * (loop + max(others, default=0))


class LightStream:
    """A stream whose frames are taken and acknowledged, and not looked at.

    ``frames``: the ``MEASURES`` [s] of each; ``sent``: of poses without a frame when [ns] they were sent, what
    ``Queued`` said then, and how late [s] they were.
    """

    def __init__(self, url: str, opening: dict[str, object]) -> None:
        self.sent: dict[int, tuple[int, list[int], float]] = {}
        self.frames: list[tuple[float, ...]] = []
        address = parse_uri(url.replace("http", "ws", 1) + "/stream")
        self._protocol = ClientProtocol(address, subprotocols=[Subprotocol(wire.SUBPROTOCOL)], max_size=None)
        self.socket = socket.create_connection((address.host, address.port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._protocol.send_request(self._protocol.connect())
        self._answer()
        self._protocol.send_text(json.dumps({"type": "open", **opening}).encode())
        said = json.loads(self._answer().data)
        if said["type"] == "error":
            raise RuntimeError(f"the service refused a stream: {said}")

    def _flush(self) -> None:
        self.socket.sendall(b"".join(self._protocol.data_to_send()))

    def _read(self) -> tuple[list[Any], int]:
        """What has come whole, and when [ns] its last byte came, by the clock of the system."""
        data, told, _, _ = self.socket.recvmsg(1 << 18, 64)
        if not data:
            raise RuntimeError("the service closed a stream")
        self._protocol.receive_data(data)
        # The system begins to note times a moment after it is asked: of the first bytes it may know none.
        seconds, rest = STAMP.unpack(told[0][2]) if told else divmod(time.time_ns(), 10**9)
        return self._protocol.events_received(), 10**9 * seconds + rest

    def _answer(self) -> Any:
        self._flush()
        while not (events := self._read()[0]):
            pass
        return events[0]

    def send(self, sequence: int, pose: np.ndarray, late_s: float, queued: Queued) -> None:
        """Sends ``pose``, ``late_s`` after its time."""
        self._protocol.send_binary(wire.pack_pose(wire.Pose(sequence, 0.0, np.zeros(3), pose)))
        data, before = b"".join(self._protocol.data_to_send()), queued.read()
        self.sent[sequence] = time.time_ns(), before, late_s
        self.socket.sendall(data)

    def take(self, queued: Queued) -> None:
        """Notes and acknowledges the frames that have come, and answers pings."""
        events, came_ns = self._read()
        for event in (one for one in events if one.opcode is Opcode.BINARY):
            told = FRAME.unpack_from(event.data)
            sequence, left_s, inside_s = told[4], told[7], 1e-6 * told[18]
            self._protocol.send_binary(wire.pack_ack(sequence))
            if sequence in self.sent:  # else it is of the time that does not count
                sent_ns, before, late_s = self.sent.pop(sequence)
                delay_s, going_s = 1e-9 * (came_ns - sent_ns), 1e-9 * came_ns - left_s
                coming_s, own_s = delay_s - inside_s - going_s, max(0.0, delay_s - queued.waited_s(before))
                self.frames.append((delay_s, coming_s, inside_s, going_s, own_s, late_s))
        self._flush()


def flow(at: Server, opening: dict[str, object], count: int, seconds: float, seed: int) -> Row:
    """The columns of ``count`` streams for ``seconds``, all frames together."""
    streams, drawn = [LightStream(at.url, opening) for _ in range(count)], random.Random(seed)
    warm, end = round(WARM_S * FPS), round((WARM_S + seconds) * FPS)
    poses, queued, begin_s = walk(), Queued(at.pid), time.monotonic()
    due = [(begin_s + drawn.random() / FPS, 0, index) for index in range(count)]
    heapq.heapify(due)
    with selectors.DefaultSelector() as ready:
        for one in streams:
            ready.register(one.socket, selectors.EVENT_READ, one)
        gc.collect()
        gc.disable()
        while (found := ready.select(max(0.0, due[0][0] - time.monotonic()) if due else END_S)) or due:
            for key, _ in found:
                key.data.take(queued)
            while due and due[0][0] <= (now_s := time.monotonic()):
                due_s, number, index = heapq.heappop(due)
                if number == warm:
                    streams[index].sent.clear()
                    streams[index].frames.clear()
                    queued.settle()
                pose = poses[(number + index * len(poses) // count) % len(poses)]
                streams[index].send(number, pose, now_s - due_s, queued)
                if number + 1 < end:
                    heapq.heappush(due, (due_s + 1.0 / FPS, number + 1, index))
        gc.enable()
    for one in streams:
        one.socket.close()
    seen = 1e3 * np.array([frame for one in streams for frame in one.frames])
    row: Row = {"frames": len(seen), "lost": sum(len(one.sent) for one in streams)}
    for name, values in zip(MEASURES, seen.T, strict=True):
        row |= {f"{name}_{what}_ms": float(np.percentile(values, share)) for what, share in TOLD.items()}
    return row


def walk() -> np.ndarray:
    """Poses (F, 24, 3) [rad] at ``FPS``."""
    return at_rate(read_motion(find_motions(["walk"])[0]), FPS).poses


def neighbour(name: str, url: str, garment: str, ending: Any, done: Any) -> None:
    """Does one thing again and again until ``ending``; ``done`` counts how often."""
    binary = {"Content-Type": "application/octet-stream", "Accept": "application/octet-stream"}
    with httpx.Client(base_url=url, timeout=300.0) as http:

        def ask(method: str, path: str, **more: Any) -> httpx.Response:
            return http.request(method, path, **more).raise_for_status()

        mesh = ask("GET", f"/garments/{garment}/mesh", headers={"Accept": "model/gltf-binary"}).content
        clip = pack_clip({"garment": garment}, np.resize(walk(), (60, 24, 3)), None)

        def upload() -> None:
            path = f"/garments?name=late{done.value}.glb&avatar=standard"
            job = ask("POST", path, content=mesh, headers=binary).json()
            while job["state"] in ("queued", "running"):
                time.sleep(0.1)
                job = ask("GET", f"/jobs/{job['id']}").json()
            ask("DELETE", f"/garments/{job['garment']}")

        deeds: dict[str, Callable[[], object]] = {
            "previews": lambda: ask("GET", f"/garments/{garment}/preview.png?size={256 + done.value % 256}"),
            "upload": upload,
            "metrics": lambda: (ask("GET", "/metrics"), time.sleep(0.25)),
            "clips": lambda: ask("POST", "/drape", content=clip, headers=binary),
        }
        while not ending.is_set():
            deeds[name]()
            done.value += 1


@contextmanager
def beside(name: str, url: str, garment: str) -> Iterator[Any]:
    """The neighbour ``name`` meanwhile, and how many things it has done."""
    spawned = multiprocessing.get_context("spawn")  # no fork: what goes on here are timings
    ending, done = spawned.Event(), spawned.Value("i", 0)
    process = spawned.Process(target=neighbour, args=(name, url, garment, ending, done))
    process.start()
    try:
        yield done
    finally:
        ending.set()
        process.join()
    if process.exitcode:
        raise RuntimeError(f"the neighbour ended with status {process.exitcode}")


def medians(rows: list[Row]) -> Row:
    """The row of medians of the measures of ``rows``, runs of as many streams."""
    middle = {name: float(np.median([row[name] for row in rows])) for name in rows[0] if name.endswith("_ms")}
    return {**rows[0], "run": "median", **dict.fromkeys(("frames", "lost")), **middle}


@Benchmark(
    "lateness",
    "How late frames are.",
    COLUMNS,
    Option("--streams", (2, 8), "at the same time", (2,)),
    Option("--seconds", 300.0, "of each run", 3.0),
    Option("--runs", 3, "of undisturbed streams", 1),
    Option("--beside", NEIGHBOURS, "neighbours, each for a fifth of the time", NEIGHBOURS[:1], choices=NEIGHBOURS),
    Option("--garment", "tshirt", "what is streamed"),
    Option("--tier", "balanced", "of the streams"),
)
def main(run: Run) -> None:
    """Rows of every run, of their medians, and of streams beside neighbours."""
    if sys.platform != "linux":
        raise Unavailable("lateness", expected="Linux, which stamps what comes", got=sys.platform, cure="Run it there.")
    options, load = run.options, os.getloadavg()[0]
    opening = {"garment": options.garment, "tier": options.tier}

    def measure(name: str, count: int, number: int, seconds: float) -> Row:
        row: Row = {"beside": name, "streams": count, "tier": options.tier, "run": str(number)}
        with server() as at:
            if not name:
                return row | flow(at, opening, count, seconds, number)
            with beside(name, at.url, options.garment) as done:
                return row | flow(at, opening, count, seconds, number) | {"done": done.value}

    for count in options.streams:
        rows = [measure("", count, number, options.seconds) for number in range(1, options.runs + 1)]
        run.add([*rows, medians(rows)])
    disturbed = [measure(name, options.streams[0], 1, options.seconds / 5.0) for name in options.beside]
    run.add(disturbed)
    run.extra |= {"load_before": load, "seconds": options.seconds}


if __name__ == "__main__":
    main.command()
