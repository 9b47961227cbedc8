"""Where the milliseconds of a stream's frame go, what a second thread gives, and what need not be computed saves.

    python -m benchmarks.frame [--quick] [--save]

Rows "kernel": a walk in jersey with motion, as a stream has it, by stage and function of the engine; ``Python`` is the
rest of the stage, NumPy with it. Times are medians over frames, ``share`` is of the frame. ``floor_ms``: bytes of all
arrays that a function is given at this machine's rate of copying as many, or the multiply-adds of its matrices
at its rate of a large product, whichever takes longer. Kernels below a hundredth of the frame stand together. The row
of the stage ``frame`` is the whole, its ``share`` what the rows add up to; they are of a frame stage by stage.
``bare_ms`` is a stream beside it as it is served: in one call a frame, where the engine has all of its stages.

Rows "threads": two streams' frames, and a clip, on one thread and on two. Rows "view": scenes of which less is asked;
``full_ms`` is the same in full, side by side, and ``saving`` the share of processor time that this saves.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.cases import FPS, at_rate
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.served import Stream
from benchmarks.speed.kernel_times import (
    PYTHON,
    Spent,
    Trace,
    copied_per_s,
    moved_bytes,
    multiply_adds,
    multiply_adds_per_s,
    replaced,
)
from benchmarks.tables import Row
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.catalog import find_motions
from drape.motion.readers import read_motion
from drape.stages.batch import PoseInput
from drape.stages.encode import REST_FRAMES, REST_S
from drape.stages.plan import Plan
from drape.stages.scene import Outfit
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

FABRIC = "jersey"
WARM, PART = 12, 6  # frames before the first that counts; frames of one stream before those of the one beside it
ROUNDS = 4  # of a measurement in threads, the fastest of which counts: another process may hold the second core
REST = max(REST_FRAMES, int(REST_S * FPS)) + 2  # frames until a body that stands has come to rest
OTHERS, LEAST_SHARE = "others", 0.01
OUTFIT = ("trousers", "tshirt")
COLUMNS = {
    "kind": "s", "garment": "s", "tier": "s", "stage": "s", "kernel": "s", "case": "s", "what": "s", "threads": "d",
    "calls": ".0f", "cpu_ms": ".3f", "wall_ms": ".3f", "share": ".3f", "floor_ms": ".4f", "bare_ms": ".3f",
    "frames_per_s": ".0f", "full_ms": ".3f", "saving": ".2f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class FrameBench:
    """The runtime that all rows share, the ``poses`` (F, 24, 3) [rad] of a walk, and the frames that count."""

    drapery: DrapeRuntime
    poses: np.ndarray
    frames: int

    def plan(self, garments: Sequence[str], **options: Any) -> Plan:
        """The plan of a stream of ``garments`` in jersey."""
        worn = [self.drapery.garments.get(name) for name in garments]
        scene = worn[0] if len(worn) == 1 else Outfit(tuple(worn))
        plan = self.drapery.plan(scene, DrapeOptions(fabric=FABRIC, **options), messages=True)
        self.drapery.add_missing(plan)
        return plan

    def stream(self, plan: Plan, **told: Any) -> Stream:
        """A new stream that drapes by ``plan``."""
        return Stream(plan, self.drapery.body.shape_count, **told)

    def pose(self, frame: int) -> np.ndarray:
        """The pose (24, 3) of a frame of the walk, which goes there and back."""
        turn = frame % (2 * len(self.poses) - 2)
        return self.poses[turn if turn < len(self.poses) else 2 * len(self.poses) - 2 - turn]

    def parts(self, warm: int = WARM) -> Iterator[range]:
        """The frames of a stream, ``PART`` by ``PART``; ``warm`` come first and do not count."""
        last = warm + self.frames
        return (range(first, min(last, first + PART)) for first in range(0, last, PART))


# --- by stage and kernel ----------------------------------------------------------------------------------------------


def kernel_rows(bench: FrameBench, garment: str, tier: str) -> list[Row]:
    """The rows of all stages and kernels of one stream, and of the whole frame."""
    plan, trace = bench.plan([garment], tier=tier), Trace()
    bare, seen = bench.stream(plan), bench.stream(plan, took=trace.took, staged=True)
    for part in bench.parts():
        for frame in part:
            bare.pose(bench.pose(frame), frame / FPS)
        with replaced(trace.timed):
            for frame in part:
                trace.begin()
                seen.pose(bench.pose(frame), frame / FPS)
    end = WARM + bench.frames
    floors = _floors(seen, bench.pose(end), end / FPS)
    spent = _medians(trace.frames()[WARM:])
    whole = np.sum(list(spent.values()), axis=0)
    named = {"kind": "kernel", "garment": garment, "tier": tier}
    rows = [
        {
            **named, "stage": stage, "kernel": kernel, "calls": calls, "cpu_ms": cpu, "wall_ms": wall,
            "share": cpu / whole[1], "floor_ms": sum(found) if (found := floors.get((stage, kernel))) else None,
        }
        for (stage, kernel), (calls, cpu, wall) in spent.items()
    ]  # fmt: skip
    took = {"cpu_ms": np.median(seen.clock.cpu_ms[WARM:]), "wall_ms": np.median(seen.clock.wall_ms[WARM:])}
    took |= {"bare_ms": np.median(bare.clock.cpu_ms[WARM:]), "share": whole[1] / took["cpu_ms"]}
    took |= {"floor_ms": sum(sum(found) for found in floors.values())}
    return [*_together(rows), {**named, "stage": "frame", "kernel": "", **{key: float(v) for key, v in took.items()}}]


def _medians(frames: Sequence[Spent]) -> dict[tuple[str, str], np.ndarray]:
    """The medians over ``frames`` of what each stage and kernel spent."""
    keys = dict.fromkeys(key for frame in frames for key in frame)
    return {key: np.median([frame.get(key, np.zeros(3)) for frame in frames], axis=0) for key in keys}


def _floors(stream: Stream, pose: np.ndarray, time_s: float) -> dict[tuple[str, str], list[float]]:
    """The floor [ms] of every call of a kernel in the next frame of ``stream``, by stage and kernel."""
    calls: list[tuple[str, float]] = []
    found: dict[tuple[str, str], list[float]] = {}

    def weighed(name: str, kernel: Any) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            result = kernel(*arguments)
            calls.append((name, floor_ms(moved_bytes(arguments, result), multiply_adds(name, arguments))))
            return result

        return call

    def took(stage: str, _: float) -> None:
        for name, least_ms in calls:
            found.setdefault((stage, name), []).append(least_ms)
        calls.clear()

    stream.took = took
    with replaced(weighed):
        stream.pose(pose, time_s)
    return found


def floor_ms(moved: int, operations: int) -> float:
    """Returns the time [ms] to move ``moved`` bytes or to do ``operations`` multiply-adds on one thread, whichever is
    longer.
    """
    moving_s = moved / copied_per_s(moved, 1) if moved else 0.0
    return 1e3 * max(moving_s, operations / multiply_adds_per_s(1) if operations else 0.0)


def _together(rows: Sequence[Row]) -> list[Row]:
    """``rows`` with the small kernels of each stage in one, and the whole stage's rows beside each other, the dearest
    kernel first."""
    found: list[Row] = []
    for stage in dict.fromkeys(row["stage"] for row in rows):
        same = sorted((row for row in rows if row["stage"] == stage), key=lambda row: -row["cpu_ms"])
        small = [row for row in same if row["share"] < LEAST_SHARE and row["kernel"] != PYTHON]
        found += [row for row in same if row not in small]
        if small:
            names = ("calls", "cpu_ms", "wall_ms", "share", "floor_ms")
            found.append(small[0] | {"kernel": OTHERS} | {key: sum(row[key] for row in small) for key in names})
    return found


# --- threads ----------------------------------------------------------------------------------------------------------


def stream_thread_rows(bench: FrameBench, garment: str) -> Iterator[Row]:
    """Frames of two streams, one after the other on one thread, and at once on two."""
    plan = bench.plan([garment])
    for threads in (1, 2):
        took = _driven(bench, [bench.stream(plan) for _ in range(2)], threads)
        yield _threads_row(garment, "two streams", threads, took, 2 * bench.frames)


def _driven(bench: FrameBench, streams: Sequence[Stream], threads: int) -> tuple[float, float]:
    """Wall and processor time [s] of the frames of all ``streams``, each on one of so many ``threads``."""

    def drive(stream: Stream, frames: range) -> None:
        for frame in frames:
            stream.pose(bench.pose(frame), frame / FPS)

    first = range(WARM, WARM + ROUNDS * bench.frames, bench.frames)
    with ThreadPoolExecutor(threads) as pool:

        def together(frames: range) -> tuple[float, float]:
            return _timed(lambda: list(pool.map(partial(drive, frames=frames), streams)))

        together(range(WARM))
        return min(together(range(start, start + bench.frames)) for start in first)


def clip_thread_row(bench: FrameBench, garment: str, threads: int) -> Row:
    """Returns the row of a clip whose network runs on ``threads`` threads."""
    plan, count = bench.plan([garment]), bench.frames
    poses = np.stack([bench.pose(frame) for frame in range(count)])
    clip = PoseInput(
        poses, np.zeros((count, 3)), np.zeros(bench.drapery.body.shape_count), np.arange(count, dtype=float) / FPS
    )

    async def drape() -> None:  # asyncio.run prints what a run gives back, frames too, within the time
        await bench.drapery.drape(plan, clip)

    took = [_timed(lambda: asyncio.run(drape())) for _ in range(1 + ROUNDS)]
    return _threads_row(garment, f"clip of {count}", threads, min(took[1:]), count)  # the first one prepares


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor time [s] of ``work``."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def _threads_row(garment: str, what: str, threads: int, took: tuple[float, float], frames: int) -> Row:
    wall_ms, cpu_ms = (1e3 * spent_s / frames for spent_s in took)
    named = {"kind": "threads", "garment": garment, "what": what, "threads": threads}
    return {**named, "cpu_ms": cpu_ms, "wall_ms": wall_ms, "frames_per_s": 1e3 / wall_ms}


# --- what need not be computed ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class View:
    """A scene of ``garments`` under the options ``full``, and ``what`` is less in it: the options ``less``, or a body
    that does not move as in full. ``pose`` gives the pose of a frame, and ``warm`` frames come before those that count;
    ``moving`` is the pose in full, where that is another."""

    case: str
    what: str
    garments: Sequence[str]
    pose: Callable[[int], np.ndarray]
    full: dict[str, Any]
    less: dict[str, Any]
    warm: int = WARM
    moving: Callable[[int], np.ndarray] | None = None


def frame_views(bench: FrameBench) -> Iterator[View]:
    """Distance, hidden garments, and a body that stands."""
    walk, shirt, far = bench.pose, ["tshirt"], {"pixels_per_m": 50.0}
    yield View("distance", "far away", shirt, walk, {}, far)
    bare = {"motion": 0.0, "advanced": {"push_out": False}}
    yield View("distance", "far away, no motion, no push-out", shirt, walk, {}, far | bare)
    for unfelt, said in (({}, ""), ({"cloth_contact": False}, ", layers do not feel each other")):
        apart = {"advanced": unfelt}
        for hidden in OUTFIT:
            yield View("hidden", f"{hidden}{said}", OUTFIT, walk, apart, apart | {"hidden": (hidden,)})
        alone = {"advanced": unfelt | {"push_out": False}}
        if unfelt:
            yield View("hidden", f"trousers{said}, no push-out", OUTFIT, walk, alone, alone | {"hidden": ("trousers",)})
    stands = lambda _: bench.poses[0]  # noqa: E731
    yield View("still", "stands, before its cloth rests", shirt, stands, {}, {}, moving=walk)
    yield View("still", "stands, its cloth at rest", shirt, stands, {}, {}, REST, moving=walk)


def view_row(bench: FrameBench, view: View) -> Row:
    """Returns the row of a view: the time of a frame with less, beside that of a frame in full."""
    pairs = ((view.full, view.moving or view.pose), (view.less, view.pose))
    streams = [(bench.stream(bench.plan(view.garments, **options)), pose) for options, pose in pairs]
    for part in bench.parts(view.warm):
        for stream, pose in streams:
            for frame in part:
                stream.message(pose(frame), frame / FPS)
    full_ms, cpu_ms = (float(np.median(stream.clock.cpu_ms[view.warm :])) for stream, _ in streams)
    took = {"full_ms": full_ms, "cpu_ms": cpu_ms, "saving": 1.0 - cpu_ms / full_ms}
    return {"kind": "view", "garment": " + ".join(view.garments), "case": view.case, "what": view.what, **took}


@Benchmark(
    "frame",
    "Where the milliseconds of a frame go, and what is saved of them.",
    COLUMNS,
    *inputs(("tshirt", "dress"), quick_garments=("tshirt",)),
    Option("--tiers", ("fast", "balanced", "accurate"), "of the rows by kernel", ("fast",)),
    Option("--frames", 64, "of each stream that count", 24),
)
def main(run: Run) -> None:
    """Measures kernels, threads, and frames that need not compute all, and adds their rows to ``run``."""
    options, body, folder = run.options, load_body(), model_folder(run.options.model)
    poses = at_rate(read_motion(find_motions(options.motions or ["walk"])[0]), FPS).poses

    def bench(threads: int) -> FrameBench:
        settings = Settings(model=str(folder), threads=threads)
        return FrameBench(DrapeRuntime(settings, body=body), poses, options.frames)

    alone, both = bench(1), bench(2)
    for garment in options.garments:
        for tier in options.tiers:
            run.add(kernel_rows(alone, garment, tier))
    for garment in options.garments:
        run.add(stream_thread_rows(alone, garment))
        run.add(clip_thread_row(one, garment, threads) for threads, one in ((1, alone), (2, both)))
    run.add(view_row(alone, view) for view in frame_views(alone))
    for one in (alone, both):
        one.drapery.close()
    run.extra |= {"frames": options.frames, "model": options.model, "gemm_gflops": 2e-9 * multiply_adds_per_s(1)}


if __name__ == "__main__":
    main.command()
