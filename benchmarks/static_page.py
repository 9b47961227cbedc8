"""A garment draped without a service beside the service's stages: bytes of the folder, time in the client, distance.

    python -m benchmarks.static_page --save              # CHROMIUM=/path/to/chromium for the browser's column
    python -m benchmarks.static_page --garments tshirt --frames 60

The folder is that of ``python -m service.static``, whose own code drapes the frames of a clip, at the times of the
clip, on one thread. ``folder_mb`` are its bytes, ``start_ms`` passes until the network is ready, from the same machine.
``node_ms`` and ``browser_ms`` are all of a frame but the drawing, ``drape_ms`` what the engine takes of it in Node.js;
``server_ms`` is that of the service's stages in this process, by the engine that DRAPE_ISA names. These are medians;
``least_ratio`` is the least of ``drape_ms`` over the least of ``server_ms``, since the machine is shared.

``ten_mm`` is the distance from the vertices of the service's stages: the RMS over the vertices of the first ``TEN``
frames, ``first_mm`` of the first ``FIRST``; ``rms_mm`` that of all frames, in which folds remember what is rounding
(``benchmarks.client_folds``). ``network_mm`` is that of the network alone, without swing and folds.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.client_folds import FIRST, TEN, browser_here, median_ms
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.speed.client_folds import Worn, rms_mm
from benchmarks.speed.static_page import draped_in, write_static
from benchmarks.tables import Row
from drape.motion.clip import MotionClip
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from service.static.folder import Asked, sizes

COLUMNS = {
    "garment": "s", "clip": "s", "tier": "s", "vertices": "d", "frames": "d", "folder_mb": ".2f", "start_ms": ".0f",
    "node_ms": ".1f", "drape_ms": ".1f", "browser_ms": ".1f", "server_ms": ".1f", "least_ratio": ".2f",
    "ten_mm": ".4f", "first_mm": ".3f", "rms_mm": ".3f", "network_mm": ".4f",
}  # fmt: skip
SMOOTH = {"folds": 0, "safe_folds": 0, "motion": 0.0}


def case(asked: Asked, frames: int, browser: str | None, model: str) -> Row:
    """The row of what is ``asked``, of its first clip."""
    runtime = DrapeRuntime(Settings(model=model))
    worn = Worn.of(runtime, asked.garment, asked.motions[0])
    clip = first_frames(worn.clip, frames)
    tier = asked.options.tier or "balanced"
    known = next(each for each in runtime.tiers if each.name == tier)
    passes = {} if known.passes is None else {"passes": known.passes}
    count = len(clip.poses)
    server, network = worn.streamed(count, {"tier": tier}, {"push_out": False, **SMOOTH, **passes})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "folder"
        write_static(runtime, asked, folder)
        found = sizes(folder)
        draped = draped_in(folder, clip)
        shown = None if browser is None else draped_in(folder, clip, browser=browser)
        smooth = draped_in(folder, clip, effort={**SMOOTH, "coarse": False})
    far = rms_mm(draped.vertices, server.vertices)
    return {
        "garment": asked.garment,
        "clip": asked.motions[0],
        "tier": tier,
        "vertices": server.vertices.shape[1],
        "frames": count,
        "folder_mb": 1e-6 * sum(found.values()),
        "start_ms": draped.start_ms,
        "node_ms": float(np.median(draped.frame_ms[1:])),
        "drape_ms": float(np.median(draped.drape_ms[1:])),
        "browser_ms": None if shown is None else float(np.median(shown.frame_ms[1:])),
        "server_ms": median_ms(server),
        "least_ratio": float(draped.drape_ms[1:].min() / server.took_ms[1:].min()),
        "ten_mm": whole(far[:TEN]),
        "first_mm": whole(far[:FIRST]),
        "rms_mm": whole(far),
        "network_mm": whole(rms_mm(smooth.vertices, network.vertices)),
    }


def first_frames(clip: MotionClip, count: int) -> MotionClip:
    """``clip`` up to ``count`` frames."""
    return replace(clip, poses=clip.poses[:count], trans=clip.trans[:count])


def whole(far_mm: np.ndarray) -> float:
    """The RMS of those of frames."""
    return float(np.sqrt(np.square(far_mm).mean()))


@Benchmark(
    "static_page",
    "A garment draped without a service beside the service's stages.",
    COLUMNS,
    *inputs(("tshirt", "dress"), ("walk",), quick_garments=("tshirt",)),
    Option("--tiers", ("balanced", "fast"), "tiers", ("balanced",)),
    Option("--frames", 264, "of a clip at most", 24),
)
def main(run: Run) -> None:
    """Every garment in every motion by every tier."""
    browser = browser_here()
    if browser is None:
        run.notes.append("No Chromium: its column is empty.")
    for garment in run.options.garments:
        for motion in run.options.motions:
            for tier in run.options.tiers:
                asked = Asked(garment, (motion,), DrapeOptions(tier=tier))
                run.add([case(asked, run.options.frames, browser, run.options.model)])


if __name__ == "__main__":
    main.command()
