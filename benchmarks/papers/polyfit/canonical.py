"""A patch's points in a frame of their own.

The frame is that of the principal axes, its signs fixed by third moments, so that it turns with the points
whatever way they lie: what is decided in it is decided for every orientation of the patch.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Canonical:
    """``points = centre + size * local @ axes^T``: local (..., n, 3), axes (..., 3, 3) in columns, size (...)."""

    local: Tensor
    axes: Tensor
    centre: Tensor
    size: Tensor


def canonical(points: Tensor) -> Canonical:
    """``points`` (..., n, 3) moved to their mean, scaled into the unit ball, turned to their principal axes.

    The third axis is that of least spread, towards the side from which the patch is a bowl; the first has
    positive skewness.
    """
    centre = points.mean(dim=-2, keepdim=True)
    moved = points - centre
    size = torch.sqrt((moved * moved).sum(dim=-1).amax(dim=-1)) + 1e-12
    moved = moved / size[..., None, None]
    _, vectors = torch.linalg.eigh(moved.mT @ moved)  # spreads ascend
    u, n = vectors[..., :, 2], vectors[..., :, 0]
    along, up = ((moved * axis[..., None, :]).sum(dim=-1) for axis in (u, n))
    radius = (moved * moved).sum(dim=-1)
    u, n = u * _sign((along**3).sum(dim=-1))[..., None], n * _sign((up * radius).sum(dim=-1))[..., None]
    axes = torch.stack([u, torch.linalg.cross(n, u), n], dim=-1)
    return Canonical(moved @ axes, axes, centre[..., 0, :], size)


def _sign(x: Tensor) -> Tensor:
    return torch.where(x < 0, -1.0, 1.0).to(x.dtype)
