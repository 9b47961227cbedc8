"""Bases of a recovery: the true pattern in another size."""

from __future__ import annotations

import numpy as np

from recovery.pattern.coordinates import with_controls
from recovery.pattern.model import Pattern
from recovery.pattern.symmetry import find_symmetries, free_controls

LEAST_OFF, MOST_OFF = 0.05, 0.10  # of all widths, and of all heights: other factors for a sleeve would unmatch its seam


def off(truth: Pattern, seed: int) -> Pattern:
    """``truth`` with all widths, and all heights, 5 to 10 % too small or too large."""
    rng = np.random.default_rng(seed)
    size = 1.0 + rng.choice([-1.0, 1.0], size=2) * rng.uniform(LEAST_OFF, MOST_OFF, size=2)
    free = free_controls(truth, find_symmetries(truth))
    return with_controls(truth, free.controls, free.origin * size)
