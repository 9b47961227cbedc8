"""Networks over the points of a patch: PolyFit's quaternion transformer, and PointNet and DGCNN that regress jets.

Points (B, n, 3) lie in their canonical frame (``benchmarks.papers.polyfit.canonical``). All pool over points by the
maximum, so they neither see an order of points nor a repeated one: ragged patches are padded by repetition.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from drape.geometry import jets
from training.layers import mlp

POINT_SIZES = (64, 128, 256)
HEAD_SIZES = (128, 64)
NEIGHBOURS = 8
EDGE_SIZES = (32, 32, 64)
SLOPE = 0.2  # of DGCNN's activation


class Encoder(nn.Module):
    """A shared MLP over points and the maximum over them (Qi et al. 2017): (B, n, 3) -> (B, 256)."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = mlp([3, *POINT_SIZES], last_activation=True)

    def forward(self, points: Tensor) -> Tensor:
        return self.layers(points).amax(dim=-2)


class Qstn(nn.Module):
    """Points -> unit quaternion wxyz (B, 4) that turns them for the fit (Guerrero et al. 2018).

    Starts as the identity, exactly.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.head = mlp([POINT_SIZES[-1], *HEAD_SIZES, 4])
        last = list(self.head.children())[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(self, points: Tensor) -> Tensor:
        change = self.head(self.encoder(points))
        # w >= 0 is kept away from zero: a turn of the canonical frame never needs more than 180 degrees.
        w = 1.0 + torch.nn.functional.softplus(change[:, :1]) - 0.6931471805599453
        quaternion = torch.cat([w, change[:, 1:]], dim=-1)
        return quaternion / torch.sqrt((quaternion * quaternion).sum(dim=-1, keepdim=True))


class PointNetRegressor(nn.Module):
    """Points -> coefficients (B, C) of the height jet over their plane."""

    def __init__(self, order: int) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.head = mlp([POINT_SIZES[-1], *HEAD_SIZES, jets.coefficient_count(order)])

    def forward(self, points: Tensor) -> Tensor:
        return self.head(self.encoder(points))


class DgcnnRegressor(nn.Module):
    """Points -> jet coefficients by edge convolutions on neighbourhoods found anew in every layer (Wang et al. 2019).

    An edge convolution of one linear layer is ``max_j act(A x_j + B x_i)``: A and B act on points, not
    on edges, and the activation, being monotonic, comes after the maximum.
    """

    def __init__(self, order: int) -> None:
        super().__init__()
        sizes = (3, *EDGE_SIZES)
        self.neighbour = nn.ModuleList(nn.Linear(a, b, bias=False) for a, b in pairwise(sizes))
        self.own = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.join = nn.Linear(sum(EDGE_SIZES), POINT_SIZES[-1])
        self.head = mlp([POINT_SIZES[-1], *HEAD_SIZES, jets.coefficient_count(order)])
        self.activation = nn.LeakyReLU(SLOPE)

    def forward(self, points: Tensor) -> Tensor:
        x, layers = points, []
        for neighbour, own in zip(self.neighbour, self.own, strict=True):
            seen = x.detach()
            index = torch.cdist(seen, seen).topk(NEIGHBOURS, dim=-1, largest=False).indices
            batch, count = index.shape[:2]
            rows = (index + count * torch.arange(batch, device=x.device)[:, None, None]).reshape(-1)
            gathered = neighbour(x).flatten(0, 1).index_select(0, rows).reshape(batch, count, NEIGHBOURS, -1)
            x = self.activation(gathered.amax(dim=-2) + own(x))
            layers.append(x)
        pooled = self.activation(self.join(torch.cat(layers, dim=-1))).amax(dim=-2)
        return self.head(pooled)
