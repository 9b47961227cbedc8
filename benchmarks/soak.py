"""Fuzzed frames through the whole engine, and rows through elementary stages, until a count or a time is reached.

    python -m benchmarks.soak [--frames 1000000] [--rows 1000000] [--seconds 600] [--seed 0]

Poses from the T-pose to 1000 rad, shapes to 20, roots to 1e6 m, steps from none to an age, folds and push-out; state
goes on from frame to frame. Every frame must be finite and within the body's reach and a garment's: the first that is
not ends the run with its seed and number (exit status 1). A tenth of the time is for the rows.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.served import Stream
from drape.catalog import find_garments
from drape.errors import DrapeError
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix, rotvec_to_quaternion, sixd_to_matrix
from drape.stages.batch import ANGLE_LIMIT_RAD, BETA_LIMIT, PLACE_LIMIT_M, Batch, PoseInput
from drape.wire import messages as wire
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

ROW_BLOCK = 2000
SHAPE_EVERY = 50  # each body has so many frames
REACH_M = 1.0  # how far a garment may be outside its body's box
STEPS_S = (0.0, 1e-9, 1.0 / 240.0, 1.0 / 60.0, 1.0 / 30.0, 0.2, 2.0, -1.0)
SPREADS_RAD = (0.0, 1e-40, 1e-4, 0.1, 0.5, np.pi, ANGLE_LIMIT_RAD)
GARMENT = "tank"


class Fuzz:
    """A stream of random frames that ``seed`` determines, of bodies with ``shapes`` shape coefficients."""

    def __init__(self, seed: int, shapes: int) -> None:
        self._rng, self._shapes, self._number = np.random.default_rng(seed), shapes, 0
        self._pose, self._betas, self._time_s = np.zeros((24, 3)), np.zeros(shapes), 0.0

    def next(self) -> tuple[PoseInput, bool]:
        """Returns the next frame, and whether it is of another body than the last one and so has no past."""
        rng, anew = self._rng, self._number % SHAPE_EVERY == 0
        if anew:
            size = rng.choice([0.0, 2.0, 5.0, BETA_LIMIT])
            self._betas = rng.uniform(-size, size, self._shapes)
        if rng.uniform() < 0.1:
            spread = rng.choice(SPREADS_RAD)
            self._pose = rng.uniform(-spread, spread, (24, 3))
        else:
            self._pose = np.clip(self._pose + rng.normal(0.0, 0.05, (24, 3)), -ANGLE_LIMIT_RAD, ANGLE_LIMIT_RAD)
        self._time_s += rng.choice(STEPS_S)
        self._number += 1
        place = rng.choice([0.0, 1.0, 1e4, PLACE_LIMIT_M]) * rng.uniform(-1.0, 1.0, (1, 3))
        return PoseInput(self._pose[None], place, self._betas, np.array([self._time_s])), anew


def soak_frames(
    drapery: DrapeRuntime, *, count: int, until_s: float, seed: int, folds: int = 2
) -> tuple[int, str | None]:
    """Drapes ``count`` random frames, or fewer if ``time.monotonic`` comes to ``until_s``. Returns how many were draped
    before the first failure, and the sentence of that, None if there was none."""
    (entry,) = drapery.garments.entries()
    plan = drapery.plan(entry, DrapeOptions(advanced=Advanced(push_out=True, folds=folds, settle=2)), messages=True)
    fuzz, stream = Fuzz(seed, drapery.body.shape_count), Stream(plan, drapery.body.shape_count)
    for number in range(count):
        if time.monotonic() >= until_s:
            return number, None
        pose, anew = fuzz.next()
        if anew:
            stream.forget()
        try:
            _check(stream.frame(pose), pose, drapery)
        except (AssertionError, DrapeError) as error:
            return number, f"frame {number} of seed {seed}: {error}"
    return count, None


def _check(batch: Batch, pose: PoseInput, drapery: DrapeRuntime) -> None:
    """Raises ``AssertionError`` where ``batch`` is no drape of the frame ``pose``."""
    box = drapery.body.posed_vertices(pose.poses, None, pose.betas)[0] - drapery.body.rest_joints(pose.betas)[0]
    vertices = batch.vertices[0]
    assert np.isfinite(vertices).all(), "not finite"
    beyond_m = max(float((vertices.max(0) - box.max(0)).max()), float((box.min(0) - vertices.min(0)).max()))
    assert beyond_m <= REACH_M, f"{beyond_m:.2f} m beyond the body"
    sent = wire.unpack_frame(batch.messages[0])
    assert np.abs(sent.positions - vertices).max() <= 1e-3, "the message is another frame"


def soak_rows(*, count: int, until_s: float, seed: int) -> tuple[int, str | None]:
    """Sends ``count`` random vectors (3,), called rows, through conversions of rotations and the wire's quantisation,
    or fewer if ``time.monotonic`` comes to ``until_s``. Returns how many went through before the first failure, and the
    sentence of that, None if there was none."""
    rng, number = np.random.default_rng(seed), 0
    while number < count and time.monotonic() < until_s:
        size = 10.0 ** rng.uniform(-45.0, 3.0, (ROW_BLOCK, 1))
        rows = size * rng.normal(size=(ROW_BLOCK, 3))
        turn = rotvec_to_matrix(rows)
        off = [
            np.abs(turn @ turn.swapaxes(-1, -2) - np.eye(3)).max(),
            np.abs(rotvec_to_matrix(matrix_to_rotvec(turn)) - turn).max(),
            np.abs(np.linalg.norm(rotvec_to_quaternion(rows), axis=1) - 1.0).max(),
        ]
        loose = sixd_to_matrix(rng.choice([0.0, 1e-40, 1.0, -1.0], (ROW_BLOCK, 6)))
        steps, low, step = wire.quantise(rows)
        lost = np.abs(wire.dequantise(steps, low, step) - rows).max(axis=0)
        room = 0.5 * step + 4.0 * np.spacing(np.abs(rows).max(axis=0).astype(np.float32))
        if max(off) > 1e-9 or not np.isfinite(loose).all() or (lost > room).any():
            return number, f"rows from {number} of seed {seed}: {max(off):.2g}"
        number += ROW_BLOCK
    return number, None


@Benchmark(
    "soak",
    "Fuzzed frames and rows.",
    {"frames": "d", "rows": "d", "failed": "s"},
    Option("--frames", 1_000_000, "at most"),
    Option("--rows", 1_000_000, "at most"),
    Option("--seconds", 600.0, "at most", 10.0),
    Option("--seed", 0, "of what is drawn"),
    Option("--garment", GARMENT, "what is draped"),
)
def main(run: Run) -> None:
    """Adds one row to ``run``: how many frames and rows went through, and the first failure, with which the run
    fails."""
    options = run.options
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        shipped = Path(folder) / "shipped"
        shipped.mkdir()
        shutil.copy(find_garments([options.garment])[0], shipped)
        settings = Settings(shipped_garments_dir=shipped, garments_dir=Path(folder), threads=options.threads)
        drapery = DrapeRuntime(settings)
    until_s, frames = time.monotonic() + 0.1 * options.seconds, 0
    rows, failed = soak_rows(count=options.rows, until_s=until_s, seed=options.seed)
    if failed is None:
        until_s = time.monotonic() + 0.9 * options.seconds
        frames, failed = soak_frames(drapery, count=options.frames, until_s=until_s, seed=options.seed)
    drapery.close()
    run.rows.append({"frames": frames, "rows": rows, "failed": failed})
    run.extra |= {"seed": options.seed, "garment": options.garment}
    run.failed = failed is not None


if __name__ == "__main__":
    main.command()
