"""The subdivided mesh of a garment as one that is delivered: with its texture coordinates and materials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.geometry import meshes

SUFFIX = "-fine"  # of the digest


def has_finer(garment: Garment) -> bool:
    """Returns whether intake subdivided the delivered triangles of ``garment``, which it does where they are long or
    few."""
    return len(garment.vertices) > garment.vertex_count


def fine_garment(garment: Garment) -> Garment:
    """Returns ``garment`` with its subdivided mesh as the delivered one, under a digest of its own. Its first vertices
    are the delivered ones, in their order. Texture coordinates are linear in every delivered triangle, whose parts have
    its material; ``drawn`` is None. A garment that was not subdivided is returned as it is, but for ``drawn``. Raises
    ``ArtifactError`` where ``fine_faces`` are no subdivision of ``faces``."""
    if not has_finer(garment):
        return garment if garment.drawn is None else replace(garment, drawn=None)
    uv, uv_faces, per_face = np.asarray(garment.uv), garment.uv_faces, 1
    for _ in _rounds(garment):
        per_face *= 4
        if len(uv_faces):
            uv, uv_faces, _ = meshes.subdivide(uv, uv_faces.astype(np.int64))
    return replace(
        garment,
        digest=garment.digest + SUFFIX,
        vertex_count=len(garment.vertices),
        faces=garment.fine_faces,
        uv=uv.astype(garment.uv.dtype),
        uv_faces=uv_faces.astype(garment.uv_faces.dtype),
        face_material=np.repeat(garment.face_material, per_face),
        drawn=None,
    )


def corner_weights(garment: Garment) -> sp.csr_matrix:
    """Returns the sparse matrix (N, V) that interpolates the N vertices of the subdivided mesh in the delivered
    triangles: rows of at most three weights, which sum to one. Raises ``ArtifactError`` where ``fine_faces`` are no
    subdivision of ``faces``."""
    weights = sp.csr_matrix(sp.identity(garment.vertex_count))
    for parents in _rounds(garment):
        weights = sp.csr_matrix(0.5 * (weights[parents[:, 0]] + weights[parents[:, 1]]))
    return weights


def _rounds(garment: Garment) -> Iterator[np.ndarray]:
    """The parents (n, 2) of every vertex after each round of subdivision of ``faces`` up to ``fine_faces``."""
    faces, count = garment.faces.astype(np.int64), garment.vertex_count
    rounds: list[np.ndarray] = []
    while len(faces) < len(garment.fine_faces):
        _, faces, parents = meshes.subdivide(np.zeros((count, 1)), faces)
        count = len(parents)
        rounds.append(parents)
    if count != len(garment.vertices) or not np.array_equal(faces, garment.fine_faces):
        raise ArtifactError(
            f"garment {garment.name} fine_faces",
            expected="a subdivision of faces",
            got=f"{len(garment.fine_faces)} triangles of {len(garment.vertices)} vertices",
            cure="Run the intake again.",
        )
    yield from rounds
