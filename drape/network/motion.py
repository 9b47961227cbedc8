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
    """The weights of the recurrent motion encoder.

    Motion features times ``scale`` (24, m) pass the layers ``joint`` of every joint and the layers ``body``. The cell
    has the layers ``input`` and ``state``, and ``out`` makes the code of its state. In t [s] the state's root mean
    square r shrinks to max((r + ``offset``) exp(-t / ``decay_s``) - ``offset``, 0).
    """

    scale: np.ndarray
    joint: tuple[Layer, ...]
    body: tuple[Layer, ...]
    input: Layer
    state: Layer
    out: Layer
    decay_s: float
    offset: float


def motion_encoder(parameters: Mapping[str, np.ndarray], network: Mapping[str, Any]) -> MotionEncoder:
    """Returns the weights of the motion encoder of ``parameters``, which have their names in training. ``network`` is
    the manifest's description of the network."""
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
    """Returns the motion codes (N, outputs) and next states (N, H) of N bodies. ``features`` (N, 24, m) are their
    motion, ``state`` (N, H) their states ``dt_s`` [s] (N,) before. The number of outputs is a multiple of sixteen, the
    rest zeros."""
    code, after = np.empty((len(state), len(encoder.out.bias)), state.dtype), np.empty_like(state)
    call_with_scratch("advance", state.dtype, encoder, features, state, dt_s, len(state), code, after)
    return code, after
