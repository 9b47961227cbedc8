"""Whether a service keeps its memory, descriptors and threads while clients come and go.

    python -m benchmarks.speed.churn [--minutes 30] [--clients 50] [--quick] [--save]

``--clients`` talk to one service in a process of its own, each by its own drawn order: it opens a stream of a drawn
garment or outfit, tier, shape and geometry, sends poses, turns it to something else, and closes it, drops the
connection or stops reading; it asks for clips as JSON, binary or GLB, for meshes and previews; it uploads a garment,
drapes and deletes it; it sends what is refused. That is far more than the service can compute: it is to refuse and to
drop frames, not to grow.

Every ``LOOK_S`` memory (VmRSS), descriptors and threads of the service's process are read. ``slope_mb_h`` is the
least-squares slope of memory after the first third, when every garment has been taken in and every path has run, with
``slope_error_mb_h`` its standard error from the means of ``BLOCKS`` equal parts of that time. ``end_slope_mb_h`` and
its error are those of the last third: an allocator's high water rises ever more rarely, a leak goes on.
"""

from __future__ import annotations

import asyncio
import collections
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.serving import Server, server
from clients.stream import DrapeStream
from drape.catalog import find_motions
from drape.errors import DrapeError
from drape.motion.readers import read_motion

LOOK_S, BLOCKS = 5.0, 8
FPS, FRAMES = 10.0, (5, 60)  # of a stream, as many poses a second; frames of one opening, the least and the most
GARMENTS = ("tshirt", "tank", "shorts", "skirt", "dress", "trousers")
OUTFITS = (("trousers", "tshirt"), ("shorts", "tank"))
TIERS = ("fast", "balanced", "accurate")
ANSWERS = ("application/json", "application/octet-stream", "model/gltf-binary")
WAIT_S = 60.0
COLUMNS = {
    "case": "s", "clients": "d", "minutes": ".1f", "streams": "d", "frames": "d", "requests": "d", "refused": "d",
    "failed": "d", "memory_mb": ".0f", "last_mb": ".0f", "slope_mb_h": ".1f", "slope_error_mb_h": ".1f",
    "end_slope_mb_h": ".1f", "end_slope_error_mb_h": ".1f", "descriptors": "d", "last_descriptors": "d",
    "threads": "d", "last_threads": "d",
}  # fmt: skip


@dataclass(eq=False)
class Tally:
    """What all clients did: counts by name, and sentences of what should not have happened."""

    counts: collections.Counter[str] = field(default_factory=collections.Counter)
    faults: list[str] = field(default_factory=list)

    def answered(self, response: httpx.Response) -> httpx.Response:
        """Counts ``response``; one above 499 is a fault, but for 503 and 507, which say that there is no room."""
        self.counts["requests"] += 1
        if response.status_code >= 400:
            self.counts["refused"] += 1
        if response.status_code >= 500 and response.status_code not in (503, 507):
            self.faults.append(f"{response.request.method} {response.request.url.path}: {response.status_code}")
        return response


@dataclass(frozen=True)
class Looked:
    """Memory [MB], descriptors and threads of a process at a time [s]."""

    at_s: float
    memory_mb: float
    descriptors: int
    threads: int

    @classmethod
    def of(cls, pid: int) -> Looked:
        told = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        memory_mb = int(told["VmRSS"].split()[0]) / 1024.0
        return cls(time.monotonic(), memory_mb, len(list(Path(f"/proc/{pid}/fd").iterdir())), int(told["Threads"]))


def slope_of(times_s: np.ndarray, memory_mb: np.ndarray) -> tuple[float, float]:
    """Slope of ``memory_mb`` over ``times_s`` and its standard error [MB/h], from ``BLOCKS`` means, which follow each
    other more loosely than single looks; NaN where there are fewer than three."""
    blocks = [part for part in np.array_split(np.arange(len(times_s)), BLOCKS) if len(part)]
    if len(blocks) < 3:
        return float("nan"), float("nan")
    x = np.array([times_s[part].mean() for part in blocks]) / 3600.0
    y = np.array([memory_mb[part].mean() for part in blocks])
    away = x - x.mean()
    slope = float(away @ y / (away @ away))
    left = y - y.mean() - slope * away
    return slope, float(np.sqrt(left @ left / (len(x) - 2) / (away @ away)))


