"""A garment draped without a service beside the service's stages: bytes of the folder, time in Chromium, distance.

    python -m benchmarks.static_page --save                         # CHROMIUM=/path/to/chromium
    python -m benchmarks.static_page --garments tshirt --frames 60 --card-frames 2

The folder is that of ``python -m service.static``, whose own code drapes the frames of a clip in Chromium, at the times
of the clip, on one thread. ``folder_mb`` are its bytes, ``wasm_mb`` and ``card_mb`` those that a browser loads which
computes on its processor or on a graphics card; ``start_ms`` passes until the network is ready, from the same machine.
``frame_ms`` is all of a frame but the drawing and ``network_ms`` the network of it; ``server_ms`` that of the service's
stages in this process. These three are medians, and ``least_ms`` the least of ``frame_ms``, since browser and machine
are shared.

``first_mm`` is the distance from the vertices of the service's stages (``inertia`` of the network): the RMS over the
vertices of the first ``FIRST`` frames; ``rms_mm`` that of all frames, in which folds remember what is rounding
(``benchmarks.client_folds``). ``network_mm`` is that of the network alone, without folds. ``card_mm``, where
``--card-frames`` asks for it, is the network on WebGPU beside the service's in float32, as the graphics card has it:
here the card is software, and its frames take seconds.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.client_folds import FIRST, browser_here, median_ms
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.speed.client_folds import Worn, rms_mm
from benchmarks.speed.static_page import SOFTWARE_CARD, draped_in, write_static
from benchmarks.tables import Row
from drape.errors import Unavailable
from drape.motion.clip import MotionClip
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from service.static.folder import RUNTIMES, Asked, loaded, sizes

COLUMNS = {
    "garment": "s", "clip": "s", "tier": "s", "vertices": "d", "frames": "d", "folder_mb": ".1f", "wasm_mb": ".1f",
    "card_mb": ".1f", "start_ms": ".0f", "frame_ms": ".1f", "least_ms": ".1f", "network_ms": ".1f", "server_ms": ".1f",
    "first_mm": ".3f", "rms_mm": ".3f", "network_mm": ".4f", "card_mm": ".4f",
}  # fmt: skip
NO_FOLDS = {"folds": 0, "safe_folds": 0}


def case(asked: Asked, frames: int, card_frames: int, browser: str, model: str) -> Row:
    """The row of what is ``asked``, of its first clip."""
    runtime = DrapeRuntime(Settings(model=model))
    worn = Worn.of(runtime, asked.garment, asked.motions[0])
    clip = first_frames(worn.clip, frames)
    tier = asked.options.tier or "balanced"
    known = next(each for each in runtime.tiers if each.name == tier)
    passes = {} if known.passes is None else {"passes": known.passes}
    alone = {"inertia": "network", "push_out": False, **NO_FOLDS, **passes}
    count = len(clip.poses)
    server, network = worn.streamed(count, {"tier": tier, "inertia": "network", "coarse": False}, alone)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "folder"
        write_static(runtime, asked, folder)
        found = sizes(folder)
        loads = {kind: sum(found[file] for file in loaded(folder, kind)) for kind in RUNTIMES}
        draped = draped_in(folder, browser, clip)
        smooth = draped_in(folder, browser, clip, effort=NO_FOLDS)
        card_mm = None
        if card_frames:
            exact = Worn.of(DrapeRuntime(Settings(model=model)), asked.garment, asked.motions[0])
            (expected,) = exact.streamed(card_frames, alone)
            few = first_frames(clip, card_frames)
            card = draped_in(folder, browser, few, provider="webgpu", effort=NO_FOLDS, flags=SOFTWARE_CARD)
            card_mm = whole(rms_mm(card.vertices, expected.vertices))
            exact.runtime.close()
    far = rms_mm(draped.vertices, server.vertices)
    return {
        "garment": asked.garment,
        "clip": asked.motions[0],
        "tier": tier,
        "vertices": server.vertices.shape[1],
        "frames": count,
        "folder_mb": 1e-6 * sum(found.values()),
        "wasm_mb": 1e-6 * loads["wasm"],
        "card_mb": 1e-6 * loads["webgpu"],
        "start_ms": draped.start_ms,
        "frame_ms": float(np.median(draped.frame_ms[1:])),
        "least_ms": float(draped.frame_ms[1:].min()),
        "network_ms": float(np.median(draped.network_ms[1:])),
        "server_ms": median_ms(server),
        "first_mm": whole(far[:FIRST]),
        "rms_mm": whole(far),
        "network_mm": whole(rms_mm(smooth.vertices, network.vertices)),
        "card_mm": card_mm,
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
    Option("--card-frames", 0, "on a graphics card in software", kind=int),
)
def main(run: Run) -> None:
    """Every garment in every motion by every tier."""
    browser = browser_here()
    if browser is None:
        raise Unavailable("Chromium", expected="one to drape in", got="none", cure="Install it, or set CHROMIUM.")
    for garment in run.options.garments:
        for motion in run.options.motions:
            for tier in run.options.tiers:
                asked = Asked(garment, (motion,), DrapeOptions(tier=tier))
                run.add([case(asked, run.options.frames, run.options.card_frames, browser, run.options.model)])


if __name__ == "__main__":
    main.command()
