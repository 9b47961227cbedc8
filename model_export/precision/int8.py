"""The packed graph with its widest matrices in int8: what processors multiply three times as fast.

A column k of a layer's input x (n, K) is told in steps of ``most[k]`` / 127, a constant, so that a number is rounded
the same way alone and in any batch; beyond ``most`` it is clipped. The steps are in the weights, and every column j of
those (K, N) has a scale of its own:

    y = s_j sum_k (q_k - 128) w_kj + b_j,    q_k = round(127 x_k / most_k) + 128 in 0 .. 255,    w_kj in -63 .. 63

Sixty-three and not 127: processors without the instruction for it add two products in 16 bits, which then hold them, so
that all processors give the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper
from torch import nn

from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.fabric_table import fabric
from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from training.data import BodySource
from training.evaluate import posed_patches
from training.model import OneFit

ROUNDED = "packed_int8"  # its name in a model folder
STEPS, WEIGHT_STEPS, MIDDLE = 127, 63, 128
FABRICS = ("chiffon", "jersey", "denim")
MARGIN = 1.25  # over the largest number seen
POSES = 24


@dataclass(frozen=True, eq=False)
class Wide:
    """A layer to be rounded: its ``weight`` (K, N) and the largest size ``most`` (K,) of each of its inputs."""

    weight: np.ndarray
    most: np.ndarray


def wide_layers(model: OneFit) -> dict[str, nn.Linear]:
    """The first layer of every correction: these hold most of a frame's multiplications.

    The decoder stays as it is: its rounding was felt as jitter (docs/log.md). The rounding of a correction is seen and
    mended by the next one, and the last ones change little.
    """
    firsts = [next(layer for layer in one.children() if isinstance(layer, nn.Linear)) for one in model.corrections]
    return {f"correction_{i}": layer for i, layer in enumerate(firsts)}


def calibrated(model: OneFit, garments: Sequence[Garment], source: BodySource, poses: np.ndarray) -> dict[str, Wide]:
    """Largest inputs of ``wide_layers`` when ``garments`` are draped at ``poses`` (F, 24, 3) [rad], with a margin.

    Networks that know fabrics drape the softest, the stiffest and one between.
    """
    layers = wide_layers(model)
    with _watched(layers) as seen:
        for garment in garments:
            for cloth in [fabric(name) for name in FABRICS] if model.config.fabric else [None]:
                posed_patches(model, garment, source, poses, fabric=cloth)
    return {
        name: Wide(layer.weight.detach().numpy().T.copy(), MARGIN * seen[name].numpy())
        for name, layer in layers.items()
    }


def on_shipped(model: OneFit) -> dict[str, Wide]:
    """``calibrated`` on the shipped garments at hard poses of the shipped clips."""
    body = load_body()
    poses = hard_poses([read_motion(path) for path in find_motions([])], body, POSES).poses
    garments = [open_garment(path, body) for path in find_garments([])]
    return calibrated(model, garments, BodySource(body, device=torch.device("cpu")), poses)


@contextmanager
def _watched(layers: Mapping[str, nn.Linear]) -> Iterator[dict[str, torch.Tensor]]:
    """The largest absolute input of every column of ``layers`` while the context lasts."""
    seen: dict[str, torch.Tensor] = {}

    def watch(name: str):
        def hook(_: nn.Module, inputs: tuple[torch.Tensor, ...]) -> None:
            most = inputs[0].detach().abs().flatten(0, -2).amax(dim=0)
            seen[name] = torch.maximum(seen.get(name, most), most)

        return hook

    handles = [layer.register_forward_pre_hook(watch(name)) for name, layer in layers.items()]
    try:
        yield seen
    finally:
        for handle in handles:
            handle.remove()


def round_matrices(proto: onnx.ModelProto, layers: Mapping[str, Wide]) -> None:
    """Replaces the Gemms of ``proto`` that hold the weights of ``layers``; refuses a graph that lacks one of them."""
    graph = proto.graph
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    left, nodes = dict(layers), []
    for node in graph.node:
        name = _layer_of(node, tensors, left) if node.op_type == "Gemm" else None
        nodes += [node] if name is None else _rounded(node, name, left.pop(name), graph)
    if left:
        raise ArtifactError(
            "packed graph",
            expected=f"a Gemm with the weights of {', '.join(sorted(left))}",
            got="none",
            cure="Export the model again.",
        )
    used = {name for node in nodes for name in node.input}
    kept = [tensor for tensor in graph.initializer if tensor.name in used]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(kept)


def _layer_of(node: onnx.NodeProto, tensors: Mapping[str, onnx.TensorProto], layers: Mapping[str, Wide]) -> str | None:
    """The layer whose weights the matrix of a Gemm are."""
    if node.input[1] not in tensors:
        return None
    matrix = numpy_helper.to_array(tensors[node.input[1]])
    turned = any(attribute.name == "transB" and attribute.i for attribute in node.attribute)
    matrix = matrix.T if turned else matrix
    return next((name for name, layer in layers.items() if np.array_equal(layer.weight, matrix)), None)


def _rounded(node: onnx.NodeProto, name: str, layer: Wide, graph: onnx.GraphProto) -> list[onnx.NodeProto]:
    """The nodes in place of a Gemm, x @ weight + c; their constants are added to ``graph``."""
    most = np.maximum(layer.most, 1e-6)
    scaled = layer.weight * (most / STEPS)[:, None]
    scale = np.maximum(np.abs(scaled).max(axis=0) / WEIGHT_STEPS, 1e-30)
    made = {
        "per_step": (STEPS / most).astype(np.float32),
        "one": np.float32(1.0),
        "middle": np.uint8(MIDDLE),
        "weight": np.rint(scaled / scale).astype(np.int8),
        "zero": np.int8(0),
        "scale": scale.astype(np.float32),
    }
    named = {key: f"rounded_{name}_{key}" for key in made}
    graph.initializer.extend(numpy_helper.from_array(np.asarray(value), named[key]) for key, value in made.items())
    inside = [f"rounded_{name}_{i}" for i in range(5)]
    return [
        helper.make_node("Mul", [node.input[0], named["per_step"]], [inside[0]]),
        helper.make_node("QuantizeLinear", [inside[0], named["one"], named["middle"]], [inside[1]]),
        helper.make_node("MatMulInteger", [inside[1], named["weight"], named["middle"], named["zero"]], [inside[2]]),
        helper.make_node("Cast", [inside[2]], [inside[3]], to=onnx.TensorProto.FLOAT),
        helper.make_node("Mul", [inside[3], named["scale"]], [inside[4]]),
        helper.make_node("Add", [inside[4], node.input[2]], [node.output[0]]),
    ]
