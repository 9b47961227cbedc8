"""Writes a checkpoint as a model folder: its ONNX graphs and a manifest, published only when parity holds."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import nn

from drape.artifacts import GraphSpec, Manifest, TensorSpec, file_digest, load_manifest, read_parameters, staged_folder
from drape.body.assets import DEFAULT_BODY, load_body
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from model_export import packed, packed_specs
from model_export.graph import (
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
from model_export.half import HALF, LARGEST_ERROR_M, LEAST, halve_matrices
from model_export.layer_graph import SAMPLE as LAYER_SAMPLE
from model_export.layer_graph import LayerGraph, layer_inputs, layer_parity_error
from model_export.packed import FirstGraph, PackedGraph
from model_export.packed_parity import packed_parity_error
from model_export.packed_specs import first_outputs, packed_inputs
from model_export.parity import TOLERANCE_M, check_parity, parity_error, sequence_error
from model_export.push_graph import OUTPUTS, PushGraph, push_inputs, push_parity_error
from model_export.push_graph import SAMPLE as PUSH_SAMPLE
from model_export.rounded import ROUNDED, Wide, round_matrices
from model_export.shared_weights import forget_origin, share_weights
from training import checkpoint
from training.model import OneFit

OPSET = 20
# Odd, and unlike each other: an axis of length 1 or two equal axes would be baked in without a word.
SAMPLE = {"frames": 3, "patches": 7, "vertices": 11, "points": 13, "clients": 5, "anchors": 17, "regions": 19}
LIMIT = {"frames": 65536, "patches": 65536, "vertices": 1 << 22, "points": 65536, "clients": 65536, "anchors": 1 << 20}
MOST = 1 << 22
ZERO_TYPES = {
    "int16": torch.int16, "int32": torch.int32, "int64": torch.int64, "uint8": torch.uint8, "float16": torch.float16,
}  # fmt: skip


def load_model(path: Path) -> tuple[OneFit, dict[str, Any]]:
    """The network of a checkpoint in evaluation mode, and what the manifest says of its training."""
    state, config = checkpoint.load(path)
    model = OneFit(config.model)
    model.load_state_dict(state["model"])
    minutes = round(float(state["elapsed_s"]) / 60.0, 1)
    frames = int(state.get("frames", int(state["step"]) * config.frames_per_step))
    return model.eval(), {
        "steps": int(state["step"]),
        "frames": frames,
        "minutes": minutes,
        "garments": [Path(name).stem for name in config.data.garments],  # of files not the folder
        "held_out": list(config.data.held_out),
    }


def export(
    model: OneFit,
    target: Path,
    *,
    garment: Garment,
    training: dict[str, Any],
    quality: list[dict[str, Any]] | None = None,
) -> Manifest:
    """Writes ``target`` and returns its manifest; refuses above ``TOLERANCE_M`` and leaves the old folder then."""
    model.eval()
    with staged_folder(target) as staged:
        graphs, weights = share_weights(staged, write_graphs(model, staged), parameters(model))
        encoder, drape = (staged / graphs[name].file for name in ("garment_encoder", "drape"))
        error = parity_error(model, encoder, drape, garment)
        if "packed" in graphs:
            error = max(error, packed_parity_error(model, encoder, staged / graphs["packed"].file, garment))
        if model.config.dynamic:
            error = max(error, sequence_error(model, staged, graphs, garment))
        error = max(error, push_parity_error(staged / graphs["push_out"].file, garment))
        error = max(error, layer_parity_error(staged / graphs["push_over"].file, garment))
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
    """What is to be told of the training of the static part of a dynamic ``model``, under "static": what the model in
    ``folder`` says of its own, where its weights are the same; nothing otherwise."""
    if not model.config.dynamic or not (folder / "manifest.json").is_file():
        return {}
    manifest = load_manifest(folder)
    kept = read_parameters(folder, manifest.weights) if manifest.weights is not None else {}
    ours = {name: value for name, value in parameters(model).items() if not name.startswith("dynamic.")}
    if not all(name in kept and np.array_equal(kept[name], value) for name, value in ours.items()):
        return {}
    return {"static": manifest.training.get("static", manifest.training)}


def sizes(model: OneFit) -> dict[str, Any]:
    """The configuration of ``model`` in the values that JSON has: lists for tuples."""
    found = asdict(model.config)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in found.items()}


def parameters(model: OneFit) -> dict[str, np.ndarray]:
    """Everything that the state of ``model`` holds, by name."""
    return {name: value.numpy() for name, value in model.state_dict().items()}


def write_graphs(model: OneFit, folder: Path) -> dict[str, GraphSpec]:
    """Writes every graph of ``model`` into ``folder``; the packed one where its representation is vector jets."""
    packs = model.config.variant == "vector"
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
    return graphs | {name: write(folder / f"{name}.onnx") for name, write in PUSHES.items()}


def write_quality(folder: Path, rows: list[dict[str, Any]]) -> None:
    """Replaces the quality table of an exported model; its graphs stay as they are."""
    _write_manifest(folder, replace(load_manifest(folder), quality=rows))


def _write_manifest(folder: Path, manifest: Manifest) -> None:
    temporary = folder / "manifest.json.part"
    temporary.write_text(manifest.to_json())
    os.replace(temporary, folder / "manifest.json")


def write_graph(
    module: nn.Module,
    path: Path,
    inputs: tuple[TensorSpec, ...],
    outputs: tuple[TensorSpec, ...],
    *,
    sample: dict[str, int] = SAMPLE,
    translations: dict[Callable, Callable] | None = None,
) -> GraphSpec:
    """Writes ``module`` as the ONNX file ``path`` whose named axes are symbolic, and what the manifest says of it."""
    samples, dynamic = {}, {}
    axes = {name: torch.export.Dim(name, min=1, max=LIMIT.get(name, MOST)) for name in sample}
    for spec in inputs:
        shape = tuple(sample[axis] if isinstance(axis, str) else axis for axis in spec.shape)
        # Index inputs must be valid indices of the sample; zeros always are.
        kind = ZERO_TYPES.get(spec.dtype)
        samples[spec.name] = torch.rand(shape) if kind is None else torch.zeros(shape, dtype=kind)
        dynamic[spec.name] = {i: axes[axis] for i, axis in enumerate(spec.shape) if isinstance(axis, str)}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of packages that are not needed here
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own deprecation notices
        program = torch.onnx.export(
            module, kwargs=samples, dynamo=True, opset_version=OPSET, input_names=[s.name for s in inputs],
            output_names=[s.name for s in outputs], dynamic_shapes=dynamic, optimize=True, verbose=False,
            custom_translation_table=translations,
        )  # fmt: skip
    assert program is not None
    proto = program.model_proto
    _check_symbolic(proto, inputs, outputs, path.name)
    forget_origin(proto)
    onnx.checker.check_model(proto)
    onnx.save(proto, str(path))
    return GraphSpec(path.name, file_digest(path), OPSET, inputs, outputs)


def write_packed(model: OneFit, path: Path) -> GraphSpec:
    """Writes the packed graph of ``model`` (vector jets only)."""
    return write_graph(
        PackedGraph(model).eval(),
        path,
        packed_inputs(model),
        packed_specs.packed_outputs(model),
        sample=packed_specs.SAMPLE,
        translations=packed.TRANSLATIONS,
    )


def write_push_out(path: Path) -> GraphSpec:
    """Writes the push-out, which is the same for every model: exported once, then copied."""
    content, spec = _exported(PushGraph, push_inputs, OUTPUTS, frozenset(PUSH_SAMPLE.items()))
    path.write_bytes(content)
    return replace(spec, file=path.name)


def write_push_over(path: Path) -> GraphSpec:
    """Writes the push-out of garments over others, likewise."""
    content, spec = _exported(LayerGraph, layer_inputs, OUTPUTS, frozenset(LAYER_SAMPLE.items()))
    path.write_bytes(content)
    return replace(spec, file=path.name)


PUSHES = {"push_out": write_push_out, "push_over": write_push_over}


@lru_cache(maxsize=2)
def _exported(
    module: Callable[[], nn.Module],
    inputs: Callable[[], tuple[TensorSpec, ...]],
    outputs: tuple[TensorSpec, ...],
    sample: frozenset[tuple[str, int]],
) -> tuple[bytes, GraphSpec]:
    with tempfile.TemporaryDirectory(prefix="push-out-") as folder:
        path = Path(folder) / "push.onnx"
        spec = write_graph(module(), path, inputs(), outputs, sample=dict(sample), translations=packed.TRANSLATIONS)
        return path.read_bytes(), spec


def add_push_out(folder: Path, garment: Garment) -> Manifest:
    """Writes the push-out's graphs into a model folder that stands; its other graphs compute what they did."""
    manifest = load_manifest(folder)
    with staged_folder(folder) as staged:
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        specs = {name: write(staged / f"{name}.onnx") for name, write in PUSHES.items()}
        files = {name: staged / spec.file for name, spec in specs.items()}
        error = max(push_parity_error(files["push_out"], garment), layer_parity_error(files["push_over"], garment))
        cure = "Do not ship this graph; find the operator that differs."
        check_parity("push_out parity", error, TOLERANCE_M, "between numpy and onnxruntime", cure=cure)
        return _with_graphs(staged, replace(manifest, parity_error_m=max(error, manifest.parity_error_m)), specs)


