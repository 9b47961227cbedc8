"""What acts on a cloth from outside in these solvers: planes of the body, and two springs on every vertex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.cloth.problem import Problem
from drape.engine.packer import Recorded
from drape.errors import InputError


@dataclass(frozen=True, eq=False)
class Around(Recorded):
    """What acts on the V vertices of a cloth from outside: a plane and two springs on each.

    ``point`` [m] and ``normal`` (V, 3) are planes of the body, whose normals need not be of unit length. The springs go
    to ``target`` [m] (V, 3) with the stiffness ``target_n_per_m`` [N/m] (V,), and to ``band`` with ``band_n_per_m``;
    the second ones are free within the slack of ``drape.cloth.waistband``.
    """

    point: np.ndarray
    normal: np.ndarray
    target: np.ndarray
    target_n_per_m: np.ndarray
    band: np.ndarray
    band_n_per_m: np.ndarray


def surroundings(problem: Problem, point: np.ndarray, normal: np.ndarray) -> Around:
    """Returns the planes ``point`` [m] and ``normal`` (V, 3) as surroundings of a cloth; the springs have no stiffness.
    Raises ``InputError`` for other shapes."""
    dtype = problem.weight_n.dtype
    point, normal = (np.ascontiguousarray(rows, dtype=dtype) for rows in (point, normal))
    if point.shape != (len(problem.weight_n), 3) or normal.shape != point.shape:
        raise InputError(
            "contact planes",
            expected=f"points and normals ({len(problem.weight_n)}, 3)",
            got=f"{point.shape} and {normal.shape}",
            cure="Give one plane per vertex.",
        )
    nowhere, none = np.zeros_like(point), np.zeros(len(point), dtype)
    return Around(point, normal, nowhere, none, nowhere, none)
