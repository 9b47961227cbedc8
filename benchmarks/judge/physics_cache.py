"""Physics optima and other drapes on disk, so that evaluating several models makes each once.

A file is named by the hash of all that its numbers depend on: rest state, material, posed bodies, starts, charts, step
limit, and the source of the minimiser, its kernels, the energies and the contact. So a change of any of them misses,
and nothing is ever stale; the folder can be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import asdict, fields
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from benchmarks.harness import ROOT
from benchmarks.judge import body_distance, descent, hessian, linear, newton, physics, settling
from benchmarks.judge.physics import Optimum, Task
from drape.cloth import contact, energies, waistband
from drape.geometry import meshes
from drape.kernels import elements, problem
from drape.live import whole

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")
CACHE_DIR = ROOT / "runs" / "physics_cache"  # ignored by git
SOURCES: tuple[ModuleType, ...] = (
    physics, newton, settling, whole, energies, contact, waistband, meshes, body_distance, descent, elements, hessian,
    linear, problem,
)  # fmt: skip


def stored_minimum(task: Task, step_limit: int, folder: Path | None) -> tuple[Optimum, bool]:
    """The optimum of ``task`` in ``step_limit`` steps at most, and whether it was in ``folder``: see ``cached``."""
    key = cache_key(task, step_limit, physics.TOLERANCE)
    return cached(key, lambda: physics.minimise(task, step_limit=step_limit), folder)


def cache_key(task: Task, step_limit: int, tolerance: float) -> str:
    """Hash, hexadecimal, of what an optimum depends on: rest state, fabric, bodies, starts, charts and the method."""
    cloth = [value for item in fields(task.cloth) if isinstance(value := getattr(task.cloth, item.name), np.ndarray)]
    contact = [task.contact.faces, *([] if task.contact.vertices is None else [task.contact.vertices])]
    settings = [asdict(task.material), task.cloth.mean_edge_m, step_limit, tolerance]
    held = [] if task.held is None else list(vars(task.held).values())
    arrays = (*cloth, *contact, task.body_vertices, *task.starts, *(task.charts or ()), *held)
    return key_of(settings, arrays, SOURCES)


def key_of(settings: list[Any], arrays: Iterable[np.ndarray], sources: Iterable[ModuleType]) -> str:
    """Hash, hexadecimal, of ``settings`` that JSON can hold, of ``arrays``, and of the text of the modules."""
    digest = hashlib.sha256()
    digest.update(json.dumps(settings, sort_keys=True).encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    for module in sources:
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


def cached(key: str, make: Callable[[], T], folder: Path | None, *, kind: type[T] = Optimum) -> tuple[T, bool]:
    """The ``kind`` stored under ``key`` in ``folder`` and True, or that of ``make``, which is stored, and False.

    A ``kind`` is a dataclass of arrays and of ``seconds``. ``folder`` None neither reads nor writes. A file that cannot
    be read is made again.
    """
    if folder is None:
        return make(), False
    path = folder / f"{key}.npz"
    stored = _read(path, kind)
    if stored is not None:
        return stored, True
    made = make()
    _write(path, made)
    return made, False


def _read(path: Path, kind: type[T]) -> T | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            found = {item.name: stored[item.name] for item in fields(kind)}
            return kind(**found | {"seconds": float(found["seconds"])})
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        print(f"{path.parent.name}: {path.name} cannot be read ({error}); making it again", flush=True)
        return None


def _write(path: Path, made: DataclassInstance) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    with open(temporary, "wb") as stream:
        np.savez_compressed(stream, **{item.name: getattr(made, item.name) for item in fields(made)})
    os.replace(temporary, path)
