"""Samples of garments, so that the push-out keeps an outer garment out of those below it.

A garment's surface is sampled as the body's skin is (``drape.contact.samples``), as sums over its own vertices: the
samples follow whatever the drape and the push-out made of it. For the garment over it, body and inner garments are one
set of samples, without those that lie under cloth at rest. The same tables and the same push-out serve all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from drape.contact.samples import CLUSTER_SIZE, FACING, Placed, Samples, at_rest, operator, place, thin_points, unit
from drape.errors import InputError
from drape.geometry import closest, meshes

SPACING_M = 0.014
THIN_M = 0.008  # of vertices nearer together one gives tangents, so that fine meshes cost no more
MEMBERS = 24  # vertices that the samples of a cluster are sums over
CANDIDATES = 48
COVER_M = 0.06  # cloth farther before a sample than this does not hide it
BEHIND_M = 0.015  # nor does cloth that lies more than this behind it: layers may cross a little at rest


@dataclass(frozen=True, eq=False)
class ClothSamples(Samples):
    """The samples of a garment, in C clusters of 4. They also come from small products of the garment's vertices.

    ``member`` (C, 24) are the vertices that a cluster is a weighted sum of, and ``rows`` (C, 24, 12) their weights for
    its 4 points, 4 first and 4 second tangents.
    """

    member: np.ndarray
    rows: np.ndarray


def cloth_samples(vertices: np.ndarray, faces: np.ndarray) -> ClothSamples:
    """Returns the samples of a garment with ``vertices`` [m] (V, 3) at rest and ``faces`` (F, 3) that are
    counter-clockwise seen from outside."""
    rest = np.asarray(vertices, dtype=np.float64)
    faces = meshes.check_faces(faces, len(rest))
    placed = place(rest, faces, np.full(len(rest), SPACING_M))
    member = _members(rest, faces, placed)
    sample = np.repeat(np.arange(len(placed.point)), MEMBERS)
    keys = np.unique(sample * len(rest) + np.repeat(member, CLUSTER_SIZE, axis=0).reshape(-1))
    made = at_rest(operator(rest, faces, placed, keys // len(rest), keys % len(rest)), rest, placed)
    return ClothSamples(made.operator, made.point, made.normal, made.spacing_m, member, _rows(made, member))


def join_samples(parts: Sequence[Samples]) -> Samples:
    """Returns the samples of several meshes as samples of one mesh, in the order of ``parts``; its vertices are the
    vertices of all, in the same order. Raises ``InputError`` for no parts."""
    if not parts:
        raise InputError("parts", expected="at least one", got="none", cure="Pass the body's samples first.")
    thirds = [[part.operator[k * part.count : (k + 1) * part.count] for part in parts] for k in range(3)]
    stacked = scipy.sparse.vstack([scipy.sparse.block_diag(third) for third in thirds])
    point, normal, spacing = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("point", "normal", "spacing_m")
    )
    return Samples(scipy.sparse.csr_matrix(stacked), point, normal, spacing)


def hidden_samples(samples: Samples, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns which of S ``samples`` are hidden at rest, bool (S,), by the cloth with ``vertices`` [m] (V, 3) and
    ``faces``: the cloth is near the sample and in front of it, and does not end there."""
    found = closest.closest_point(samples.point, vertices, faces)
    before = ((found.point - samples.point) * samples.normal).sum(axis=1)
    return (found.distance < COVER_M) & (before > -BEHIND_M) & ~closest.on_border(found, faces)


def _members(rest: np.ndarray, faces: np.ndarray, placed: Placed) -> np.ndarray:
    """Vertices (C, 24) of each cluster: the corners of its samples' faces, then the nearest that face its way.

    Where there are fewer, the first one repeats.
    """
    normals = meshes.vertex_normals(rest, faces)
    thin = _thinned(rest, normals)
    corners = faces[placed.face].reshape(-1, 3 * CLUSTER_SIZE)
    centre = placed.point.reshape(-1, CLUSTER_SIZE, 3).mean(axis=1)
    facing = unit(placed.normal.reshape(-1, CLUSTER_SIZE, 3).mean(axis=1))
    near = thin[KDTree(rest[thin]).query(centre, k=min(CANDIDATES, len(thin)))[1].reshape(len(centre), -1)]
    fits = np.einsum("cnk,ck->cn", normals[near], facing) > FACING
    member = np.repeat(corners[:, :1], MEMBERS, axis=1)
    for cluster, (own, around) in enumerate(zip(corners, near, strict=True)):
        chosen = dict.fromkeys([*own.tolist(), *around[fits[cluster]].tolist()])
        first = list(chosen)[:MEMBERS]
        member[cluster, : len(first)] = first
    return member


def _thinned(rest: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Vertices no two of which are nearer than ``THIN_M``, the two sides of thin parts counted apart."""
    key = np.concatenate([rest, 0.5 * THIN_M * normals], axis=1)
    return thin_points(key, np.full(len(rest), THIN_M))


def _rows(samples: Samples, member: np.ndarray) -> np.ndarray:
    """The operator's numbers by cluster (C, 24, 12); zero in places that repeat a vertex."""
    entries = samples.operator.tocoo()
    kind, sample = np.divmod(entries.row, samples.count)
    cluster, own = np.divmod(sample, CLUSTER_SIZE)
    place_of = (member[cluster] == entries.col[:, None]).argmax(axis=1)
    rows = np.zeros((*member.shape, 3 * CLUSTER_SIZE), dtype=np.float32)
    rows[cluster, place_of, kind * CLUSTER_SIZE + own] = entries.data
    return rows
