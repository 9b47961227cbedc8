"""Garments distilled to joints: how far from their drape with tracks, on spring bones, and carried by the rig alone.

    python -m benchmarks.joints
    python -m benchmarks.joints --avatars me.vrm --garments tshirt skirt --joints 32 --save

Weights and springs are fitted to ``--motions``, weights also to poses of training; ``--unseen`` are clips of which they
know nothing, to which tracks alone are fitted anew, six seconds of each: by default ``turn`` and four recorded ones.
Distances are root mean squares over vertices and frames [mm], the mean of clips and the worst. ``kb``: what the file of
a clip is larger by than the character's. ``distil_s``: processor time.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import drape
from benchmarks.avatars import characters
from benchmarks.harness import Benchmark, Option, Run, inputs
from drape.avatar.distilled import JOINTS
from drape.catalog import find_motions
from drape.distilling import Joints, Motion
from drape.files.data import data_folder
from drape.motion.readers import read_motion

SECONDS = 6.0  # of a clip that nothing is fitted to

COLUMNS = {
    "avatar": "s", "garment": "s", "joints": "d", "tracks_seen_mm": ".1f", "tracks_unseen_mm": ".1f",
    "tracks_worst_mm": ".1f", "springs_seen_mm": ".1f", "springs_unseen_mm": ".1f", "carried_unseen_mm": ".1f",
    "kb": ".0f", "distil_s": ".1f",
}  # fmt: skip


@Benchmark(
    "joints",
    "Garments distilled to joints.",
    COLUMNS,
    *inputs(
        ("tshirt", "circle_skirt", "dress"), ("walk", "squat", "reach", "stretch"),
        quick_garments=("tshirt",), quick_motions=("walk",),
    ),
    Option("--unseen", (), "clips that nothing but tracks is fitted to", ("turn",), kind=str),
    Option("--avatars", (), "GLB or VRM files (the first of DRAPE_DATA/avatars)", kind=str),
    Option("--joints", JOINTS, "of a garment"),
)  # fmt: skip
def main(run: Run) -> None:
    """A row for every character and garment."""
    options, opened = run.options, drape.load(run.options.model)
    recorded = data_folder("motions")
    more = [] if recorded is None else [str(path) for path in sorted(recorded.glob("*.npz"))[::6][:4]]
    unseen = [read_motion(path) for path in find_motions(options.unseen or ("turn", *more))]
    unseen = [clip.window(0, min(clip.frame_count, round(SECONDS * clip.fps))) for clip in unseen]
    for path in characters(options.avatars)[: len(options.avatars) or 1]:
        for name in options.garments:
            worn = opened.wear(name, on=path)
            begun_s = time.process_time()
            made = drape.distil(worn, find_motions(options.motions), joints=options.joints)
            row = {"avatar": path.stem, "garment": name, "joints": options.joints}
            row["distil_s"] = time.process_time() - begun_s
            run.add([row | told(made, path, find_motions(options.motions), unseen)])


def told(made: Joints, path: Path, seen: Sequence[Motion], unseen: Sequence[Motion]) -> dict[str, float]:
    """The figures of one garment."""
    errors = {key: [made.errors_mm(clip)[0] for clip in clips] for key, clips in (("seen", seen), ("unseen", unseen))}
    found = {
        f"{way}_{key}_mm": float(np.mean([one[way] for one in rows]))
        for key, rows in errors.items()
        for way in ("tracks", "springs", "carried")
    }
    found["tracks_worst_mm"] = max(one["tracks"] for one in errors["unseen"])
    return found | {"kb": (len(made.glb(unseen[0])) - path.stat().st_size) / 1e3}


if __name__ == "__main__":
    main.command()
