"""Tier exact beside tier accurate and the crossing-free judge, over frames spread over clips.

    python -m benchmarks.exact
    python -m benchmarks.exact --garments tshirt --motions squat --looked-at 3 --save

Starts are folds of ``accurate`` over the clip. A measured frame is computed as the last one of a clip that begins
``--before`` frames earlier, each frame coming from the one before it (``drape.exact.frame``). ``jitter_ratio``, over
these frames, is that of third differences to those of ``accurate``. ``gain`` is 0 for skinning with the nearest-vertex
push, and 1 for the judge, which goes down from the network's drape for as many steps as it takes in quality tables
(``benchmarks.judge.ipc_optimum``); that start may cross, and then so does its end. ``processor_s`` of
one core, ``steps``, force and crossings are of the measured frame; ``first_s`` is the first one's time.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.folds import PASSES, judged
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.judge import ipc_optimum
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.judged import Judged, jitter_ratio
from benchmarks.network import Network
from benchmarks.scenes import FPS, Clip, Folding, Scene, fabrics_option, scenes
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_motions
from drape.cloth import metrics
from drape.exact.frame import Sheet, exact
from drape.live.fold_step import FoldEffort

ACCURATE = FoldEffort(4, cloth_contact=True)
SEEN = ("skin_pixels_pct", "detail_mm", "colliding_triangle_pct")
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "frame": "d", "method": "s", "energy_j": ".4f", "gain": ".4f",
    "force_share": ".4f", "crossings": "d", "steps": "d", "jitter_ratio": ".2f", "skin_pixels_pct": ".3f",
    "detail_mm": ".2f", "colliding_triangle_pct": ".2f", "first_s": ".0f", "processor_s": ".0f",
}  # fmt: skip


def measure(scene: Scene, network: Network, before: int) -> list[Row]:
    """The rows of a scene: tier accurate, tier exact and the judge, in each of its measured frames."""
    starts = scene.starts({"network_all": network})
    folded = Folding(scene.constants, ACCURATE, scene.clip.fps).frames(starts["network_all"], scene.clip.skin)
    judge, body, rows = judged(scene, starts["skinning"]), scene.body, []
    betas = np.zeros(body.shape_count)
    root = body.rest_joints(betas)[0]
    sheet = Sheet.of(scene.garment, scene.fabric, body, betas, scene.garment.vertices - root)
    for number, frame in enumerate(scene.clip.measured):
        here, run = judge.at(np.array([number])), slice(max(frame - before, 0), frame + 1)
        starts_m = folded[run].astype(np.float64)
        x, took = _followed(sheet, scene.clip.poses[run], starts_m - root)
        x, start = x + root, starts_m[-1]
        took["jitter_ratio"] = jitter_ratio(x, starts_m) if len(x) > 3 else float("nan")
        task = here.task((starts["network_all"][frame][None].astype(np.float64),))
        least, _ = ipc_optimum.stored_minimum(task, CACHE_DIR)
        found = {"accurate": (start, {}), "exact": (x[-1], took), "judge": (least.vertices[0], _judged(least))}
        skinned_j = here.energies(here.skinned)["energy_j"]
        least_j = here.energies(least.vertices)["energy_j"]
        for method, (x, more) in found.items():
            row = scene.name | {"frame": int(frame), "method": method} | _figures(here, x) | more
            rows.append(row | {"gain": metrics.gain(skinned_j, row["energy_j"], least_j)})
    return rows


def _followed(sheet: Sheet, poses: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, Row]:
    """The frames [m] (F, V, 3) of a clip in ``poses`` (F, 24, 3) from ``starts`` (F, V, 3), and about the last one."""
    frames, took_s, lain, told = [], [], None, None
    for pose, start in zip(poses, starts, strict=True):
        begun_s = time.process_time()
        lain, told = exact(sheet, pose, start, lain)
        frames.append(lain.x)
        took_s.append(time.process_time() - begun_s)
    assert told is not None
    row = {"processor_s": took_s[-1], "first_s": took_s[0], "force_share": told.force_share, "steps": told.steps}
    return np.stack(frames), row


def _judged(least) -> Row:
    weight = {"processor_s": float(least.processor_s[0]), "steps": int(least.steps[0])}
    return weight | {"residual_n": float(least.residual_n[0])}


def _figures(judge: Judged, x: np.ndarray) -> Row:
    crossings = int(intersection_count(x[None], judge.cloth.faces)[0])
    return judge.figures(x[None], SEEN) | {"energy_j": judge.energies(x[None])["energy_j"], "crossings": crossings}


@Benchmark(
    "exact",
    "Tier exact beside accurate and the crossing-free judge.",
    COLUMNS,
    *inputs(("tshirt", "dress"), ("walk", "squat"), quick_garments=("tank",), quick_motions=("walk",)),
    fabrics_option("jersey"),
    Option("--frames", 90, "of a clip at most", 6),
    Option("--looked-at", 6, "frames of a clip that are measured", 1),
    Option("--before", 4, "frames that each of them comes from", 0),
)
def main(run: Run) -> None:
    """Rows of every scene."""
    options, body = run.options, load_body()
    network = Network.asked(options, body, passes=PASSES["network_all"])
    paths = find_motions(options.motions)
    clips = [Clip.read(path, FPS, options.frames, body, looked_at=options.looked_at) for path in paths]
    for scene in scenes(options, clips, body):
        run.add(measure(scene, network, options.before))
    run.extra |= {"model": options.model}


if __name__ == "__main__":
    main.command()
