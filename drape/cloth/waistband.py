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
    """Vertices (n,) of a garment's highest border, and the length of band [m] (n,) that each stands for."""

    vertex: np.ndarray
    length_m: np.ndarray


def waistband(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> Waistband | None:
    """The band of a garment at rest, ``vertices`` [m] (V, 3) on ``body``; ``None`` if it hangs from the shoulders.

    A garment that ends below the chest has one: its border of the greatest mean height.
    """
    loops = meshes.boundary_loops(faces)
    if not loops or vertices[:, 1].max() > body.joints_template[CHEST, 1]:
        return None
    top = max(loops, key=lambda loop: float(vertices[loop, 1].mean()))
    steps = np.linalg.norm(np.roll(vertices[top], -1, axis=0) - vertices[top], axis=1)
    return Waistband(top, 0.5 * (steps + np.roll(steps, 1)))


def band_energy(way: Array, length_m: Array) -> Array:
    """Energy [J] (F,) of a band whose vertices are ``way`` [m] (F, n, 3) off the places that the body gives them.

    ``K / 2 sum l max(0, |d| - slack)^2``: free within the slack, a spring past it, along the skin and off it alike.
    """
    xp = namespace(way)
    # A bound and not a plain root, whose gradient at zero is infinite.
    past = xp.clip(xp.sqrt(xp.clip(xp.sum(way * way, axis=-1), min=1e-12)) - SLACK_M, min=0.0)
    return 0.5 * STIFFNESS_N_M2 * xp.sum(length_m * past * past, axis=-1)
