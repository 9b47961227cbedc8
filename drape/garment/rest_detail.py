"""The rest state of a garment's cloth: its smooth shape is forgotten, what was sewn or pressed into it stays.

A mesh modelled on a body has the body's shape in it. Cloth has not: it is cut flat, and round only because it is worn.
What a cloth does remember are lines: the fold of a hem, the edge of a collar, a pressed pleat, a seam. So an angle at
rest is kept where it is sharp, against a copy of the surface that is smoothed over ``SMOOTHING_M``, and where the sharp
hinges run on as a line; a sharp place of a few centimetres is a crumple of modelling. Everything else is flat at rest.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.sparse import csgraph

from drape.cloth import rest_state
from drape.cloth.rest_state import RestState
from drape.errors import MeshError
from drape.garment.grain import CornerUv, corner_uv, panel_unit, read_grain, weighted_median
from drape.garment.rest_pose import smoother, subdivide_smooth
from drape.garment.sewing import SewnHinges
from drape.geometry import mesh_graphs, meshes

Rest = Literal["auto", "flat", "modelled"]
SMOOTHING_M = 0.05
# Measured on the garments of docs/guide/garments.md: hems, cuffs and collars are lines of 8 to 23 cm at 30 degrees and
# more; what crumples under a bust, at a crotch or in an armpit ends within 7 cm.
CREASE_RAD, LINE_M = np.radians(30.0), 0.08
FOLD_RAD = np.radians(90.0)  # no body is as sharp as a fold
HEM_M = 0.04  # cloth between a crease and an open rim is doubled if the two are this near
HEM_STIFFENING = 2.0
DOUBLED = re.compile(r"(?<![a-z])(hem|cuff|collar|(waist|neck|wrist)?band|placket|facing)", re.IGNORECASE)
# Area by which a panel as wide as a hand spans must be distorted to lie flat, median over the cloth: real garments 1.01
# to 1.11, balls of 15 and of 10 cm 1.27 and 1.78.
PANEL_RADIUS_M, DISTORTION_LIMIT = 0.10, 1.2


@dataclass(frozen=True, eq=False)
class RestCloth:
    """The cloth that a rest state is found for, with G triangles.

    ``vertices`` [m] (N, 3) at rest and ``faces`` (G, 3). ``modelled`` [m] (N, 3): the same cloth as it was delivered,
    which shows the creases. ``on_corners``: its texture coordinates, or None. ``doubled`` (G,) bool: triangles of a
    material that is sewn double. ``uv_unit_m``: metres of cloth per unit of uv, where uv are panels. ``resized``: the
    cloth was moved to another body, and is no longer as large as its panels. ``sewn``: angles and stiffening as its
    maker states them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    modelled: np.ndarray
    on_corners: CornerUv | None
    doubled: np.ndarray
    uv_unit_m: float | None = None
    resized: bool = False
    sewn: SewnHinges | None = None


@dataclass(frozen=True)
class RestFigures:
    """Where a rest state comes from: ``kept_share`` in [0, 1], the share of hinges that keep an angle; ``hem_share``,
    that of hinges that are stiffened; ``grain``, "uv" or "vertical"; ``grain_share``, the share of the area whose uv
    are a flattening; ``lengths``, "mesh" or "panels"."""

    kept_share: float
    hem_share: float
    grain: str
    grain_share: float
    lengths: str


def doubled_faces(material_names: Sequence[str], face_material: np.ndarray, face_count: int) -> np.ndarray:
    """Returns which of ``face_count`` subdivided triangles are of a material that is sewn double, bool
    (``face_count``,): one called a hem, cuff, collar or the like. ``face_material`` (F,) is the number of each
    delivered face's material."""
    named = np.array([bool(DOUBLED.search(name)) for name in material_names] or [False])
    delivered = named[face_material] if len(named) > face_material.max(initial=0) else face_material < 0
    rounds = face_count // max(len(delivered), 1)
    return np.repeat(delivered, rounds) if rounds * len(delivered) == face_count else np.zeros(face_count, dtype=bool)


