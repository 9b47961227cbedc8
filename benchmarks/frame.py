"""Where the milliseconds of a stream's frame go.

    python -m benchmarks.frame [--quick] [--save]

A walk in jersey with motion, as a stream has it, by stage and function of the engine; ``Python`` is the rest of the
stage, NumPy with it. Times are medians over frames, ``share`` is of the frame. ``floor_ms``: bytes of all
arrays that a function is given at this machine's rate of copying as many, or the multiply-adds of its matrices
at its rate of a large product, whichever takes longer. Kernels below a hundredth of the frame stand together. The row
of the stage ``frame`` is the whole, its ``share`` what the rows add up to; they are of a frame stage by stage.
``bare_ms`` is a stream beside it as it is served: in one call a frame, where the engine has all of its stages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
from drape.stages.plan import Plan
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

FABRIC = "jersey"
WARM, PART = 12, 6  # frames before the first that counts; frames of one stream before those of the one beside it
OTHERS, LEAST_SHARE = "others", 0.01
COLUMNS = {
    "garment": "s", "tier": "s", "stage": "s", "kernel": "s", "calls": ".0f", "cpu_ms": ".3f", "wall_ms": ".3f",
    "share": ".3f", "floor_ms": ".4f", "bare_ms": ".3f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class FrameBench:
    """What all streams share: the runtime, the ``poses`` (F, 24, 3) [rad] of a walk, and how many ``frames`` of each
    are measured."""

    drapery: DrapeRuntime
    poses: np.ndarray
    frames: int

    def plan(self, garment: str, tier: str) -> Plan:
        """Returns the plan of a stream of ``garment`` in jersey and ``tier``, with all constants computed."""
        options = DrapeOptions.model_validate({"fabric": FABRIC, "tier": tier})
        plan = self.drapery.plan(self.drapery.garments.get(garment), options, messages=True)
        self.drapery.add_missing(plan)
        return plan

    def stream(self, plan: Plan, **options: Any) -> Stream:
        """Returns a new stream that drapes by ``plan``, with ``options`` of ``Stream``."""
        return Stream(plan, self.drapery.body.shape_count, **options)

    def pose(self, frame: int) -> np.ndarray:
        """Returns the pose (24, 3) [rad] of frame number ``frame``; the walk is played forwards and backwards."""
        turn = frame % (2 * len(self.poses) - 2)
        return self.poses[turn if turn < len(self.poses) else 2 * len(self.poses) - 2 - turn]

    def parts(self) -> Iterator[range]:
        """Returns the numbers of a stream's frames in ranges of ``PART``; the first ``WARM`` are not measured."""
        last = WARM + self.frames
        return (range(first, min(last, first + PART)) for first in range(0, last, PART))


def kernel_rows(bench: FrameBench, garment: str, tier: str) -> list[Row]:
    """Returns the rows of a stream of ``garment`` in ``tier``: one for each kernel of each stage, and one for the whole
    frame (the module says what their columns are)."""
    plan, trace = bench.plan(garment, tier), Trace()
    bare, traced = bench.stream(plan), bench.stream(plan, took=trace.took, staged=True)
    for part in bench.parts():
        for frame in part:
            bare.pose(bench.pose(frame), frame / FPS)
        with replaced(trace.timed):
            for frame in part:
                trace.begin()
                traced.pose(bench.pose(frame), frame / FPS)
    end = WARM + bench.frames
    floors = _floors(traced, bench.pose(end), end / FPS)
    spent = _medians(trace.frames()[WARM:])
    whole = np.sum(list(spent.values()), axis=0)
    named = {"kind": "kernel", "garment": garment, "tier": tier}
    rows = [
        {
            **named, "stage": stage, "kernel": kernel, "calls": calls, "cpu_ms": cpu, "wall_ms": wall,
            "share": cpu / whole[1], "floor_ms": sum(times) if (times := floors.get((stage, kernel))) else None,
        }
        for (stage, kernel), (calls, cpu, wall) in spent.items()
    ]  # fmt: skip
    took = {"cpu_ms": np.median(traced.clock.cpu_ms[WARM:]), "wall_ms": np.median(traced.clock.wall_ms[WARM:])}
    took |= {"bare_ms": np.median(bare.clock.cpu_ms[WARM:]), "share": whole[1] / took["cpu_ms"]}
    took |= {"floor_ms": sum(sum(times) for times in floors.values())}
    return [*_together(rows), {**named, "stage": "frame", "kernel": "", **{key: float(v) for key, v in took.items()}}]


