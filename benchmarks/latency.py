"""Latency and throughput of the packed graph, beside skinning and the floor in the same run.

    python -m benchmarks.latency [--quick] [--threads 2] [--provider cuda [--half]] [--model FOLDER] [--save]

A row's times are those of one call: pose in, vertices of ``batch`` frames out, without push-out. ``push_out_ms`` comes
on top; rows "onnx_pushed" are both in one, with all passes of the network and with fewer.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.clock import Timing, timed
from benchmarks.harness import Benchmark, Option, Run
from benchmarks.speed import floor
from benchmarks.speed.skinning_push import SkinningPush
from benchmarks.tables import Row
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.graph.feeds import garment_feed
from drape.graph.packing import PackedBody, pack_body
from drape.inference.engine import Engine
from drape.inference.onnx_runtime import PROVIDER_NAMES, Device
from drape.inference.packing import Packer, ScenePlan
from drape.motion.samples import SAMPLES
from drape.stages.collision import Pusher
from training.exported import load_exported
from training.model import OneFit

COLUMNS = {
    "name": "s", "garment": "s", "vertices": "d", "patches": "d", "batch": "d", "min_ms": ".3f",
    "p50_ms": ".3f", "p95_ms": ".3f", "p99_ms": ".3f", "frames_per_s": ".0f", "push_out_ms": ".2f",
}  # fmt: skip
SINGLE = ("tshirt", "dress")
BATCHES = (1, 2, 4, 8, 16, 32, 64, 128, 256)


@dataclass(frozen=True)
class Bench:
    """The engines, model and body that all measurements share."""

    engine: Engine
    model: OneFit
    body: BodyModel
    shape: PackedBody
    seconds: float
    threads: int

    def packer(self, garments: dict[str, Garment]) -> Packer:
        """A packer with ``garments`` in store."""
        packer = Packer(self.engine, self.body)
        for key, garment in garments.items():
            packer.add(key, garment)
        return packer

    def clock(self, packer: Packer, keys: Sequence[str], plan: ScenePlan) -> Timing:
        """Time of draping one frame of each of ``keys``, every one on a body of its own; poses change every call."""
        every = np.resize(poses(64), (64 + len(keys), 24, 3))
        items = [(key, row) for row, key in enumerate(keys)]
        turn = iter(range(sys.maxsize))

        def call() -> None:
            start = next(turn) % 64
            packer.run(plan, self.shape.rows(every[start : start + len(keys)]), items)

        return timed(call, seconds=self.seconds)


def single_rows(bench: Bench, name: str) -> list[Row]:
    """One frame of one garment: ours by plan, skinning with a push, and the floor."""
    garment = shipped(name)
    packer = bench.packer({name: garment})
    size = {"garment": name, "vertices": garment.vertex_count, "patches": garment.patch_count, "batch": 1}
    pose = poses(5)[2:3]
    skinning = SkinningPush(garment, bench.body)
    rows: list[Row] = [
        {"name": "onnx", **bench.clock(packer, [name], ScenePlan()).row()},
        *pushed_rows(bench, packer, name, garment),
    ]
    rows[0]["push_out_ms"] = rows[1]["push_out_ms"]
    rows.append({"name": "onnx_jets", **bench.clock(packer, [name], ScenePlan("jets")).row()})
    skin = timed(lambda: skinning.skin(pose), seconds=bench.seconds)
    both = timed(lambda: skinning.push(skinning.skin(pose), pose), seconds=bench.seconds)
    rows.append({"name": "skinning_push", **both.row(), "push_out_ms": both.p50_ms - skin.p50_ms})
    rows.append(floor.floor_row(bench.model, packer.store.packed(name), threads=bench.threads))
    for row in rows:
        row.setdefault("frames_per_s", 1e3 / row["p50_ms"] if "p50_ms" in row else None)
    return [row | size for row in rows]


def pushed_rows(bench: Bench, packer: Packer, key: str, garment: Garment) -> list[Row]:
    """One frame with its push-out, by passes of the network: all, then fewer; ``push_out_ms`` the push-out's part."""
    push, rows = pushing(bench, key, garment), []
    for passes in (None, *reversed(range(bench.engine.pass_count))):
        drape = draping(bench, packer, key, passes)
        draped = drape()
        both = timed(lambda drape=drape: push(*drape()), seconds=bench.seconds)
        alone = timed(lambda draped=draped: push(*draped), seconds=bench.seconds / 2)
        count = bench.engine.pass_count if passes is None else passes
        rows.append({"name": "onnx_pushed", "passes": count, **both.row(), "push_out_ms": alone.p50_ms})
    return rows


