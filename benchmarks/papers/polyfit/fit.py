"""The differentiable jet fit, and how well a fit stands: height, normals, bijectivity."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from drape.geometry import jets
from drape.geometry.rotations import quaternion_to_matrix

RIDGE = 1e-6  # on coefficients of unit-size patches, per point
FLOOR = 1e-12  # under roots, so that a perfect fit has a gradient


@dataclass(frozen=True)
class Fit:
    """Height jets (B, C) over the plane of ``points`` (B, n, 3), and the heights they leave over (B, n)."""

    coefficients: Tensor
    points: Tensor
    residual: Tensor
    order: int


def fit_jet(points: Tensor, *, order: int, ridge: float = RIDGE) -> Fit:
    """The jet of ``order`` that is nearest, by ridge least squares, to ``points`` (B, n, 3) over their own plane."""
    basis = jets.basis(points[..., :2], order)
    transposed = basis.transpose(-1, -2) / points.shape[-2]
    normal = transposed @ basis + ridge * torch.eye(basis.shape[-1], dtype=points.dtype, device=points.device)
    factor = torch.linalg.cholesky_ex(normal)[0]  # does not raise: a step that is not finite is the loop's to judge
    coefficients = torch.cholesky_solve(transposed @ points[..., 2:], factor)[..., 0]
    return Fit(coefficients, points, points[..., 2] - (basis @ coefficients[..., None])[..., 0], order)


def given_jet(points: Tensor, coefficients: Tensor, *, order: int) -> Fit:
    """``coefficients`` (B, C) from elsewhere as a fit of ``points`` (B, n, 3)."""
    value = (jets.basis(points[..., :2], order) @ coefficients[..., None])[..., 0]
    return Fit(coefficients, points, points[..., 2] - value, order)


def turned(points: Tensor, quaternion: Tensor) -> Tensor:
    """``points`` (B, n, 3) turned by ``quaternion`` wxyz (B, 4)."""
    return points @ quaternion_to_matrix(quaternion).transpose(-1, -2)


def height_rmse(fit: Fit) -> Tensor:
    """Root mean square height that a fit leaves over (B,), in patch sizes."""
    return torch.sqrt((fit.residual**2).mean(dim=-1) + FLOOR)


def jet_normals(fit: Fit) -> Tensor:
    """Unit normals (B, n, 3) of the fitted graphs, in the frame of the fit."""
    uv = fit.points[..., :2]
    du = (jets.basis_derivative(uv, fit.order, u_times=1) @ fit.coefficients[..., None])[..., 0]
    dv = (jets.basis_derivative(uv, fit.order, v_times=1) @ fit.coefficients[..., None])[..., 0]
    normal = torch.stack([-du, -dv, torch.ones_like(du)], dim=-1)
    return normal / normal.norm(dim=-1, keepdim=True)


def normal_error_deg(fit: Fit, normals: Tensor) -> Tensor:
    """Mean angle [deg] (B,) between fitted and true ``normals`` (B, n, 3) of the frame of the fit, either side up."""
    cosine = (jet_normals(fit) * normals).sum(-1).abs().clamp(max=1.0)
    return torch.rad2deg(torch.arccos(cosine)).mean(dim=-1)


def steepness(normals: Tensor, *, limit: float = 0.2) -> Tensor:
    """How far normals (B, n, 3) lean past the cosine ``limit`` from the patch's own side (B,): zero for a bijection.

    The side is that of most normals, since a frame's sign is free.
    """
    side = torch.where(normals[..., 2].mean(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    return (torch.relu(limit - side * normals[..., 2]) ** 2).mean(dim=-1)


def over_share(normals: Tensor) -> Tensor:
    """Share (B,) of points that look down while most look up: where the height is no function."""
    side = torch.where(normals[..., 2].mean(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    return (side * normals[..., 2] <= 0).to(normals.dtype).mean(dim=-1)
