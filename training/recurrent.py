"""The recurrent part of the body encoder: what motion adds to the code of a pose (OneFit, section 3; NCS, section 4).

Three things are not as published. Time counts in seconds, so that frames of any spacing may
follow each other. The state loses size by itself and, without input, only turns: a body that
stands still comes to an exactly zero state, whatever the weights are. And the state begins as
pendulums, which is what it has to learn.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from drape.body.skeleton import JOINT_COUNT
from drape.graph.inputs import SLOPE
from training.config import ModelConfig
from training.layers import mlp

REFERENCE_DT_S = 1.0 / 30.0  # a step of this length is one step of an ordinary gated recurrent unit
INPUT_LIMIT = 10.0  # scaled features beyond it are a glitch or a teleport
SMALLEST_RATE, SMALLEST_ACCELERATION = 0.1, 0.5  # [1/s], [m/s^2]; joints that hardly move are not blown up
SLOWEST_HZ, FASTEST_HZ = 0.4, 4.0  # frequencies of the pendulums that the state begins as
TINY = 1e-12


class MotionScale(nn.Module):
    """A layer that divides motion features (n, 24, 12) by the root mean square of each, and cuts them off at
    ``INPUT_LIMIT``. Nothing is subtracted, so zero stays zero."""

    inverse: Tensor

    def __init__(self, feature_count: int) -> None:
        super().__init__()
        self.register_buffer("inverse", torch.ones(JOINT_COUNT, feature_count))

    def set_from(self, samples: Tensor) -> None:
        """Sets the divisors to the root mean squares of ``samples`` (n, 24, 12), but no lower than a floor."""
        size = samples.square().mean(dim=0).sqrt()
        floor = torch.full_like(size, SMALLEST_RATE)
        floor[:, -3:] = SMALLEST_ACCELERATION
        self.inverse.copy_(1.0 / torch.maximum(size, floor))

    def forward(self, features: Tensor) -> Tensor:
        return torch.clamp(features * self.inverse, -INPUT_LIMIT, INPUT_LIMIT)


class CalmingGRU(nn.Module):
    """A gated recurrent unit without biases, in seconds, whose state comes to rest by itself.

    With a step of ``REFERENCE_DT_S`` and no calming it is torch's GRUCell; shorter and longer steps take their share of
    the way. The size of a state is its root mean square, at most 1. Without input the size after the time t is at most
    (1 + c) exp(-t / tau) - c, for any weights: tau is ``decay_s``, and c is chosen so that a size of 1 is 0 after
    ``rest_s``. Each step first lowers the size so; what follows may turn the state but make it larger only by the size
    of the input.
    """

    def __init__(self, inputs: int, size: int, *, decay_s: float, rest_s: float) -> None:
        super().__init__()
        self.decay_s = decay_s
        self.offset = 1.0 / math.expm1(rest_s / decay_s)  # c: (1 + c) exp(-rest / tau) = c
        self.weight_ih = nn.Parameter(torch.empty(3 * size, inputs))
        self.weight_hh = nn.Parameter(torch.empty(3 * size, size))
        # Ordinary motion shall bring the state to a size that calming takes its time with.
        nn.init.normal_(self.weight_ih, std=0.25 / math.sqrt(inputs))
        nn.init.uniform_(self.weight_hh, -1.0 / math.sqrt(size), 1.0 / math.sqrt(size))
        with torch.no_grad():
            self.weight_hh[2 * size :] = pendulums(size)

    def forward(self, x: Tensor, state: Tensor, dt_s: Tensor) -> Tensor:
        """Returns the state (F, H) after the inputs ``x`` (F, n) have lasted for ``dt_s`` (F,) [s]."""
        state, size = self.calm(state, dt_s)
        from_input, from_state = x @ self.weight_ih.mT, state @ self.weight_hh.mT
        input_reset, input_keep, input_new = from_input.chunk(3, dim=-1)
        state_reset, state_keep, state_new = from_state.chunk(3, dim=-1)
        new = torch.tanh(input_new + torch.sigmoid(input_reset + state_reset) * state_new)
        share = torch.sigmoid(-(input_keep + state_keep)) * (dt_s / REFERENCE_DT_S)[:, None]
        moved = state + torch.clamp(share, max=1.0) * (new - state)
        largest = size + root_mean_square(input_new)
        return moved * torch.clamp(largest / torch.clamp(root_mean_square(moved), min=TINY), max=1.0)

    def calm(self, state: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        """Returns ``state`` (F, H) after it has decayed for ``dt_s`` (F,) [s], and its root mean square then (F, 1)."""
        before = root_mean_square(state)
        size = torch.clamp((before + self.offset) * torch.exp(-dt_s / self.decay_s)[:, None] - self.offset, min=0.0)
        return state * (size / torch.clamp(before, min=TINY)), size


def root_mean_square(x: Tensor) -> Tensor:
    """Returns the root mean square (F, 1) of each row of ``x`` (F, n). Its gradient is zero where a row is zero."""
    square = x.square().mean(dim=-1, keepdim=True)
    still = square == 0.0
    return torch.where(still, 0.0, torch.sqrt(torch.where(still, 1.0, square)))


def pendulums(size: int) -> Tensor:
    """Returns weights (H, H), from the state to its candidate, with which pairs of small states swing at frequencies
    between ``SLOWEST_HZ`` and ``FASTEST_HZ``, evenly in the logarithm. ``size`` is H.

    Gates of a small state stand at one half, so a step is s + (U s / 2 - s) / 2, and this is
    the turn exp(i w dt) for U = 2 (1 + 2 (exp(i w dt) - 1)).
    """
    pairs = size // 2
    hertz = torch.logspace(math.log10(SLOWEST_HZ), math.log10(FASTEST_HZ), pairs)
    angle = 2.0 * math.pi * hertz * REFERENCE_DT_S
    along, across = 2.0 * (2.0 * torch.cos(angle) - 1.0), 4.0 * torch.sin(angle)
    weights = torch.zeros(size, size)
    first, second = torch.arange(pairs), torch.arange(pairs) + pairs
    weights[first, first] = weights[second, second] = along
    weights[first, second], weights[second, first] = -across, across
    return weights


class DynamicEncoder(nn.Module):
    """A recurrent network that computes dynamic body codes (F, 256) and next states (F, H) of F bodies from their
    motion features (F, 24, 12), states (F, H) and time steps [s] (F,).

    Nothing here has a bias: no motion and a zero state give a code of exactly zero, and the
    garment hangs as the static network drapes it. Codes count in deviations of the static code
    (``set_code_scale``): the decoder answers to differences that small.
    """

    code_scale: Tensor

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        per_joint = 32
        self.scale = MotionScale(config.dynamic_feature_count)
        self.joint = mlp([config.dynamic_feature_count, per_joint, per_joint], last_activation=True, bias=False)
        self.body = mlp([per_joint * JOINT_COUNT, config.motion_hidden, config.state_size], bias=False)
        self.cell = CalmingGRU(
            config.state_size, config.state_size, decay_s=config.state_decay_s, rest_s=config.state_rest_s
        )
        self.out = nn.Linear(config.state_size, config.body_code_size, bias=False)
        for layer in [*self.joint, *self.body]:
            if isinstance(layer, nn.Linear):
                nn.init.kaiming_normal_(layer.weight, a=SLOPE)
        # Small first codes: training starts from the static drape.
        nn.init.normal_(self.out.weight, std=0.1)
        self.register_buffer("code_scale", torch.full((config.body_code_size,), 1.0 / math.sqrt(config.state_size)))

    def set_code_scale(self, static_codes: Tensor) -> None:
        """Makes the standard deviations of ``static_codes`` (n, 256) the unit of dynamic codes."""
        self.code_scale.copy_(static_codes.std(dim=0) / math.sqrt(self.out.in_features))

    def forward(self, features: Tensor, state: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        x = self.body(self.joint(self.scale(features)).flatten(1))
        state = self.cell(x, state, dt_s)
        return self.code_scale * self.out(state), state
