"""The cloth of a garment whose wearer is looked for: points, openings and size, in the file's unit."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from drape.garment.contours import Contour, open_contours, pierced_parts
from drape.garment.files.mesh import GarmentMesh
from drape.garment.inside import tube_ends
from drape.garment.mesh_checks import AREA_MINIMUM, consistent_turn
from drape.garment.sheets import pieces_of
from drape.garment.sleeves import covers_arms
from drape.garment.wearer_fields import DENSE_COUNT, Bones, cloth_points, unthreaded
from drape.garment.wearer_reading import Reading
from drape.geometry import meshes

EXTENT_M = (0.12, 2.4)  # extents of garments
COARSE_COUNT, FINE_COUNT = 350, 800  # points on the cloth
SMALL_M2, SMALL = 0.4, 0.07  # smaller cloth costs this for every factor e: an outfit may be read as a collar
LOPSIDED = 6.0  # cost of cloth that is less symmetric across left and right than along another axis
CUFF_M = 0.12  # shorter openings are holes
LOOP_SHARE, LOOP_COUNT, LOOP_POINTS = 0.2, 6, 24  # least length over the extent; most borders; points on each
LOOP_PIECE = 0.1  # a piece with a smaller share of the area is a strap, a lace or a tape, which has no opening


class SearchedCloth:
    """The cloth ``mesh`` of a garment whose wearer is looked for, in the unit and axes of its file. Points on it (n,
    3), in three densities: ``few``, with the normals ``few_normals``; ``points``, with ``normals`` and the number
    ``piece`` (n,) of the piece of each; and ``many``. ``area``; ``extent``, the longest side of its box; and ``loops``
    (L, 24, 3), points along each of its long borders."""

    def __init__(self, mesh: GarmentMesh) -> None:
        self.mesh = mesh
        self.area = float(meshes.face_areas(mesh.vertices, mesh.faces).sum())
        self.few, face = cloth_points(mesh.vertices, mesh.faces, COARSE_COUNT)
        self.few_normals = meshes.face_normals(mesh.vertices, mesh.faces)[face]
        self.many = cloth_points(mesh.vertices, mesh.faces, DENSE_COUNT)[0]
        self.points, face = cloth_points(mesh.vertices, mesh.faces, FINE_COUNT)
        wound = np.where(consistent_turn(mesh.faces), -1.0, 1.0)[face]
        self.normals = wound[:, None] * meshes.face_normals(mesh.vertices, mesh.faces)[face]
        piece, area = pieces_of(mesh.vertices, mesh.faces)
        self.piece = piece[face]
        self.extent = float(np.ptp(self.points, axis=0).max())
        large = mesh.faces[area[piece] > LOOP_PIECE * self.area]
        long = [one for one in open_contours(mesh.vertices, large) if one.length_m > LOOP_SHARE * self.extent]
        picked = [one.points[np.linspace(0, len(one.points), LOOP_POINTS, endpoint=False).astype(int)] for one in long]
        self.loops = np.array(picked[:LOOP_COUNT]).reshape(-1, LOOP_POINTS, 3)

    def may_be(self, scale: float) -> bool:
        """Returns whether the cloth has the size of a garment if a unit of the file is ``scale`` [m]."""
        return EXTENT_M[0] <= self.extent * scale <= EXTENT_M[1] and self.area * scale**2 >= AREA_MINIMUM

    def contours(self, reading: Reading) -> list[Contour]:
        """Returns the borders that look like the end of a tube and are no holes, in metres, y up, facing +z as
        ``reading`` turns the file; the most sideways first."""
        ends = tube_ends(replace(self.mesh, vertices=reading.apply(self.mesh.vertices)))
        return [one for one in ends if one.length_m > CUFF_M]

    def pierced(self, reading: Reading, joints: np.ndarray) -> tuple[str, ...]:
        """Returns the names of the body's parts whose bones go through the cloth, as in ``pierced_parts``. ``joints``
        [m] (24, 3) are in the frame that ``reading`` gives."""
        return pierced_parts(self.mesh.vertices, self.mesh.faces, joints @ reading.turn / reading.scale)

    def empty(self, reading: Reading, joints: np.ndarray) -> int:
        """Returns the number of long borders that no bone goes through. ``joints`` [m] (24, 3) are in the frame that
        ``reading`` gives."""
        return unthreaded(reading.apply(self.loops.reshape(-1, 3)).reshape(self.loops.shape), joints)

    def covers(self, reading: Reading, bones: Bones, *, move: np.ndarray | float = 0.0) -> bool:
        """Returns whether the cloth, in the frame that ``reading`` gives and moved by ``move`` [m] (3,), covers the
        arms of the body with ``bones`` and has no sleeves, as a cape does."""
        return covers_arms(reading.apply(self.many) + move, bones)

    @cached_property
    def lopsided(self) -> np.ndarray:
        """Returns for each axis of the file how far (3,) the cloth is from its mirror image along it: the mean distance
        over the extent, without unit."""
        tree, middle = KDTree(self.many), 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
        mirrored = [self.points + 2.0 * (middle - self.points) * axis for axis in np.eye(3)]
        return np.array([tree.query(one)[0].mean() for one in mirrored]) / self.extent

    def oddness(self, reading: Reading) -> float:
        """Returns the cost of ``reading``, at least 0 and without unit. It grows the smaller the cloth is in that
        reading, and the more the cloth differs from its mirror image across left and right than across other axes."""
        small = SMALL * max(0.0, float(np.log(SMALL_M2 / (self.area * reading.scale**2))))
        across = float(np.abs(reading.turn[0]) @ self.lopsided)
        return small + LOPSIDED * (across - float(self.lopsided.min()))
