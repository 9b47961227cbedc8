"""Writes a checkpoint as a model folder: its ONNX graphs and a manifest, published only when parity holds."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from drape.artifacts import GraphSpec, Manifest, load_manifest, read_parameters, staged_folder
from drape.body.assets import DEFAULT_BODY, load_body
from drape.garment.cache import Garment
from model_export.onnx_file import write_graph
from model_export.packed.graph import FirstGraph, first_outputs, write_packed
from model_export.parity import (
    TOLERANCE_M,
    check_parity,
    packed_parity_error,
    parity_error,
    push_parity_error,
    sequence_error,
)
from model_export.push.push_graphs import PUSHES, write_push
from model_export.readable_graphs import (
    DrapeGraph,
    DynamicGraph,
    EncoderGraph,
    drape_inputs,
    drape_outputs,
    dynamic_inputs,
    dynamic_outputs,
    encoder_inputs,
    encoder_outputs,
)
from model_export.shared_weights import share_weights
from training import checkpoint
from training.onefit import OneFit


def load_model(path: Path) -> tuple[OneFit, dict[str, Any]]:
    """Returns the network of the checkpoint at ``path``, in evaluation mode, and the manifest's entry on its training:
    steps, frames, minutes, garments, and what was held out.

    Raises ``ArtifactError`` where the file is no checkpoint.
    """
    state, config = checkpoint.load_checkpoint(path)
    model = OneFit(config.model)
    model.load_state_dict(state["model"])
    minutes = round(float(state["elapsed_s"]) / 60.0, 1)
    frames = int(state.get("frames", int(state["step"]) * config.frames_per_step))
    return model.eval(), {
        "steps": int(state["step"]),
        "frames": frames,
        "minutes": minutes,
        "garments": [Path(name).stem for name in config.data.garments],  # a file without its folder
        "held_out": list(config.data.held_out),
        **({"held_out_fabrics": list(config.data.held_out_fabrics)} if config.model.fabric else {}),
    }


def export(
    model: OneFit,
    target: Path,
    *,
    garment: Garment,
    training: dict[str, Any],
    quality: list[dict[str, Any]] | None = None,
) -> Manifest:
    """Writes ``model`` as the model folder ``target`` and returns its manifest, which holds ``training`` and the rows
    ``quality``.

    Raises ``ArtifactError`` where a vertex of ``garment``, draped by torch and by ONNX Runtime, differs by more than
    ``TOLERANCE_M``. The folder then stays as it was.
    """
    model.eval()
    with staged_folder(target) as staged:
        graphs, weights = share_weights(staged, write_graphs(model, staged), parameters(model))
        encoder, drape = (staged / graphs[name].file for name in ("garment_encoder", "drape"))
        error = parity_error(model, encoder, drape, garment)
        if "packed" in graphs:
            error = max(error, packed_parity_error(model, encoder, staged / graphs["packed"].file, garment))
        if model.config.dynamic:
            error = max(error, sequence_error(model, staged, graphs, garment))
        error = max(error, push_parity_error(staged, garment))
        check_parity("parity", error, TOLERANCE_M, "between torch and onnxruntime")
        manifest = Manifest(
            name=target.name,
            graphs=graphs,
            body=DEFAULT_BODY,
            body_digest=load_body().digest,
            embedding_size=model.config.embedding_size,
            parity_error_m=error,
            dynamic=model.config.dynamic,
            state_size=model.config.state_size if model.config.dynamic else 0,
            training=training,
            quality=quality or [],
            network=sizes(model),
            weights=weights,
        )
        (staged / "manifest.json").write_text(manifest.to_json())
    return manifest


def static_training(model: OneFit, folder: Path) -> dict[str, Any]:
    """Returns {"static": entry} for a dynamic ``model``: what the manifest in ``folder`` says of the training of its
    static network.

    Returns {} for a static ``model``, and where ``folder`` has other static weights or no model.
    """
    if not model.config.dynamic or not (folder / "manifest.json").is_file():
        return {}
    manifest = load_manifest(folder)
    theirs = read_parameters(folder, manifest.weights) if manifest.weights is not None else {}
    ours = {name: value for name, value in parameters(model).items() if not name.startswith("dynamic.")}
    if not all(name in theirs and np.array_equal(theirs[name], value) for name, value in ours.items()):
        return {}
    return {"static": manifest.training.get("static", manifest.training)}


def sizes(model: OneFit) -> dict[str, Any]:
    """Returns the fields of the configuration of ``model`` by name, with lists for tuples, as JSON has them."""
    fields = asdict(model.config)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}


def parameters(model: OneFit) -> dict[str, np.ndarray]:
    """Returns the parameters and buffers of ``model`` by their names in its state; the arrays share their memory."""
    return {name: value.numpy() for name, value in model.state_dict().items()}


def write_graphs(model: OneFit, folder: Path) -> dict[str, GraphSpec]:
    """Writes every graph of ``model`` into ``folder`` as ``NAME.onnx``; returns the manifest's entries by name.

    Only a network of vector jets has the graph "packed", and only a dynamic one "dynamic_encoder".
    """
    packs = model.config.vector
    encoder = (FirstGraph(model), first_outputs(model)) if packs else (EncoderGraph(model), encoder_outputs(model))
    parts = {
        "garment_encoder": (encoder[0], encoder_inputs(model), encoder[1]),
        "drape": (DrapeGraph(model), drape_inputs(model), drape_outputs(model)),
    }
    if model.config.dynamic:
        parts["dynamic_encoder"] = DynamicGraph(model), dynamic_inputs(model), dynamic_outputs(model)
    graphs = {key: write_graph(part[0], folder / f"{key}.onnx", *part[1:]) for key, part in parts.items()}
    if packs:
        graphs["packed"] = write_packed(model, folder / "packed.onnx")
    return graphs | {name: write_push(name, folder) for name in PUSHES}


def commit() -> str:
    """Returns the short hash of the commit that is checked out, or "unknown" outside a checkout."""
    import subprocess

    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def command_line() -> str:
    """Returns the command line of this program, each path in it cut to its last part."""
    return " ".join(["python -m model_export", *(Path(a).name if "/" in a else a for a in sys.argv[1:])])
