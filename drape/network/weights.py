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
    """The weights of the network.

    ``mean`` and ``inverse_deviation`` standardise the body's features. ``body`` and then ``from_body`` make the summand
    of the decoder's first layer that depends on the body alone, ``surroundings`` that of a patch's surroundings.
    ``trunk`` and ``heads`` decode the sum. ``first`` and ``second`` are the two layers of each correction. ``basis``
    (7, 15) are the jets' monomials at the strain points, ``basis_u`` and ``basis_v`` their derivatives; ``logs`` (16,)
    are the logits of a sample by how much it belongs to another part, in 15ths.
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
    """Returns the weights of ``parameters``, which have their names in training; jets are multiplied by
    ``output_gain``."""
    decoder = "decoder."
    nothing = np.zeros(len(parameters[decoder + "from_surroundings.weight"]), np.float32)
    heads = [parameter_layers(parameters, f"{decoder}heads.{name}.") for name in ("plane", "height")]
    joint_heads = [_beside(*pair, shared=depth == 0) for depth, pair in enumerate(zip(*heads, strict=True))]
    count = len({name.split(".")[1] for name in parameters if name.startswith("corrections.")})
    pairs = [_jet_layers(parameter_layers(parameters, f"corrections.{i}."), output_gain) for i in range(count)]
    points, order = strain_points(), jets.HEIGHT_ORDER
    along = [jets.basis_derivative(points, order, **times) for times in ({"u_times": 1}, {"v_times": 1})]
    logs = np.log(np.arange(OTHER_STEPS + 1) / OTHER_STEPS + OTHER_LEAST)
    return Weights(
        parameters["body.standardise.mean"],
        parameters["body.standardise.inverse_deviation"],
        body_layers(parameter_layers(parameters, "body.layers.")),
        body_layer(parameters[decoder + "from_body.weight"]),
        layer(parameters[decoder + "from_surroundings.weight"], nothing, SLOPE),
        tuple(layer(*pair, SLOPE) for pair in parameter_layers(parameters, decoder + "trunk.")),
        _jet_layers(joint_heads, output_gain),
        tuple(first for first, _ in pairs),
        tuple(second for _, second in pairs),
        *(np.ascontiguousarray(table, np.float32) for table in (jets.basis(points, order), *along, logs)),
    )


def parameter_layers(parameters: Mapping[str, np.ndarray], start: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns weight and bias of each layer whose name in ``parameters`` begins with ``start``, in order. A layer
    without a bias has zeros."""
    numbers = sorted({int(name[len(start) :].split(".")[0]) for name in parameters if name.startswith(start)})
    weights = [(number, parameters[f"{start}{number}.weight"]) for number in numbers]
    return [
        (weight, parameters.get(f"{start}{number}.bias", np.zeros(len(weight), weight.dtype)))
        for number, weight in weights
    ]


def body_layers(layers: list[tuple[np.ndarray, np.ndarray]], *, last: float = 1.0) -> tuple[Layer, ...]:
    """Returns the layers of a body with these weights and biases. All bend by ``SLOPE``, but the last one by
    ``last``."""
    count = len(layers)
    return tuple(body_layer(*pair, SLOPE if i + 1 < count else last) for i, pair in enumerate(layers))


def _jet_layers(layers: list[tuple[np.ndarray, np.ndarray]], gain: float) -> tuple[Layer, ...]:
    """Layers of which the last gives jets, times ``gain``."""
    *first, (weight, bias) = layers
    return (*(layer(*pair, SLOPE) for pair in first), layer(np.float32(gain) * weight, np.float32(gain) * bias))


def _beside(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], *, shared: bool
) -> tuple[np.ndarray, np.ndarray]:
    """One layer with the outputs of both, which read the same input if it is ``shared``, else one each."""
    (a, b), bias = (first[0], second[0]), np.concatenate([first[1], second[1]])
    if shared:
        return np.concatenate([a, b]), bias
    weight = np.zeros((len(a) + len(b), a.shape[1] + b.shape[1]), a.dtype)
    weight[: len(a), : a.shape[1]], weight[len(a) :, a.shape[1] :] = a, b
    return weight, bias
