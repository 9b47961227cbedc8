"""A cloth as flat arrays, in float32 or float64, for the engine to read.

Their energy is that of ``drape.cloth.energies``; the engine's formulas are in ``drape/engine/source/elements.hpp``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import DEGENERATE, ClothMesh, contact_n_per_m
from drape.cloth.material import Material
from drape.cloth.waistband import SLACK_M
from drape.engine.packer import Recorded
from drape.geometry import meshes
from drape.geometry.colouring import colour_order

# Triangles lower than this share of the mean edge are made to bend less: the quadratic force grows with 1 / height.
LOW_TRIANGLE = 0.4
FLAT_SINE = 1e-6  # a hinge whose angle at rest has a smaller sine is flat
LEAST_N_PER_M = 3.0  # added to the Hessian block of every vertex
REACH_M = 0.01


class KernelConstants(NamedTuple):
    """The numbers of a cloth that all its elements share, as floats of the kernels' type.

    ``warp``, ``cross`` and ``weft`` [N/m] are half of ``Material``'s, ``shear`` is a quarter: times F^T F - I they give
    the stress. Contact begins ``gap`` [m] over the skin; the waistband's springs pull from ``slack`` [m] on.
    ``per_edge`` [1/m] is one over the mean edge, which makes lengths dimensionless, and ``degenerate`` is added to
    their squares. ``least`` [N/m] is added to the Hessian block of every vertex; a step moves no vertex by more than
    ``reach`` [m].
    """

    warp: np.floating
    cross: np.floating
    weft: np.floating
    shear: np.floating
    gap: np.floating
    slack: np.floating
    per_edge: np.floating
    degenerate: np.floating
    least: np.floating
    reach: np.floating


class Triangles(NamedTuple):
    """The F triangles of a cloth, and for every vertex the triangles around it.

    ``corner`` (F, 3); ``inverse`` (F, 4) [1/m]: entries 00, 10, 01, 11 of the inverse rest shape; ``area`` (F,) [m^2].
    The triangles of vertex v are rows ``start[v]`` to ``start[v + 1]`` of ``other`` (3F, 2) and ``slope`` (3F, 5). With
    v as first corner, ``other`` has the second and third one; ``slope`` has the slopes [1/m] along warp and weft of the
    shape functions of the second, then of the third corner, and the area [m^2].
    """

    corner: np.ndarray
    inverse: np.ndarray
    area: np.ndarray
    start: np.ndarray
    other: np.ndarray
    slope: np.ndarray


class Hinges(NamedTuple):
    """The H hinges of a cloth, and for every vertex the hinges that it is a corner of.

    ``corner`` (H, 4): the ends of the edge, then the third corners of both triangles; ``stiffness`` (H,) [J];
    ``cosine``, ``sine`` (H,) of the rest angle. The hinges of vertex v are ``member[start[v] : start[v + 1]]``, each 4
    h + c where v is corner c of hinge h.
    """

    corner: np.ndarray
    stiffness: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    start: np.ndarray
    member: np.ndarray


class QuadraticBending(NamedTuple):
    """The symmetric matrix Q [N/m] (V, V) of the bending of hinges that are flat at rest, in compressed rows.

    Row v has the ``value`` at the columns ``vertex`` from ``start[v]`` to ``start[v + 1]``, and ``diagonal[v]`` (V,).
    The energy is x^T Q x / 2, for each hinge k/2 w |sum c_i x_i|^2 (Bergou et al. 2006, "A Quadratic Bending Model for
    Inextensible Surfaces", SGP). Q is constant as long as triangles keep their lengths.
    """

    start: np.ndarray
    vertex: np.ndarray
    value: np.ndarray
    diagonal: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem(Recorded):
    """A cloth of V vertices as flat arrays, without what surrounds it.

    ``weight_n`` (V,) [N] is each vertex's weight, ``contact_n_per_m`` (V,) [N/m] its contact stiffness. ``order`` (V,)
    has the vertices colour by colour; ``colour_start`` says where each colour begins. No two vertices of one colour
    share a triangle or hinge. ``hinges`` are all hinges; ``quadratic`` bends those that are flat at rest, and
    ``creases`` are the others.
    """

    constants: KernelConstants
    triangles: Triangles
    hinges: Hinges
    quadratic: QuadraticBending
    weight_n: np.ndarray
    contact_n_per_m: np.ndarray
    order: np.ndarray
    colour_start: np.ndarray
    creases: Hinges


def problem(
    cloth: ClothMesh, material: Material, *, dtype: type[np.floating] = np.float32, reach_m: float = REACH_M
) -> Problem:
    """Returns ``cloth`` made of ``material`` as flat arrays: floats of ``dtype``, indices int32.

    A step moves no vertex by more than ``reach_m`` [m].
    """
    triangles, hinges = _triangles(cloth, dtype), _hinges(cloth, material, dtype)
    flat = (np.abs(cloth.hinge_sine) < FLAT_SINE) & (cloth.hinge_cosine > 0.0)
    graph = stencil(cloth)
    order, colour_start = colour_order(graph)
    warp, weft, cross, shear = (float(value) for value in material.membrane)
    numbers = (
        *(0.5 * warp, 0.5 * cross, 0.5 * weft, 0.25 * shear, material.contact_gap_m, SLACK_M, 1.0 / cloth.mean_edge_m),
        *(DEGENERATE, LEAST_N_PER_M, reach_m),
    )
    return Problem(
        constants=KernelConstants(*(dtype(number) for number in numbers)),
        triangles=triangles,
        hinges=hinges,
        quadratic=_quadratic(cloth, np.where(flat, hinges.stiffness, 0.0).astype(np.float64), dtype),
        weight_n=(material.gravity_m_s2 * cloth.vertex_mass(material)).astype(dtype),
        contact_n_per_m=contact_n_per_m(cloth, material).astype(dtype),
        order=order,
        colour_start=colour_start,
        creases=_of_hinges(hinges, ~flat),
    )


def stencil(cloth: ClothMesh) -> Any:
    """Returns a sparse symmetric matrix (V, V) in compressed rows: 1 where two vertices share a triangle or a hinge,
    and on the diagonal."""
    count, corners = cloth.vertex_count, [cloth.faces, cloth.hinge_index.reshape(4, -1).T]
    rows = np.concatenate([np.repeat(c, c.shape[1], axis=1).reshape(-1) for c in corners] + [np.arange(count)])
    columns = np.concatenate([np.tile(c, (1, c.shape[1])).reshape(-1) for c in corners] + [np.arange(count)])
    pattern = scipy.sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    pattern.sum_duplicates()
    pattern.data[:] = 1.0
    return pattern


def _triangles(cloth: ClothMesh, dtype: type[np.floating]) -> Triangles:
    faces, (a, b, c, d) = cloth.faces, cloth.inverse_shape
    slopes = np.stack([np.stack([-a - b, -c - d], axis=1), np.stack([a, c], axis=1), np.stack([b, d], axis=1)], axis=1)
    start, entry = _members(faces, cloth.vertex_count)
    face, place = entry // 3, entry % 3
    second, third = (place + 1) % 3, (place + 2) % 3
    own = [slopes[face, second], slopes[face, third], cloth.face_area[face, None]]
    return Triangles(
        corner=faces.astype(np.int32),
        inverse=np.ascontiguousarray(cloth.inverse_shape.T, dtype=dtype),
        area=cloth.face_area.astype(dtype),
        start=start,
        other=np.stack([faces[face, second], faces[face, third]], axis=1).astype(np.int32),
        slope=np.concatenate(own, axis=1).astype(dtype),
    )


def _hinges(cloth: ClothMesh, material: Material, dtype: type[np.floating]) -> Hinges:
    corner = np.ascontiguousarray(cloth.hinge_index.reshape(4, -1).T, dtype=np.int32)
    mean, second, fourth = (float(value) for value in material.bending)
    rigidity = mean + second * cloth.hinge_turn[:, 0] + fourth * cloth.hinge_turn[:, 1]
    start, member = _members(corner, cloth.vertex_count)
    numbers = (rigidity * cloth.hinge_weight, cloth.hinge_cosine, cloth.hinge_sine)
    stiffness, cosine, sine = (number.astype(dtype) for number in numbers)
    return Hinges(corner, stiffness, cosine, sine, start, member)


def _of_hinges(hinges: Hinges, chosen: np.ndarray) -> Hinges:
    """Those of ``hinges`` that are ``chosen`` (H,)."""
    corner = hinges.corner[chosen]
    start, member = _members(corner, len(hinges.start) - 1)
    return Hinges(corner, hinges.stiffness[chosen], hinges.cosine[chosen], hinges.sine[chosen], start, member)


def _members(corner: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each vertex's elements begin (V + 1,), and those elements as element times corners plus corner."""
    start = np.concatenate([[0], np.cumsum(np.bincount(corner.reshape(-1), minlength=vertex_count))])
    return start.astype(np.int32), np.argsort(corner.reshape(-1), kind="stable").astype(np.int32)


def _quadratic(cloth: ClothMesh, stiffness: np.ndarray, dtype: type[np.floating]) -> QuadraticBending:
    """The matrix of the hinges with the ``stiffness`` [J] (H,), which is zero where one is not flat at rest."""
    corner, flat = cloth.hinge_index.reshape(4, -1).T, unfold_hinges(cloth)
    ends, weight = np.zeros((2, len(corner))), stiffness.copy()
    wings = []
    for length, along, rise in zip(flat.length, flat.along, flat.height, strict=True):
        foot, height = along / length**2, np.maximum(rise, 1e-3 * cloth.mean_edge_m)
        weight *= np.minimum(1.0, height / (LOW_TRIANGLE * cloth.mean_edge_m))
        ends -= np.stack([1.0 - foot, foot]) / height
        wings.append(1.0 / height)
    turn = np.stack([*ends, *wings], axis=1)  # (H, 4): the sum of turn times place over the corners is the angle [rad]
    block = weight[:, None, None] * turn[:, :, None] * turn[:, None, :]
    index = np.repeat(corner, 4, axis=1).reshape(-1), np.tile(corner, (1, 4)).reshape(-1)
    shape = (cloth.vertex_count, cloth.vertex_count)
    matrix = scipy.sparse.coo_matrix((block.reshape(-1), index), shape=shape).tocsr()
    matrix.sum_duplicates()
    diagonal = matrix.diagonal()
    off = (matrix - scipy.sparse.diags(diagonal)).tocsr()
    off.eliminate_zeros()
    off.sort_indices()
    return QuadraticBending(
        off.indptr.astype(np.int32), off.indices.astype(np.int32), off.data.astype(dtype), diagonal.astype(dtype)
    )


def rest_edges(cloth: ClothMesh) -> np.ndarray:
    """Returns the two edges [m] (F, 2, 2) from the first corner of every triangle at rest, in the axes (warp, weft)."""
    return np.linalg.inv(cloth.inverse_shape.T.reshape(-1, 2, 2).transpose(0, 2, 1)).transpose(0, 2, 1)


class Unfolded(NamedTuple):
    """The H hinges with both triangles laid flat at rest; the first axis of each array is the triangle.

    ``length`` [m] (2, H) of the shared edge as each triangle has it; ``along`` [m^2] (2, H): the scalar product of the
    edge and the vector from its start to the third corner; ``height`` [m] (2, H) of that corner over the edge.
    """

    length: np.ndarray
    along: np.ndarray
    height: np.ndarray


def unfold_hinges(cloth: ClothMesh) -> Unfolded:
    """Returns lengths and heights of the hinges of ``cloth``, laid flat."""
    edges, faces = rest_edges(cloth), cloth.faces
    place = np.concatenate([np.zeros((len(edges), 1, 2)), edges], axis=1)  # (F, 3 corners, 2)
    corner, hinges = cloth.hinge_index.reshape(4, -1).T, []
    for side, own in enumerate(meshes.hinge_faces(faces).T):
        i, j, third = (place[own, (faces[own] == corner[:, k, None]).argmax(axis=1)] for k in (0, 1, 2 + side))
        edge, arm = j - i, third - i
        length = np.linalg.norm(edge, axis=1)
        height = np.abs(edge[:, 0] * arm[:, 1] - edge[:, 1] * arm[:, 0]) / length
        hinges.append((length, (edge * arm).sum(axis=1), height))
    return Unfolded(*(np.stack(each) for each in zip(*hinges, strict=True)))
