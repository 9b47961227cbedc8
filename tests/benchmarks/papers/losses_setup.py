"""Charts whose losses are known: points of one patch, a frame of it, a sheet of equilateral triangles."""

from __future__ import annotations

import numpy as np
import torch

from benchmarks.papers import losses as paper
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from training.model import Posed

F64 = torch.float64
SCALE = 0.1


def flat_jet(count: int = 1) -> torch.Tensor:
    jet = torch.zeros(count, jets.JET_COUNT, dtype=F64)
    jet[:, 1] = jet[:, jets.IN_PLANE_COUNT + 2] = 1.0
    return jet


def samples_at(uv: torch.Tensor, rest_jet: torch.Tensor) -> paper.ChartSamples:
    """Points (n, 2) of one patch at the origin, in the first of four chart slots."""
    count = len(uv)
    slots = torch.zeros(count, 4, 2, dtype=F64)
    slots[:, 0] = uv
    weight = torch.zeros(count, 4, dtype=F64)
    weight[:, 0] = 1.0
    rest = rest_jet.expand(count, 4, -1)
    return paper.ChartSamples(
        vertex=torch.arange(count),
        patch=torch.zeros(count, 4, dtype=torch.int64),
        weight=weight,
        uv=slots,
        place=SCALE * jets.evaluate(rest, slots),
        scale=torch.full((count, 4), SCALE, dtype=F64),
        rest_jet=rest,
    )


def posed_with(added: torch.Tensor, rotvec=(0.0, 0.0, 0.0), centre=(0.0, 0.0, 0.0)) -> Posed:
    """One frame of one patch whose jet got ``added`` (27,)."""
    rotation = torch.from_numpy(rotvec_to_matrix(np.array(rotvec)))[None, None]
    return Posed(rotation, torch.tensor([[centre]], dtype=F64), added[None, None])
