"""Whether moving cloth looks as it does at rest: a stream with swing and folds beside stills of its own poses.

    python -m benchmarks.moving
    python -m benchmarks.moving --garments tshirt --motions walk $DRAPE_DATA/motions/cmu_02_04.npz --fps 60

A still is a frame without a past, settled in ``STILL`` rounds of eight steps. Every measured frame is compared with the
still of its own pose. ``dihedral``, ``sharp``, ``fine``, ``middle``, ``coarse`` and ``hem`` are shares of the still's:
the RMS dihedral angle, hinges folded by more than 60 degrees, relief of waves below 2 cm, of 2 to 8 and of 8 to 30 cm,
and the third difference along the hems. ``network_area`` and ``swung_area`` are the area before folds over the still's:
folds have to hide what it lacks. ``pop`` is the change of fine relief from frame to frame over that relief.
``crossings`` and ``still_crossings`` are pairs of triangles that cross. ``ms`` is a frame's swing and folds.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.moving import Looks
from benchmarks.network import Network
from benchmarks.scenes import FPS, Folding, Scene, read_clips
from benchmarks.swing import swung
from benchmarks.tables import Row
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import fabric
from drape.garment.fine import fine_garment
from drape.live.fold_step import FoldEffort, Frame, fold

STILL = 20  # rounds that a still gets
OWN = "own"
GARMENTS = ("circle_skirt", "shirt", "dress", "tshirt", "trousers", "longsleeve")
MOTIONS = ("turn", "reach", "walk", "squat")
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "fps": ".0f", "dihedral": ".2f", "sharp": ".2f", "fine": ".2f",
    "middle": ".2f", "coarse": ".2f", "hem": ".2f", "network_area": ".3f", "swung_area": ".3f", "pop": ".2f",
    "crossings": ".0f", "still_crossings": ".0f", "dihedral_deg": ".1f", "still_deg": ".1f", "ms": ".2f",
}  # fmt: skip


def measure(scene: Scene, network: Network, steps: int) -> Row:
    """The row of a scene."""
    garment, clip = scene.garment, scene.clip
    drape = scene.network(network)
    moving, swing_ms = swung(scene, drape, folds=0)
    folding = Folding(scene.constants, FoldEffort(steps, cloth_contact=True), clip.fps)
    stream = folding.frames(moving.astype(np.float32), clip.skin).astype(np.float64)
    settled = FoldEffort(8, STILL, cloth_contact=True)
    seen = clip.measured[1:]  # the first frame is a still itself
    begin = time.thread_time()
    still = np.stack(
        [fold(scene.constants, None, Frame(drape[i], clip.skin[i], 0.0), settled)[0] for i in seen]
    ).astype(np.float64)
    still_ms = 1e3 * (time.thread_time() - begin) / len(seen)
    count, faces = garment.vertex_count, garment.faces.astype(np.int64)
    looks = Looks(garment.delivered_rest(), faces, garment.vertices[:count].astype(np.float64))
    ours, own = stream[seen], still

    def share(values: np.ndarray, base: np.ndarray) -> float:
        return float(np.mean(values) / np.mean(base)) if np.mean(base) > 0.0 else float("nan")

    fine, middle, coarse = looks.relief_mm(ours).mean(axis=0) / looks.relief_mm(own).mean(axis=0)
    area = looks.area_m2(own)
    return scene.name | {
        "fps": clip.fps,
        "dihedral": share(looks.dihedral_deg(ours), looks.dihedral_deg(own)),
        "sharp": share(looks.sharp_pct(ours), looks.sharp_pct(own)),
        "fine": float(fine),
        "middle": float(middle),
        "coarse": float(coarse),
        "hem": share(looks.hem_mm(ours), looks.hem_mm(own)),
        "network_area": share(looks.area_m2(drape[seen].astype(np.float64)), area),
        "swung_area": share(looks.area_m2(moving[seen].astype(np.float64)), area),
        "pop": looks.pop(stream),
        "crossings": float(intersection_count(ours, faces).mean()),
        "still_crossings": float(intersection_count(own, faces).mean()),
        "dihedral_deg": float(looks.dihedral_deg(ours).mean()),
        "still_deg": float(looks.dihedral_deg(own).mean()),
        "ms": float(np.median(folding.ms[1:])) + swing_ms,
        "still_ms": still_ms,
        "resets": folding.resets,
    }


@Benchmark(
    "moving",
    "Whether moving cloth looks as it does at rest.",
    COLUMNS,
    *inputs(GARMENTS, MOTIONS, quick_garments=("tshirt",), quick_motions=("walk",)),
    Option("--fabrics", (OWN,), f"what garments are made of; {OWN} is their own"),
    Option("--folds", 1, "steps of folds: the default tier's"),
    Option("--fps", FPS, "frames a second"),
    Option("--frames", 120, "of a clip at most", 30),
)
def main(run: Run) -> None:
    """Rows of every garment in every fabric over every clip, and their means."""
    options, body = run.options, load_body()
    network = Network(model_folder(options.model), body, threads=options.threads)
    clips = read_clips(options, body, options.fps)
    for path in find_garments(options.garments):
        garment = fine_garment(open_garment(path, body))
        for name in options.fabrics:
            cloth = fabric(garment.fabric if name == OWN else name)
            run.add([measure(Scene(garment, cloth, clip), network, options.folds) for clip in clips])
    run.extra |= {"frames": options.frames, "folds": options.folds, "model": options.model}


if __name__ == "__main__":
    main.command()
