"""Energies [J] (...) of a cloth at positions (..., V, 3): membrane, bending, gravity, inertia, contact.

Written once for numpy and torch. Positions are first laid out as planes
(3, ..., V), so that every formula is a handful of whole-array products and the
gathers run along the last axis: in torch the backward of ``take`` along axis -2
is many times slower.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from drape.arrays import Array, device, namespace
from drape.cloth.bending import hinge, one_minus_cosine
from drape.cloth.material import Material
from drape.cloth.membrane import RestTriangles, membrane_energy, rest_triangles
from drape.cloth.rest_state import RestState, modelled_rest
from drape.geometry import meshes

# Added to squared lengths in units of the mean edge: a collapsed triangle keeps a finite
# gradient, a healthy one loses 1e-8 of its cosine.
DEGENERATE = 1e-8


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """The constants of a cloth's energy with F triangles, V vertices and H hinges. Arrays are numpy's until ``like``
    moves them.

    ``faces`` (F, 3), ``face_index`` (3F,) and ``hinge_index`` (4H,) are vertex indices; in the last two all first
    corners come before all second ones. ``inverse_shape`` (4, F) [1/m]: entries 00, 10, 01, 11 of the inverse of the
    rest shape D (2 x 2: rows warp and weft, columns the edges from the first corner). ``face_area`` (F,) and
    ``vertex_area`` (V,) [m^2] are at rest. ``hinge_cosine``, ``hinge_sine`` (H,) are of the rest angle.
    ``hinge_weight`` (H,): l^2 / (A1 + A2) times the hinge's stiffening, zero between needle triangles. ``hinge_turn``
    (H, 2): cos 2a and cos 4a, a the angle between the warp and the direction in which the hinge bends. ``mean_edge_m``
    [m] is the mean edge at rest.
    """

    faces: np.ndarray
    face_index: Array
    inverse_shape: Array
    face_area: Array
    vertex_area: Array
    hinge_index: Array
    hinge_cosine: Array
    hinge_sine: Array
    hinge_weight: Array
    hinge_turn: Array
    mean_edge_m: float

    @classmethod
    def from_rest(cls, vertices: np.ndarray, faces: np.ndarray) -> ClothMesh:
        """Returns the constants of a mesh that is at rest at ``vertices`` [m] (V, 3), its grain vertical
        (``rest_state.modelled_rest``)."""
        return cls.of(modelled_rest(vertices, faces), faces, len(vertices))

    @classmethod
    def of(cls, rest: RestState, faces: np.ndarray, vertex_count: int) -> ClothMesh:
        """Returns the constants of a mesh of ``faces`` (F, 3) on ``vertex_count`` vertices with the rest state
        ``rest``."""
        faces = meshes.check_faces(faces, vertex_count)
        area, sides = rest.face_area, meshes.hinge_faces(faces)
        triangles = rest_triangles(rest.edges[:, 0].T, rest.edges[:, 1].T)
        spread = np.zeros(vertex_count)
        np.add.at(spread, faces.reshape(-1), np.repeat(area / 3.0, 3))
        third = rest.edges[:, 1] - rest.edges[:, 0]
        lengths = np.linalg.norm(np.concatenate([rest.edges[:, 0], rest.edges[:, 1], third]), axis=1)
        hinges = meshes.hinges(faces)
        shared = _shared_edges(rest.edges, faces, hinges, sides)  # (H, 2 sides, 2)
        mean_edge = float(lengths.mean())
        # The guard eats the angle of such a hinge: its cosine and sine would have less than half their size.
        needle = (4.0 * area[sides].prod(axis=1) / mean_edge**4) ** 2 < DEGENERATE / 3.0
        square = np.linalg.norm(shared, axis=2).mean(axis=1) ** 2
        # A hinge bends across its edge (fabric.bending_angle): at the angle to the warp that its edge has to the weft.
        turn = np.arctan2(shared[..., 0], shared[..., 1])
        return cls(
            faces=faces,
            face_index=np.ascontiguousarray(faces.T).reshape(-1),
            inverse_shape=triangles.inverse,
            face_area=area,
            vertex_area=spread,
            hinge_index=np.ascontiguousarray(hinges.T).reshape(-1),
            hinge_cosine=np.cos(rest.hinge_angle),
            hinge_sine=np.sin(rest.hinge_angle),
            hinge_weight=np.where(needle, 0.0, rest.stiffening * square / area[sides].sum(axis=1)),
            hinge_turn=np.stack([np.cos(n * turn).mean(axis=1) for n in (2.0, 4.0)], axis=1),
            mean_edge_m=mean_edge,
        )

    @property
    def vertex_count(self) -> int:
        return self.vertex_area.shape[0]

    def like(self, positions: Array) -> ClothMesh:
        """Returns the same constants in the namespace, dtype and device of ``positions``. Do this once, outside the
        loop."""
        xp = namespace(positions)
        moved = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray) and item.name != "faces":
                dtype = None if value.dtype.kind in "iu" else positions.dtype
                value = xp.asarray(value, dtype=dtype, device=device(positions))
            moved[item.name] = value
        return ClothMesh(**moved)

    def vertex_mass(self, material: Material) -> Array:
        """Mass [kg] (V,) of every vertex."""
        return material.density_kg_m2 * self.vertex_area


def _shared_edges(edges: np.ndarray, faces: np.ndarray, hinges: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The edge i -> j of every hinge [m] (H, 2, 2) in the axes (warp, weft) of its first and second triangle."""
    place = np.concatenate([np.zeros((len(edges), 1, 2)), edges], axis=1)  # (F, 3 corners, 2)
    vectors = []
    for side in range(2):
        face = sides[:, side]
        start, end = (place[face, (faces[face] == hinges[:, k, None]).argmax(axis=1)] for k in (0, 1))
        vectors.append(end - start)
    return np.stack(vectors, axis=1)


