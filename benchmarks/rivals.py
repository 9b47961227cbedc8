"""A frame of every tier beside what others do: skinning with a push-out, and skinning alone, the floor of a frame.

    python -m benchmarks.rivals [--garments tshirt dress trousers] [--save]

Frames are of a walk in jersey with motion, as a stream computes them, on one thread; everything takes turns in one
run. ``skinning and push``: linear blend skinning by a sparse matrix, and SciPy's nearest vertex of the body.
``skinning``: the delivered vertices by four bones each, in the engine's language, in float32. ``over_rival`` and
``over_floor``: medians of processor time over theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.clock import Clock
from benchmarks.frame import WARM, Bench
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.scenes import FPS, at_rate
from benchmarks.speed.skinning_push import SkinningPush
from benchmarks.tables import Row
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.catalog import find_motions
from drape.engine.calls import call
from drape.garment.cache import Garment
from drape.motion.readers import read_motion
from drape.stages.tiers import NAMES
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

RIVAL, FLOOR = "skinning and push", "skinning"
COLUMNS = {
    "garment": "s", "what": "s", "vertices": "d", "cpu_ms": ".3f", "over_rival": ".3f", "over_floor": ".1f",
}  # fmt: skip


class FourBones:
    """Linear blend skinning of a ``garment`` on the mean shape by the four heaviest bones of each vertex."""

    def __init__(self, garment: Garment, bench: Bench) -> None:
        self._body, count = bench.drapery.body, garment.vertex_count
        weights = garment.skin_weights(self._body)[:count]
        self._bone = np.ascontiguousarray(np.argsort(-weights, axis=1)[:, :4].astype(np.int32))
        heaviest = np.take_along_axis(weights, self._bone.astype(np.int64), axis=1)
        self._weight = np.ascontiguousarray((heaviest / heaviest.sum(axis=1, keepdims=True)).astype(np.float32))
        self._rest, self._moved = np.ascontiguousarray(garment.vertices[:count], np.float32), np.empty((count, 3), "f4")

    def bones(self, pose: np.ndarray) -> np.ndarray:
        """The matrices [A t] (24, 3, 4) of ``pose`` (24, 3), which are no part of the floor."""
        rotations, translations = self._body.bones(pose[None])
        return np.ascontiguousarray(np.concatenate([rotations[0], translations[0][..., None]], axis=-1), np.float32)

    def skin(self, bones: np.ndarray) -> np.ndarray:
        """The vertices [m] (V, 3) moved by ``bones``."""
        call("law_skin", np.float32, self._rest, self._weight, self._bone, bones, len(self._rest), self._moved)
        return self._moved


def rows_of(bench: Bench, name: str) -> Iterator[Row]:
    """A row of each tier of the garment ``name``, of the rival, and of the floor."""
    garment = bench.drapery.garments.get(name).garment
    rival, floor = SkinningPush(garment, bench.drapery.body), FourBones(garment, bench)
    streams = {tier: bench.stream(bench.plan([name], tier=tier)) for tier in NAMES}
    clocks = {RIVAL: Clock(), FLOOR: Clock()}
    for part in bench.parts():
        for stream in streams.values():
            for frame in part:
                stream.pose(bench.pose(frame), frame / FPS)
        for what, work in ((RIVAL, _pushed(rival)), (FLOOR, floor.skin)):
            for frame in part:
                given = floor.bones(bench.pose(frame)) if what == FLOOR else bench.pose(frame)[None]
                with clocks[what]:
                    work(given)
    clocks = {tier: stream.clock for tier, stream in streams.items()} | clocks
    took = {what: float(np.median(clock.cpu_ms[WARM:])) for what, clock in clocks.items()}
    for what, cpu_ms in took.items():
        ratios = {"over_rival": cpu_ms / took[RIVAL], "over_floor": cpu_ms / took[FLOOR]}
        yield {"garment": name, "what": what, "vertices": garment.vertex_count, "cpu_ms": cpu_ms, **ratios}


def _pushed(rival: SkinningPush) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pose: rival.push(rival.skin(pose), pose)


@Benchmark(
    "rivals",
    "A frame of every tier beside skinning.",
    COLUMNS,
    *inputs(("tshirt", "dress", "trousers"), quick_garments=("tshirt",)),
    Option("--frames", 96, "of each that count", 12),
)
def main(run: Run) -> None:
    """Rows of each garment."""
    options, body, folder = run.options, load_body(), model_folder(run.options.model)
    poses = at_rate(read_motion(find_motions(options.motions or ["walk"])[0]), FPS).poses
    drapery = DrapeRuntime(Settings(models_dir=folder.parent, model=folder.name, threads=1), body=body)
    for name in options.garments:
        run.add(rows_of(Bench(drapery, poses, options.frames), name))
    drapery.close()
    run.extra |= {"frames": options.frames, "model": options.model}


if __name__ == "__main__":
    main.command()
