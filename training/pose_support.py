"""Which poses a network has seen, kept beside it: ``python -m training.pose_support --model NAME --write``.

Kept are the poses of ``training.poses`` that cover the others best (farthest-point sampling, Gonzalez 1985), their
mirror images counted, and the pose in which garments are made. Limits are what ``PASSING`` of the frames of clips that
training never saw stay within. The table says what share of them and of poses that nobody takes is beyond.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drape.artifacts import DEFAULT_MODEL, FileSpec, load_manifest, model_folder
from drape.body.pose_distance import PARTS, STEPS, PoseSupport, pose_parts
from drape.body.skeleton import JOINT_COUNT
from drape.catalog import MOTIONS_DIR
from drape.errors import NotFound
from drape.files.data import data_folder
from drape.motion.readers import read_motion
from training.config import DataConfig
from training.poses import PoseBank, mirror_poses, read_training_clips

COUNTS = {"legs": 256, "trunk": 256, "tilt": 64}
PASSING = 0.99  # share of the frames of unseen clips
SPREADS_RAD = (0.3, 0.5, 0.7, 1.0, np.pi, 1000.0)
FILE = "poses.npz"


def support_of(seen: np.ndarray, unseen: np.ndarray, *, counts: Mapping[str, int] = COUNTS) -> PoseSupport:
    """Returns ``counts`` poses of each part of the body that cover ``seen`` (n, 24, 3) [rad] and its mirror images,
    with limits that ``PASSING`` of the poses ``unseen`` (m, 24, 3) [rad] stay within."""
    poses = np.concatenate([np.zeros((1, JOINT_COUNT, 3)), seen, mirror_poses(seen)])
    rows = {name: _steps(spread_rows(part, counts[name])) for name, part in pose_parts(poses).items()}
    support = PoseSupport(**rows, limits=np.ones(len(PARTS)))
    # Each part lets as many go, so that all together let no more go than was asked.
    passing = 1.0 - (1.0 - PASSING) / len(PARTS)
    limits = np.quantile(support.distances(unseen), passing, axis=0, method="higher")
    return replace(support, limits=np.maximum(limits, 1e-6))


def spread_rows(rows: np.ndarray, count: int) -> np.ndarray:
    """Returns at most ``count`` different rows of ``rows`` (n, d): the first one, then each time the one farthest from
    all that are chosen."""
    chosen, far = [0], np.full(len(rows), np.inf)
    while len(chosen) < count:
        far = np.minimum(far, ((rows - rows[chosen[-1]]) ** 2).sum(axis=1))
        if far.max() <= 0.0:
            break
        chosen.append(int(far.argmax()))
    return rows[chosen]


def _steps(rows: np.ndarray) -> np.ndarray:
    return np.rint(STEPS * rows).astype(np.int8)


def shares_beyond(support: PoseSupport, clips: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Returns the share of poses beyond the limits of ``support``, from 0 to 1, by name: of each of ``clips`` (F, 24,
    3) [rad]; and, as "uniform to S rad" for each S of ``SPREADS_RAD``, of poses whose components are uniform between -S
    and S."""
    generator = np.random.default_rng(0)
    uniform = {f"uniform to {s:.1f} rad": generator.uniform(-s, s, (1000, JOINT_COUNT, 3)) for s in SPREADS_RAD}
    return {name: float((support.novelty(poses) > 1.0).mean()) for name, poses in ({**clips} | uniform).items()}


def write_support(folder: Path, support: PoseSupport) -> None:
    """Writes ``support`` as the file ``poses.npz`` of the model ``folder``, and its entry into the manifest there."""
    content, manifest = support.to_bytes(), load_manifest(folder)
    spec = FileSpec(FILE, hashlib.sha256(content).hexdigest())
    (folder / FILE).write_bytes(content)
    (folder / "manifest.json").write_text(replace(manifest, poses=spec).to_json(), encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line: prints shares of poses beyond the limits and, with ``--write``, writes the support into
    the model's folder. Raises ``NotFound`` without a folder of data."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default=DEFAULT_MODEL, help="name or folder of the model")
    parser.add_argument("--write", action="store_true", help="put the poses into the model's folder")
    options = parser.parse_args(argv)
    folder = model_folder(options.model)
    motions = data_folder("motions")
    if motions is None:
        raise NotFound("motions", expected="clips trained on", got="no DRAPE_DATA", cure="Set DRAPE_DATA.")
    config = DataConfig(held_out=tuple(load_manifest(folder).training["held_out"]))
    trained_on = np.concatenate(PoseBank(read_training_clips([motions], held_out=config.held_out), config).frames)
    files = [motions / f"{name}.npz" for name in config.held_out] + sorted(MOTIONS_DIR.glob("*.npz"))
    unseen = {path.stem: read_motion(path).poses.astype(np.float64) for path in files}
    support = support_of(trained_on, np.concatenate(list(unseen.values())))
    shares = shares_beyond(support, unseen)
    for name, share in shares.items():
        print(f"{name:24s} {100.0 * share:6.2f} % beyond")
    if options.write:
        write_support(folder, support)
    size = len(support.to_bytes())
    print(json.dumps({"bench": "pose_support", "frames": len(trained_on), "bytes": size, "beyond": shares}))


if __name__ == "__main__":
    main()
