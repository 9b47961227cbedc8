"""Patches as small as the cloth needs them, at a given count: curvature first, then what the fit leaves over.

Curvature says beforehand where a polynomial will fail, but not by how much: a bend is no trouble, a crease is.
So the density of the partition starts from the curvature and is raised where patches still fit worst.
"""

from __future__ import annotations

import numpy as np

from drape.garment.density import DENSITY_LIMIT, curvature_density, spread
from drape.garment.fitting import DEFAULT_SEED, RestGarment, patch_fields

ROUNDS = 3
GAIN_RANGE = (0.5, 6.0)  # of the density, in one round; a patch's width goes with its fourth root
WIDTH_M = 0.015  # over which a round's gain is spread, so that patches shrink gradually


def patch_rmse(rest: RestGarment, fields: dict[str, np.ndarray]) -> np.ndarray:
    """RMS [m] (K,) of what each patch's jet leaves over, its vertices weighed by area and by the blend."""
    weight = (fields["chart_weight"].astype(np.float64) * rest.areas[:, None]).reshape(-1)
    squared = np.sum(fields["chart_residual"].astype(np.float64) ** 2, axis=-1).reshape(-1)
    owner, count = fields["chart_patch"].reshape(-1), len(fields["patch_scale"])
    mass = np.bincount(owner, weight, count)
    return np.sqrt(np.bincount(owner, weight * squared, count) / np.maximum(mass, 1e-15))


def adaptive_density(
    rest: RestGarment,
    *,
    count: int | None = None,
    seed: int = DEFAULT_SEED,
    unfold: bool = False,
    rounds: int = ROUNDS,
) -> np.ndarray:
    """Density (N,) for ``patch_fields`` with the same ``count``, ``seed`` and ``unfold``: the worst patch is least bad.

    Of curvature alone and ``rounds`` refinements of it that whose worst patch fits best. What fits projections best
    need not fit charts that are laid flat.
    """
    density = curvature_density(rest.vertices, rest.faces, rest.normals, rest.areas)
    best, least = density, np.inf
    for index in range(rounds + 1):
        fields = patch_fields(rest, count=count, seed=seed, density=density, unfold=unfold)
        error = patch_rmse(rest, fields)
        if error.max() < least:
            best, least = density, float(error.max())
        if index < rounds:
            density = _refined(rest, density, fields, error)
    return best


def _refined(rest: RestGarment, density: np.ndarray, fields: dict[str, np.ndarray], error: np.ndarray) -> np.ndarray:
    """``density`` raised where the patches' ``error`` is above its median, within the range a partition can follow."""
    relative = np.clip(error / np.maximum(np.median(error), 1e-12), *GAIN_RANGE)
    gain = np.sum(fields["chart_weight"] * relative[fields["chart_patch"]], axis=1)
    raised = density * spread(gain, rest.vertices, rest.faces, rest.areas, width_m=WIDTH_M)
    return np.clip(raised / raised.min(), 1.0, DENSITY_LIMIT)
