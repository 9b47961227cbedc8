"""``drape doctor``: what computes here, a swatch of cloth that it folds for a second, and what is installed where."""

from __future__ import annotations

import os
import platform
import socket
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.engine.library import load, processor_level
from drape.folders import ASSETS
from drape.garment.cache import OWN_GARMENTS_DIR
from drape.live.clock import Frame
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.fold_step import FoldEffort, FoldMemory, fold
from drape.live.skin_walks import NEIGHBOURS, SkinGraph

SIDE, SPACING_M = 21, 0.01
TEST_S = 0.5  # the same frames follow once more
HELD_N_PER_M = 100.0  # stiffness that holds the upper edge
FPS = 30.0
PARTS = {"service": "fastapi", "inference of other models": "onnxruntime", "training and recovery": "torch"}


def processor() -> str:
    """Returns the name of the processor, its level of x86-64 and, if it has them, "tiles" (AMX), separated by
    commas."""
    level, tiles = processor_level()
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = (names or [platform.processor() or platform.machine()])[0]
    return name + (f", x86-64-v{level}" if level else "") + (", tiles" if tiles else "")


def swatch() -> tuple[FoldConstants, np.ndarray]:
    """Returns the constants of a square of cloth that hangs by its upper edge, far from any skin, and its vertices [m]
    (V, 3) float32."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(*[SPACING_M * np.arange(SIDE)] * 2, indexing="ij"))
    vertices = np.stack([x, y, 0.02 * np.sin(60.0 * x)], axis=1)
    corner = np.flatnonzero((np.arange(SIDE * SIDE) % SIDE < SIDE - 1) & (np.arange(SIDE * SIDE) < SIDE * (SIDE - 1)))
    faces = np.concatenate([corner[:, None] + np.array(turn) for turn in ((0, SIDE, SIDE + 1), (0, SIDE + 1, 1))])
    held = np.where(y > y.max() - 0.5 * SPACING_M, HELD_N_PER_M, 0.0)
    graph = SkinGraph(np.zeros((1, NEIGHBOURS), np.int32), np.ones(1), np.zeros((1, 3)))
    nearest = np.zeros(len(vertices), np.int32)
    worn = WornCloth(ClothMesh.from_rest(vertices, faces), Material(), held, graph, nearest, 0.0)
    return FoldConstants.of(worn), vertices.astype(np.float32)


def folded(constants: FoldConstants, vertices: np.ndarray, frames: int, seconds: float) -> tuple[np.ndarray, int]:
    """Returns the vertices [m] (V, 3) of the cloth after frames of folds, and how many frames were computed: at most
    ``frames``, and none is begun later than ``seconds`` [s] after the call."""
    skin = np.tile([10.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], (1, 1))
    memory: FoldMemory | None = None
    out, count, end_s = vertices, 0, time.monotonic() + seconds
    while count < frames and time.monotonic() < end_s:
        frame = Frame(vertices, skin, count / FPS)
        out, memory, _ = fold(constants, memory, frame, FoldEffort(2, cloth_contact=True))
        count += 1
    return out, count


def packages() -> dict[str, str]:
    """Returns for each part of the product, a key of ``PARTS``, the name and the version of the package that it needs,
    or just "-" where that is not installed."""
    versions = {}
    for part, name in PARTS.items():
        try:
            versions[part] = f"{name} {version(name)}"
        except PackageNotFoundError:
            versions[part] = "-"
    return versions


def is_free(port: int) -> bool:
    """Returns whether nobody listens on the TCP ``port`` of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0


def can_write(folder: Path) -> bool:
    """Returns whether files can be made in ``folder``, or the folder itself where it does not exist."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def findings() -> tuple[dict[str, str], list[str]]:
    """Returns facts about the installation by subject, such as "processor" and "self-test", each in words; and a list
    with a sentence for each thing that is wrong, which says how to mend it."""
    wrong: list[str] = []
    forced = os.environ.get("DRAPE_ISA")
    facts = {"processor": processor()}
    facts["engine"] = Path(load()._name).name + (f" (DRAPE_ISA={forced})" if forced else "")
    threads = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    facts |= {"threads": str(threads), "python": platform.python_version()} | packages()
    facts["assets"] = str(ASSETS)
    folder = Path(os.environ.get("DRAPE_GARMENTS_DIR") or OWN_GARMENTS_DIR)  # as the service reads it
    facts["garments of users"] = str(folder)
    if not can_write(folder):
        wrong.append(f"{folder} cannot be written: set DRAPE_GARMENTS_DIR to a folder that can.")
    facts["port 8000"] = "free" if is_free(8000) else "taken"
    if facts["port 8000"] == "taken":
        wrong.append("Somebody listens on port 8000: start with --port, or end that.")
    constants, vertices = swatch()
    first, frames = folded(constants, vertices, sys.maxsize, TEST_S)
    again, _ = folded(constants, vertices, frames, np.inf)
    fine = bool(np.isfinite(first).all()) and np.array_equal(first, again) and not np.array_equal(first, vertices)
    outcome = "and the same again, bit for bit" if fine else "and NOT the same again"
    facts["self-test"] = f"{frames} frames of a swatch of {len(vertices)} vertices in {TEST_S:g} s, {outcome}"
    if not fine:
        wrong.append("The engine does not repeat itself: build or install it anew.")
    return facts, wrong
