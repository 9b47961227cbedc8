"""Energies [J] of a cloth at positions (..., V, 3): membrane, bending, gravity, inertia, contact.

Written once for numpy and torch. Positions are first laid out as planes
(3, ..., V), so that every formula is a handful of whole-array products and the
gathers run along the last axis: in torch the backward of ``take`` along axis -2
is thirty times slower (docs/reference/quality.md). Every function returns (...,).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from drape.arrays import Array, check_finite, check_shape, device, namespace
from drape.cloth.material import Material
from drape.errors import InputError, MeshError
from drape.geometry import meshes

# Added to squared lengths in units of the mean edge: a collapsed triangle keeps a finite
# gradient, a healthy one loses 1e-8 of its cosine.
DEGENERATE = 1e-8
SMALLEST_AREA_SHARE = 1e-9  # of the mean triangle; below it a rest shape has no inverse


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """Constants of a rest mesh. Arrays are numpy's until ``like`` moves them.

    ``face_index`` (3F,), ``hinge_index`` (4H,): vertices, all first corners before all
    second ones. ``inverse_shape`` (3, F) [1/m]: entries 00, 01, 11 of the inverse of the rest
    shape D (2 x 2, columns = the edges from the first corner in the triangle's own axes, the
    first along the first edge, so entry 10 is zero). ``face_area`` (F,), ``vertex_area`` (V,)
    [m^2]. ``hinge_cosine``, ``hinge_sine`` (H,) of the rest angle; ``hinge_weight`` (H,) =
    l^2 / (A1 + A2), zero between needles. ``mean_edge_m`` makes lengths dimensionless.
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
    mean_edge_m: float

    @classmethod
    def from_rest(cls, vertices: np.ndarray, faces: np.ndarray) -> ClothMesh:
        """The constants of the rest positions ``vertices`` [m] (V, 3)."""
        rest = np.asarray(vertices, dtype=np.float64)
        check_shape("vertices", rest, (None, 3), error=MeshError)
        check_finite("vertices", rest, error=MeshError)
        faces = meshes.check_faces(faces, len(rest))
        area = meshes.face_areas(rest, faces)
        if len(faces) == 0 or area.min() <= SMALLEST_AREA_SHARE * area.mean():
            raise MeshError(
                "faces",
                expected="at least one triangle, all with an area",
                got=f"{len(faces)} triangles" + (f", face {int(area.argmin())} of area zero" if len(faces) else ""),
                cure="Remove degenerate triangles.",
            )
        first, second = meshes.corner_edges(rest, faces)
        length = np.linalg.norm(first, axis=1)
        along = (first * second).sum(axis=1) / length
        height = 2.0 * area / length
        hinges, sides = meshes.hinges(faces), meshes.hinge_faces(faces)
        shared = np.linalg.norm(rest[hinges[:, 1]] - rest[hinges[:, 0]], axis=1)
        mean_edge = float(meshes.edge_lengths(rest, meshes.unique_edges(faces)).mean())
        hinge_index = np.ascontiguousarray(hinges.T).reshape(-1)
        cosine, sine = _hinge_angles(_planes(rest), hinge_index, mean_edge)
        norm = np.sqrt(cosine**2 + sine**2)
        needle = norm < 0.5  # the guard ate the angle: such a hinge bends freely
        norm = np.where(needle, 1.0, norm)
        return cls(
            faces=faces,
            face_index=np.ascontiguousarray(faces.T).reshape(-1),
            inverse_shape=np.stack([1.0 / length, -along / (length * height), 1.0 / height]),
            face_area=area,
            vertex_area=meshes.vertex_areas(rest, faces),
            hinge_index=hinge_index,
            hinge_cosine=cosine / norm,
            hinge_sine=sine / norm,
            hinge_weight=np.where(needle, 0.0, shared**2 / area[sides].sum(axis=1)),
            mean_edge_m=mean_edge,
        )

    @property
    def vertex_count(self) -> int:
        return self.vertex_area.shape[0]

    def like(self, positions: Array) -> ClothMesh:
        """The same constants in the namespace, dtype and device of ``positions``; do this once, outside the loop."""
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


def membrane(positions: Array, mesh: ClothMesh, material: Material) -> Array:
    """St.Venant-Kirchhoff membrane energy.

    Per triangle F = [x1 - x0, x2 - x0] D^-1 (3 x 2), E = (F^T F - I) / 2,
    energy = area (mu |E|^2 + lambda/2 tr(E)^2).
    """
    return _membrane(_planes(positions), mesh, material)


def bending(positions: Array, mesh: ClothMesh, material: Material) -> Array:
    """Hinge energy: sum of k l^2 / (A1 + A2) (1 - cos(theta - theta0)), theta the signed dihedral angle.

    For small changes k/2 l^2 / (A1 + A2) (theta - theta0)^2. On a mesh of
    equilateral triangles that is a plate of rigidity k [N m]: k/2 (curvature)^2 per
    area on a cylinder (Seung & Nelson 1988), and 1.15 k per hinge.
    """
    return _bending(_planes(positions), mesh, material)


