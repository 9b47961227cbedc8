"""Physics optima on disk, so that several models are evaluated against one minimisation.

A file's name is the hash of all that its numbers depend on: rest state, material, posed bodies, starts, charts, step
limit, and the sources of the minimiser, of what it calls in the engine, of the energies and the contact. A change of
any of them misses the file, so that nothing is ever stale; only comments and docstrings of Python may change. The
folder can be deleted at any time.
"""

from __future__ import annotations

import ast
import hashlib
import json
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT
from benchmarks.judge import physics
from benchmarks.judge.physics import Optimum, OptimumTask
from drape.cloth import bending, contact, energies, membrane, problem, waistband
from drape.engine.build import SOURCE
from drape.exact import blended_planes, descent, hessian, linear, newton, settling, surroundings
from drape.files.atomic import whole_file
from drape.geometry import meshes
from drape.live import whole

CACHE_DIR = ROOT / "runs" / "physics_cache"  # ignored by git
MODULES = (
    physics, newton, settling, whole, energies, membrane, bending, contact, waistband, meshes, blended_planes, descent,
    hessian, linear, problem, surroundings,
)  # fmt: skip
HEADERS = ("physics", "linear", "blended_planes", "elements", "grid", "numbers", "vectors")
SOURCES = (*(Path(str(module.__file__)) for module in MODULES), *(SOURCE / f"{name}.hpp" for name in HEADERS))


def stored_minimum(task: OptimumTask, step_limit: int, folder: Path | None) -> tuple[Optimum, bool]:
    """Returns the optimum of ``task`` in ``step_limit`` steps at most, and whether it was in ``folder`` already
    (``cached``)."""
    key = cache_key(task, step_limit, physics.TOLERANCE)
    return cached(key, lambda: physics.minimise(task, step_limit=step_limit), folder)


def cache_key(task: OptimumTask, step_limit: int, tolerance: float) -> str:
    """Returns the hash, hexadecimal, of all that an optimum depends on: rest state, fabric, bodies, starts, charts,
    waistband, and the method with its sources."""
    cloth = [value for item in fields(task.cloth) if isinstance(value := getattr(task.cloth, item.name), np.ndarray)]
    contact = [task.contact.faces, *([] if task.contact.vertices is None else [task.contact.vertices])]
    settings = [asdict(task.material), task.cloth.mean_edge_m, step_limit, tolerance]
    band = [] if task.waistband is None else list(vars(task.waistband).values())
    arrays = (*cloth, *contact, task.body_vertices, *task.starts, *(task.charts or ()), *band)
    return key_of(settings, arrays, SOURCES)


def key_of(settings: list[Any], arrays: Iterable[np.ndarray], sources: Iterable[Path]) -> str:
    """Returns the hash, hexadecimal, of ``settings`` that JSON can hold, of ``arrays`` with their types and shapes, and
    of the files ``sources``, of Python's without comments and docstrings."""
    digest = hashlib.sha256()
    digest.update(json.dumps(settings, sort_keys=True).encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    for source in sources:
        digest.update(_code(source) if source.suffix == ".py" else source.read_bytes())
    return digest.hexdigest()


def _code(path: Path) -> bytes:
    tree = ast.parse(path.read_bytes())
    for node in list(ast.walk(tree)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            del node.body[0]
    return ast.dump(tree).encode()


def cached(key: str, make: Callable[[], Optimum], folder: Path | None) -> tuple[Optimum, bool]:
    """Returns the optimum stored under ``key`` in ``folder`` and True; or else that which ``make`` returns, which is
    then stored, and False.

    With None for ``folder`` nothing is read or stored. A file that cannot be read is replaced.
    """
    if folder is None:
        return make(), False
    path = folder / f"{key}.npz"
    stored = _read(path)
    if stored is not None:
        return stored, True
    optimum = make()
    _write(path, optimum)
    return optimum, False


def _read(path: Path) -> Optimum | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            values: dict[str, Any] = {item.name: stored[item.name] for item in fields(Optimum)}
            values["seconds"] = float(values["seconds"])
            return Optimum(**values)
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        print(f"{path.parent.name}: {path.name} cannot be read ({error}); making it again", flush=True)
        return None


def _write(path: Path, optimum: Optimum) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as stream:
        np.savez_compressed(stream, **{item.name: getattr(optimum, item.name) for item in fields(optimum)})
