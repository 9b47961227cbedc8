"""Changes to a model folder that stands: its quality table, the push-out's graphs, the packed graph in fewer bits."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import onnx

from drape.artifacts import GraphSpec, Manifest, file_digest, load_manifest, read_parameters, staged_folder
from drape.files.atomic import whole_file
from drape.garment.cache import Garment
from model_export.half import HALF, LARGEST_ERROR_M, LEAST, halve_matrices
from model_export.parity import TOLERANCE_M, check_parity, packed_parity_error, push_parity_error
from model_export.push.push_graphs import PUSHES, write_push
from model_export.shared_weights import share_weights
from training.onefit import OneFit


def write_quality(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Replaces the quality table of an exported model; its graphs stay as they are."""
    _write_manifest(folder, replace(load_manifest(folder), quality=rows))


def _write_manifest(folder: Path, manifest: Manifest) -> None:
    with whole_file(folder / "manifest.json") as file:
        file.write(manifest.to_json().encode())


def add_push_out(folder: Path, garment: Garment) -> Manifest:
    """Writes the push-out's graphs into a model folder that exists; no bit of its other graphs' results changes."""
    manifest = load_manifest(folder)
    with staged_folder(folder) as staged:
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        specs = {name: write_push(name, staged) for name in PUSHES}
        error = push_parity_error(staged, garment)
        cure = "Do not ship this graph; find the operator that differs."
        check_parity("push_out parity", error, TOLERANCE_M, "between numpy and onnxruntime", cure=cure)
        return _with_graphs(staged, replace(manifest, parity_error_m=max(error, manifest.parity_error_m)), specs)


def add_half(folder: Path, model: OneFit, garment: Garment, *, least: int = LEAST) -> Manifest:
    """Adds the packed graph with matrices of ``least`` numbers or more in float16 to a model folder that exists.

    Refuses (``ArtifactError``) if that moves a vertex of ``garment`` by more than ``LARGEST_ERROR_M``.
    """
    manifest = load_manifest(folder)
    with staged_folder(folder) as staged:
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        packed_spec = manifest.graphs["packed"]
        proto = onnx.load(str(staged / packed_spec.file))
        halve_matrices(proto, least=least)
        onnx.checker.check_model(proto)
        path = staged / f"{HALF}.onnx"
        onnx.save(proto, str(path))
        spec = replace(packed_spec, file=path.name, sha256=file_digest(path))
        written = _with_graphs(staged, manifest, {HALF: spec})
        error = packed_parity_error(model, staged / manifest.graphs["garment_encoder"].file, path, garment)
        cure = "Export without it (--no-half)."
        check_parity("packed graph in float16", error, LARGEST_ERROR_M, "from torch in float32", cure=cure)
        return written


def _with_graphs(folder: Path, manifest: Manifest, specs: dict[str, GraphSpec]) -> Manifest:
    """``manifest`` with the graphs ``specs`` added, whose files lie in ``folder``; written there."""
    kept = read_parameters(folder, manifest.weights) if manifest.weights is not None else None
    graphs, weights = share_weights(folder, manifest.graphs | specs, kept)
    changed = replace(manifest, graphs=graphs, weights=weights)
    _write_manifest(folder, changed)
    return changed