def add_int8(folder: Path, layers: Mapping[str, Wide]) -> Manifest:
    """Writes the packed graph with ``layers`` in int8 into a model folder that stands, as a graph beside the others."""
    return _add_packed(folder, ROUNDED, lambda proto: round_matrices(proto, layers))


def add_half(folder: Path, model: OneFit, garment: Garment, *, least: int = LEAST) -> Manifest:
    """Writes the packed graph with matrices of ``least`` numbers or more in float16, likewise.

    Refuses (``ArtifactError``) where ``garment`` is then draped elsewhere by more than ``LARGEST_ERROR_M``.
    """

    def check(staged: Path, manifest: Manifest) -> None:
        encoder = staged / manifest.graphs["garment_encoder"].file
        error = packed_parity_error(model, encoder, staged / f"{HALF}.onnx", garment)
        cure = "Export without it (--no-half)."
        check_parity("packed graph in float16", error, LARGEST_ERROR_M, "from torch in float32", cure=cure)

    return _add_packed(folder, HALF, lambda proto: halve_matrices(proto, least=least), check)


def _add_packed(
    folder: Path,
    name: str,
    change: Callable[[onnx.ModelProto], object],
    check: Callable[[Path, Manifest], None] = lambda staged, manifest: None,
) -> Manifest:
    """Writes the packed graph after ``change`` into ``folder`` as the graph ``name``, if it passes ``check``."""
    manifest = load_manifest(folder)
    with staged_folder(folder) as staged:
        shutil.copytree(folder, staged, dirs_exist_ok=True)
        packed_spec = manifest.graphs["packed"]
        proto = onnx.load(str(staged / packed_spec.file))
        change(proto)
        onnx.checker.check_model(proto)
        path = staged / f"{name}.onnx"
        onnx.save(proto, str(path))
        spec = replace(packed_spec, file=path.name, sha256=file_digest(path))
        written = _with_graphs(staged, manifest, {name: spec})
        check(staged, written)
        return written


