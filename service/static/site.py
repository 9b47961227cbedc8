"""Writes the folder by which browsers drape one garment without a service: page, engine, network and answers.

All but the page is compressed (.gz), so that any server of files will do. ``about.json`` says what each file is, and
``clients/web/lib/src/local.js`` reads it. The answers are those that the service's application gives in this process.
"""

from __future__ import annotations

import asyncio
import gzip
import json
import shutil
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.artifacts import staged_folder
from drape.engine.build import LIBRARIES, WEB
from drape.engine.flat_records import flat_records
from drape.errors import ArtifactError, InputError, Unavailable
from drape.folders import CLONE
from drape.geometry import jets
from drape.inference.graph_names import PACKED
from drape.stages.batch import shape_array
from drape.stages.network import Network
from drape.wire.folds_message import pack_folds
from drape.wire.options import DrapeOptions
from service.settings import page_folder
from service.stream.opening import opening_answer

if TYPE_CHECKING:
    from fastapi import FastAPI

    from drape.artifacts import Manifest
    from drape.body.pose_distance import PoseSupport
    from drape.stages.plan import Plan
    from service.compute.drape_runtime import DrapeRuntime

FORMAT = 3
ABOUT = "about.json"
PAGE = page_folder("static/dist")
ENGINE = (LIBRARIES if CLONE else page_folder("")) / f"{WEB.name}{WEB.suffix}"
JSON, BINARY = "application/json", "application/octet-stream"
COMPRESSION_LEVEL = 6  # of gzip


@dataclass(frozen=True)
class FolderRequest:
    """The contents of a folder by which browsers drape without a service: the id of the garment, the ids of the clips
    (``motions``), the options of the drape, and the body's shape coefficients (S,); () is the mean shape."""

    garment: str
    motions: tuple[str, ...]
    options: DrapeOptions = field(default_factory=DrapeOptions)
    betas: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Folder:
    """The folder ``path``, while files are added to it."""

    path: Path

    def add(self, name: str, content: bytes) -> str:
        """Writes ``content`` compressed by gzip, and returns the file's name: ``name`` and ".gz"."""
        file = f"{name}.gz"
        (self.path / file).write_bytes(gzip.compress(content, COMPRESSION_LEVEL, mtime=0))
        return file


async def write_folder(app: FastAPI, runtime: DrapeRuntime, request: FolderRequest, target: Path) -> None:
    """Writes the folder ``target``, by which browsers drape without a service: the page, the engine, the network of the
    garment that ``request`` names, and the answers of ``app`` that the page needs. ``app`` is the service around
    ``runtime``.

    Refuses options or a model that a browser cannot drape by itself (``InputError``, ``ArtifactError``), a ``target``
    that holds something else (``InputError``), and a page that has not been built (``Unavailable``).
    """
    if target.exists() and not is_ours(target):
        raise InputError(str(target), expected="a new folder", got="one with other files", cure="Name another folder.")
    check_built()
    entry, shape = runtime.garments.get(request.garment), shape_array(request.betas, runtime.body)
    for motion in request.motions:
        runtime.motions.get(motion)
    chosen = request.options.model_copy(update={"geometry": "jets", "folds_by": "client", "resolution": "fine"})
    async with app.router.lifespan_context(app):
        plan = runtime.plan(entry, chosen, messages=True)
        check_jets(runtime.engine.manifest)
        check_inertia(plan.options)
        runtime.add_missing(plan)
        with staged_folder(target) as path:
            folder = Folder(path)
            shutil.copytree(PAGE, path, dirs_exist_ok=True)
            about = {
                "format": FORMAT,
                "garment": entry.id,
                "options": request.options.model_dump(mode="json", exclude_unset=True) | {"betas": request.betas},
                "joints": runtime.body.rest_joints(shape).tolist(),
                "opened": json.loads(opening_answer(plan, app.state.drape, None)),
                "answers": {name: folder.add(*file) async for name, file in _answers(app, request, plan)},
                "engine": folder.add(ENGINE.name, ENGINE.read_bytes()),
                "network": _add_network(folder, plan),
                "novelty": _add_poses(folder, runtime.engine.pose_support),
            }
            (path / ABOUT).write_text(json.dumps(about, indent=1))


