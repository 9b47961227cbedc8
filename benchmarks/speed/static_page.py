"""A garment draped without a service: the folder of ``service.static`` in Node.js and Chromium, frame by frame."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.client_folds import LIBRARY, node_here, said_in_browser
from drape.motion.clip import MotionClip
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.static.folder import Asked, write_folder

SCRIPT = Path(__file__).with_suffix(".mjs")
PAGE = "measured.html"


@dataclass(frozen=True, eq=False)
class Draped:
    """What a client made: ``vertices`` [m] (F, V, 3), what each frame took [ms], and the drape of it, without normals;
    how long it took to begin."""

    vertices: np.ndarray
    frame_ms: np.ndarray
    drape_ms: np.ndarray
    start_ms: float


def write_static(runtime: DrapeRuntime, asked: Asked, target: Path) -> None:
    """``write_folder`` of a runtime, which is closed then."""
    asyncio.run(write_folder(create_app(runtime.settings, runtime=runtime), runtime, asked, target))


def draped_in(
    folder: Path, clip: MotionClip, *, browser: str | None = None, effort: dict[str, Any] | None = None
) -> Draped:
    """The ``clip`` as the program ``browser``, or else Node.js, drapes it with what lies in ``folder``; the library's
    modules go there.

    ``effort``: options of folds in place of the folder's. Raises ``Unavailable`` where there is no Node.js.
    """
    for source in (*(LIBRARY / "src").glob("*.js"), SCRIPT):
        shutil.copy(source, folder)
    poses, trans = clip.poses.reshape(-1, 72).tolist(), clip.trans.tolist()
    asked = {"poses": poses, "trans": trans, "fps": clip.fps, "effort": effort or {}}
    (folder / "asked.json").write_text(json.dumps(asked))
    (folder / "package.json").write_text('{"type": "module"}')
    (folder / PAGE).write_text(f'<!doctype html><script type="module" src="{SCRIPT.name}"></script>')
    if browser is None:
        run = subprocess.run([node_here(), str(folder / SCRIPT.name)], capture_output=True, text=True, timeout=300)
        said = json.loads(run.stdout) if run.returncode == 0 else {"error": run.stderr}
    else:
        said = said_in_browser(folder, browser, page=PAGE)
    if "error" in said:
        raise RuntimeError(said["error"])
    took = np.array(said["took"])
    vertices = np.frombuffer((folder / "vertices.bin").read_bytes(), "<f4").reshape(len(took), -1, 3)
    return Draped(vertices, took[:, 0], took[:, 1], float(said["start_ms"]))
