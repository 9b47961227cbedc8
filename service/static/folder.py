"""The folder of one garment that browsers drape by themselves: a page, the network, and what a service would answer.

Answers, the network and ONNX Runtime lie there compressed (.gz), so that any server of files will do. ``about.json``
says which file is what; ``clients/web/lib/src/local.js`` reads it.
"""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.artifacts import staged_folder
from drape.errors import ArtifactError, InputError, Unavailable
from drape.geometry import jets
from drape.wire.options import DrapeOptions
from service.graphs.graph_names import DYNAMIC, PACKED
from service.settings import ROOT
from service.stages.batch import shape_array
from service.stages.network import Network
from service.static.answers import answer
from service.stream.opening import opened

if TYPE_CHECKING:
    from fastapi import FastAPI

    from drape.artifacts import Manifest
    from drape.body.pose_support import PoseSupport
    from service.compute.drape_runtime import DrapeRuntime
    from service.graphs.engine import Engine
    from service.stages.plan import Plan

FORMAT = 1
ABOUT = "about.json"
PAGE = ROOT / "clients/web/static/dist"
ORT = ROOT / "clients/web/node_modules/onnxruntime-web"
# Its module and its binary by where the network is computed: on processors, and on graphics cards besides.
RUNTIMES = {
    "wasm": ("ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm"),
    "webgpu": ("ort.webgpu.bundle.min.mjs", "ort-wasm-simd-threaded.asyncify.wasm"),
}
JSON, BINARY, GLB = "application/json", "application/octet-stream", "model/gltf-binary"
LEVEL = 6  # of compression


@dataclass(frozen=True)
class Asked:
    """The garment, the clips that the folder holds, how it is draped, and the shape of the body.

    ``webgpu``: for graphics cards too.
    """

    garment: str
    motions: tuple[str, ...]
    options: DrapeOptions = field(default_factory=DrapeOptions)
    betas: tuple[float, ...] = ()
    webgpu: bool = True


@dataclass(frozen=True, eq=False)
class Folder:
    """A folder that is being written."""

    path: Path

    def add(self, name: str, content: bytes) -> str:
        """Writes ``content`` compressed; returns the name of its file."""
        file = f"{name}.gz"
        (self.path / file).write_bytes(gzip.compress(content, LEVEL, mtime=0))
        return file


async def write_folder(app: FastAPI, runtime: DrapeRuntime, asked: Asked, target: Path) -> None:
    """Writes the folder ``target`` for what is ``asked``; ``app`` is the service around ``runtime``.

    Refuses what a client cannot drape by itself (``InputError``, ``ArtifactError``), a folder that is there and holds
    something else, and a page that has not been built (``Unavailable``).
    """
    if target.exists() and not is_ours(target):
        raise InputError(str(target), expected="a new folder", got="one with other files", cure="Name another folder.")
    check_built(webgpu=asked.webgpu)
    entry, shape = runtime.garments.get(asked.garment), shape_array(asked.betas, runtime.body)
    for motion in asked.motions:
        runtime.motions.get(motion)
    chosen = asked.options.model_copy(update={"geometry": "jets", "folds_by": "client", "resolution": "fine"})
    async with app.router.lifespan_context(app):
        plan = runtime.plan(entry, chosen, messages=True)
        check_jets(runtime.engine.manifest)
        runtime.add_missing(plan)
        with staged_folder(target) as path:
            folder = Folder(path)
            shutil.copytree(PAGE, path, dirs_exist_ok=True)
            about = {
                "format": FORMAT,
                "garment": entry.id,
                "options": asked.options.model_dump(mode="json", exclude_unset=True) | {"betas": asked.betas},
                "joints": runtime.body.rest_joints(shape).tolist(),
                "opened": json.loads(opened(plan, app.state.drape, None)),
                "answers": {name: folder.add(*file) async for name, file in _answers(app, asked)},
                "network": _add_network(folder, runtime.engine, plan, shape),
                "novelty": _add_poses(folder, runtime.engine.pose_support),
                "runtime": _add_runtimes(path, webgpu=asked.webgpu),
            }
            (path / ABOUT).write_text(json.dumps(about, indent=1))