def membrane(positions: Array, mesh: ClothMesh, material: Material) -> Array:
    """Returns the membrane energy [J] (...) of ``positions`` [m] (..., V, 3), summed over the triangles.

    It is that of ``drape.cloth.membrane``, along warp and weft.
    """
    return _membrane(_planes(positions), mesh, material)


def bending(positions: Array, mesh: ClothMesh, material: Material) -> Array:
    """Returns the bending energy [J] (...) of ``positions`` [m] (..., V, 3), summed over the hinges
    (``drape.cloth.bending``).

    A hinge's rigidity is that of its direction (``fabric.hinge_harmonics``), times its stiffening.
    """
    return _bending(_planes(positions), mesh, material)


def gravity(positions: Array, mesh: ClothMesh, material: Material, *, height_m: float | Array = 0.0) -> Array:
    """Returns the potential energy of weight, m g (y - height) [J] (...), of ``positions`` [m] (..., V, 3), summed over
    the vertices. ``height_m`` [m], where it is zero, is a number or (..., 1)."""
    xp = namespace(positions)
    weight = material.gravity_m_s2 * mesh.vertex_mass(material)
    return xp.sum(weight * (positions[..., 1] - height_m), axis=-1)


def inertia(
    positions: Array,
    before: Array,
    before_that: Array,
    mesh: ClothMesh,
    material: Material,
    *,
    dt_s: float | Array,
    dt_before_s: float | Array | None = None,
) -> Array:
    """Returns the inertial energy [J] (...): the sum over the vertices of m / (2 dt^2) |x - (x1 + dt v)|^2, v = (x1 -
    x2) / dt1.

    ``positions`` x, ``before`` x1 and ``before_that`` x2 are [m] (..., V, 3). x1 is ``dt_s`` (dt) before x, and x2 is
    ``dt_before_s`` (dt1) before x1, both [s] and numbers or arrays (...); dt1 is dt if left out. With equal steps it is
    SNUG's m / (2 dt^2) |x - 2 x1 + x2|^2.
    """
    xp = namespace(positions)
    ratio = 1.0 if dt_before_s is None else dt_s / dt_before_s
    # Both times may be arrays (...): the ratio then stands against vertices and coordinates.
    ratio = ratio if isinstance(ratio, int | float) else ratio[..., None, None]
    off = positions - before - ratio * (before - before_that)
    return xp.sum(mesh.vertex_mass(material) * xp.sum(off * off, axis=-1), axis=-1) / (2.0 * dt_s * dt_s)


