"""Garments on characters of users: how the rig is found, how our body fits, and whether skin shows through.

    python -m benchmarks.avatars
    python -m benchmarks.avatars --avatars me.vrm --garments tshirt trousers --motions walk squat --save

A character is read, its rig is found without a hand, and garments are cut for it. Clips go there and back through its
rig (``retarget_deg``: the mean angle that a joint is then off by). Their frames are draped one after the other with
folds as in a stream, and skin is counted by ``benchmarks.measure.skin_pixels`` on the character's own surface, drawn as
clients draw it: faces that the garment covers lie deeper (``drape.avatar.covered``). ``as_it_is_pct`` is without that.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.skin_pixels import PosedBody, covered_faces, skin_pixels_pct
from benchmarks.network import Network
from benchmarks.scenes import Clip, Folding
from drape.avatar.covered import DEEPER_M
from drape.avatar.covered import covered_faces as faces_under
from drape.avatar.wearer import Wearer, read_wearer, wearer_name
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.fabric_table import fabric
from drape.errors import Unavailable
from drape.files.data import data_folder
from drape.files.formats import AVATAR_SUFFIXES
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.garment.tailor import tailored
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort
from drape.motion.rig_poses import poses_to_rig
from drape.stages.folds import SETTLE

FPS, LOOKED_AT = 30.0, 8  # of the frames of a clip skin is counted in so many
COLUMNS = {
    "avatar": "s", "garment": "s", "clip": "s", "joints": "d", "fit_median_mm": ".1f", "fit_p95_mm": ".1f",
    "read_s": ".1f", "cut_s": ".1f", "retarget_deg": ".2f", "skin_pixels_pct": ".3f", "worst_pct": ".2f",
    "as_it_is_pct": ".3f", "resets": "d",
}  # fmt: skip


def characters(given: tuple[str, ...]) -> list[Path]:
    """The files that were ``given``, or those in the folder of avatars in DRAPE_DATA."""
    folder = data_folder("avatars")
    paths = [Path(one) for one in given] or ([] if folder is None else sorted(folder.iterdir()))
    found = [path for path in paths if path.suffix.lower() in AVATAR_SUFFIXES]
    if not found:
        cure = "Name files: --avatars me.vrm, or set DRAPE_DATA."
        raise Unavailable("avatars", expected="GLB or VRM files", got="none", cure=cure)
    return found


def retarget_deg(wearer: Wearer, poses: np.ndarray) -> float:
    """The mean angle [deg] between joints of ``poses`` (F, 24, 3) and of what its rig makes of them."""
    back, _ = wearer.from_rig(poses_to_rig(wearer.rig, poses)[..., [1, 2, 3, 0]], None)
    turn = rotvec_to_matrix(back) @ np.swapaxes(rotvec_to_matrix(poses), -1, -2)
    cosine = np.clip(np.abs(matrix_to_quaternion(turn)[..., 0]), 0.0, 1.0)
    return float(np.degrees(2.0 * np.arccos(cosine)).mean())


def skin_seen(wearer: Wearer, garment: Garment, clip: Clip, network: Network, folds: int) -> tuple[np.ndarray, int]:
    """Share [%] of skin in pictures (2, n, 4) of frames of ``clip``, as clients draw it and as it is, and how many
    frames were begun anew."""
    start = network.drape(garment, clip.poses).vertices
    folding = Folding(
        fold_constants(garment, wearer.body, fabric(garment.fabric)), FoldEffort(folds, SETTLE, True), FPS
    )
    cloth = folding.frames(start, clip.skin)
    covered = covered_faces(wearer.vertices, wearer.faces, garment.vertices, garment.faces)
    under = faces_under(wearer.vertices, wearer.faces, [(garment.vertices, garment.faces)])
    rows = np.unique(np.linspace(0, len(cloth) - 1, LOOKED_AT).astype(int))
    surface = wearer.posed(clip.poses[rows], clip.trans[rows])
    share = [
        [
            skin_pixels_pct(
                PosedBody.of(skin, wearer.faces, deeper=under, by_m=by_m),
                covered, cloth[row] + clip.trans[row], garment.faces,
            )
            for row, skin in zip(rows, surface, strict=True)
        ]
        for by_m in (DEEPER_M, 0.0)
    ]  # fmt: skip
    return np.array(share), folding.resets


@Benchmark(
    "avatars",
    "Garments on characters of users.",
    COLUMNS,
    *inputs(("tshirt", "trousers"), ("walk", "squat"), quick_garments=("tshirt",), quick_motions=("walk",)),
    Option("--avatars", (), "GLB or VRM files (those in DRAPE_DATA/avatars)", kind=str),
    Option("--frames", 120, "of a clip at most", 4),
    Option("--folds", 1, "steps of folds"),
)
def main(run: Run) -> None:
    """A row for every character, garment and clip."""
    options, body = run.options, load_body()
    for path in characters(options.avatars):
        begun_s = time.perf_counter()
        wearer = read_wearer(path.read_bytes(), name=wearer_name(path.stem), body=body)
        row = {"avatar": wearer.name, "joints": len(wearer.joints), "read_s": time.perf_counter() - begun_s}
        row |= {"fit_median_mm": wearer.median_mm, "fit_p95_mm": wearer.p95_mm}
        network = Network.asked(options, wearer.body, passes=0)
        for name in find_garments(options.garments):
            begun_s = time.perf_counter()
            garment = tailored(fine_garment(open_garment(name, body)), body, wearer.body)
            row |= {"garment": garment.name, "cut_s": time.perf_counter() - begun_s}
            for motion in find_motions(options.motions):
                clip = Clip.read(motion, FPS, options.frames, wearer.body)
                run.add([row | _worn(wearer, garment, clip, network, options.folds)])
    run.extra |= {"frames": options.frames, "folds": options.folds, **network.record()}


def _worn(wearer: Wearer, garment: Garment, clip: Clip, network: Network, folds: int) -> dict[str, object]:
    (share, as_it_is), resets = skin_seen(wearer, garment, clip, network, folds)
    found: dict[str, object] = {"clip": clip.name, "retarget_deg": retarget_deg(wearer, clip.poses), "resets": resets}
    found |= {"skin_pixels_pct": float(np.nanmean(share)), "worst_pct": float(np.nanmax(share))}
    return found | {"as_it_is_pct": float(np.nanmean(as_it_is))}


if __name__ == "__main__":
    main.command()