def subdivided_like(vertices: np.ndarray, faces: np.ndarray, face_count: int) -> np.ndarray:
    """Returns the vertices [m] (N, 3) of the mesh ``vertices`` (V, 3), ``faces`` (F, 3) after smooth subdivision into
    ``face_count`` triangles. The first V are ``vertices``."""
    while len(faces) < face_count:
        vertices, faces, _ = subdivide_smooth(vertices, faces)
    return vertices


def rest_of(cloth: RestCloth, rest: Rest = "auto") -> tuple[RestState, RestFigures]:
    """Returns the rest state of ``cloth``, and where it comes from.

    ``rest`` "modelled": lengths and angles of the mesh at rest. "flat": its lengths and no angle. "auto": its lengths,
    and angles as delivered, but only at creases and at seams of panels. Where uv are panels of a known size, "flat" and
    "auto" take their lengths, unless the cloth is resized. Cloth that is ``sewn`` has the angles and hems that its
    maker states: folds of its drape are no creases.

    Raises ``MeshError`` for "flat" and cloth that does not lie flat, and ``InputError`` as ``read_grain`` does.
    """
    grain = read_grain(cloth.vertices, cloth.modelled, cloth.faces, cloth.on_corners, cloth.uv_unit_m)
    state = rest_state.modelled_rest(cloth.vertices, cloth.faces, grain.warp)
    unit = panel_unit(grain, cloth.uv_unit_m)
    kept = np.ones(len(state.hinge_angle), dtype=bool)
    lengths = "mesh"
    if rest != "modelled":
        if cloth.sewn is not None:
            angle, kept = cloth.sewn.angle, cloth.sewn.angle != 0.0
            stiffening = np.maximum(cloth.sewn.stiffening, _stiffening(cloth, np.zeros_like(kept)))
        else:
            angle, crease = creases(cloth.modelled, cloth.faces)
            kept, stiffening = crease | grain.seam, _stiffening(cloth, crease)
        kept &= rest == "auto"
        state = RestState(state.edges, np.where(kept, angle, 0.0), stiffening)
        if rest == "flat" and not grain.from_uv.any():
            _refuse_round(cloth)
        if unit is not None and not cloth.resized:
            edges = np.where(grain.from_uv[:, None, None], unit * grain.panel_edges, state.edges)
            state, lengths = replace(state, edges=edges), "panels"
    figures = RestFigures(
        kept_share=float(kept.mean()) if len(kept) else 0.0,
        hem_share=float((state.stiffening > 1.0).mean()) if len(kept) else 0.0,
        grain="uv" if grain.from_uv.any() else "vertical",
        grain_share=grain.share,
        lengths=lengths,
    )
    return state, figures


