"""A torch module as an ONNX file with fixed names and symbolic axes."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable
from pathlib import Path

import onnx
import torch
from torch import nn

from drape.artifacts import GraphSpec, TensorSpec, file_digest
from drape.errors import ArtifactError
from model_export.shared_weights import forget_origin

OPSET = 20
# Lengths to trace with, of every named axis: primes, unlike each other and every fixed axis. An axis of length 1 or two
# equal axes would be baked in without a word.
SAMPLE = {
    "shapes": 5, "parts": 11, "part_bones": 13, "frames": 17, "all_parts": 23, "cloth_parts": 29, "regions": 31,
    "bodies": 37, "clients": 41, "patches": 43, "stored_patches": 47, "vertices": 53, "anchors": 59, "points": 61,
    "anchor_blocks": 67, "tiles": 71, "stored_tiles": 73, "blocks": 89, "groups": 101, "patch_blocks": 103,
    "under_vertices": 107,
}  # fmt: skip
MOST = 1 << 22


def write_graph(
    module: nn.Module,
    path: Path,
    inputs: tuple[TensorSpec, ...],
    outputs: tuple[TensorSpec, ...],
    *,
    translations: dict[Callable, Callable] | None = None,
) -> GraphSpec:
    """Writes ``module`` as the ONNX file ``path``, with the names and the symbolic axes of ``inputs`` and ``outputs``.
    Returns its entry in the manifest.

    The module takes its inputs as one dictionary by name, as an ONNX session does. ``translations`` are writers of
    ONNX by torch operator. Raises ``ArtifactError`` where the exporter fixed the length of a symbolic axis.
    """
    named = {axis for spec in inputs for axis in spec.shape if isinstance(axis, str)}
    axes = {name: torch.export.Dim(name, min=1, max=MOST) for name in sorted(named)}
    samples, dynamic = {}, {}
    for spec in inputs:
        shape = tuple(SAMPLE[axis] if isinstance(axis, str) else axis for axis in spec.shape)
        # Index inputs must be valid indices of the sample; zeros always are.
        samples[spec.name] = torch.rand(shape) if spec.dtype == "float32" else _zeros(shape, spec.dtype)
        dynamic[spec.name] = {i: axes[axis] for i, axis in enumerate(spec.shape) if isinstance(axis, str)}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of packages that are not needed here
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the exporter's own deprecation notices
        # By keyword: of positional arguments the exporter takes a last dictionary for keywords.
        program = torch.onnx.export(
            module, kwargs={"tensors": samples}, dynamo=True, opset_version=OPSET, input_names=list(samples),
            output_names=[s.name for s in outputs], dynamic_shapes={"tensors": dynamic}, optimize=True, verbose=False,
            custom_translation_table=translations,
        )  # fmt: skip
    assert program is not None
    proto = program.model_proto
    _settle_lengths(proto.graph, inputs)
    _check_symbolic(proto, inputs, outputs, path.name)
    forget_origin(proto)
    onnx.checker.check_model(proto)
    onnx.save(proto, str(path))
    return GraphSpec(path.name, file_digest(path), OPSET, inputs, outputs)


def _zeros(shape: tuple[int, ...], dtype: str) -> torch.Tensor:
    return torch.zeros(shape, dtype=getattr(torch, dtype))


def _settle_lengths(graph: onnx.GraphProto, inputs: tuple[TensorSpec, ...]) -> None:
    """Reads the length of every named axis off the smallest input that has it; the exporter takes any of them.

    Vectors of indices are no source: a graph cut out of this one may lack them, as it may lack large inputs.
    """
    specs = {spec.name: spec for spec in inputs}
    matrices = [spec for spec in inputs if len(spec.shape) > 1 or spec.dtype == "float32"]
    matrices.sort(key=lambda spec: math.prod(SAMPLE[axis] if isinstance(axis, str) else axis for axis in spec.shape))
    for node in graph.node:
        if node.op_type != "Shape" or node.input[0] not in specs:
            continue
        read = {attribute.name: attribute for attribute in node.attribute}
        axis = specs[node.input[0]].shape[read["start"].i]
        assert isinstance(axis, str) and read["end"].i == read["start"].i + 1
        source = next((spec for spec in matrices if axis in spec.shape), specs[node.input[0]])
        place = source.shape.index(axis)
        node.input[0], read["start"].i, read["end"].i = source.name, place, place + 1


def _check_symbolic(
    proto: onnx.ModelProto, inputs: tuple[TensorSpec, ...], outputs: tuple[TensorSpec, ...], file: str
) -> None:
    """Raises unless every axis that the specification names is symbolic in the graph, and no other."""
    for specs, values in ((inputs, proto.graph.input), (outputs, proto.graph.output)):
        for spec, value in zip(specs, values, strict=True):
            axes = value.type.tensor_type.shape.dim
            shape = tuple(axis.dim_param if axis.HasField("dim_param") else axis.dim_value for axis in axes)
            fits = value.name == spec.name and len(shape) == len(spec.shape)
            fits = fits and all(
                isinstance(have, str) if isinstance(want, str) else have == want
                for want, have in zip(spec.shape, shape, strict=True)
            )
            if not fits:
                raise ArtifactError(
                    f"{file} {spec.name}",
                    expected=f"shape {spec.shape}",
                    got=f"{value.name} {shape}",
                    cure="An axis was baked in at export: use an odd sample size.",
                )
