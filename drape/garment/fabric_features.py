"""The features of a fabric that the garment encoder reads: stretch, shear and bending in the axes of each patch."""

from __future__ import annotations

import numpy as np

from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_of
from drape.cloth.rest_state import RestState
from drape.errors import ArtifactError
from drape.garment.cache import Atlas, Garment
from drape.garment.grain import corner_uv, read_grain
from drape.geometry import meshes

FABRIC_COUNT = 12
STRETCH_N_PER_M, BENDING_J, DENSITY_KG_M2 = 300.0, 1e-5, 0.2  # about the middle of garments' cloth
SHEAR_OF_ISOTROPIC = 4.0 / 3.0  # shear over stretch where Poisson's ratio is a third


def warp_directions(rest: RestState, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the unit warp direction (F, 3) of every triangle of the mesh at ``vertices`` [m] (V, 3), in their frame:
    the first column of F = E D^-1, with the edges E there and D in ``rest``."""
    first, second = meshes.corner_edges(np.asarray(vertices, dtype=np.float64), faces)
    (a, b), (c, d) = np.moveaxis(rest.edges[:, 0], 1, 0), np.moveaxis(rest.edges[:, 1], 1, 0)
    along = (d[:, None] * first - b[:, None] * second) / (a * d - b * c)[:, None]
    return along / np.linalg.norm(along, axis=1, keepdims=True)


def patch_grain(atlas: Atlas, vertices: np.ndarray, faces: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """Returns (cos 2a, sin 2a) (K, 2) float32 for each patch of ``atlas``, where a is the angle from its u axis to the
    warp of its triangles. It is the mean over the triangles by area, and is shorter than 1 where the grain turns within
    the patch. A warp and its opposite count as the same. ``vertices`` [m] (V, 3), ``faces`` (F, 3), and ``warp`` (F,
    3), a unit vector per triangle."""
    area = meshes.face_areas(np.asarray(vertices, dtype=np.float64), faces)
    turned = np.zeros((len(vertices), 3, 3))
    np.add.at(turned, faces.reshape(-1), np.repeat(area[:, None, None] * warp[:, :, None] * warp[:, None], 3, axis=0))
    total = np.zeros((atlas.patch_count, 3, 3))
    weight = atlas.chart_weight.astype(np.float64)[..., None, None]
    np.add.at(total, atlas.chart_patch, weight * turned[:, None])
    frame = atlas.patch_rotation.astype(np.float64)
    local = frame.transpose(0, 2, 1) @ total @ frame
    uu, vv, uv = local[:, 0, 0], local[:, 1, 1], local[:, 0, 1]
    return (np.stack([uu - vv, 2.0 * uv], axis=1) / np.maximum(uu + vv, 1e-12)[:, None]).astype(np.float32)


def rest_grain(garment: Garment) -> np.ndarray:
    """Returns (cos 2a, sin 2a) (K, 2) float32 for each patch of ``garment`` at rest, where a is the angle from the
    patch's u axis to the warp (``patch_grain``)."""
    vertices, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    if garment.rest_edges is not None:
        warp = warp_directions(garment.rest_state(), vertices, faces)
    else:  # the same warp as in its rest state, which takes longer to make
        warp = read_grain(vertices, vertices, faces, corner_uv(garment.uv, garment.uv_faces, len(faces))).warp
    return patch_grain(garment, vertices, faces, warp)


def encoder_features(garment: Garment, width: int, fabric: Fabric | None = None) -> np.ndarray:
    """Returns the input (K, ``width``) float32 of the garment encoder for the K patches of ``garment``: the patch
    features and, if ``width`` has room for them, 12 features of the fabric. ``fabric`` is the garment's own by
    default. Networks from before there were fabrics read the patch features alone. Raises ``ArtifactError`` for any
    other width."""
    features = np.ascontiguousarray(garment.patch_features, dtype=np.float32)
    if features.shape[1] == width:
        return features
    if features.shape[1] + FABRIC_COUNT != width:
        raise ArtifactError(
            "garment patch_features",
            expected=f"{width} numbers per patch, or {width - FABRIC_COUNT} besides those of a fabric",
            got=str(features.shape[1]),
            cure="Run the intake of this release again.",
        )
    made_of = fabric_of(garment.fabric) if fabric is None else fabric
    return np.concatenate([features, fabric_features(made_of, rest_grain(garment))], axis=1)


def fabric_features(fabric: Fabric, grain: np.ndarray) -> np.ndarray:
    """Returns features (K, 12) float32 of ``fabric`` on K patches with ``grain`` (K, 2), as ``patch_grain`` returns it.

    Six columns are alike on all patches: stretch, shear over stretch, ``cross_n_per_m`` over stretch, bending, bending
    of the bias over bending, density. Stretch and bending are geometric means of warp and weft. The others turn with
    the grain, so that it says nothing about cloth that is alike in all directions: 2, warp over weft in stretch, times
    the grain; 2, the same in bending; 2, half the sum of columns 1 and 4 (from 0), times (cos 4a, sin 4a). All numbers
    but column 2 are logarithms, so that each doubling counts alike.
    """
    two = np.asarray(grain, dtype=np.float64)
    four = np.stack([two[:, 0] ** 2 - two[:, 1] ** 2, 2.0 * two[:, 0] * two[:, 1]], axis=1)
    stretch = np.sqrt(fabric.warp_n_per_m * fabric.weft_n_per_m)
    bending = np.sqrt(fabric.bending_warp_j * fabric.bending_weft_j)
    shear = np.log(fabric.shear_n_per_m / (SHEAR_OF_ISOTROPIC * stretch))
    bias = np.log(fabric.bending_bias_j / bending)
    alike = np.array(
        [
            np.log(stretch / STRETCH_N_PER_M),
            shear,
            fabric.cross_n_per_m / stretch,
            np.log(bending / BENDING_J),
            bias,
            np.log(fabric.density_kg_m2 / DENSITY_KG_M2),
        ]
    )
    parts = [
        np.broadcast_to(alike, (len(two), len(alike))),
        0.5 * np.log(fabric.warp_n_per_m / fabric.weft_n_per_m) * two,
        0.5 * np.log(fabric.bending_warp_j / fabric.bending_weft_j) * two,
        0.5 * (shear + bias) * four,
    ]
    return np.concatenate(parts, axis=1).astype(np.float32)