def creases(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the dihedral angles [rad] (H,) of the hinges of a surface, in the order of ``meshes.hinges``, and which
    of these are creases, bool (H,). A hinge is sharp if its angle is above ``CREASE_RAD``, and differs by as much from
    its angle after the surface is smoothed over ``SMOOTHING_M``. A hinge that is folded over is sharp too. A sharp
    hinge is a crease if it and the sharp hinges connected with it span ``LINE_M``."""
    angle = rest_state.dihedral_angles(vertices, faces)
    smooth = rest_state.dihedral_angles(smoother(vertices, faces, SMOOTHING_M)(vertices), faces)
    turn = angle - smooth
    # Smoothing crushes a narrow fold, and what is next to it: there only the angle itself counts.
    turn = np.abs(np.arctan2(np.sin(turn), np.cos(turn)))
    sharp = (np.minimum(np.abs(angle), turn) > CREASE_RAD) | (np.abs(angle) > FOLD_RAD)
    if not sharp.any():
        return angle, sharp
    first, second = meshes.hinges(faces)[sharp, :2].T
    line = mesh_graphs.joined_parts(len(vertices), first, second)
    low, high = np.full((len(vertices), 3), np.inf), np.full((len(vertices), 3), -np.inf)
    for end in (first, second):
        np.minimum.at(low, line[end], vertices[end])
        np.maximum.at(high, line[end], vertices[end])
    sharp[sharp] = np.linalg.norm(high - low, axis=1)[line[first]] >= LINE_M
    return angle, sharp


def distortion(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Returns by what factor areas differ, at least 1, in panels of the radius ``PANEL_RADIUS_M`` that are laid flat:
    the median over the cloth ``vertices`` [m] (N, 3), ``faces``. It is (1 - W / 4 pi)^-2, the ratio of the factors at
    rim and centre of a disc of total curvature W on a sphere, mapped with least distortion (stereographically). W is
    the angle defect, spread over the surface."""
    area = meshes.vertex_areas(vertices, faces)
    defect = np.full(len(vertices), 2.0 * np.pi)
    for k in range(3):
        corner = faces[:, k]
        e1, e2 = (vertices[faces[:, (k + n) % 3]] - vertices[corner] for n in (1, 2))
        turn = np.arctan2(np.linalg.norm(np.cross(e1, e2), axis=1), (e1 * e2).sum(axis=1))
        np.subtract.at(defect, corner, turn)
    defect[meshes.boundary_vertices(faces)] = 0.0
    spread = smoother(vertices, faces, 0.5 * PANEL_RADIUS_M)(np.column_stack([defect, area]))
    curvature = np.abs(spread[:, 0]) / np.maximum(spread[:, 1], 1e-12) * np.pi * PANEL_RADIUS_M**2
    middle = weighted_median(curvature, area)
    return (1.0 - min(middle / (4.0 * np.pi), 0.99)) ** -2.0


def _refuse_round(cloth: RestCloth) -> None:
    ratio = distortion(cloth.modelled, cloth.faces)
    if ratio > DISTORTION_LIMIT:
        raise MeshError(
            "rest",
            expected=f"a garment that lies flat: panels of {200 * PANEL_RADIUS_M:.0f} cm with areas within "
            f"{100 * (DISTORTION_LIMIT - 1.0):.0f} % of each other, for half the cloth",
            got=f"{100 * (ratio - 1.0):.0f} %",
            cure="Take rest auto or modelled, or give the garment uv that are its panels.",
        )


def _stiffening(cloth: RestCloth, crease: np.ndarray) -> np.ndarray:
    """Factors (H,): ``HEM_STIFFENING`` where cloth lies double, in a material so called or between crease and rim."""
    sides, hinges = meshes.hinge_faces(cloth.faces), meshes.hinges(cloth.faces)
    double = cloth.doubled[sides].all(axis=1)
    rim = meshes.boundary_vertices(cloth.faces)
    if len(rim) and crease.any():
        graph = mesh_graphs.edge_graph(cloth.modelled, cloth.faces)
        away = [
            csgraph.dijkstra(graph, directed=False, indices=np.unique(near), limit=HEM_M, min_only=True)
            for near in (hinges[crease, :2], rim)
        ]
        hem = away[0] + away[1] <= HEM_M
        double |= hem[hinges[:, :2]].all(axis=1)
    return np.where(double, HEM_STIFFENING, 1.0)


def cloth_of(
    vertices: np.ndarray,
    fine_faces: np.ndarray,
    on_corners: tuple[np.ndarray, np.ndarray],
    materials: tuple[Sequence[str], np.ndarray],
) -> RestCloth:
    """Returns the cloth of a garment of which only the mesh at rest is known, so that lengths are that mesh's:
    ``vertices`` [m] (N, 3) and ``fine_faces`` (G, 3). ``on_corners``: its uv (T, 2) and uv_faces (F, 3). ``materials``:
    their names, and the number (F,) of each delivered face's."""
    faces, points = np.asarray(fine_faces, dtype=np.int64), np.asarray(vertices, dtype=np.float64)
    doubled = doubled_faces(*materials, len(faces))
    return RestCloth(points, faces, points, corner_uv(*on_corners, len(faces)), doubled, resized=True)
