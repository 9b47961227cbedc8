"""Small rest garments, shared by the garment tests."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from drape.garment.cache import Garment
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.fitting import RestGarment, fit_garment, rest_garment
from tests.drape.cloth.cloth_shapes import tube
from tests.fixtures.garments import default_body

PATCH_COUNT = 24


def side_by_side(*pieces: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh of several pieces, each a metre further along x."""
    vertices, faces, start = [], [], 0
    for index, (v, f) in enumerate(pieces):
        vertices.append(v + np.array([index, 0.0, 0.0]))
        faces.append(f + start)
        start += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


@functools.cache
def barrel() -> RestGarment:
    """An open tube of 840 vertices round the trunk of the shipped body."""
    vertices, faces = tube(40, 20, radius_m=0.25, height_m=0.5)
    return rest_garment(vertices - [0.0, 0.1, 0.0], faces, default_body())


def barrel_mesh() -> GarmentMesh:
    """The barrel as it would be delivered, its last ring left to subdivision."""
    rest = barrel()
    delivered = len(rest.vertices) - 40
    faces = rest.faces[(rest.faces < delivered).all(axis=1)]
    return replace(plain_mesh("barrel", rest.vertices[:delivered], faces), material_names=("cotton", "hem"))


@functools.cache
def barrel_garment() -> Garment:
    """The fitted barrel."""
    rest, manifest = barrel(), {"source": "a tube"}
    return fit_garment(
        barrel_mesh(), rest.vertices, rest.faces, default_body(), digest="d" * 64, manifest=manifest, count=PATCH_COUNT
    )
