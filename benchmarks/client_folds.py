"""Folds made by the client beside those of the service, of the same frames in one run: bytes, time, distance.

    python -m benchmarks.client_folds --save                     # CHROMIUM=/path/to/chromium for the browser's columns
    python -m benchmarks.client_folds --garments tshirt --motions walk --frames 60

Two streams of each case get the same poses at the same times: vertices, and jets with ``folds_by`` client, both by the
same tier. The stages run in this process, a frame of each stream after the other, and are timed; ``server_ratio`` is
the median time of a frame of jets over that of vertices. The library's own code decodes the jets, swings and folds, in
Node.js and in Chromium (``node_ms``, ``browser_ms``: all of a frame, ``fold_ms`` swing and folds of it).

``rms_mm`` is the distance of the client's vertices from the service's: the RMS over vertices and frames. Folds
remember, and small differences grow. ``first_mm`` is that of the first ``FIRST`` frames; ``smooth_mm`` that of the
same jets without folds. Three columns part the distance: ``step_mm`` and ``ten_mm``, the client's swing and folds on
the frames of the network as the service has them, of all frames and of the first ``TEN``; and ``rounding_mm``, the
service beside itself where the network's vertices differ by a ten-thousandth of a millimetre, float32's rounding at a
metre: no other arithmetic can be nearer than that for long.
"""

from __future__ import annotations

import gzip
import os
import shutil

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.speed.client_folds import Streamed, Worn, client_folder, in_browser, in_node, rms_mm
from benchmarks.tables import Row
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

COLUMNS = {
    "garment": "s", "clip": "s", "tier": "s", "vertices": "d", "frames": "d", "frame_bytes": "d", "jets_bytes": "d",
    "constants_mb": ".1f", "server_ms": ".1f", "jets_ms": ".1f", "server_ratio": ".2f", "node_ms": ".1f",
    "fold_ms": ".1f", "browser_ms": ".1f", "rms_mm": ".3f", "first_mm": ".3f", "ten_mm": ".4f", "smooth_mm": ".2f",
    "step_mm": ".4f", "rounding_mm": ".3f",
}  # fmt: skip
FIRST, TEN = 60, 10  # frames: a second, and before folds have grown apart
NOISE_M = 1e-7
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def case(worn: Worn, tier: str, frames: int, browser: str | None) -> Row:
    """The row of a garment in a clip."""
    frames = min(frames, len(worn.clip.poses))
    known = next(each for each in worn.runtime.tiers if each.name == tier)
    passes = {} if known.passes is None else {"passes": known.passes}
    network, server, jets = worn.streamed(
        frames,
        {"tier": tier, "folds": 0, "push_out": False, "motion": 0.0, **passes},
        {"tier": tier},
        {"tier": tier, "geometry": "jets", "folds_by": "client"},
    )
    with client_folder(worn, jets.messages, jets.options) as folder:
        node = in_node(folder)
        shown = None if browser is None else in_browser(folder, browser)
    with client_folder(worn, jets.messages, jets.options, network.vertices) as folder:
        step = in_node(folder)
    noise = np.random.default_rng(0).normal(scale=NOISE_M, size=network.vertices.shape).astype(np.float32)
    again = rms_mm(worn.folded(network.vertices + noise, server.options), worn.folded(network.vertices, server.options))
    far = rms_mm((node if shown is None else shown).vertices, server.vertices)
    exact = rms_mm(step.vertices, server.vertices)
    server_ms, jets_ms = median_ms(server), median_ms(jets)
    return {
        "garment": worn.entry.id,
        "tier": tier,
        "vertices": server.vertices.shape[1],
        "frames": frames,
        "frame_bytes": len(server.messages[0]),
        "jets_bytes": len(jets.messages[0]),
        "constants_mb": 1e-6 * len(gzip.compress(worn.message(jets.options), 6)),
        "server_ms": server_ms,
        "jets_ms": jets_ms,
        "server_ratio": jets_ms / server_ms,
        "node_ms": float(np.median(node.frame_ms[1:])),
        "fold_ms": float(np.median(node.fold_ms[1:])),
        "browser_ms": None if shown is None else float(np.median(shown.frame_ms[1:])),
        "rms_mm": float(np.sqrt(np.square(far).mean())),
        "first_mm": float(np.sqrt(np.square(far[:FIRST]).mean())),
        "ten_mm": float(np.sqrt(np.square(exact[:TEN]).mean())),
        "smooth_mm": float(rms_mm(worn.smooth(jets.messages), server.vertices).mean()),
        "step_mm": float(np.sqrt(np.square(exact).mean())),
        "rounding_mm": float(np.sqrt(np.square(again).mean())),
    }


def median_ms(stream: Streamed) -> float:
    """The median time [ms] of a frame, but for the first, which settles."""
    return float(np.median(stream.took_ms[1:]))


def browser_here() -> str | None:
    """A Chromium, the one that CHROMIUM names or one on the path."""
    named = os.environ.get("CHROMIUM")
    return named or next((path for name in BROWSERS if (path := shutil.which(name))), None)


@Benchmark(
    "client_folds",
    "Folds made by the client beside those of the service.",
    COLUMNS,
    *inputs(("tshirt", "dress", "trousers"), ("walk",), quick_garments=("tshirt",)),
    Option("--tiers", ("balanced", "fast"), "tiers", ("balanced",)),
    Option("--frames", 264, "of a clip at most", 60),
)
def main(run: Run) -> None:
    """Every garment in every motion by every tier."""
    runtime, browser = DrapeRuntime(Settings(model=run.options.model)), browser_here()
    if browser is None:
        run.notes.append("No Chromium: its columns are empty.")
    for garment in run.options.garments:
        for motion in run.options.motions:
            worn = Worn.of(runtime, garment, motion)
            for tier in run.options.tiers:
                run.add([{"clip": motion} | case(worn, tier, run.options.frames, browser)])
    runtime.close()


if __name__ == "__main__":
    main.command()
