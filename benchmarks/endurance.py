"""Whether folds last: whole clips at several frame rates, one frame after the other, memory and all.

    python -m benchmarks.endurance
    python -m benchmarks.endurance --garments tshirt --motions reach walk $DRAPE_DATA/motions --fps 15 30 60 --save

Folds are those of streams: on the network without corrections, in cloth that feels itself. A row is a clip at a rate in
a fabric. ``resets`` are frames that were begun anew, because they were not finite or too far from the network's;
``broken`` are frames that are not finite all the same. ``long_pct`` is the share of all edges in all frames that are
longer than 1.3 times their rest, ``network_long_pct`` that of the network's own drape, and ``longest`` the longest of
them. The record has the clips' rows summed up; its ``worst`` is the clip of the longest edge.
"""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.network import Network
from benchmarks.scenes import Clip, Folding, Scene, at_rate, fabrics_option, scenes
from benchmarks.tables import Row, text_table
from drape.body.assets import load_body
from drape.catalog import find_motions
from drape.geometry import meshes
from drape.live.fold_step import FoldEffort
from drape.motion.readers import read_motion

RATES_FPS = (15.0, 30.0, 60.0)
QUICK_FRAMES = 20
CHUNK = 64  # frames that the network drapes at a time
LONG = 1.3  # of an edge's rest
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "fps": ".0f", "frames": "d", "resets": "d", "broken": "d",
    "long_pct": ".3f", "network_long_pct": ".3f", "longest": ".2f", "worst": "s",
}  # fmt: skip


def endure(scene: Scene, network: Network, steps: int) -> Row:
    """The row of a scene, with so many ``steps`` of folds through all of its clip."""
    clip, garment = scene.clip, scene.garment
    folding = Folding(scene.constants, FoldEffort(steps, cloth_contact=True), clip.fps)
    edges = meshes.unique_edges(garment.fine_faces.astype(np.int64))
    rest = meshes.edge_lengths(garment.vertices.astype(np.float64), edges)
    broken, longs, longest = 0, np.zeros(2, np.int64), 0.0
    for begin in range(0, len(clip.poses), CHUNK):
        poses = clip.poses[begin : begin + CHUNK]
        part = Scene(garment, scene.fabric, Clip.of(clip.name, clip.fps, poses, scene.body))
        drapes = part.network(network)
        found = folding.frames(drapes, part.clip.skin)
        broken += int((~np.isfinite(found)).any(axis=(1, 2)).sum())
        stretch = [meshes.edge_lengths(one.astype(np.float64), edges) / rest for one in (found, drapes)]
        longs += [np.count_nonzero(one > LONG) for one in stretch]
        longest = max(longest, float(stretch[0].max()))
    long_pct, network_long_pct = (100.0 * longs / (len(edges) * len(clip.poses))).tolist()
    counts = {"fps": clip.fps, "frames": len(clip.poses), "resets": int(folding.resets), "broken": broken}
    return scene.name | counts | {"long_pct": long_pct, "network_long_pct": network_long_pct, "longest": longest}


def totals(rows: list[Row]) -> list[Row]:
    """One row for all clips of a garment in a fabric at a rate, each clip by its frames; ``worst`` is the clip's name
    whose ``longest`` it is."""
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        groups.setdefault((row["garment"], row["fabric"], row["fps"]), []).append(row)
    found = []
    for (garment, cloth, fps), ones in groups.items():
        frames = [one["frames"] for one in ones]
        whole: Row = {name: int(sum(one[name] for one in ones)) for name in ("frames", "resets", "broken")}
        for name in ("long_pct", "network_long_pct"):
            whole[name] = float(np.average([one[name] for one in ones], weights=frames))
        worst = max(ones, key=lambda one: one["longest"])
        whole |= {"longest": worst["longest"], "worst": worst["clip"]}
        found.append({"garment": garment, "fabric": cloth, "clip": "all", "fps": fps, **whole})
    return found


@Benchmark(
    "endurance",
    "Whether folds last.",
    COLUMNS,
    *inputs(("tshirt",), quick_motions=("walk",)),
    fabrics_option("jersey", "denim", "satin"),
    Option("--fps", RATES_FPS, "frames a second", RATES_FPS[:1]),
    Option("--steps", 2, "of folds"),
)
def main(run: Run) -> None:
    """Rows of every scene at every rate, summed up over the clips."""
    options, body = run.options, load_body()
    network = Network.asked(options, body, passes=0)
    rows: list[Row] = []
    for motion in map(read_motion, find_motions(options.motions)):
        for fps in options.fps:
            poses = at_rate(motion, fps).poses[: QUICK_FRAMES if options.quick else None]
            for scene in scenes(options, [Clip.of(motion.name, fps, poses, body)], body):
                rows.append(endure(scene, network, options.steps))
                print(text_table(rows[-1:], COLUMNS), flush=True)
    run.rows = totals(rows)
    clips = list(dict.fromkeys(row["clip"] for row in rows))
    run.extra |= {"clips": clips, "steps": options.steps, **network.record()}


if __name__ == "__main__":
    main.command()
