"""How folds are carried from frame to frame once more, in NumPy and vertex order (``source/carry.hpp``, ``turns.hpp``).

Turns are unit quaternions (V, 4), the real part first.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material

CARRY_PASSES, FINE_PASSES = 3, 2


def surface_turns(then: np.ndarray, now: np.ndarray, faces: np.ndarray, passes: int) -> np.ndarray:
    """The turns from frames ``then`` (V, 3, 3) to those ``now``, so many times the mean with the neighbours' on
    ``faces``."""
    turns = Rotation.from_matrix(np.einsum("vki,vkj->vij", now, then)).as_quat(scalar_first=True)
    for _ in range(passes):
        total = turns.copy()
        for corner in range(3):
            own = faces[:, corner]
            for other in (corner - 1, corner - 2):
                np.add.at(total, own, _nearer(turns[faces[:, other]], turns[own]))
        turns = total / np.linalg.norm(total, axis=1, keepdims=True)
    return turns


def turned(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """``vectors`` (n, 3) after ``turns`` (n, 4)."""
    return Rotation.from_quat(turns, scalar_first=True).apply(vectors)


def carry_energy(
    x: np.ndarray, before: np.ndarray, turns: np.ndarray, cloth: ClothMesh, material: Material
) -> tuple[float, np.ndarray]:
    """What is stretched at ``x`` [m] (V, 3) beside the places ``before`` after ``turns``: energy [J], gradient [N]."""
    a, b, c, d = cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d]), np.stack([a, c]), np.stack([b, d])])  # (corner, axis, F)
    corners = [turns[cloth.faces[:, n]] for n in range(3)]
    columns = np.einsum("iaf,fix->fax", slopes, x[cloth.faces])
    old = np.einsum("iaf,fix->fax", slopes, before[cloth.faces])
    mean = np.sum([_nearer(one, corners[0]) for one in corners], axis=0)
    wanted = np.stack([turned(mean, old[:, axis]) for axis in range(2)], axis=1)
    warp, weft, _, shear = (float(value) for value in material.membrane)
    stiff = np.array([warp, weft]) + shear
    off = columns - wanted
    energy = 0.5 * np.einsum("f,a,fax,fax->", cloth.face_area, stiff, off, off)
    forces, gradient = np.einsum("f,a,iaf,fax->fix", cloth.face_area, stiff, slopes, off), np.zeros_like(x)
    np.add.at(gradient, cloth.faces, forces)
    return float(energy), gradient


def _nearer(turns: np.ndarray, own: np.ndarray) -> np.ndarray:
    """``turns`` with the signs that are nearer to ``own``."""
    return np.where((turns * own).sum(axis=1, keepdims=True) < 0.0, -turns, turns)