def contact(distance: Array, mesh: ClothMesh, material: Material) -> Array:
    """Returns the contact energy c A max(0, gap - d)^2 [J] (...), summed over the vertices.

    ``distance`` d [m] (..., V) from the body is positive outside; A is a vertex's area at rest, c and gap are
    ``contact_j_m4`` and ``contact_gap_m`` of ``material``.
    """
    xp = namespace(distance)
    depth = xp.clip(material.contact_gap_m - distance, min=0.0)
    return material.contact_j_m4 * xp.sum(mesh.vertex_area * depth * depth, axis=-1)


def contact_n_per_m(mesh: ClothMesh, material: Material) -> Array:
    """Returns the contact stiffness 2 c A [N/m] (V,) of every vertex: the second derivative of ``contact`` inside the
    gap."""
    return 2.0 * material.contact_j_m4 * mesh.vertex_area


def total(
    positions: Array,
    mesh: ClothMesh,
    material: Material,
    *,
    distance: Array | None = None,
    height_m: float | Array = 0.0,
) -> dict[str, Array]:
    """Returns the static energies [J] (...) of ``positions`` [m] (..., V, 3) by name: "membrane", "bending" and
    "gravity", and "contact" where ``distance`` [m] (..., V) from the body is given. Heights count from ``height_m``
    [m], a number or (..., 1)."""
    planes = _planes(positions)
    parts = {
        "membrane": _membrane(planes, mesh, material),
        "bending": _bending(planes, mesh, material),
        "gravity": gravity(positions, mesh, material, height_m=height_m),
    }
    if distance is not None:
        parts["contact"] = contact(distance, mesh, material)
    return parts


def _planes(positions: Array) -> Array:
    """Positions (..., V, 3) as (3, ..., V)."""
    xp = namespace(positions)
    return xp.permute_dims(positions, (positions.ndim - 1, *range(positions.ndim - 1)))


def _corners(planes: Array, index: Array, count: int) -> list[Array]:
    """``count`` arrays (3, ..., n): the positions at the parts of ``index`` (count * n,)."""
    xp = namespace(planes)
    flat = xp.reshape(planes, (-1, planes.shape[-1]))
    gathered = xp.take(flat, index, axis=-1)
    parts = xp.reshape(gathered, (*planes.shape[:-1], count, index.shape[0] // count))
    return list(xp.unstack(parts, axis=-2))


def _membrane(planes: Array, mesh: ClothMesh, material: Material) -> Array:
    corners, rest = _corners(planes, mesh.face_index, 3), RestTriangles(mesh.inverse_shape, mesh.face_area)
    return namespace(planes).sum(membrane_energy(corners, rest, material.membrane), axis=-1)


def _bending(planes: Array, mesh: ClothMesh, material: Material) -> Array:
    xp = namespace(planes)
    hinges = hinge(_corners(planes * (1.0 / mesh.mean_edge_m), mesh.hinge_index, 4), DEGENERATE)
    weighted = mesh.hinge_weight * one_minus_cosine(hinges, mesh.hinge_cosine, mesh.hinge_sine)
    turned = weighted @ mesh.hinge_turn  # (..., 2)
    mean, second, fourth = (_scalar(b) for b in material.bending)
    return mean * xp.sum(weighted, axis=-1) + second * turned[..., 0] + fourth * turned[..., 1]


def _scalar(constant: float | Array) -> float | Array:
    """A constant (..., 1) of as many cloths as (...), which is what is left of the hinges once they are summed."""
    return constant if isinstance(constant, float | int) else constant[..., 0]
