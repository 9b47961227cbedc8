"""How cloth pulls: strain along warp and weft at its vertices, and the pressure of what lies on the skin.

    strain     |F e| - 1 along warp and weft e, F the deformation gradient: engineering strain
    pressure   p = sum_ab s_ab k_ab, Laplace's law with the tension s [N/m] and the curvature k [1/m] of the cloth

Tension is the positive part of the stress: cloth that is pushed together buckles and presses nothing. On a cylinder of
radius R, pulled by T around it, p = T / R. The smooth drape of the network, without folds, is what these are meant for:
folds have curvatures of their own, which press nobody, and take up strain that a smooth cloth shows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.cloth import membrane
from drape.cloth.energies import ClothMesh
from drape.geometry import meshes

LEAST_N_PER_M = 1e-9  # added where there is no tension, so that its root is not zero


class Tension(NamedTuple):
    """The pull in a cloth at its V vertices: engineering strain along ``warp`` and ``weft`` (V,), negative where cloth
    is pushed together, and the ``pressure`` [N/m^2] (V,) on the skin, 0 or more."""

    warp: np.ndarray
    weft: np.ndarray
    pressure: np.ndarray


def cloth_tension(
    vertices: np.ndarray, cloth: ClothMesh, stiffness: membrane.Stiffness, touching: np.ndarray
) -> Tension:
    """Returns strain and pressure of ``cloth`` at ``vertices`` [m] (V, 3), by vertex.

    ``stiffness`` is (warp, weft, cross, shear) [N/m]; ``touching`` (V,) bool says which vertices lie on the skin, since
    others have no pressure. A vertex has the mean of its triangles, weighted by their areas at rest.
    """
    along = _columns(vertices, cloth)
    strains = [np.sqrt(np.sum(way * way, axis=0)) - 1.0 for way in along]
    warp, weft, pressure = face_means(np.stack([*strains, face_pressure(vertices, cloth, stiffness)]), cloth)
    return Tension(warp, weft, np.where(touching, np.maximum(pressure, 0.0), 0.0))


def face_pressure(vertices: np.ndarray, cloth: ClothMesh, stiffness: membrane.Stiffness) -> np.ndarray:
    """Returns the pressure [N/m^2] (F,) of each triangle against its normal, negative where the cloth is hollow.

    It is (S_pp p.dn_p + S_tt t.dn_t + S_pt (p.dn_t + t.dn_p)) / J: p and t are the columns of the deformation gradient
    (warp, weft), J is the stretch of the area, S the second Piola-Kirchhoff stress after ``membrane.tension``, and dn
    are the slopes of the cloth's normal along warp and weft.
    """
    p, t = _columns(vertices, cloth)
    along_p, along_t = _columns(meshes.vertex_normals(vertices, cloth.faces), cloth)
    pp, tt, pt = membrane.tension(membrane.stress(membrane.green_strain(p, t), stiffness), LEAST_N_PER_M)
    by_pp, by_tt, by_pt = (np.sum(a, axis=0) for a in (p * along_p, t * along_t, p * along_t + t * along_p))
    area = np.linalg.norm(np.cross(p, t, axis=0), axis=0)
    return (pp * by_pp + tt * by_tt + pt * by_pt) / np.maximum(area, 1e-6)


def _columns(values: np.ndarray, cloth: ClothMesh) -> tuple[np.ndarray, np.ndarray]:
    """The slopes (3, F) of ``values`` (V, 3) along warp and weft."""
    return membrane.deformation_columns([values[column].T for column in cloth.faces.T], cloth.inverse_shape)


def face_means(values: np.ndarray, cloth: ClothMesh) -> np.ndarray:
    """Returns for every vertex the mean (..., V) of ``values`` (..., F) of the triangles around it, weighted by area at
    rest."""
    rows = np.concatenate([values.reshape(-1, values.shape[-1]), np.ones((1, values.shape[-1]))]) * cloth.face_area
    count = len(cloth.vertex_area)
    sums = [np.bincount(cloth.face_index, np.tile(row, 3), minlength=count) for row in rows]
    means = np.array(sums[:-1]) / np.maximum(sums[-1], 1e-30)
    return means.reshape(*values.shape[:-1], count)