Draped = tuple[np.ndarray, np.ndarray]  # vertices, posed skin


def draping(bench: Bench, packer: Packer, key: str, passes: int | None) -> Callable[[], Draped]:
    """Drapes ``key`` in another pose with every call, with so many passes of the network, None for all."""
    plan, every, turn = ScenePlan(skin=True, passes=passes), poses(64), iter(range(sys.maxsize))

    def drape() -> Draped:
        row = next(turn) % 64
        found = packer.run(plan, bench.shape.rows(every[row : row + 1]), [(key, 0)])[0].arrays
        return found["vertices"][None], found["skin"][None]

    return drape


def pushing(bench: Bench, key: str, garment: Garment) -> Callable[..., None]:
    """Pushes what ``draping`` gives out of the body."""
    pusher = Pusher(bench.engine, bench.body)
    pusher.add(key, garment_feed(garment), garment.vertices[: garment.vertex_count], garment.faces)

    def push(vertices: np.ndarray, skin: np.ndarray) -> None:
        pusher.push([key], vertices, skin)

    return push


def batch_rows(bench: Bench, batches: Sequence[int]) -> list[Row]:
    """Frames of all shipped garments in turn, every one of another client."""
    garments = {name: shipped(name) for name in shipped_names()}
    packer, rows = bench.packer(garments), []
    for batch in batches:
        keys = [list(garments)[i % len(garments)] for i in range(batch)]
        timing = bench.clock(packer, keys, ScenePlan())
        size = {
            "vertices": sum(garments[key].vertex_count for key in keys),
            "patches": sum(garments[key].patch_count for key in keys),
            "frames_per_s": 1e3 * batch / timing.p50_ms,
        }
        rows.append({"name": "onnx", "garment": "mixed", "batch": batch, **timing.row(), **size})
    return rows


def network_of(folder: Path) -> OneFit:
    """The network in torch whose graphs are in the model ``folder``."""
    weights, config, _ = load_exported(folder)
    model = OneFit(config).eval()
    model.load_state_dict(weights)
    return model


def shipped(name: str) -> Garment:
    """The shipped garment called ``name``."""
    return load_garment(next(iter(sorted(GARMENTS_DIR.glob(f"{name}-*.npz")))))


def shipped_names() -> list[str]:
    """Names of all shipped garments."""
    return sorted({path.name.rsplit("-", 1)[0] for path in GARMENTS_DIR.glob("*.npz")})


def poses(count: int) -> np.ndarray:
    """Poses (count, 24, 3) [rad], spread over the sample clips."""
    clips = [make().poses for make in SAMPLES.values()]
    every = np.concatenate(clips)
    return every[np.linspace(0, len(every) - 1, count).astype(int)]


@Benchmark(
    "latency",
    "Latency and throughput.",
    COLUMNS,
    Option("--model", MODELS_DIR / "onefit", "a model folder", kind=Path),
    Option("--provider", "cpu", "what graphs run on", choices=list(PROVIDER_NAMES)),
    Option("--half", False, "the network's matrices in float16"),
)
def main(run: Run) -> None:
    """Rows of single frames and of batches."""
    options, body, load = run.options, load_body(), os.getloadavg()[0]
    device = Device(options.provider, options.threads)
    engine = Engine(options.model, device=device, half=options.half)
    seconds, model = 0.3 if options.quick else 3.0, network_of(options.model)
    bench = Bench(engine, model, body, pack_body(body), seconds, options.threads)
    run.rows = [row for name in SINGLE for row in single_rows(bench, name)]
    run.rows += batch_rows(bench, BATCHES[:4:3] if options.quick else BATCHES)
    if load > 0.5:
        run.notes.append(f"the machine was busy: load {load:.1f} when this began; such times are provisional")
    graph = "packed" if engine.compiled is None else "compiled"
    run.extra |= {"device": options.provider, "provider": engine.provider, "load_before": load}
    run.extra |= {"model": options.model.name, "graph": graph, "half": options.half}


if __name__ == "__main__":
    main.command()
