"""The weights of an exported model, read back from its ONNX graphs, so that training can go on from what is shipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from drape.artifacts import load_manifest
from drape.errors import ArtifactError
from drape.geometry import jets
from training.agreement import TANGENT_COUNT
from training.config import ModelConfig
from training.layers import SURROUNDINGS_COUNT
from training.model import OneFit

DRAPE, ENCODER = "drape", "garment_encoder"
TERMS = sorted((jets.JET_COUNT, TANGENT_COUNT))  # of training.agreement.tangent_terms, a constant and no weight
WITHOUT_BIAS = "decoder.from_surroundings"  # the one layer that the exporter writes without anything that names it


def load_exported(folder: Path) -> tuple[dict[str, Tensor], ModelConfig, tuple[str, ...]]:
    """Weights of the static network in ``folder``, its sizes, and the clips that it was never trained on.

    A recurrent encoder is not read: what is trained from here is the drape of single poses.
    """
    manifest = load_manifest(folder)
    arrays: dict[str, np.ndarray] = {}
    outputs = {spec.name: spec for spec in manifest.graphs[DRAPE].outputs}
    for name, prefix in ((ENCODER, "garment."), (DRAPE, "")):
        graph = onnx.load(str(folder / manifest.graphs[name].file)).graph
        arrays |= {key: value for key, value in _weights(graph).items() if key.startswith(prefix)}
    try:
        config = _sizes(arrays, closing_fit=outputs["jet"].shape[-1] == jets.FULL_COUNT)
        made = OneFit(config).state_dict()
        weights = {key: torch.from_numpy(arrays[key].copy()).reshape(made[key].shape) for key in made}
    except (KeyError, RuntimeError) as error:
        raise ArtifactError(
            f"model {manifest.name}",
            expected="the weights of a draping network",
            got=f"none of {error}",
            cure="Start from the checkpoint.pt of its training.",
        ) from error
    return weights, config, tuple(str(clip) for clip in manifest.training.get("held_out", ()))


def _weights(graph: onnx.GraphProto) -> dict[str, np.ndarray]:
    """Parameters of ``graph`` by their names in the network.

    The exporter keeps the names of biases, and of weights that a Gemm takes as they are. Others are
    transposed for a MatMul and nameless; such a weight belongs to the bias that is added to its product.
    """
    stored = {tensor.name: tensor for tensor in graph.initializer}
    named = {name.removeprefix("model."): numpy_helper.to_array(tensor) for name, tensor in stored.items()}
    added = {
        name: other
        for node in graph.node
        if node.op_type == "Add"
        for name, other in (tuple(node.input), tuple(reversed(node.input)))
        if other in stored
    }
    for node in graph.node:
        if node.op_type == "MatMul" and node.input[1] in stored and not node.input[1].endswith(".weight"):
            bias = added.get(node.output[0], "").removeprefix("model.")
            matrix = numpy_helper.to_array(stored[node.input[1]])
            if bias.endswith(".bias"):
                named[f"{bias.removesuffix('.bias')}.weight"] = matrix.T
            elif sorted(matrix.shape) != TERMS:
                named[f"{WITHOUT_BIAS}.weight"] = matrix.T
    return named


def _sizes(arrays: dict[str, np.ndarray], *, closing_fit: bool) -> ModelConfig:
    """The configuration whose network has these parameters; a closing fit has none."""

    def widths(layers: str) -> list[int]:
        found = {
            key: value for key, value in arrays.items() if key.startswith(f"{layers}.") and key.endswith(".weight")
        }
        return [len(found[key]) for key in sorted(found, key=lambda key: int(key.split(".")[-2]))]

    around = arrays.get(f"{WITHOUT_BIAS}.weight")
    corrected = sorted(key for key in arrays if key.startswith("corrections.") and key.endswith(".0.bias"))
    vector = any(key.startswith("decoder.heads.plane") for key in arrays)
    return ModelConfig(
        patch_feature_count=arrays["garment.first.0.weight"].shape[1],
        body_feature_count=arrays["body.layers.0.weight"].shape[1],
        garment_hidden=len(arrays["garment.first.0.weight"]),
        embedding_size=widths("garment.second")[-1],
        body_hidden=len(arrays["body.layers.0.weight"]),
        body_code_size=widths("body.layers")[-1],
        decoder_sizes=(len(arrays["decoder.from_patch.weight"]), *widths("decoder.trunk")),
        head_sizes=tuple(widths("decoder.heads.height")[:-1]),
        variant="vector" if vector else "paper",
        surroundings=around is not None,
        agreed_base=around is not None and around.shape[1] > SURROUNDINGS_COUNT,
        corrections=len(corrected),
        correction_hidden=len(arrays[corrected[0]]) if corrected else ModelConfig.correction_hidden,
        closing_fit=closing_fit,
    )