async def streaming(url: str, poses: np.ndarray, drawn: random.Random, tally: Tally) -> None:
    """A stream from opening to its end, in one of the ways in which streams end."""

    def opening() -> dict[str, Any]:
        worn = drawn.choice((*GARMENTS, *OUTFITS))
        betas = [drawn.uniform(-1.0, 1.0) for _ in range(10)] if drawn.random() < 0.3 else None
        geometry = "jets" if drawn.random() < 0.2 else "vertices"
        more = {"folds": 0} if geometry == "jets" else {"tier": drawn.choice(TIERS)}
        return {"garment": worn, "betas": betas, "geometry": geometry, **more}

    asked = opening()
    stream = await DrapeStream.open(url, **asked)
    tally.counts["streams"] += 1

    async def take() -> None:
        while True:
            await (stream.receive_jets() if asked["geometry"] == "jets" else stream.receive())
            tally.counts["frames"] += 1

    taking, first = asyncio.create_task(take()), drawn.randrange(len(poses))
    try:
        for number in range(drawn.randint(*FRAMES)):
            await stream.send(poses[(first + 3 * number) % len(poses)])
            await asyncio.sleep(1.0 / FPS)
            if taking.done():
                taking.result()
    finally:
        taking.cancel()
        await asyncio.gather(taking, return_exceptions=True)
        end = drawn.random()
        if end < 0.2:
            stream._connection.transport.abort()
        elif end < 0.3:  # nobody reads any more: the service closes it
            await asyncio.sleep(4.0)
        elif end < 0.5:
            asked = opening()
            await stream.reopen(asked.pop("garment"), **asked)
        await stream.close()


async def asking(http: httpx.AsyncClient, poses: np.ndarray, drawn: random.Random, tally: Tally) -> None:
    """A request that is answered, or one that is refused."""
    garment, kind = drawn.choice(GARMENTS), drawn.random()
    if kind < 0.5:
        frames, accept = drawn.choice((1, 1, 4, 30)), drawn.choice(ANSWERS)
        begin = drawn.randrange(len(poses) - frames)
        asked = {"garment": garment, "poses": poses[begin : begin + frames].tolist(), "tier": "fast"}
        tally.answered(await http.post("/drape", json=asked, headers={"Accept": accept}))
    elif kind < 0.65:
        tally.answered(await http.get(f"/garments/{garment}/mesh"))
    elif kind < 0.75:
        tally.answered(await http.get(f"/garments/{garment}/preview.png"))
    elif kind < 0.85:
        tally.answered(await http.get(drawn.choice(("/garments", "/health", "/tiers", "/metrics", "/openapi.json"))))
    else:
        bodies = (b"{", b"[]," * 100_000, b'{"garment": "none", "poses": []}', bytes(1000))
        json = {"Content-Type": "application/json"}
        tally.answered(await http.post("/drape", content=drawn.choice(bodies), headers=json))


async def uploading(http: httpx.AsyncClient, mesh: bytes, drawn: random.Random, tally: Tally) -> None:
    """A garment that is uploaded, draped and deleted; sometimes its job is cancelled."""
    raw = {"Content-Type": "application/octet-stream"}
    query = {"name": f"churn{drawn.randrange(10**9)}.glb", "avatar": "standard"}
    accepted = tally.answered(await http.post("/garments", params=query, content=mesh, headers=raw))
    if accepted.status_code != 202:
        return
    tally.counts["uploads"] += 1
    cancelled, job = drawn.random() < 0.3, accepted.json()
    while job["state"] in ("queued", "running"):
        if cancelled:
            tally.answered(await http.delete(f"/jobs/{job['id']}"))
            return
        await asyncio.sleep(0.5)
        job = tally.answered(await http.get(f"/jobs/{job['id']}")).json()
    if job["state"] == "done":
        tally.answered(
            await http.post("/drape", json={"garment": job["garment"], "poses": np.zeros((1, 24, 3)).tolist()})
        )
        tally.answered(await http.delete(f"/garments/{job['garment']}"))
    else:
        tally.faults.append(f"upload: {job['problem']}")