def _medians(frames: Sequence[Spent]) -> dict[tuple[str, str], np.ndarray]:
    """The medians over ``frames`` of what each stage and kernel spent."""
    keys = dict.fromkeys(key for frame in frames for key in frame)
    return {key: np.median([frame.get(key, np.zeros(3)) for frame in frames], axis=0) for key in keys}


def _floors(stream: Stream, pose: np.ndarray, time_s: float) -> dict[tuple[str, str], list[float]]:
    """The floor [ms] of every call of a kernel in the next frame of ``stream``, by stage and kernel."""
    calls: list[tuple[str, float]] = []
    floors: dict[tuple[str, str], list[float]] = {}

    def weighed(name: str, kernel: Any) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            result = kernel(*arguments)
            calls.append((name, floor_ms(moved_bytes(arguments, result), multiply_adds(name, arguments))))
            return result

        return call

    def took(stage: str, _: float) -> None:
        for name, least_ms in calls:
            floors.setdefault((stage, name), []).append(least_ms)
        calls.clear()

    stream.took = took
    with replaced(weighed):
        stream.pose(pose, time_s)
    return floors


def floor_ms(moved: int, operations: int) -> float:
    """Returns the time [ms] in which one thread moves ``moved`` bytes, or that in which it does ``operations``
    multiply-adds, whichever is longer."""
    moving_s = moved / copied_per_s(moved) if moved else 0.0
    return 1e3 * max(moving_s, operations / multiply_adds_per_s() if operations else 0.0)


def _together(rows: Sequence[Row]) -> list[Row]:
    """``rows`` with the small kernels of each stage in one, and the whole stage's rows beside each other, the dearest
    kernel first."""
    merged: list[Row] = []
    for stage in dict.fromkeys(row["stage"] for row in rows):
        same = sorted((row for row in rows if row["stage"] == stage), key=lambda row: -row["cpu_ms"])
        small = [row for row in same if row["share"] < LEAST_SHARE and row["kernel"] != PYTHON]
        merged += [row for row in same if row not in small]
        if small:
            names = ("calls", "cpu_ms", "wall_ms", "share", "floor_ms")
            merged.append(small[0] | {"kernel": OTHERS} | {key: sum(row[key] for row in small) for key in names})
    return merged


@Benchmark(
    "frame",
    "Where the milliseconds of a frame go.",
    COLUMNS,
    *inputs(("tshirt", "dress"), quick_garments=("tshirt",)),
    Option("--tiers", ("fast", "balanced", "accurate"), "that are measured", ("fast",)),
    Option("--frames", 64, "of each stream that count", 24),
)
def main(run: Run) -> None:
    """Adds to ``run`` the rows of every garment in every tier, and to its record the frames, the model and the rate of
    a matrix product [GFLOP/s]."""
    options, folder = run.options, model_folder(run.options.model)
    poses = at_rate(read_motion(find_motions(options.motions or ["walk"])[0]), FPS).poses
    drapery = DrapeRuntime(Settings(model=str(folder), threads=1), body=load_body())
    bench = FrameBench(drapery, poses, options.frames)
    for garment in options.garments:
        for tier in options.tiers:
            run.add(kernel_rows(bench, garment, tier))
    drapery.close()
    run.extra |= {"frames": options.frames, "model": options.model, "gemm_gflops": 2e-9 * multiply_adds_per_s()}


if __name__ == "__main__":
    main.command()
