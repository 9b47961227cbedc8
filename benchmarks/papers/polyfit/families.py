"""The four families of functions that PolyFit learns from (OneFit, appendix A.1), with their gradients.

4-jet ``sum alpha_ij u^(i-j) v^j``; trigonometric ``alpha cos(theta r)``; Gaussian
``alpha exp(-|w - w0|^2 / 2 sigma^2)``; Bessel ``alpha J0(k |w - w0|)``; w = (u, v) in [-1, 1]^2, r = |w|.
The paper gives the ranges of alpha, theta, sigma and k; centres w0 are drawn from [-1, 1]^2 here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from drape.geometry import jets

FAMILIES = ("jet", "trigonometric", "gaussian", "bessel")
AMPLITUDE = (-0.5, 0.5)
THETA = (np.pi, 2.0 * np.pi)
SIGMA = (0.5, 1.0)
BESSEL_K = 5.0
JET_ORDER = 4
TINY = 1e-12


@dataclass(frozen=True)
class Patches:
    """Points (B, n, 3) of patches and the unit normals (B, n, 3) of the surface there."""

    points: Tensor
    normals: Tensor


def draw_patches(count: int, point_count: int, *, families: tuple[str, ...], seed: tuple[int, int]) -> Patches:
    """``count`` random graphs (u, v, f(u, v)), f the sum of one function of each family; ``seed`` = (run, batch)."""
    rng = np.random.default_rng(seed)
    uv = torch.from_numpy(rng.uniform(-1.0, 1.0, size=(count, point_count, 2)).astype(np.float32))
    height = torch.zeros(count, point_count)
    slope = torch.zeros(count, point_count, 2)
    for name in families:
        value, gradient = _FUNCTIONS[name](uv, draw_parameters(name, count, rng))
        height, slope = height + value, slope + gradient
    normals = torch.cat([-slope, torch.ones_like(height)[..., None]], dim=-1)
    points = torch.cat([uv, height[..., None]], dim=-1)
    return Patches(points, normals / normals.norm(dim=-1, keepdim=True))


def draw_parameters(name: str, count: int, rng: np.random.Generator) -> dict[str, Tensor]:
    """Random parameters of ``count`` functions of one family."""
    shapes = {
        "jet": {"alpha": (AMPLITUDE, (jets.coefficient_count(JET_ORDER),))},
        "trigonometric": {"alpha": (AMPLITUDE, (1,)), "theta": (THETA, (1,))},
        "gaussian": {"alpha": (AMPLITUDE, (1,)), "sigma": (SIGMA, (1,)), "centre": ((-1.0, 1.0), (2,))},
        "bessel": {"alpha": (AMPLITUDE, (1,)), "centre": ((-1.0, 1.0), (2,))},
    }[name]
    return {
        key: torch.from_numpy(rng.uniform(*bounds, size=(count, *shape)).astype(np.float32))
        for key, (bounds, shape) in shapes.items()
    }


def jet(uv: Tensor, p: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Values (B, n) and gradients (B, n, 2) of 4-jets at ``uv`` (B, n, 2)."""
    alpha = p["alpha"][:, None]
    du = jets.basis_derivative(uv, JET_ORDER, u_times=1)
    dv = jets.basis_derivative(uv, JET_ORDER, v_times=1)
    value = (alpha * jets.basis(uv, JET_ORDER)).sum(-1)
    return value, torch.stack([(alpha * du).sum(-1), (alpha * dv).sum(-1)], dim=-1)


def trigonometric(uv: Tensor, p: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Values and gradients of ``alpha cos(theta r)``."""
    r = uv.norm(dim=-1)
    slope = -p["alpha"] * p["theta"] * torch.sin(p["theta"] * r) / (r + TINY)
    return p["alpha"] * torch.cos(p["theta"] * r), slope[..., None] * uv


def gaussian(uv: Tensor, p: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Values and gradients of ``alpha exp(-|w - w0|^2 / 2 sigma^2)``."""
    away = uv - p["centre"][:, None]
    value = p["alpha"] * torch.exp(-(away**2).sum(-1) / (2.0 * p["sigma"] ** 2))
    return value, -(value / p["sigma"] ** 2)[..., None] * away


def bessel(uv: Tensor, p: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Values and gradients of ``alpha J0(k |w - w0|)``; J0' = -J1."""
    away = uv - p["centre"][:, None]
    r = away.norm(dim=-1)
    slope = -p["alpha"] * BESSEL_K * torch.special.bessel_j1(BESSEL_K * r) / (r + TINY)
    return p["alpha"] * torch.special.bessel_j0(BESSEL_K * r), slope[..., None] * away


_FUNCTIONS = {"jet": jet, "trigonometric": trigonometric, "gaussian": gaussian, "bessel": bessel}
