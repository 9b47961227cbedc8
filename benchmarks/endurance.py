"""Whether folds last: whole clips at several frame rates, one frame after the other, memory and all.

    python -m benchmarks.endurance
    python -m benchmarks.endurance --garments tshirt --motions reach walk $DRAPE_DATA/motions --fps 15 30 60 --save

Steps of folds on the network without corrections, with cloth against cloth, as streams have them. A row is a clip at a
rate in a fabric: ``resets`` are frames that were begun anew as they were not finite or too far from the network's,
``broken`` frames that are not finite all the same; ``long_pct`` is the share of all edges in all frames that are longer
than 1.3 times their rest, ``network_long_pct`` that of the network's own drape, and ``longest`` the longest of them.
The record has the rows of all clips together, and as ``worst`` the clip of the longest edge.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from benchmarks.shared import common
from benchmarks.shared.network import Network, add_precision
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.contact.skin import shaped_skin
from drape.errors import ended
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.geometry import meshes
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold, warm_up
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion

FABRICS, RATES_FPS = ("jersey", "denim", "satin"), (15.0, 30.0, 60.0)
STEPS, QUICK_FRAMES = 2, 20
CHUNK = 64  # frames that the network drapes at a time
LONG = 1.3  # of an edge's rest
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "fps": ".0f", "frames": "d", "resets": "d", "broken": "d",
    "long_pct": ".3f", "network_long_pct": ".3f", "longest": ".2f", "worst": "s",
}  # fmt: skip


def endure(
    garment: Garment, cloth: Fabric, motion: MotionClip, body: BodyModel, network: Network, steps: int
) -> dict[str, Any]:
    """The row of ``garment`` made of ``cloth`` through all of ``motion``."""
    made, effort = fold_constants(garment, body, cloth), FoldEffort(steps, cloth_contact=True)
    edges = meshes.unique_edges(garment.fine_faces.astype(np.int64))
    rest = meshes.edge_lengths(garment.vertices.astype(np.float64), edges)
    memory, resets, broken, longs, longest = None, 0, 0, np.zeros(2, np.int64), 0.0
    for begin in range(0, len(motion.poses), CHUNK):
        poses = motion.poses[begin : begin + CHUNK]
        skin = shaped_skin(body).table(*body.bones(poses), np.zeros((len(poses), body.shape_count)))
        skin = skin.reshape(len(poses), -1, skin.shape[-1])
        drapes = network.drape(garment, poses).vertices.astype(np.float32)
        for i, drape in enumerate(drapes):
            vertices, memory, report = fold(made, memory, Frame(drape, skin[i], (begin + i) / motion.fps), effort)
            resets += report.reset
            broken += not np.isfinite(vertices).all()
            stretch = [meshes.edge_lengths(one.astype(np.float64), edges) / rest for one in (vertices, drape)]
            longs += [np.count_nonzero(one > LONG) for one in stretch]
            longest = max(longest, float(stretch[0].max()))
    long_pct, network_long_pct = 100.0 * longs / (len(edges) * len(motion.poses))
    return {
        "garment": garment.name,
        "fabric": cloth.name,
        "clip": motion.name,
        "fps": motion.fps,
        "frames": len(motion.poses),
        "resets": int(resets),
        "broken": broken,
        "long_pct": float(long_pct),
        "network_long_pct": float(network_long_pct),
        "longest": longest,
    }


def totals(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """All clips together by garment, fabric and rate; shares by frames."""
    groups: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["garment"], row["fabric"], row["fps"]), []).append(row)
    found = []
    for (garment, cloth, fps), ones in groups.items():
        frames = np.array([one["frames"] for one in ones])
        whole = {name: int(sum(one[name] for one in ones)) for name in ("frames", "resets", "broken")}
        shares = {
            name: float(np.average([one[name] for one in ones], weights=frames))
            for name in ("long_pct", "network_long_pct")
        }
        worst = max(ones, key=lambda one: one["longest"])
        of = {"longest": worst["longest"], "worst": worst["clip"]}
        found.append({"garment": garment, "fabric": cloth, "clip": "all", "fps": fps, **whole, **shares, **of})
    return found


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.endurance", description="Whether folds last.")
    common.add_inputs(parser)
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), metavar="NAME", help="default: three")
    parser.add_argument("--fps", nargs="+", type=float, default=list(RATES_FPS), help="frames per second (15 30 60)")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of folds (%(default)s)")
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or ["tshirt"]
    if options.quick:
        options.motions, options.fabrics, options.fps = (
            options.motions or ["walk"],
            options.fabrics[:1],
            options.fps[:1],
        )
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body, folder = load_body(), model_folder(options.model)
    network = Network(folder, body, threads=options.threads, precision=options.precision, passes=0)
    warm_up()
    rows: list[dict[str, Any]] = []
    for path in find_motions(options.motions):
        motion = read_motion(path)
        for fps in options.fps:
            clip = motion if abs(motion.fps - fps) < 1e-6 else motion.resampled(fps)
            if options.quick:
                clip = clip.window(0, QUICK_FRAMES)
            for garment in (fine_garment(open_garment(path, body)) for path in find_garments(options.garments)):
                for cloth in map(fabric, options.fabrics):
                    rows.append(endure(garment, cloth, clip, body, network.made_of(cloth), options.steps))
                    common.print_table(rows[-1:], COLUMNS)
    print()
    whole = totals(rows)
    common.print_table(whole, COLUMNS)
    clips = list(dict.fromkeys(row["clip"] for row in rows))
    return common.finish("endurance", whole, options, clips=clips, steps=options.steps, **network.record())


if __name__ == "__main__":
    sys.exit(ended(main))
