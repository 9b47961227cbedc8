"""The rest state of a cloth, without stress: flat triangles in the axes of its fabric, and the angles of its hinges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.errors import InputError, MeshError
from drape.geometry import meshes

SMALLEST_AREA_SHARE = 1e-9  # share of the mean area; the shape of a smaller triangle has no inverse
UP = (0.0, 1.0, 0.0)
FORWARD = (0.0, 0.0, 1.0)  # the grain of cloth that lies level
LEVEL = 0.1  # length of the grain's projection below which a triangle counts as level


@dataclass(frozen=True, eq=False)
class RestState:
    """The state without stress of F triangles and H hinges (in the order of ``meshes.hinges``). Raises ``MeshError`` or
    ``InputError`` for triangles without area, numbers that are not finite, and a negative stiffening.

    ``edges`` [m] (F, 2, 2): from each triangle's first corner to its second and third, in the axes (warp, weft), which
    is the rest metric and the grain in one. ``hinge_angle`` [rad] (H,): the dihedral angle without stress, positive
    where the fold points along the normals. ``stiffening`` (H,): factor of the fabric's bending, 2 in a hem.
    """

    edges: np.ndarray
    hinge_angle: np.ndarray
    stiffening: np.ndarray

    def __post_init__(self) -> None:
        check_shape("rest edges", self.edges, (None, 2, 2), error=MeshError)
        check_finite("rest edges", self.edges, error=MeshError)
        area = self.face_area
        if len(area) == 0 or area.min() <= SMALLEST_AREA_SHARE * area.mean():
            raise MeshError(
                "faces",
                expected="at least one triangle, all with an area",
                got=f"{len(area)} triangles" + (f", face {int(area.argmin())} of area zero" if len(area) else ""),
                cure="Remove degenerate triangles.",
            )
        for name, angles in (("hinge angles", self.hinge_angle), ("stiffening", self.stiffening)):
            check_finite(name, angles, error=MeshError)
        if (self.stiffening < 0.0).any():
            raise InputError("stiffening", expected="factors >= 0", got=str(self.stiffening.min()), cure="Take 1.")

    @property
    def face_area(self) -> np.ndarray:
        """The areas [m^2] (F,) of the triangles at rest."""
        e = self.edges
        return 0.5 * np.abs(e[:, 0, 0] * e[:, 1, 1] - e[:, 0, 1] * e[:, 1, 0])


def grain_along(vertices: np.ndarray, faces: np.ndarray, direction: np.ndarray | tuple[float, ...] = UP) -> np.ndarray:
    """Returns the unit warp (F, 3) of every triangle: ``direction``, (3,) or (F, 3), projected onto its plane.

    A garment's grain hangs vertically unless it is cut otherwise; on a triangle that lies level it runs forward.
    """
    normal = meshes.face_normals(vertices, faces)
    laid = np.broadcast_to(np.asarray(direction, dtype=np.float64), normal.shape)
    laid = laid - (laid * normal).sum(axis=1, keepdims=True) * normal
    ahead = np.array(FORWARD) - normal[:, 2:] * normal
    laid = np.where(np.linalg.norm(laid, axis=1, keepdims=True) < LEVEL, ahead, laid)
    return laid / np.maximum(np.linalg.norm(laid, axis=1, keepdims=True), 1e-12)


def modelled_rest(vertices: np.ndarray, faces: np.ndarray, grain: np.ndarray | None = None) -> RestState:
    """Returns the rest state of a mesh that is at rest as it lies, with the lengths and angles of ``vertices`` [m] (V,
    3).

    ``grain`` (F, 3) is the unit warp in every triangle's plane; left out, it hangs vertically. Raises ``MeshError`` for
    vertices that are not finite, indices out of range and triangles without area.
    """
    rest = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", rest, (None, 3), error=MeshError)
    check_finite("vertices", rest, error=MeshError)
    faces = meshes.check_faces(faces, len(rest))
    warp = grain_along(rest, faces) if grain is None else grain
    weft = np.cross(meshes.face_normals(rest, faces), warp)
    pair = np.stack(meshes.corner_edges(rest, faces), axis=1)  # (F, 2, 3)
    edges = np.stack([(pair * axis[:, None]).sum(axis=2) for axis in (warp, weft)], axis=2)
    angle = dihedral_angles(rest, faces)
    return RestState(edges, angle, np.ones(len(angle)))


def flat_rest(vertices: np.ndarray, faces: np.ndarray, grain: np.ndarray | None = None) -> RestState:
    """Returns ``modelled_rest`` with every hinge flat at rest."""
    state = modelled_rest(vertices, faces, grain)
    return RestState(state.edges, np.zeros_like(state.hinge_angle), state.stiffening)


def dihedral_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the dihedral angle [rad] (H,) at every hinge, in (-pi, pi]: zero in the plane, positive where the fold
    points along the normals. Hinges are in the order of ``meshes.hinges``."""
    first, second, left, right = (vertices[index] for index in meshes.hinges(faces).T)
    e, a, b = second - first, left - first, right - first
    n1, n2 = np.cross(e, a), np.cross(b, e)
    length = np.linalg.norm(e, axis=1)
    return np.arctan2(-length * (n1 * b).sum(axis=1), (n1 * n2).sum(axis=1))
