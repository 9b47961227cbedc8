"""A cloth as flat arrays: what the kernels of the local solver read, in float32 or float64.

They are named tuples of arrays because numba takes those as arguments. The energy is that of ``drape.cloth.energies``,
to which two springs per vertex may be added: to a target (inertia, mass over dt^2) and to where a waistband holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from drape.cloth.energies import DEGENERATE, ClothMesh, contact_n_per_m
from drape.cloth.material import Material
from drape.cloth.waistband import SLACK_M
from drape.errors import InputError
from drape.geometry import meshes
from drape.kernels.colouring import colour_order

# Triangles lower than this share of the mean edge bend less in the quadratic model: its force grows with 1 / height.
LOW_TRIANGLE = 0.4
FLAT_SINE = 1e-6  # of a hinge's angle at rest, below which it is flat


class Constants(NamedTuple):
    """Numbers of the cloth in the kernels' type, so that no literal turns float32 into float64.

    ``warp``, ``cross``, ``weft`` half, ``shear`` a quarter of ``Material``'s [N/m]: what they are times F^T F - I.
    ``least`` [N/m] is added to every vertex's block, ``reach`` [m] the most that a step moves a vertex.
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
    zero: np.floating
    half: np.floating
    one: np.floating


class Triangles(NamedTuple):
    """``corner`` (F, 3); ``inverse`` (F, 4) [1/m]: 00, 10, 01, 11 of the inverse rest shape; ``area`` (F,) [m^2].

    Rows ``start[v]`` to ``start[v + 1]`` of ``other`` (3F, 2) and ``slope`` (3F, 5) are the triangles of vertex v with
    it as first corner: the two other vertices, for each its slope along warp and weft, and the area.
    """

    corner: np.ndarray
    inverse: np.ndarray
    area: np.ndarray
    start: np.ndarray
    other: np.ndarray
    slope: np.ndarray


class Hinges(NamedTuple):
    """``corner`` (H, 4); ``stiffness`` (H,) [J]; ``cosine``, ``sine`` (H,) of the rest angle.

    ``member`` (4H,): the hinges of vertex v, and its place in them, as 4 h + place, from ``start[v]`` on.
    """

    corner: np.ndarray
    stiffness: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    start: np.ndarray
    member: np.ndarray


class QuadraticBending(NamedTuple):
    """The constant symmetric matrix [N/m] of bending that keeps lengths, of hinges flat at rest: rows without diagonal.

    Its energy is half of x^T Q x: k/2 w |sum c_i x_i|^2 per hinge (Bergou et al. 2006).
    """

    start: np.ndarray
    vertex: np.ndarray
    value: np.ndarray
    diagonal: np.ndarray


class Surroundings(NamedTuple):
    """What acts on the vertices from outside.

    ``point``, ``normal`` (V, 3): planes of the body, whose normals need not be of unit length. ``target`` (V, 3) with
    ``target_n_per_m`` (V,), ``band`` (V, 3) with ``band_n_per_m`` (V,): springs, the second free within the slack of
    ``drape.cloth.waistband``.
    """

    point: np.ndarray
    normal: np.ndarray
    target: np.ndarray
    target_n_per_m: np.ndarray
    band: np.ndarray
    band_n_per_m: np.ndarray


class Problem(NamedTuple):
    """A cloth without its surroundings. ``weight_n`` (V,) [N], ``contact_n_per_m`` (V,) [N/m], ``order`` (V,): vertices
    colour by colour, so that no two of one colour share an element; ``colour_start`` where each colour begins.
    ``quadratic`` is of the hinges flat at rest, ``creases`` are the others."""

    constants: Constants
    triangles: Triangles
    hinges: Hinges
    quadratic: QuadraticBending
    weight_n: np.ndarray
    contact_n_per_m: np.ndarray
    order: np.ndarray
    colour_start: np.ndarray
    creases: Hinges


@dataclass(frozen=True)
class Options:
    """How a problem is stepped: ``least_n_per_m`` on every block, at most ``reach_m`` per step and vertex."""

    least_n_per_m: float = 3.0
    reach_m: float = 0.01


