"""What the knobs beside the tiers trade: precision, patches, the mesh that is sent, its coordinates, the rate.

    python -m benchmarks.other_knobs
    python -m benchmarks.other_knobs --garments $DRAPE_DATA/garments/female_tshirt.obj --save
    python -m benchmarks.other_knobs --garments tshirt --quick

Each way differs from what is served (``balanced``, as a stream's message) in one knob. All drape the same clips, frame
by frame in turn, at rest (motion 0), and are measured as ``benchmarks.tradeoff`` measures, after their message was
unpacked. ``kbytes`` are those of a second of stream. Of a lower rate every ``every``-th frame is draped, and those
between are drawn by a client on the line between two; ``ms`` is then a shown frame's share. Where the garment is a mesh
file, it is taken in again with three quarters and with twice its patches. What is sent as delivered hangs in the finer
mesh: only its way from physics is told.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from benchmarks.folds import Clip
from benchmarks.shared import common
from benchmarks.shared.network import Network
from benchmarks.tradeoff import FPS, FRAMES, PASSES, QUICK_FRAMES, Case, Runner, times
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.fabric_table import fabric
from drape.errors import ended
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.garment.intake import IntakeOptions, intake
from drape.wire.messages import unpack_frame
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import Drapery
from service.settings import Settings
from service.stages.batch import Batch

Precision = Literal["int8", "float32", "float16"]
FABRIC = "jersey"
COLUMNS = {
    "garment": "s", "clip": "s", "way": "s", "ms": ".2f", "cost": ".2f", "kbytes": ".0f", "gain": ".3f",
    "error_mm": ".2f", "edge_pct": ".2f", "detail_share": ".2f", "jitter_ratio": ".2f", "skin_pixels_pct": ".3f",
    "self_intersections": ".0f",
}  # fmt: skip


@dataclass(frozen=True)
class Way:
    """One knob turned: ``name`` says which. ``patches``: over the usual number; ``every``: of how many frames one is
    draped; ``options``: of the request."""

    name: str
    precision: Precision = "int8"
    patches: float = 1.0
    every: int = 1
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def delivered(self) -> bool:
        return self.options.get("resolution") == "delivered"


WAYS = (
    Way("as served: int8, 16 bits, 30 a second"),
    Way("network in float32", precision="float32"),
    Way("network with weights of 16 bits", precision="float16"),
    Way("coordinates of 8 bits", options={"bits": 8}),
    Way("15 a second, lines between", every=2),
    Way("7.5 a second, lines between", every=4),
    Way("three quarters of the patches", patches=0.75),
    Way("twice the patches", patches=2.0),
    Way("sent as delivered", options={"resolution": "delivered"}),
)


@dataclass(eq=False)
class Streamed(Runner):
    """A runner whose frames are what a client unpacks; ``bytes`` of all messages so far."""

    bytes: int = 0

    def step(self, frame: int) -> Batch:
        batch = super().step(frame)
        (message,) = batch.messages
        self.bytes += len(message)
        self.vertices[frame] = unpack_frame(message).vertices()
        return batch


def between(vertices: np.ndarray, draped: np.ndarray) -> np.ndarray:
    """``vertices`` (F, V, 3) whose rows ``draped`` (n,), the first and the last among them, are kept, and the others on
    the line between two of these."""
    frames = np.arange(len(vertices))
    right = np.clip(np.searchsorted(draped, frames, side="left"), 1, None)
    before, after = draped[right - 1], draped[right]
    share = ((frames - before) / (after - before))[:, None, None]
    return ((1.0 - share) * vertices[before] + share * vertices[after]).astype(vertices.dtype)


def draped_frames(count: int, every: int) -> np.ndarray:
    """Every ``every``-th of ``count`` frames, and the last."""
    return np.union1d(np.arange(0, count, every), [count - 1])


def measure(
    case: Case, garments: dict[float, Garment], draperies: dict[Precision, Drapery], ways: Sequence[Way] = WAYS
) -> list[dict[str, Any]]:
    """A row for each of ``ways`` that there is: of patches where ``garments``, by their number over the usual one, have
    them, and as delivered where that mesh is another than the ``case``'s."""
    clip = case.referee.clip
    found = []
    for way in ways:
        garment = garments.get(way.patches)
        if garment is None or (way.delivered and garment.vertex_count == len(garment.vertices)):
            continue
        drapery = draperies[way.precision]
        worn = garment if way.delivered else fine_garment(garment)
        asked = DrapeOptions(tier="balanced", motion=0.0, fabric=case.fabric.name, **way.options)
        plan = drapery.plan(drapery.garments.add(worn, "user"), asked, messages=True)
        drapery.take_in(plan)
        kept = draped_frames(len(clip.poses), way.every)
        slower = replace(clip, fps=clip.fps / way.every, poses=clip.poses[kept])
        found.append((way, kept, Streamed.of(plan, slower, drapery.body.shape_count)))
    for frame in range(len(clip.poses)):
        for _, kept, runner in found:
            if frame < len(kept):
                runner.step(frame)
    served: dict[str, Any] = {}
    rows = []
    for way, kept, runner in found:
        vertices = np.empty((len(clip.poses), *runner.vertices.shape[1:]), np.float32)
        vertices[kept] = runner.vertices
        vertices = between(vertices, kept)
        cost = {
            "ms": times(runner.wall_ms, runner.cpu_ms)["cpu_ms"] / way.every,
            "kbytes": 1e-3 * clip.fps * runner.bytes / len(kept) / way.every,
        }
        served = served or {"start": vertices, **cost}
        named = {"garment": case.garment.name, "fabric": case.fabric.name, "clip": clip.name, "way": way.name}
        if way.delivered:
            seen, least = vertices[clip.measured], case.least.vertices[:, : vertices.shape[1]]
            figures: dict[str, Any] = {"error_mm": 1e3 * float(np.linalg.norm(seen - least, axis=-1).mean())}
        else:
            figures = case.row(vertices, served["start"])
        rows.append({**figures, **named, **cost, "cost": cost["ms"] / served["ms"]})
    return rows