def gravity(positions: Array, mesh: ClothMesh, material: Material, *, height_m: float | Array = 0.0) -> Array:
    """Potential energy m g (y - height) of the vertices; ``height_m`` a number or (..., 1)."""
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
    """Inertia's part of the incremental potential, m / (2 dt^2) |x - (x1 + dt v)|^2, v = (x1 - x2) / dt1.

    ``before`` x1 is ``dt_s`` [s] ago, ``before_that`` x2 another ``dt_before_s`` (dt1; as long if left
    out), numbers or arrays (...). With equal steps it is SNUG's m / (2 dt^2) |x - 2 x1 + x2|^2.
    """
    xp = namespace(positions)
    ratio = 1.0 if dt_before_s is None else dt_s / dt_before_s
    # Both times may be arrays (...): the ratio then stands against vertices and coordinates.
    ratio = ratio if isinstance(ratio, int | float) else ratio[..., None, None]
    off = positions - before - ratio * (before - before_that)
    return xp.sum(mesh.vertex_mass(material) * xp.sum(off * off, axis=-1), axis=-1) / (2.0 * dt_s * dt_s)


def contact(distance: Array, mesh: ClothMesh, material: Material) -> Array:
    """Contact energy c A max(0, gap - d)^2 of the vertices, ``distance`` d [m] (..., V) signed, outside positive."""
    xp = namespace(distance)
    depth = xp.clip(material.contact_gap_m - distance, min=0.0)
    return material.contact_j_m4 * xp.sum(mesh.vertex_area * depth * depth, axis=-1)


def total(
    positions: Array,
    mesh: ClothMesh,
    material: Material,
    *,
    distance: Array | None = None,
    before: Array | None = None,
    before_that: Array | None = None,
    dt_s: float | Array | None = None,
    dt_before_s: float | Array | None = None,
    height_m: float | Array = 0.0,
) -> dict[str, Array]:
    """The parts by name; "contact" where ``distance`` is given, "inertia" where the two steps before are."""
    planes = _planes(positions)
    parts = {
        "membrane": _membrane(planes, mesh, material),
        "bending": _bending(planes, mesh, material),
        "gravity": gravity(positions, mesh, material, height_m=height_m),
    }
    if distance is not None:
        parts["contact"] = contact(distance, mesh, material)
    if before is not None and before_that is not None and dt_s is not None:
        parts["inertia"] = inertia(positions, before, before_that, mesh, material, dt_s=dt_s, dt_before_s=dt_before_s)
    elif not (before is None and before_that is None and dt_s is None):
        raise InputError(
            "before, before_that and dt_s",
            expected="all three or none",
            got="some of them",
            cure="Pass the two earlier positions and the time step.",
        )
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
    xp = namespace(planes)
    x0, x1, x2 = _corners(planes, mesh.face_index, 3)
    e1, e2 = x1 - x0, x2 - x0
    # F's columns: f1 = a e1 and f2 = b e1 + d e2, as D^-1 is upper triangular.
    a, b, d = xp.unstack(mesh.inverse_shape, axis=0)
    f1, f2 = a * e1, b * e1 + d * e2
    e11 = 0.5 * (xp.sum(f1 * f1, axis=0) - 1.0)
    e22 = 0.5 * (xp.sum(f2 * f2, axis=0) - 1.0)
    e12 = 0.5 * xp.sum(f1 * f2, axis=0)
    trace = e11 + e22
    squared = e11 * e11 + e22 * e22 + 2.0 * (e12 * e12)
    density = material.mu_n_per_m * squared + (0.5 * material.lambda_n_per_m) * (trace * trace)
    return xp.sum(mesh.face_area * density, axis=-1)


def _hinge_angles(planes: Array, hinge_index: Array, mean_edge_m: float) -> tuple[Array, Array]:
    """Cosine and sine (..., H) of the signed dihedral angle, positive where the fold points along the normals.

    With e = xj - xi, a = xk - xi, b = xl - xi the normals are n1 = e x a and
    n2 = b x e, and n1 x n2 = -(n1 . b) e, so that no second cross product is needed.
    """
    xp = namespace(planes)
    xi, xj, xk, xl = _corners(planes * (1.0 / mean_edge_m), hinge_index, 4)
    e = xp.unstack(xj - xi, axis=0)
    a = xp.unstack(xk - xi, axis=0)
    b = xp.unstack(xl - xi, axis=0)
    n1, n2 = _cross(e, a), _cross(b, e)
    scale = 1.0 / xp.sqrt(_dot(n1, n1) * _dot(n2, n2) + DEGENERATE)
    return _dot(n1, n2) * scale, -xp.sqrt(_dot(e, e) + DEGENERATE) * _dot(n1, b) * scale


def _bending(planes: Array, mesh: ClothMesh, material: Material) -> Array:
    xp = namespace(planes)
    cosine, sine = _hinge_angles(planes, mesh.hinge_index, mesh.mean_edge_m)
    fold = 1.0 - (cosine * mesh.hinge_cosine + sine * mesh.hinge_sine)
    return material.bending_j * xp.sum(mesh.hinge_weight * fold, axis=-1)


def _cross(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, Array, Array]:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: tuple[Array, ...], b: tuple[Array, ...]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