def problem(
    cloth: ClothMesh, material: Material, *, dtype: type[np.floating] = np.float32, options: Options | None = None
) -> Problem:
    """The flat arrays of ``cloth`` made of ``material``; floats of ``dtype``, indices int32."""
    options = options or Options()
    triangles, hinges = _triangles(cloth, dtype), _hinges(cloth, material, dtype)
    flat = (np.abs(cloth.hinge_sine) < FLAT_SINE) & (cloth.hinge_cosine > 0.0)
    graph = stencil(cloth)
    order, colour_start = colour_order(graph)
    warp, weft, cross, shear = (float(value) for value in material.membrane)
    numbers = (
        *(0.5 * warp, 0.5 * cross, 0.5 * weft, 0.25 * shear, material.contact_gap_m, SLACK_M, 1.0 / cloth.mean_edge_m),
        *(DEGENERATE, options.least_n_per_m, options.reach_m, 0.0, 0.5, 1.0),
    )
    return Problem(
        constants=Constants(*(dtype(number) for number in numbers)),
        triangles=triangles,
        hinges=hinges,
        quadratic=_quadratic(cloth, np.where(flat, hinges.stiffness, 0.0).astype(np.float64), dtype),
        weight_n=(material.gravity_m_s2 * cloth.vertex_mass(material)).astype(dtype),
        contact_n_per_m=contact_n_per_m(cloth, material).astype(dtype),
        order=order,
        colour_start=colour_start,
        creases=_of_hinges(hinges, ~flat),
    )


def surroundings(problem: Problem, point: np.ndarray, normal: np.ndarray) -> Surroundings:
    """The tangent planes (V, 3) alone; the springs have no stiffness."""
    dtype = problem.weight_n.dtype
    point, normal = (np.ascontiguousarray(rows, dtype=dtype) for rows in (point, normal))
    if point.shape != (len(problem.weight_n), 3) or normal.shape != point.shape:
        raise InputError(
            "contact planes",
            expected=f"points and normals ({len(problem.weight_n)}, 3)",
            got=f"{point.shape} and {normal.shape}",
            cure="Give one plane per vertex.",
        )
    nowhere, none = np.zeros_like(point), np.zeros(len(point), dtype)
    return Surroundings(point, normal, nowhere, none, nowhere, none)


def stencil(cloth: ClothMesh) -> Any:
    """Sparse symmetric matrix (V, V) in rows, one where two vertices share an element, and on the diagonal."""
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
    """Where each vertex's elements begin (V + 1,), and they, as element times corners plus place, in element order."""
    start = np.concatenate([[0], np.cumsum(np.bincount(corner.reshape(-1), minlength=vertex_count))])
    return start.astype(np.int32), np.argsort(corner.reshape(-1), kind="stable").astype(np.int32)


def _quadratic(cloth: ClothMesh, stiffness: np.ndarray, dtype: type[np.floating]) -> QuadraticBending:
    corner, sides = cloth.hinge_index.reshape(4, -1).T, meshes.hinge_faces(cloth.faces)
    rest = np.linalg.inv(cloth.inverse_shape.T.reshape(-1, 2, 2).transpose(0, 2, 1))  # columns: the edges
    place = np.concatenate([np.zeros((len(rest), 1, 2)), rest.transpose(0, 2, 1)], axis=1)  # (F, 3 corners, 2)
    ends, weight = np.zeros((2, len(corner))), stiffness.copy()
    wings = []
    for side in range(2):
        faces = cloth.faces[sides[:, side]]
        i, j, third = (place[sides[:, side], (faces == corner[:, k, None]).argmax(axis=1)] for k in (0, 1, 2 + side))
        edge, arm = j - i, third - i
        length = np.linalg.norm(edge, axis=1)
        foot = (edge * arm).sum(axis=1) / length**2
        height = np.maximum(np.abs(edge[:, 0] * arm[:, 1] - edge[:, 1] * arm[:, 0]) / length, 1e-3 * cloth.mean_edge_m)
        weight *= np.minimum(1.0, height / (LOW_TRIANGLE * cloth.mean_edge_m))
        ends -= np.stack([1.0 - foot, foot]) / height
        wings.append(1.0 / height)
    part = np.stack([*ends, *wings], axis=1)  # (H, 4): their sum over the corners is the turn [rad]
    block = weight[:, None, None] * part[:, :, None] * part[:, None, :]
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
