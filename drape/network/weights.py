"""The weights of the network as the engine takes them, from the parameters of a model's folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drape.contact.projection import OTHER_LEAST
from drape.contact.proximity import OTHER_STEPS
from drape.engine.packer import Recorded
from drape.garment.consensus import strain_points
from drape.geometry import jets
from drape.graph.inputs import SLOPE
from drape.network.dense import Layer, body_layer, layer


@dataclass(frozen=True, eq=False)
class Weights(Recorded):
    """The weights: of the body's features, of its code (``body``, then ``from_body``), of the surroundings of a patch,
    of the trunk and the heads, and the two layers of each correction.

    And constants: the jets' ``basis`` (7, 15) at the points that are felt, with its derivatives, and the ``logs`` (16,)
    of how much a sample is another part.
    """

    mean: np.ndarray
    inverse_deviation: np.ndarray
    body: tuple[Layer, ...]
    from_body: Layer
    surroundings: Layer
    trunk: tuple[Layer, ...]
    heads: tuple[Layer, ...]
    first: tuple[Layer, ...]
    second: tuple[Layer, ...]
    basis: np.ndarray
    basis_u: np.ndarray
    basis_v: np.ndarray
    logs: np.ndarray


def weights_of(parameters: Mapping[str, np.ndarray], output_gain: float) -> Weights:
    """The weights of ``parameters`` by their names in training; ``output_gain`` is the factor of jets."""
    decoder = "decoder."
    nothing = np.zeros(len(parameters[decoder + "from_surroundings.weight"]), np.float32)
    heads = [parameter_layers(parameters, f"{decoder}heads.{name}.") for name in ("plane", "height")]
    count = len({name.split(".")[1] for name in parameters if name.startswith("corrections.")})
    pairs = [_made(parameter_layers(parameters, f"corrections.{i}."), output_gain) for i in range(count)]
    points, order = strain_points(), jets.HEIGHT_ORDER
    along = [jets.basis_derivative(points, order, **times) for times in ({"u_times": 1}, {"v_times": 1})]
    logs = np.log(np.arange(OTHER_STEPS + 1) / OTHER_STEPS + OTHER_LEAST)
    return Weights(
        parameters["body.standardise.mean"],
        parameters["body.standardise.inverse_deviation"],
        body_layers(parameter_layers(parameters, "body.layers.")),
        body_layer(parameters[decoder + "from_body.weight"]),
        layer(parameters[decoder + "from_surroundings.weight"], nothing, SLOPE),
        tuple(layer(*each, SLOPE) for each in parameter_layers(parameters, decoder + "trunk.")),
        _made([_beside(*each, shared=depth == 0) for depth, each in enumerate(zip(*heads, strict=True))], output_gain),
        tuple(first for first, _ in pairs),
        tuple(second for _, second in pairs),
        *(np.ascontiguousarray(each, np.float32) for each in (jets.basis(points, order), *along, logs)),
    )


def parameter_layers(parameters: Mapping[str, np.ndarray], start: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns weights and biases of the layers whose names in ``parameters`` begin with ``start``, in order; zeros for
    a layer without biases."""
    numbers = sorted({int(name[len(start) :].split(".")[0]) for name in parameters if name.startswith(start)})
    weights = [(number, parameters[f"{start}{number}.weight"]) for number in numbers]
    return [
        (weight, parameters.get(f"{start}{number}.bias", np.zeros(len(weight), weight.dtype)))
        for number, weight in weights
    ]


def body_layers(layers: list[tuple[np.ndarray, np.ndarray]], *, last: float = 1.0) -> tuple[Layer, ...]:
    """The ``layers`` of a body, between which numbers are bent; ``last`` is the slope of what the last one gives."""
    count = len(layers)
    return tuple(body_layer(*each, SLOPE if i + 1 < count else last) for i, each in enumerate(layers))


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
