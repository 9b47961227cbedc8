"""Layers of the network as the packed graph multiplies with them: merged, reordered, gains in the weights."""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import nn

from drape.body.skeleton import JOINT_COUNT
from drape.graph.inputs import SLOPE


def surroundings_layer(layer: nn.Linear) -> nn.Parameter:
    """The layer's weights (108, n) for [offsets as (3, 24), rotation, jets of the agreed base] instead of [offsets as
    (24, 3), gravity, these jets]."""
    count = 3 * JOINT_COUNT
    weight = layer.weight.detach()
    base = weight[:, count + 3 :].T
    matrix = torch.zeros(count + 9 + len(base), layer.out_features)
    matrix[count + 9 :] = base
    matrix[:count] = weight[:, :count].reshape(-1, JOINT_COUNT, 3).permute(2, 1, 0).reshape(count, -1)
    matrix[count + 3 : count + 6] = -weight[:, count : count + 3].T  # gravity is minus the second row of the rotation
    return nn.Parameter(matrix, requires_grad=False)


def merged_heads(heads: nn.ModuleDict, gain: float) -> nn.Sequential:
    """Both heads as one, which gives jets (P, 27); the output gain is in the weights."""
    plane, height = _linears(heads["plane"]), _linears(heads["height"])
    layers: list[nn.Module] = []
    for depth, (a, b) in enumerate(zip(plane[:-1], height[:-1], strict=True)):
        made = _side_by_side(a, b, shared=depth == 0)  # both read the trunk's output
        layers += [made, nn.LeakyReLU(SLOPE)]
    last = _side_by_side(plane[-1], height[-1], shared=len(plane) == 1)
    with torch.no_grad():
        last.weight.mul_(gain)
        last.bias.mul_(gain)
    return nn.Sequential(*layers, last).requires_grad_(False)


def correction_layers(correction: nn.Module, gain: float) -> nn.Sequential:
    """A ``training.layers.Correction`` with the output gain in its weights."""
    first, last = _linears(correction)
    scaled = nn.Linear(last.in_features, last.out_features)
    with torch.no_grad():
        scaled.weight.copy_(gain * last.weight)
        scaled.bias.copy_(gain * last.bias)
    return nn.Sequential(copy.deepcopy(first), nn.LeakyReLU(SLOPE), scaled).requires_grad_(False)


def _linears(head: nn.Module) -> list[nn.Linear]:
    return [cast(nn.Linear, child) for child in head.children() if isinstance(child, nn.Linear)]


def _side_by_side(a: nn.Linear, b: nn.Linear, *, shared: bool) -> nn.Linear:
    """One layer with the outputs of both, which read the same input if it is ``shared``, else one each."""
    start = 0 if shared else a.in_features
    layer = nn.Linear(start + b.in_features, a.out_features + b.out_features)
    with torch.no_grad():
        layer.weight.zero_()
        layer.weight[: a.out_features, : a.in_features] = a.weight
        layer.weight[a.out_features :, start:] = b.weight
        layer.bias[: a.out_features], layer.bias[a.out_features :] = a.bias, b.bias
    return layer
