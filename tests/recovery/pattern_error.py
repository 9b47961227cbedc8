"""The error of a recovered pattern beside the true one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.coordinates import control_points
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.symmetry import procrustes


class PatternError(NamedTuple):
    """``controls_m`` [m] (K,) of every control point; ``areas`` (P,) of every panel over the true one, less 1."""

    controls_m: np.ndarray
    areas: np.ndarray


def pattern_error(found: Pattern, truth: Pattern) -> PatternError:
    """The error of ``found`` against ``truth``, which has the same panels in the same order.

    A panel's place in its own plane means nothing, so each is moved rigidly to where it fits best; it is not mirrored.
    """
    own, true = map(control_points, (found, truth))
    if not (np.array_equal(own.panel, true.panel) and np.array_equal(own.edge, true.edge)):
        raise InputError(
            "patterns",
            expected="the same panels with the same edges",
            got=f"{len(found.panels)} and {len(truth.panels)} panels, {len(own)} and {len(true)} control points",
            cure="Compare a recovery with the pattern that its base was made from.",
        )
    far = np.zeros(len(own))
    for panel in range(len(truth.panels)):
        mine = own.panel == panel
        a, b = own.positions[mine], true.positions[mine]
        matrix, _ = procrustes(a, b, reflect=False)
        far[mine] = np.linalg.norm((a - a.mean(axis=0)) @ matrix - (b - b.mean(axis=0)), axis=1)
    pairs = zip(found.panels, truth.panels, strict=True)
    return PatternError(far, np.array([geometry.area(a) / geometry.area(b) - 1.0 for a, b in pairs]))
