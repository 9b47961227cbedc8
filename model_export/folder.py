"""Changes to a model folder that stands: its quality table, the push-out's graphs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from drape.artifacts import GraphSpec, Manifest, load_manifest, read_parameters, staged_folder
from drape.files.atomic import whole_file
from drape.garment.cache import Garment
from model_export.parity import TOLERANCE_M, check_parity, push_parity_error
from model_export.push.push_graphs import PUSHES, write_push
from model_export.shared_weights import share_weights


def write_quality(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Writes ``rows`` of ``benchmarks.quality`` into the manifest of the model ``folder``, in place of those there."""
    _write_manifest(folder, replace(load_manifest(folder), quality=rows))


def _write_manifest(folder: Path, manifest: Manifest) -> None:
    with whole_file(folder / "manifest.json") as file:
        file.write(manifest.to_json().encode())


def add_push_out(folder: Path, garment: Garment) -> Manifest:
    """Writes the graphs of the push-out into the model ``folder``, which exists; returns its new manifest. The results
    of its other graphs keep every bit.

    Raises ``ArtifactError`` where these graphs and NumPy move a vertex of ``garment`` to places more than
    ``TOLERANCE_M`` apart. The folder then stays as it was.
    """
    manifest = load_manifest(folder)
    with staged_folder(folder) as staged:
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        specs = {name: write_push(name, staged) for name in PUSHES}
        error = push_parity_error(staged, garment)
        cure = "Do not ship this graph; find the operator that differs."
        check_parity("push_out parity", error, TOLERANCE_M, "between numpy and onnxruntime", cure=cure)
        return _with_graphs(staged, replace(manifest, parity_error_m=max(error, manifest.parity_error_m)), specs)


def _with_graphs(folder: Path, manifest: Manifest, specs: dict[str, GraphSpec]) -> Manifest:
    """Returns ``manifest`` with the graphs ``specs`` added, whose files lie in ``folder``; it is written there too."""
    parameters = read_parameters(folder, manifest.weights) if manifest.weights is not None else None
    graphs, weights = share_weights(folder, manifest.graphs | specs, parameters)
    changed = replace(manifest, graphs=graphs, weights=weights)
    _write_manifest(folder, changed)
    return changed
