"""A garment draped without a service: the folder of ``service.static`` in Chromium, frame by frame."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.client_folds import LIBRARY, said_in_browser
from drape.motion.clip import MotionClip
from service.app import create_app
from service.compute.drape_runtime import DrapeRuntime
from service.static.folder import Asked, write_folder

SCRIPT = Path(__file__).with_suffix(".mjs")
PAGE = "measured.html"
WAIT_S = 1200.0  # a graphics card in software takes seconds a frame
# A graphics card that is none, for WebGPU where there is no other.
SOFTWARE_CARD = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan")


@dataclass(frozen=True, eq=False)
class Draped:
    """What a browser made: ``vertices`` [m] (F, V, 3), what each frame took [ms], and the network of it; how long it
    took to begin, and what it ``told`` of where it computes."""

    vertices: np.ndarray
    frame_ms: np.ndarray
    network_ms: np.ndarray
    start_ms: float
    told: dict[str, Any]


def write_static(runtime: DrapeRuntime, asked: Asked, target: Path) -> None:
    """``write_folder`` of a runtime, which is closed then."""
    asyncio.run(write_folder(create_app(runtime.settings, runtime=runtime), runtime, asked, target))


def draped_in(
    folder: Path,
    browser: str,
    clip: MotionClip,
    *,
    provider: str = "wasm",
    effort: dict[str, Any] | None = None,
    flags: Sequence[str] = ("--disable-gpu",),
) -> Draped:
    """The ``clip`` as the program ``browser`` drapes it with what lies in ``folder``; the library's modules go there.

    ``effort``: options of folds in place of the folder's.
    """
    for source in (*(LIBRARY / "src").glob("*.js"), LIBRARY / "dist/folds.js", SCRIPT):
        shutil.copy(source, folder)
    poses, trans = clip.poses.reshape(-1, 72).tolist(), clip.trans.tolist()
    asked = {"poses": poses, "trans": trans, "fps": clip.fps, "provider": provider, "effort": effort or {}}
    (folder / "asked.json").write_text(json.dumps(asked))
    (folder / PAGE).write_text(f'<!doctype html><script type="module" src="{SCRIPT.name}"></script>')
    said = said_in_browser(folder, browser, flags=flags, page=PAGE, wait_s=WAIT_S)
    if "error" in said:
        raise RuntimeError(said["error"])
    took = np.array(said["took"])
    vertices = np.frombuffer((folder / "vertices.bin").read_bytes(), "<f4").reshape(len(took), -1, 3)
    return Draped(vertices, took[:, 0], took[:, 1], float(said["start_ms"]), said["told"])
