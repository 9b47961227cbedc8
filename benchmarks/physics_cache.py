"""Physics optima on disk, so that evaluating several models minimises each drape once.

A file is named by the hash of all that its numbers depend on: rest mesh, skin weights, poses,
material, body, step limit, and the source of the minimiser, the energies and the contact. So a
change of any of them misses, and nothing is ever stale; the folder can be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from types import ModuleType

import numpy as np

from benchmarks import common, physics
from benchmarks.physics import Optimum
from drape.body import model
from drape.cloth import contact, energies
from drape.cloth.material import Material
from drape.garment.cache import Garment
from drape.geometry import meshes, rigid, rotations, skinning

CACHE_DIR = common.ROOT / "runs" / "physics_cache"  # ignored by git
SOURCES: tuple[ModuleType, ...] = (physics, energies, contact, model, meshes, rigid, rotations, skinning)


def cache_key(
    garment: Garment, body: model.BodyModel, poses: np.ndarray, material: Material, step_limit: int, tolerance: float
) -> str:
    """Hash of what an optimum depends on, hexadecimal; its start follows from garment, body and poses."""
    digest = hashlib.sha256()
    settings = [body.digest, asdict(material), step_limit, tolerance]
    digest.update(json.dumps(settings, sort_keys=True).encode())
    for array in (garment.vertices, garment.fine_faces, garment.skin_weights, poses):
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    for module in SOURCES:
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


def cached(key: str, minimise: Callable[[], Optimum], folder: Path | None) -> tuple[Optimum, bool]:
    """The optimum stored under ``key`` in ``folder`` and True, or that of ``minimise``, which is stored, and False.

    ``folder`` None neither reads nor writes. A file that cannot be read is made again.
    """
    if folder is None:
        return minimise(), False
    path = folder / f"{key}.npz"
    stored = _read(path)
    if stored is not None:
        return stored, True
    optimum = minimise()
    _write(path, optimum)
    return optimum, False


def _read(path: Path) -> Optimum | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            return Optimum(
                vertices=stored["vertices"],
                residual_n=stored["residual_n"],
                change=stored["change"],
                steps=stored["steps"],
                seconds=float(stored["seconds"]),
            )
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        print(f"physics cache: {path.name} cannot be read ({error}); minimising again", flush=True)
        return None


def _write(path: Path, optimum: Optimum) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    with open(temporary, "wb") as stream:
        np.savez_compressed(stream, **{item.name: getattr(optimum, item.name) for item in fields(Optimum)})
    os.replace(temporary, path)
