"""The weights of the network as its kernels take them, from the parameters of a model's folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drape.graph.inputs import SLOPE
from drape.kernels.tiles import aligned
from drape.network.dense import BodyLayer, Layer, body_layer, layer


class Corrections(NamedTuple):
    """One layer of all n corrections, which have one size: ``Layer``'s arrays with an axis of corrections before."""

    weight: np.ndarray
    bias: np.ndarray
    slope: np.floating
    tiles: np.ndarray


class Weights(NamedTuple):
    """The weights: of the body's features, of its code (``body``, then ``from_body``), of the surroundings of a patch,
    of the trunk and the heads, and the two layers of all corrections."""

    mean: np.ndarray
    inverse_deviation: np.ndarray
    body: tuple[BodyLayer, ...]
    from_body: BodyLayer
    surroundings: Layer
    trunk: tuple[Layer, ...]
    heads: tuple[Layer, ...]
    corrections: tuple[Corrections, Corrections]


def weights_of(parameters: Mapping[str, np.ndarray], output_gain: float) -> Weights:
    """The weights of ``parameters`` by their names in training; ``output_gain`` is the factor of jets."""
    decoder = "decoder."
    nothing = np.zeros(len(parameters[decoder + "from_surroundings.weight"]), np.float32)
    heads = [_layers(parameters, f"{decoder}heads.{name}.") for name in ("plane", "height")]
    trunk = _layers(parameters, decoder + "trunk.")
    return Weights(
        parameters["body.standardise.mean"],
        parameters["body.standardise.inverse_deviation"],
        tuple(body_layer(*each) for each in _layers(parameters, "body.layers.")),
        body_layer(parameters[decoder + "from_body.weight"]),
        layer(parameters[decoder + "from_surroundings.weight"], nothing, SLOPE),
        tuple(layer(*each, SLOPE) for each in trunk),
        _made([_beside(*each, shared=depth == 0) for depth, each in enumerate(zip(*heads, strict=True))], output_gain),
        _stacked(parameters, output_gain),
    )


def _stacked(parameters: Mapping[str, np.ndarray], gain: float) -> tuple[Corrections, Corrections]:
    """Both layers of all corrections."""
    count = len({name.split(".")[1] for name in parameters if name.startswith("corrections.")})
    pairs = [_made(_layers(parameters, f"corrections.{i}."), gain) for i in range(count)]
    first, last = (
        Corrections(
            np.stack([one.weight for one in each]),
            np.stack([one.bias for one in each]),
            each[0].slope,
            aligned(np.stack([one.tiles for one in each])),
        )
        for each in zip(*pairs, strict=True)
    )
    return first, last


def _layers(parameters: Mapping[str, np.ndarray], start: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights and biases of the layers whose names begin with ``start``, in order."""
    numbers = {int(name[len(start) :].split(".")[0]) for name in parameters if name.startswith(start)}
    return [(parameters[f"{start}{number}.weight"], parameters[f"{start}{number}.bias"]) for number in sorted(numbers)]


def _made(layers: list[tuple[np.ndarray, np.ndarray]], gain: float) -> tuple[Layer, ...]:
    """Layers of which the last gives jets, times ``gain``."""
    *first, (weight, bias) = layers
    return (*(layer(*each, SLOPE) for each in first), layer(np.float32(gain) * weight, np.float32(gain) * bias))


def _beside(
    one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray], *, shared: bool
) -> tuple[np.ndarray, np.ndarray]:
    """One layer with the outputs of both, which read the same input if it is ``shared``, else one each."""
    (a, b), bias = (one[0], other[0]), np.concatenate([one[1], other[1]])
    if shared:
        return np.concatenate([a, b]), bias
    weight = np.zeros((len(a) + len(b), a.shape[1] + b.shape[1]), a.dtype)
    weight[: len(a), : a.shape[1]], weight[len(a) :, a.shape[1] :] = a, b
    return weight, bias
