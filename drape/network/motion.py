"""The recurrent encoder of a body's motion, ``training.recurrent``, by the engine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.packer import Recorded
from drape.graph.inputs import SLOPE
from drape.network.dense import Layer, body_layer
from drape.network.weights import body_layers, parameter_layers


@dataclass(frozen=True, eq=False)
class MotionEncoder(Recorded):
    """The weights of the encoder: the ``scale`` (24, m) of motion features, layers of a ``joint`` and of the ``body``,
    the cell's from its ``input`` and its ``state``, and what gives a code, ``out``. The state's size falls as
    exp(-t / ``decay_s``), less an ``offset``."""

    scale: np.ndarray
    joint: tuple[Layer, ...]
    body: tuple[Layer, ...]
    input: Layer
    state: Layer
    out: Layer
    decay_s: float
    offset: float


def motion_encoder(parameters: Mapping[str, np.ndarray], network: Mapping[str, Any]) -> MotionEncoder:
    """The encoder of ``parameters`` by their names in training; ``network`` is the manifest's description."""
    decay_s = float(network["state_decay_s"])
    return MotionEncoder(
        parameters["dynamic.scale.inverse"],
        body_layers(parameter_layers(parameters, "dynamic.joint."), last=SLOPE),
        body_layers(parameter_layers(parameters, "dynamic.body.")),
        body_layer(parameters["dynamic.cell.weight_ih"]),
        body_layer(parameters["dynamic.cell.weight_hh"]),
        body_layer(parameters["dynamic.code_scale"][:, None] * parameters["dynamic.out.weight"]),
        decay_s,
        1.0 / math.expm1(float(network["state_rest_s"]) / decay_s),
    )


def advance_encoder(
    encoder: MotionEncoder, features: np.ndarray, state: np.ndarray, dt_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Codes (N, outputs) and next states (N, H) of N bodies with motion ``features`` (N, 24, m) and ``state`` (N, H)
    after steps ``dt_s`` (N,) [s]. Codes are filled up to a multiple of sixteen outputs."""
    code, after = np.empty((len(state), len(encoder.out.bias)), state.dtype), np.empty_like(state)
    call_with_scratch("advance", state.dtype, encoder, features, state, dt_s, len(state), code, after)
    return code, after
