"""Latency and throughput of the packed graph, beside its rivals in the same run, and how cost grows.

A row's times are those of one call: pose in, vertices of ``batch`` frames out, without push-out; ``push_out_ms``
comes on top, and rows "onnx_pushed" are both in one, with all passes of the network and with fewer. Rows with a vertex,
patch or garment count that no shipped garment has measure growth. A rival that could not run here says why under
``skipped``; Newton needs an interpreter that has it.

    python -m benchmarks.latency [--quick] [--threads 2] [--model FOLDER] [--newton PYTHON] [--save]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.shared import common
from benchmarks.speed import rivals as latency_rivals
from benchmarks.speed.setup import (
    WARM_CALLS,
    Timing,
    network_of,
    poses,
    shipped,
    shipped_names,
    timed,
    with_patches,
    with_vertices,
)
from drape.artifacts import MODELS_DIR
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.errors import ended
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.graph.packing import PackedBody, pack_body
from drape.graph.push_feed import SkinShapes
from service.graphs.engine import Engine
from service.graphs.graph_names import JETS, PACKED
from service.graphs.onnx_runtime import PROVIDER_NAMES, Device
from service.graphs.packing import SHAPE_INDEX, STORED_INDEX, Packer, ScenePlan
from service.graphs.push import Pusher
from training.model import OneFit

COLUMNS = {
    "name": "s", "garment": "s", "vertices": "d", "patches": "d", "batch": "d", "min_ms": ".3f",
    "p50_ms": ".3f", "p95_ms": ".3f", "p99_ms": ".3f", "frames_per_s": ".0f", "push_out_ms": ".2f", "stages": "s",
    "skipped": "s",
}  # fmt: skip
SINGLE = ("tshirt", "dress")
BATCHES = (1, 2, 4, 8, 16, 32, 64, 128, 256)
VERTICES = (1000, 5000, 20000, 80000)
PATCHES = (100, 200, 300, 400)
GARMENTS = (1, 4, 16, 64)


@dataclass(frozen=True)
class Bench:
    """What all measurements share."""

    engine: Engine
    halved: Engine
    keeping: Engine  # subnormal numbers
    model: OneFit
    body: BodyModel
    shape: PackedBody
    seconds: float
    threads: int

    def packer(self, garments: dict[str, Garment], *, half: bool = False) -> Packer:
        """A packer with ``garments`` in store, of the network in float16 where ``half`` is asked for."""
        packer = Packer(self.halved if half else self.engine, self.body)
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


def single_rows(bench: Bench, name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """One frame of one garment: ours by plan, with its stages, and every rival."""
    garment = shipped(name)
    packer = bench.packer({name: garment})
    size = {"garment": name, "vertices": garment.vertex_count, "patches": garment.patch_count, "batch": 1}
    pose = poses(5)[2:3]
    skinning = latency_rivals.SkinningPush(garment, bench.body)
    whole = bench.clock(packer, [name], ScenePlan())
    rows: list[dict[str, Any]] = [
        {"name": "onnx", **whole.row(), "stage_ms": stages(bench, packer, name, pose, whole)},
        *pushed_rows(bench, packer, name, garment),
        subnormal_row(bench, name, garment),
    ]
    rows[0]["push_out_ms"] = rows[1]["push_out_ms"]
    rows.append({"name": "onnx_jets", **bench.clock(packer, [name], ScenePlan("jets")).row()})
    if bench.halved.half:
        by_half = bench.packer({name: garment}, half=True)
        rows.append({"name": "onnx_fp16", **bench.clock(by_half, [name], ScenePlan()).row()})
    rows += latency_rivals.torch_rows(
        bench.model, garment, bench.body, pose, seconds=bench.seconds, compiled=not options.quick
    )
    skin = timed(lambda: skinning.skin(pose), seconds=bench.seconds)
    both = timed(lambda: skinning.push(skinning.skin(pose), pose), seconds=bench.seconds)
    rows.append({"name": "skinning_push", **both.row(), "push_out_ms": both.p50_ms - skin.p50_ms})
    rows.append(latency_rivals.floor_row(bench.model, packer.store.packed(name), threads=bench.threads))
    if name == SINGLE[0]:
        draped = packer.run(ScenePlan(), bench.shape.rows(pose), [(name, 0)])[0].arrays["vertices"]
        rows.append(
            {"name": "newton_vbd", "skipped": "quick form"}
            if options.quick
            else latency_rivals.newton_row(options.newton, garment, bench.body, pose, draped)
        )
    for row in rows:
        row.setdefault("frames_per_s", 1e3 / row["p50_ms"] if "p50_ms" in row else None)
    return [row | size for row in rows]


def pushed_rows(bench: Bench, packer: Packer, key: str, garment: Garment) -> list[dict[str, Any]]:
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


def subnormal_row(bench: Bench, key: str, garment: Garment) -> dict[str, Any]:
    """The first of ``pushed_rows`` with subnormal numbers kept, call by call in turn with them taken as zero.

    ``ratio``: how many times as long the median of the packed graph, of the push-out and of both then is.
    """
    sides = [replace(bench, engine=engine) for engine in (bench.engine, bench.keeping)]
    calls = [(draping(one, one.packer({key: garment}), key, None), pushing(one, key, garment)) for one in sides]
    taken: list[list[tuple[float, float]]] = []
    end = time.perf_counter() + 2.0 * bench.seconds
    while len(taken) < 10 + WARM_CALLS or time.perf_counter() < end:
        row = []
        for drape, push in calls:
            start = time.perf_counter()
            draped = drape()
            between = time.perf_counter()
            push(*draped)
            row.append((between - start, time.perf_counter() - between))
        taken.append(row)
    times = 1e3 * np.array(taken[WARM_CALLS:])  # (calls, 2 sides, 2 stages)
    whole = times.sum(axis=2)
    flushed, kept = np.median(np.concatenate([times, whole[:, :, None]], axis=2), axis=0)
    ratio = dict(zip(("packed", "push_out", "both"), (kept / flushed).tolist(), strict=True))
    row = Timing.of(whole[:, 1].tolist()).row()
    return {"name": "onnx_subnormals", **row, "push_out_ms": float(kept[1]), "ratio": ratio}


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


def stages(bench: Bench, packer: Packer, key: str, pose: np.ndarray, whole: Timing) -> dict[str, float]:
    """Milliseconds of one frame by stage, as differences of graphs that end after each."""
    rows = bench.shape.rows(pose)
    feed = rows | packer.store.packed(key).stored
    packer.run(ScenePlan(), rows, [(key, 0)])
    feed |= packer._composed(((key, 0),), alone=True)[0].arrays
    if bench.engine.feels_body:
        feed |= SkinShapes(bench.body).feed(rows["betas"])
    feed |= at_rest(bench.engine)
    done, last = {"pose": timed(lambda: bench.shape.rows(pose), seconds=bench.seconds / 4).p50_ms}, 0.0
    for stage, outputs in {"patches": JETS, "vertices": ("vertices",)}.items():
        session = bench.engine.open_cut(PACKED, outputs, direct=(*STORED_INDEX, *SHAPE_INDEX))
        values = {name: bench.engine.value(np.ascontiguousarray(feed[name])) for name in session.inputs}

        def call(session=session, outputs=outputs, values=values) -> None:
            session.run(outputs, values)

        now = timed(call, seconds=bench.seconds).p50_ms
        done[stage], last = now - last, now
    return done | {"packing": whole.p50_ms - sum(done.values())}


def at_rest(engine: Engine) -> dict[str, np.ndarray]:
    """The code of one body that does not move, of a dynamic model."""
    return {"dynamic_code": np.zeros((1, engine.code_size), np.float32)} if engine.dynamic else {}


def batch_rows(bench: Bench, batches: Sequence[int]) -> list[dict[str, Any]]:
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


def growth_rows(bench: Bench, *, quick: bool) -> list[dict[str, Any]]:
    """One T-shirt with more vertices, with more patches, and with more garments in store and in the call."""
    shirt, rows = shipped("tshirt"), []
    variants = [(f"vertices {count}", with_vertices(shirt, count)) for count in (VERTICES[1:2] if quick else VERTICES)]
    variants += [(f"patches {count}", with_patches(shirt, count)) for count in (() if quick else PATCHES)]
    for label, garment in variants:
        packer = bench.packer({label: garment})
        timing = bench.clock(packer, [label], ScenePlan())
        size = {"vertices": garment.vertex_count, "patches": garment.patch_count, "store_bytes": packer.store.bytes}
        rows.append({"name": "onnx", "garment": f"tshirt, {label}", "batch": 1, **size, **timing.row()})
    five = with_vertices(shirt, 5000)
    for count in GARMENTS[:2] if quick else GARMENTS:
        keys = [f"garment {i}" for i in range(count)]
        packer = bench.packer({key: replace(five, name=key) for key in keys})
        size = {"vertices": five.vertex_count * count, "patches": five.patch_count * count}
        for label, chosen in ((f"1 of {count} in store", keys[:1]), (f"all {count} in store", keys)):
            timing = bench.clock(packer, chosen, ScenePlan())
            extra = {"batch": len(chosen), "store_bytes": packer.store.bytes}
            rows.append({"name": "onnx", "garment": label, **size, **extra, **timing.row()})
    for row in rows:
        row["frames_per_s"] = 1e3 * row["batch"] / row["p50_ms"]
    return rows


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description="Latency and throughput.")
    parser.add_argument("--model", type=Path, default=MODELS_DIR / "onefit", help="a model folder; default the shipped")
    parser.add_argument("--newton", help="an interpreter that has the package newton")
    parser.add_argument("--provider", choices=list(PROVIDER_NAMES), default="cpu")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    load = os.getloadavg()[0]
    device, body = Device(options.provider, options.threads), load_body()
    engine, halved = (Engine(options.model, device=device, half=half) for half in (False, True))
    keeping = Engine(options.model, device=replace(device, keep_subnormals=True))
    seconds = 0.3 if options.quick else 3.0
    bench = Bench(engine, halved, keeping, network_of(options.model), body, pack_body(body), seconds, options.threads)
    rows = [row for name in SINGLE for row in single_rows(bench, name, options)]
    rows += batch_rows(bench, BATCHES[:4:3] if options.quick else BATCHES)
    rows += growth_rows(bench, quick=options.quick)
    shown = [row | {"stages": _stages_text(row.get("stage_ms"))} for row in rows]
    common.print_table(shown, COLUMNS)
    if load > 0.5:
        print(f"the machine was busy: load {load:.1f} when this began; such times are provisional")
    return common.finish(
        "latency", rows, options, device=options.provider, provider=engine.provider, load_before=load,
        model=options.model.name, graph="packed_int8" if engine.int8 else "packed",
    )  # fmt: skip


def _stages_text(stage_ms: dict[str, float] | None) -> str | None:
    return None if stage_ms is None else " ".join(f"{name} {ms:.2f}" for name, ms in stage_ms.items())


if __name__ == "__main__":
    sys.exit(ended(main))
