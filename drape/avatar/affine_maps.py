"""Affine maps (..., 3, 4): one after the other, their inverses, and the rigid ones that fit points best."""

from __future__ import annotations

import numpy as np

from drape.motion.node_clip import nearest_rotations


def rigid_fit(sources: np.ndarray, targets: np.ndarray, masses: np.ndarray | None = None) -> np.ndarray:
    """Returns the rigid maps (F, 3, 4), rotation R and translation t, that bring points x nearest to points y: those of
    the least sum of m |R x + t - y|^2 (Kabsch 1976).

    x are ``sources`` (N, 3), y ``targets`` (F, N, 3) in one unit, and m ``masses`` (N,), equal ones by default.
    """
    masses = np.ones(len(sources)) if masses is None else masses
    share = masses / masses.sum()
    middle, middles = share @ sources, np.einsum("n,fna->fa", share, targets)
    moments = np.einsum("fna,nb->fab", targets - middles[:, None], share[:, None] * (sources - middle), optimize=True)
    turns = nearest_rotations(moments)
    return np.concatenate([turns, (middles - turns @ middle)[..., None]], axis=-1)


def compose(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Returns the affine maps (..., 3, 4) that apply ``before`` (..., 3, 4) first and ``after`` (..., 3, 4) then."""
    linear = after[..., :3] @ before[..., :3]
    return np.concatenate([linear, after[..., :3] @ before[..., 3:] + after[..., 3:]], axis=-1)


def affine_inverse(maps: np.ndarray) -> np.ndarray:
    """Returns the inverses (..., 3, 4) of affine ``maps`` (..., 3, 4)."""
    linear = np.linalg.inv(maps[..., :3])
    return np.concatenate([linear, -linear @ maps[..., 3:]], axis=-1)