def is_ours(target: Path) -> bool:
    """Whether ``target`` is an empty folder or one that this module has written: such a one may be replaced."""
    try:
        about = json.loads((target / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return target.is_dir() and not any(target.iterdir())
    return isinstance(about, dict) and {"format", "garment", "answers", "network"} <= about.keys()


def check_built(*, webgpu: bool) -> None:
    """Refuses (``Unavailable``) where the page or ONNX Runtime for browsers is not there."""
    needed = [PAGE / "index.html", *(ORT / "dist" / name for kind in _kinds(webgpu) for name in RUNTIMES[kind])]
    missing = [path for path in needed if not path.is_file()]
    if missing:
        got = f"no {missing[0].relative_to(ROOT)}"
        raise Unavailable("page without a service", expected="its build", got=got, cure="Run make page.")


def _kinds(webgpu: bool) -> list[str]:
    return [kind for kind in RUNTIMES if webgpu or kind != "webgpu"]


def check_jets(manifest: Manifest) -> None:
    """Refuses a model whose jets are not those of the wire: the client reads them as the graph gives them."""
    (jet,) = (tensor for tensor in manifest.graphs[PACKED].outputs if tensor.name == "jet")
    if jet.shape[-1] != jets.FULL_COUNT:
        raise ArtifactError(
            f"{manifest.name} jet",
            expected=f"{jets.FULL_COUNT} numbers a patch",
            got=str(jet.shape[-1]),
            cure="Export a model with a closing fit.",
        )


async def _answers(app: FastAPI, asked: Asked) -> AsyncIterator[tuple[str, tuple[str, bytes]]]:
    """What the client asks a service for: the path without its query, and (name of a file, content)."""
    garment, betas = f"/garments/{asked.garment}", ",".join(str(beta) for beta in asked.betas)
    fabric = asked.options.fabric if isinstance(asked.options.fabric, str) else ""
    wanted = {
        f"{garment}/mesh": (f"{garment}/mesh?resolution=fine", JSON, "mesh.json"),
        f"{garment}/jets": (f"{garment}/jets?resolution=fine", BINARY, "layout.bin"),
        f"{garment}/folds": (f"{garment}/folds?resolution=fine&fabric={fabric}&betas={betas}", BINARY, "folds.bin"),
        garment: (garment, JSON, "garment.json"),
        "/health": ("/health", JSON, "health.json"),
        "/fabrics": ("/fabrics", JSON, "fabrics.json"),
        "/tiers": ("/tiers", JSON, "tiers.json"),
    }
    body = json.loads(await answer(app, "/health", JSON))["body"]
    wanted[f"/bodies/{body}"] = (f"/bodies/{body}?betas={betas}", JSON, "body.json")
    wanted[f"/bodies/{body}/mesh"] = (f"/bodies/{body}/mesh?betas={betas}", GLB, "body.glb")
    for motion in asked.motions:
        wanted[f"/motions/{motion}"] = (f"/motions/{motion}?betas={betas}", JSON, f"motion-{motion}.json")
    for name, (path, kind, file) in wanted.items():
        yield name, (file, await answer(app, path, kind))
    for name, ids in (("/garments", [asked.garment]), ("/motions", asked.motions)):
        every = {one["id"]: one for one in json.loads(await answer(app, name, JSON))}
        yield name, (f"{name[1:]}.json", json.dumps([every[one] for one in ids]).encode())


def _add_network(folder: Folder, engine: Engine, plan: Plan, shape: np.ndarray) -> dict[str, Any]:
    """Writes the graphs: the garment's, and that of motion."""
    network = next(stage for stage in plan.stages if isinstance(stage, Network))
    files = {"graph": folder.add("network.onnx", network.whole_model(plan, shape))}
    if engine.dynamic:
        files["motion"] = folder.add("motion.onnx", engine.whole_cut(DYNAMIC, ("dynamic_code", "next_state"), {}))
    return {**files, "code": engine.code_size, "state": engine.state_size}


def _add_poses(folder: Folder, support: PoseSupport | None) -> dict[str, Any] | None:
    """Writes the poses of training, int8, row after row of each part (``drape.body.pose_support``)."""
    if support is None:
        return None
    parts = (support.legs, support.trunk, support.tilt)
    file = folder.add("poses.bin", b"".join(part.astype(np.int8).tobytes() for part in parts))
    return {"file": file, "rows": [len(part) for part in parts], "limits": support.limits.tolist()}


def _add_runtimes(path: Path, *, webgpu: bool) -> dict[str, dict[str, str]]:
    """Writes ONNX Runtime's modules as they are, since those load themselves as workers, and its binaries."""
    found = {}
    for kind in _kinds(webgpu):
        module, binary = RUNTIMES[kind]
        shutil.copy(ORT / "dist" / module, path)
        found[kind] = {"module": module, "binary": Folder(path).add(binary, (ORT / "dist" / binary).read_bytes())}
    return found


def sizes(folder: Path) -> dict[str, int]:
    """Bytes of the files in ``folder``, by name."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}


def loaded(folder: Path, kind: str) -> Iterator[str]:
    """Names of the files in ``folder`` that a browser loads which computes on ``kind``, "wasm" or "webgpu"."""
    about = json.loads((folder / ABOUT).read_text())
    others = {name for key in about["runtime"] if key != kind for name in about["runtime"][key].values()}
    return (name for name in sizes(folder) if name not in others)