async def going(url: str, number: int, poses: np.ndarray, mesh: bytes, end_s: float, tally: Tally) -> None:
    """One client until ``end_s``; the first uploads too."""
    drawn = random.Random(number)
    while time.monotonic() < end_s:
        try:
            if drawn.random() < 0.6:
                await streaming(url, poses, drawn, tally)
                continue
            async with httpx.AsyncClient(base_url=url, timeout=WAIT_S) as http:
                for _ in range(drawn.randint(1, 5)):
                    await asking(http, poses, drawn, tally)
                if number == 0:
                    await uploading(http, mesh, drawn, tally)
        except (DrapeError, httpx.TransportError) as error:
            tally.counts["refused"] += 1
            asked = f" at {error.request.url.path}" if isinstance(error, httpx.RequestError) else ""
            tally.counts[f"refused: {type(error).__name__}{asked}"] += 1
        await asyncio.sleep(drawn.uniform(0.0, 2.0))


async def churn(at: Server, minutes: float, clients: int) -> tuple[Tally, list[Looked]]:
    """What ``clients`` did to the service for ``minutes``, and what its process held meanwhile."""
    clip = read_motion(find_motions(["walk"])[0])
    with httpx.Client(base_url=at.url, timeout=WAIT_S) as http:
        mesh = http.get("/garments/tank/mesh", headers={"Accept": "model/gltf-binary"}).content
    tally, end_s = Tally(), time.monotonic() + 60.0 * minutes
    looked = [Looked.of(at.pid)]

    async def look() -> None:
        while time.monotonic() < end_s:
            await asyncio.sleep(min(LOOK_S, 6.0 * minutes))
            looked.append(Looked.of(at.pid))

    await asyncio.gather(look(), *(going(at.url, number, clip.poses, mesh, end_s, tally) for number in range(clients)))
    await asyncio.sleep(5.0 if minutes > 1.0 else 0.5)  # what was dropped has been noticed
    looked.append(Looked.of(at.pid))
    return tally, looked


def row_of(tally: Tally, looked: Sequence[Looked], minutes: float, clients: int) -> dict[str, Any]:
    """The row of one run."""

    def slope_after(begin: int) -> tuple[float, float]:
        times_s, memory = (np.array([getattr(one, name) for one in looked[begin:-1]]) for name in ("at_s", "memory_mb"))
        return slope_of(times_s, memory)

    settled = looked[len(looked) // 3 : -1]
    slope, error = slope_after(len(looked) // 3)
    end_slope, end_error = slope_after(2 * len(looked) // 3)
    first, last = settled[0], looked[-1]
    counted = {name: tally.counts[name] for name in ("streams", "frames", "requests", "refused", "uploads")}
    return {
        "case": "churn", "clients": clients, "minutes": minutes, **counted, "failed": len(tally.faults),
        "memory_mb": first.memory_mb, "last_mb": last.memory_mb, "slope_mb_h": slope, "slope_error_mb_h": error,
        "end_slope_mb_h": end_slope, "end_slope_error_mb_h": end_error,
        "descriptors": first.descriptors, "last_descriptors": last.descriptors,
        "threads": first.threads, "last_threads": last.threads,
    }  # fmt: skip


@Benchmark(
    "churn",
    "Clients that come and go.",
    COLUMNS,
    Option("--minutes", 30.0, "of the run", 0.1),
    Option("--clients", 50, "at the same time", 6),
)
def main(run: Run) -> None:
    """One row: what the clients did, and what the service held."""
    options = run.options
    with server() as at:
        tally, looked = asyncio.run(churn(at, options.minutes, options.clients))
    run.rows.append(row_of(tally, looked, options.minutes, options.clients))
    told = {"faults": tally.faults[:10], "counts": dict(tally.counts)}
    run.notes.append(str(told))
    run.extra |= {"memory_mb": [round(one.memory_mb, 1) for one in looked], **told}


if __name__ == "__main__":
    main.command()
