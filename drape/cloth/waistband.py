"""The waistband holds trousers and skirts up: statics without friction would let them slide for ever."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import Array, namespace
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.geometry import meshes

STIFFNESS_N_M2 = 500.0  # force per length of band and per way past the slack
SLACK_M = 0.01
CHEST = JOINT_NAMES.index("spine3")


@dataclass(frozen=True, eq=False)
class Waistband:
    """A waistband: the vertices (n,) of a garment's highest border in order, and the length [m] (n,) of band at
    each."""

    vertex: np.ndarray
    length_m: np.ndarray


def waistband(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> Waistband | None:
    """Returns the waistband of a garment that is at rest on ``body`` at ``vertices`` [m] (V, 3): the border with the
    greatest mean height.

    It is ``None`` if the garment has no border or reaches above the chest, and so hangs from the shoulders.
    """
    loops = meshes.boundary_loops(faces)
    if not loops or vertices[:, 1].max() > body.joints_template[CHEST, 1]:
        return None
    top = max(loops, key=lambda loop: float(vertices[loop, 1].mean()))
    steps = np.linalg.norm(np.roll(vertices[top], -1, axis=0) - vertices[top], axis=1)
    return Waistband(top, 0.5 * (steps + np.roll(steps, 1)))


def band_energy(way: Array, length_m: Array) -> Array:
    """Returns the energy [J] (F,) of a waistband in F frames. ``way`` [m] (F, n, 3) is how far each of its n vertices
    is from where the body would take it; ``length_m`` [m] (n,) is the length of band at each.

    It is ``K / 2 sum l max(0, |d| - slack)^2`` with ``STIFFNESS_N_M2`` and ``SLACK_M``: free within the slack, a spring
    past it, along the skin and off it alike.
    """
    xp = namespace(way)
    # A bound and not a plain root, whose gradient at zero is infinite.
    past = xp.clip(xp.sqrt(xp.clip(xp.sum(way * way, axis=-1), min=1e-12)) - SLACK_M, min=0.0)
    return 0.5 * STIFFNESS_N_M2 * xp.sum(length_m * past * past, axis=-1)
