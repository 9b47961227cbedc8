"""Tier exact beside tier accurate and the crossing-free judge, over frames spread over clips.

    python -m benchmarks.exact
    python -m benchmarks.exact --garments tshirt --motions squat --looked-at 3 --save

A frame starts from folds of ``accurate`` over the clip up to it, and is computed as a job does in the first frame of a
block: from the T-pose, where those cross (``drape.exact.frame``). ``gain`` is 0 for skinning with the nearest-vertex
push, and 1 for the judge, which goes down from the network's drape for as many steps as it takes in quality tables
(``benchmarks.judge.ipc_optimum``); that start may cross, and then so does its end. ``processor_s`` is of one core.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.folds import PASSES, judged
from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.judge import ipc_optimum
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.judged import Judged
from benchmarks.network import Network
from benchmarks.scenes import FPS, Clip, Folding, Scene, fabrics_option, scenes
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_motions
from drape.cloth import metrics
from drape.exact.frame import Sheet, exact
from drape.live.fold_step import FoldEffort, warm_up

ACCURATE = FoldEffort(2, cloth_contact=True)
SEEN = ("skin_pixels_pct", "detail_mm", "colliding_triangle_pct")
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "frame": "d", "method": "s", "energy_j": ".4f", "gain": ".4f",
    "force_share": ".4f", "crossings": "d", "steps": "d", "skin_pixels_pct": ".3f", "detail_mm": ".2f",
    "colliding_triangle_pct": ".2f", "processor_s": ".0f",
}  # fmt: skip


def measure(scene: Scene, network: Network) -> list[Row]:
    """The rows of a scene: tier accurate, tier exact and the judge, in each of its measured frames."""
    starts = scene.starts({"network_all": network})
    folded = Folding(scene.constants, ACCURATE, scene.clip.fps).frames(starts["network_all"], scene.clip.skin)
    judge, body, rows = judged(scene, starts["skinning"]), scene.body, []
    betas = np.zeros(body.shape_count)
    root = body.rest_joints(betas)[0]
    sheet = Sheet.of(scene.garment, scene.fabric, body, betas, scene.garment.vertices - root)
    for number, frame in enumerate(scene.clip.measured):
        here, begun_s = judge.at(np.array([number])), time.process_time()
        start = folded[frame].astype(np.float64)
        lain, told = exact(sheet, scene.clip.poses[frame], start - root)
        took = {"processor_s": time.process_time() - begun_s, "force_share": told.force_share, "steps": told.steps}
        task = here.task((starts["network_all"][frame][None].astype(np.float64),))
        least, _ = ipc_optimum.stored_minimum(task, CACHE_DIR)
        found = {"accurate": (start, {}), "exact": (lain.x + root, took), "judge": (least.vertices[0], _judged(least))}
        skinned_j = here.energies(here.skinned)["energy_j"]
        least_j = here.energies(least.vertices)["energy_j"]
        for method, (x, more) in found.items():
            row = scene.name | {"frame": int(frame), "method": method} | _figures(here, x) | more
            rows.append(row | {"gain": metrics.gain(skinned_j, row["energy_j"], least_j)})
    return rows


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
)
def main(run: Run) -> None:
    """Rows of every scene."""
    options, body = run.options, load_body()
    network = Network.asked(options, body, passes=PASSES["network_all"])
    warm_up()
    paths = find_motions(options.motions)
    clips = [Clip.read(path, FPS, options.frames, body, looked_at=options.looked_at) for path in paths]
    for scene in scenes(options, clips, body):
        run.add(measure(scene, network))
    run.extra |= {"model": options.model}


if __name__ == "__main__":
    main.command()