def is_ours(target: Path) -> bool:
    """Returns whether ``target`` may be replaced: it is an empty folder, or one that this module has written."""
    try:
        about = json.loads((target / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return target.is_dir() and not any(target.iterdir())
    return isinstance(about, dict) and {"format", "garment", "answers", "network"} <= about.keys()


def check_built() -> None:
    """Refuses (``Unavailable``) where the page or the engine for browsers has not been built."""
    missing = [path for path in (PAGE / "index.html", ENGINE) if not path.is_file()]
    if missing:
        got = f"no {missing[0]}"
        raise Unavailable("page without a service", expected="a build of it", got=got, cure="Run make page.")


def check_inertia(options: DrapeOptions) -> None:
    """Refuses (``InputError``) inertia by the network, because the page moves cloth only by the mesh's own mass."""
    if options.knob and options.advanced.inertia == "network":
        cure = "Leave inertia out, or stream from a service."
        raise InputError("advanced.inertia", expected="mesh without a service", got="network", cure=cure)


def check_jets(manifest: Manifest) -> None:
    """Refuses (``ArtifactError``) a model whose jets have another number of coefficients than a JETS message."""
    (jet,) = (tensor for tensor in manifest.graphs[PACKED].outputs if tensor.name == "jet")
    if jet.shape[-1] != jets.FULL_COUNT:
        raise ArtifactError(
            f"{manifest.name} jet",
            expected=f"{jets.FULL_COUNT} numbers a patch",
            got=str(jet.shape[-1]),
            cure="Export a model with a closing fit.",
        )


async def _answers(app: FastAPI, request: FolderRequest, plan: Plan) -> AsyncIterator[tuple[str, tuple[str, bytes]]]:
    """Yields each answer that the page needs of a service: its path without the query, and (name of a file, body)."""
    garment, betas = f"/garments/{request.garment}", ",".join(str(beta) for beta in request.betas)
    fabric = request.options.fabric if isinstance(request.options.fabric, str) else ""
    chosen = f"fabric={fabric}&betas={betas}&coarse={bool(plan.options.advanced.coarse)}"
    wanted = {
        f"{garment}/mesh": (f"{garment}/mesh?resolution=fine", BINARY, "mesh.bin"),
        f"{garment}/jets": (f"{garment}/jets?resolution=fine", BINARY, "layout.bin"),
        f"{garment}/folds": (f"{garment}/folds?resolution=fine&{chosen}", BINARY, "folds.bin"),
        garment: (garment, JSON, "garment.json"),
        "/health": ("/health", JSON, "health.json"),
        "/fabrics": ("/fabrics", JSON, "fabrics.json"),
        "/tiers": ("/tiers", JSON, "tiers.json"),
    }
    body = json.loads(await ask_application(app, "/health", JSON))["body"]
    wanted[f"/bodies/{body}"] = (f"/bodies/{body}?betas={betas}", JSON, "body.json")
    wanted[f"/bodies/{body}/mesh"] = (f"/bodies/{body}/mesh?betas={betas}", BINARY, "body.bin")
    for motion in request.motions:
        wanted[f"/motions/{motion}"] = (f"/motions/{motion}?betas={betas}", JSON, f"motion-{motion}.json")
    for name, (path, kind, file) in wanted.items():
        yield name, (file, await ask_application(app, path, kind))
    for name, ids in (("/garments", [request.garment]), ("/motions", request.motions)):
        by_id = {entry["id"]: entry for entry in json.loads(await ask_application(app, name, JSON))}
        yield name, (f"{name[1:]}.json", json.dumps([by_id[entry_id] for entry_id in ids]).encode())


def _add_network(folder: Folder, plan: Plan) -> dict[str, str]:
    """Writes the network of the garment, as records of the engine in a FOLDS message. Returns its place."""
    network = next(stage for stage in plan.stages if isinstance(stage, Network))
    return {"file": folder.add("network.bin", pack_folds(*flat_records(network.records(plan))))}


def _add_poses(folder: Folder, support: PoseSupport | None) -> dict[str, Any] | None:
    """Writes the poses of training, int8, row after row of each part (``drape.body.pose_distance``). Returns their
    place, numbers of rows and limits; None for a model without such poses."""
    if support is None:
        return None
    parts = (support.legs, support.trunk, support.tilt)
    file = folder.add("poses.bin", b"".join(part.astype(np.int8).tobytes() for part in parts))
    return {"file": file, "rows": [len(part) for part in parts], "limits": support.limits.tolist()}


def folder_sizes(folder: Path) -> dict[str, int]:
    """Returns the sizes in bytes of the files directly in ``folder``, by name."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}


async def ask_application(app: FastAPI, path: str, kind: str) -> bytes:
    """Returns the body of the answer of ``app`` to GET ``path`` with ``kind`` as Accept header. Raises ``InputError``
    with the fields of the problem document where the status is not 200."""
    address, _, query = path.partition("?")
    scope = {
        "type": "http",
        "method": "GET",
        "path": address,
        "raw_path": address.encode(),
        "query_string": query.encode(),
        "headers": [(b"host", b"127.0.0.1"), (b"accept", kind.encode())],
        "client": ("127.0.0.1", 0),
        "server": ("127.0.0.1", 80),
        "scheme": "http",
        "http_version": "1.1",
        "root_path": "",
        "asgi": {"version": "3.0"},
    }
    sent: list[dict[str, Any]] = []
    incoming = iter([{"type": "http.request", "body": b"", "more_body": False}])

    async def receive() -> dict[str, Any]:
        for message in incoming:
            return message
        return await asyncio.Future()  # the client stays connected

    async def send(message: Any) -> None:
        sent.append(message)

    await app(scope, receive, send)
    body = b"".join(message.get("body", b"") for message in sent)
    if sent[0]["status"] != 200:
        problem = json.loads(body)
        words = {name: str(problem.get(name, "")) for name in ("expected", "got", "cure")}
        raise InputError(str(problem.get("name", path)), **words)
    return body