def with_patches(path: Path, body: BodyModel, ways: Sequence[Way] = WAYS) -> dict[float, Garment]:
    """The garment at ``path`` by its number of patches over the usual one: of a cached one as it is alone."""
    usual = {1.0: open_garment(path, body)}
    if path.suffix == ".npz":
        return usual
    more = {way.patches for way in ways} - {1.0}
    return usual | {share: intake(path, body=body, options=IntakeOptions(patches=share)) for share in sorted(more)}


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.other_knobs", description="What the knobs beside the tiers trade."
    )
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, help=f"of a clip at most (default {FRAMES}, quick {QUICK_FRAMES})")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or (["tshirt"] if options.quick else ["tshirt", "dress"])
    options.motions = options.motions or (["walk"] if options.quick else ["walk", "squat"])
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the tables and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body, folder = load_body(), model_folder(options.model)
    base = Settings(models_dir=folder.parent, model=folder.name, threads=options.threads)
    settings: dict[Precision, Settings] = {
        "int8": base,
        "float32": base.model_copy(update={"int8": False}),
        "float16": base.model_copy(update={"half": True}),
    }
    draperies: dict[Precision, Drapery] = {name: Drapery(one, body=body) for name, one in settings.items()}
    networks = {
        f"network_{'all' if passes is None else passes}": Network(folder, body, threads=options.threads, passes=passes)
        for passes in PASSES
    }
    worn = [with_patches(path, body) for path in find_garments(options.garments)]
    rows: list[dict[str, Any]] = []
    for path in find_motions(options.motions):
        clip = Clip.read(path, FPS, options.frames, body)
        for garments in worn:
            case = Case.of(fine_garment(garments[1.0]), fabric(FABRIC), clip, body, networks)
            rows += measure(case, garments, draperies)
            print(f"{case.garment.name}, {clip.name}: done", flush=True)
    for drapery in draperies.values():
        drapery.close()
    common.print_table(rows, COLUMNS)
    return common.finish("other_knobs", rows, options, frames=options.frames, model=options.model)


if __name__ == "__main__":
    sys.exit(ended(main))
