"""Small cloths with everything that acts on them, for the tests of the local solver."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.problem import Problem, problem
from drape.cloth.rest_state import flat_rest, grain_along, modelled_rest
from drape.exact.surroundings import Around, surroundings
from tests.drape.cloth.cloth_shapes import grid

MATERIALS = {
    "isotropic": Material(),
    "rib": Material.of(fabric("rib")),
    "poplin": Material.of(fabric("poplin")),
    "denim": Material.of(fabric("denim")),
}


class Scene(NamedTuple):
    cloth: ClothMesh
    material: Material
    problem: Problem
    around: Around
    x: np.ndarray


def crumpled(material: str = "isotropic", *, flat: bool = False, springs: bool = True, noise_m=0.001) -> Scene:
    """A bent and stretched grid, its grain turned by 0.4, half of it in contact, with all springs or none."""
    rng = np.random.default_rng(7)
    rest, faces = grid(6, 5)
    rest[:, 2] = 0.004 * np.sin(150.0 * rest[:, 0])
    grain = grain_along(rest, faces, (np.sin(0.4), np.cos(0.4), 0.0))
    state = (flat_rest if flat else modelled_rest)(rest, faces, grain)
    cloth = ClothMesh.of(state, faces, len(rest))
    made = problem(cloth, MATERIALS[material], dtype=np.float64)
    x = rest + noise_m * rng.normal(size=rest.shape)
    normals = rng.normal(size=x.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = np.where(np.arange(len(x)) % 2 == 0, 0.002, 0.008)[:, None]
    around = surroundings(made, x - away * normals, normals)
    if springs:
        around = replace(
            around,
            target=x + 1e-3 * rng.normal(size=x.shape),
            target_n_per_m=np.where(np.arange(len(x)) % 4 == 0, 2.0, 0.0),
            band=x + 1e-2 * rng.normal(size=x.shape),
            band_n_per_m=np.where(np.arange(len(x)) % 5 == 0, 3.0, 0.0),
        )
    return Scene(cloth, MATERIALS[material], made, around, x)
