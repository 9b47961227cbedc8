"""Constants of the packed graph: merged layers of the network, and tables that turn formulas into products."""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import Tensor, nn

from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.garment.agreement import FIT_COUNT
from drape.garment.cache import CHARTS_PER_VERTEX
from drape.geometry import jets
from drape.graph.packing import COLUMNS
from training.layers import SLOPE

# Entries of q q^T (wxyz, row by row) in each entry of the rotation matrix less the identity, and in |q|^2.
_ROTATION = (
    ((10, -2), (15, -2)), ((6, 2), (3, -2)), ((7, 2), (2, 2)),
    ((6, 2), (3, 2)), ((5, -2), (15, -2)), ((11, 2), (1, -2)),
    ((7, 2), (2, -2)), ((11, 2), (1, 2)), ((5, -2), (10, -2)),
    ((0, 1), (5, 1), (10, 1), (15, 1)),
)  # fmt: skip
_SIXD = (0, 3, 6, 1, 4, 7)  # entries of the rotation matrix in the 6D descriptor: its first two columns
# (entry of q, sign) in the matrix L with L(a) b = a b, row by row.
_LEFT = (
    (0, 1), (1, -1), (2, -1), (3, -1),
    (1, 1), (0, 1), (3, -1), (2, 1),
    (2, 1), (3, 1), (0, 1), (1, -1),
    (3, 1), (2, -1), (1, 1), (0, 1),
)  # fmt: skip
# Rows of (x, x', y, y', z, z') that the four factors of a cross product take: u_yzx v_zxy - u_zxy v_yzx.
_CROSS = (2, 4, 0, 5, 1, 3, 4, 0, 2, 3, 5, 1)
# Rows of (place, 1, u, v, uu, uv, vv) whose products are the basis of orders 3 and 4.
_HIGHER = (6, 6, 8, 8, 6, 6, 7, 7, 8), (4, 5, 4, 5, 6, 7, 7, 8, 8)


def tables() -> dict[str, Tensor]:
    """Buffers of ``PackedGraph`` that do not depend on the network."""
    rotation = torch.zeros(16, 10)
    for column, entries in enumerate(_ROTATION):
        for row, factor in entries:
            rotation[row, column] = factor
    left = torch.zeros(4, 16)
    for column, (row, sign) in enumerate(_LEFT):
        left[row, column] = sign
    turned = torch.zeros(6, 12)
    for column, row in enumerate(_CROSS):
        turned[row, column] = 1.0
    offsets, descent = torch.eye(JOINT_COUNT), torch.zeros(JOINT_COUNT, JOINT_COUNT)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            offsets[joint, parent] -= 1.0
            descent[joint] = descent[parent]
            descent[joint, joint] = 1.0
    return {
        "rotation_terms": rotation,
        "sixd_terms": rotation[:, list(_SIXD)],
        "neutral": torch.eye(3).reshape(9)[list(_SIXD)],
        "left_terms": left,
        "cross_terms": turned,
        "identity": torch.eye(3).reshape(1, 9),
        "offsets": offsets,
        "descent": descent,
        "parents": torch.tensor([max(parent, 0) for parent in PARENTS]),
        "without_root": torch.tensor([JOINT_COUNT, *range(1, JOINT_COUNT)]),
        **_jet_tables(),
        "chart_sums": torch.kron(torch.eye(3), torch.ones(1, CHARTS_PER_VERTEX)),
        "axis_sums": torch.eye(JOINT_COUNT).repeat(3, 1),
        "higher_first": torch.tensor(_HIGHER[0]),
        "higher_second": torch.tensor(_HIGHER[1]),
    }


def ancestor_jumps() -> list[Tensor]:
    """Ancestors (25,) of every joint at distance 1, 2, 4, ... until all are past the root; row 24 is past it."""
    above = [parent if parent >= 0 else JOINT_COUNT for parent in PARENTS] + [JOINT_COUNT]
    jumps = []
    while any(joint != JOINT_COUNT for joint in above):
        jumps.append(torch.tensor(above))
        above = [above[joint] for joint in above]
    return jumps