def _with_graphs(folder: Path, manifest: Manifest, specs: dict[str, GraphSpec]) -> Manifest:
    """``manifest`` with the graphs ``specs`` besides, whose files lie in ``folder``, written there."""
    kept = read_parameters(folder, manifest.weights) if manifest.weights is not None else None
    graphs, weights = share_weights(folder, manifest.graphs | specs, kept)
    changed = replace(manifest, graphs=graphs, weights=weights)
    _write_manifest(folder, changed)
    return changed


def _check_symbolic(
    proto: onnx.ModelProto, inputs: tuple[TensorSpec, ...], outputs: tuple[TensorSpec, ...], where: str
) -> None:
    """Raises unless every axis that the specification names is symbolic in the graph, and no other."""
    for specs, values in ((inputs, proto.graph.input), (outputs, proto.graph.output)):
        for spec, value in zip(specs, values, strict=True):
            axes = value.type.tensor_type.shape.dim
            got = tuple(axis.dim_param if axis.HasField("dim_param") else axis.dim_value for axis in axes)
            fits = value.name == spec.name and len(got) == len(spec.shape)
            fits = fits and all(
                isinstance(have, str) if isinstance(want, str) else have == want
                for want, have in zip(spec.shape, got, strict=True)
            )
            if not fits:
                raise ArtifactError(
                    f"{where} {spec.name}",
                    expected=f"shape {spec.shape}",
                    got=f"{value.name} {got}",
                    cure="An axis was baked in at export: use an odd sample size.",
                )


def commit() -> str:
    """The commit of the working tree, or "unknown" outside a checkout."""
    import subprocess

    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def command_line() -> str:
    """How this program was called, without folders of this machine."""
    return " ".join(["python -m model_export", *(Path(a).name if "/" in a else a for a in sys.argv[1:])])
