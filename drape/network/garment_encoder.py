"""The garment encoder on a processor: ``training.layers.GarmentEncoder`` and the garment's half of the first layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drape.engine.library import LANES
from drape.graph.inputs import SLOPE
from drape.network.dense import Layer, Rows, layer, rows_of, run_layer
from drape.network.weights import parameter_layers


class EncoderLayers(NamedTuple):
    """The weights of the garment encoder: ``mean`` and ``inverse_deviation`` (m,) of patch features, the layers of its
    ``first`` part, and those of its ``second``. The last one gives the summand of the decoder's first layer that
    depends on the patch alone.

    The layers have no tiles: a garment is encoded once.
    """

    mean: np.ndarray
    inverse_deviation: np.ndarray
    first: tuple[Layer, ...]
    second: tuple[Layer, ...]


def garment_encoder(parameters: Mapping[str, np.ndarray]) -> EncoderLayers:
    """Returns the encoder's weights of ``parameters``, which have their names in training."""
    first, second = (parameter_layers(parameters, f"garment.{part}.") for part in ("first", "second"))
    slopes = [*[SLOPE] * (len(second) - 1), 1.0, 1.0]
    second.append((parameters["decoder.from_patch.weight"], parameters["decoder.from_patch.bias"]))
    return EncoderLayers(
        parameters["garment.standardise.mean"],
        parameters["garment.standardise.inverse_deviation"],
        tuple(layer(*pair, SLOPE, tiles=False) for pair in first),
        tuple(layer(*pair, slope, tiles=False) for pair, slope in zip(second, slopes, strict=True)),
    )


def encode_patches(encoder: EncoderLayers, features: np.ndarray) -> np.ndarray:
    """Returns the summand (K, n) float32 of the decoder's first layer that depends on the patch alone, for K patches
    with ``features`` (K, m)."""
    own = np.clip((features - encoder.mean) * encoder.inverse_deviation, -5.0, 5.0).astype(np.float32)
    x = rows_of(own)
    count = encoder.second[0].weight.size // len(encoder.second[0].bias) - x.shape[1]
    hidden = _through(encoder.first, x)[:, :count]
    outputs = _through(encoder.second, np.concatenate([hidden, x], axis=1))
    return np.ascontiguousarray(outputs.swapaxes(1, 2)).reshape(-1, outputs.shape[1])[: len(features)]


def _through(layers: Sequence[Layer], x: np.ndarray) -> np.ndarray:
    """Rows (blocks, n, 16) of the ``layers`` one after the other, of rows ``x``."""
    for dense in layers:
        after = np.empty((len(x), len(dense.bias), LANES), np.float32)
        run_layer(dense, Rows(x.reshape(-1), x.shape[1], 0), Rows(after.reshape(-1), after.shape[1], 0))
        x = after
    return x