def _jet_columns(plane: int) -> list[int]:
    """Places of a jet's numbers, ``plane`` of them of each in-plane polynomial, among the 4 x 18."""
    counts = (plane, plane, jets.HEIGHT_COUNT)
    return [row * COLUMNS + 3 + i for row, count in enumerate(counts) for i in range(count)]


def _jet_tables() -> dict[str, Tensor]:
    """Jets (P, 27) @ ``placed`` + ``frame_only`` is (P, 4 * 18), which multiplies [scaled rotation, centre].

    Its rows are p, q, h and one: columns 0-2 pass the rest place (an identity), 3-17 are the jets; the last row's
    entry 3 adds the centre. ``placed_full`` does the same for full jets (P, 45). ``fit_choice`` (63, 27) and
    ``full_choice`` (63, 45) pick the jets and the full jets among the 3 x 21 fitted numbers.
    """
    placed, frame_only = torch.zeros(jets.JET_COUNT, 4 * COLUMNS), torch.zeros(1, 4 * COLUMNS)
    placed[torch.arange(jets.JET_COUNT), torch.tensor(_jet_columns(jets.IN_PLANE_COUNT))] = 1.0
    full = torch.zeros(jets.FULL_COUNT, 4 * COLUMNS)
    full[torch.arange(jets.FULL_COUNT), torch.tensor(_jet_columns(jets.HEIGHT_COUNT))] = 1.0
    for axis in range(3):
        frame_only[0, axis * COLUMNS + axis] = 1.0
    frame_only[0, 3 * COLUMNS + 3] = 1.0
    plane = range(jets.HEIGHT_COUNT, FIT_COUNT)
    columns = [*plane, *(FIT_COUNT + i for i in plane), *(2 * FIT_COUNT + i for i in range(jets.HEIGHT_COUNT))]
    full_columns = [FIT_COUNT * axis + i for axis in range(3) for i in range(jets.HEIGHT_COUNT)]
    every = torch.eye(3 * FIT_COUNT)
    return {
        "placed": placed,
        "placed_full": full,
        "frame_only": frame_only,
        "fit_choice": every[:, columns].contiguous(),
        "full_choice": every[:, full_columns].contiguous(),
    }


def surroundings_layer(layer: nn.Linear | None) -> nn.Parameter | None:
    """The layer's weights (81, n) for [offsets as (3, 24), rotation] instead of [offsets as (24, 3), gravity].

    With the agreed base (108, n): its jets come last.
    """
    if layer is None:
        return None
    count = 3 * JOINT_COUNT
    weight = layer.weight.detach()
    base = weight[:, count + 3 :].T  # of the agreed base, where the network has one
    made = torch.zeros(count + 9 + len(base), layer.out_features)
    made[count + 9 :] = base
    made[:count] = weight[:, :count].reshape(-1, JOINT_COUNT, 3).permute(2, 1, 0).reshape(count, -1)
    made[count + 3 : count + 6] = -weight[:, count : count + 3].T  # gravity is minus the second row of the rotation
    return nn.Parameter(made, requires_grad=False)


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
    made = nn.Linear(last.in_features, last.out_features)
    with torch.no_grad():
        made.weight.copy_(gain * last.weight)
        made.bias.copy_(gain * last.bias)
    return nn.Sequential(copy.deepcopy(first), nn.LeakyReLU(SLOPE), made).requires_grad_(False)


def _linears(head: nn.Module) -> list[nn.Linear]:
    return [cast(nn.Linear, child) for child in head.children() if isinstance(child, nn.Linear)]


def _side_by_side(a: nn.Linear, b: nn.Linear, *, shared: bool) -> nn.Linear:
    """One layer that gives the outputs of both, of the same input or of each its own."""
    start = 0 if shared else a.in_features
    made = nn.Linear(start + b.in_features, a.out_features + b.out_features)
    with torch.no_grad():
        made.weight.zero_()
        made.weight[: a.out_features, : a.in_features] = a.weight
        made.weight[a.out_features :, start:] = b.weight
        made.bias[: a.out_features], made.bias[a.out_features :] = a.bias, b.bias
    return made
