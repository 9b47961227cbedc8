"""Folds made by the client beside those of the service, of the same frames in one run: bytes, time, distance.

    python -m benchmarks.client_folds --save                     # CHROMIUM=/path/to/chromium for the browser's columns
    python -m benchmarks.client_folds --garments tshirt --motions walk --frames 60

Three streams of each case get the same poses at the same times: vertices with folds (``inertia`` of the network, as
jets have), vertices as a stream has them by default (swing before the folds), and jets with ``folds_by`` client. The
stages run in this process, a frame of each stream after the other, and are timed; ``server_ratio`` is the median time
of a frame of jets over that of vertices with folds, ``default_ratio`` over that of the default. The library's own code
decodes the jets and folds, in Node.js and in Chromium (``node_ms``, ``browser_ms``: all of a frame, ``fold_ms`` the
folds of it).

``rms_mm`` is the distance of the client's vertices from the service's: the RMS over vertices and frames. Folds
remember, and small differences grow. ``first_mm`` is that of the first ``FIRST`` frames; ``smooth_mm`` that of the
same jets without folds. Two columns part the distance: ``step_mm``, the client's step on the frames of the network as
the service has them, and ``rounding_mm``, the service beside itself where the network's vertices differ by a
ten-thousandth of a millimetre, float32's rounding at a metre: no other arithmetic can be nearer than that for long.
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
    "constants_mb": ".1f", "server_ms": ".1f", "default_ms": ".1f", "jets_ms": ".1f", "server_ratio": ".2f",
    "default_ratio": ".2f", "node_ms": ".1f", "fold_ms": ".1f", "browser_ms": ".1f", "rms_mm": ".3f", "first_mm": ".3f",
    "smooth_mm": ".2f", "step_mm": ".4f", "rounding_mm": ".3f",
}  # fmt: skip
FIRST = 60  # frames: a second
NOISE_M = 1e-7
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def case(worn: Worn, tier: str, frames: int, browser: str | None) -> Row:
    """The row of a garment in a clip."""
    frames = min(frames, len(worn.clip.poses))
    known = next(each for each in worn.runtime.tiers if each.name == tier)
    passes = {} if known.passes is None else {"passes": known.passes}
    network, server, usual, jets = worn.streamed(
        frames,
        {"tier": tier, "folds": 0, "push_out": False, "inertia": "network", **passes},
        {"tier": tier, "inertia": "network", "coarse": False},  # as clients fold
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
    server_ms, usual_ms, jets_ms = (median_ms(each) for each in (server, usual, jets))
    return {
        "garment": worn.entry.id,
        "tier": tier,
        "vertices": server.vertices.shape[1],
        "frames": frames,
        "frame_bytes": len(server.messages[0]),
        "jets_bytes": len(jets.messages[0]),
        "constants_mb": 1e-6 * len(gzip.compress(worn.message(), 6)),
        "server_ms": server_ms,
        "default_ms": usual_ms,
        "jets_ms": jets_ms,
        "server_ratio": jets_ms / server_ms,
        "default_ratio": jets_ms / usual_ms,
        "node_ms": float(np.median(node.frame_ms[1:])),
        "fold_ms": float(np.median(node.fold_ms[1:])),
        "browser_ms": None if shown is None else float(np.median(shown.frame_ms[1:])),
        "rms_mm": float(np.sqrt(np.square(far).mean())),
        "first_mm": float(np.sqrt(np.square(far[:FIRST]).mean())),
        "smooth_mm": float(rms_mm(worn.smooth(jets.messages), server.vertices).mean()),
        "step_mm": float(np.sqrt(np.square(rms_mm(step.vertices, server.vertices)).mean())),
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
