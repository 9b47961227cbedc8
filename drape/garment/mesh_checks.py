"""Decides whether a mesh can be draped, and brings it to metres, y up, normals outward.

Unit, up axis and height of the floor are found from where the garment lies on its avatar: at the right scale it
surrounds the body a few centimetres away, at any other it does not. The mesh's notes record every change; a fault
that cannot be cured safely is refused.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Literal

import igl
import numpy as np

from drape.arrays import check_finite
from drape.errors import MeshError
from drape.files.notes import warning
from drape.garment.avatars import Avatar
from drape.garment.files.mesh import VERTEX_LIMIT, GarmentMesh, check_count
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point, nearest_vertices

UNITS_M = {"m": 1.0, "cm": 0.01, "dm": 0.1, "mm": 0.001, "inch": 0.0254}
UP_AXES = ("y", "z")
Unit = Literal["auto", "m", "cm", "dm", "mm", "inch"]
Up = Literal["auto", "y", "z"]
VERTEX_MINIMUM = 24
AREA_MINIMUM = 0.02  # m^2, less cloth than a glove has
EXTENT_M = (0.015, 2.6)
FLAT_ALTITUDE = 1e-5  # a triangle lower than this share of its longest edge has no normal
# Misfit of the seven real garments on their own avatars: 0.01 to 0.06; in another unit or far away: from 0.07.
MISFIT_LIMIT, MISFIT_LIMIT_UNNAMED = 0.25, 0.06
PLAIN_PREFERENCE = 1.5  # metres, y up wins over a reading that fits better by less than this factor
RIVAL_MARGIN = 1.25  # units whose misfits differ by less than this factor cannot be told apart
SKIN_DEPTH_M = 0.008  # garments as delivered cut this deep into their avatar
SAMPLE_COUNT = 600


@dataclass(frozen=True, order=True)
class Placement:
    """How a file's coordinates may be read: their ``unit`` ("m", "cm", ...), the ``up`` axis ("y" or "z"), and whether
    the origin is on the ``floor`` under the avatar, not at the avatar's own origin."""

    unit: str
    up: str
    floor: bool

    @property
    def plain(self) -> bool:
        return (self.unit, self.up, self.floor) == ("m", "y", False)

    def apply(self, points: np.ndarray, avatar: Avatar) -> np.ndarray:
        points = points * UNITS_M[self.unit]
        if self.up == "z":
            points = np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
        return points + np.array([0.0, avatar.vertices[:, 1].min(), 0.0]) if self.floor else points


def check_mesh(mesh: GarmentMesh, avatar: Avatar, *, carried: bool = False) -> GarmentMesh:
    """Returns ``mesh`` wound consistently with normals outward, and with notes (``describe``); it lies on ``avatar`` in
    metres, y up. Vertices keep their order and number. ``carried``: bones carry the mesh rigidly, so it may be smaller
    than cloth. Raises ``MeshError`` for a one-sided surface, and for less area than a garment has."""
    mesh = orient_outward(mesh, avatar)
    if not carried:
        check_area(mesh, "garment area")
    return mesh.noted(*describe(mesh))


def check_surface(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` without faces that have no area or repeat another. Raises ``MeshError`` where it is empty or too
    large, a number is not finite, an index is out of range, or an edge has more than two faces."""
    check_arrays(mesh, vertex_limit=2 * VERTEX_LIMIT)
    mesh = without_flat_faces(mesh)
    check_edges(mesh)
    return mesh


def check_area(mesh: GarmentMesh, name: str) -> None:
    """Raises ``MeshError``, about the field ``name``, if ``mesh`` [m] has less than ``AREA_MINIMUM`` of area: its unit
    is not the metre then."""
    area = float(meshes.face_areas(mesh.vertices, mesh.faces).sum())
    if area < AREA_MINIMUM:
        raise MeshError(
            name,
            expected=f"at least {AREA_MINIMUM} m^2",
            got=f"{area:.4f} m^2",
            cure="Check the unit of the file (--unit).",
        )


def check_arrays(mesh: GarmentMesh, *, vertex_limit: int = VERTEX_LIMIT) -> None:
    """Raises ``MeshError`` for a mesh with no faces, too few or more than ``vertex_limit`` vertices, all vertices at
    one place, numbers that are not finite, or indices out of range."""
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise MeshError(
            "garment",
            expected="vertices and faces",
            got=f"{len(mesh.vertices)} and {len(mesh.faces)}",
            cure="Export the garment's surface.",
        )
    check_count(mesh.name, len(mesh.vertices), vertex_limit)
    if np.ptp(mesh.vertices, axis=0).max() == 0.0:
        raise MeshError(
            "garment",
            expected="vertices at several places",
            got=f"all of {len(mesh.faces)} faces at one",
            cure="Look for an object or a node whose scale is 0 in what exported it.",
        )
    if len(mesh.vertices) < VERTEX_MINIMUM:
        raise MeshError(
            "garment",
            expected=f"at least {VERTEX_MINIMUM} vertices",
            got=str(len(mesh.vertices)),
            cure="Subdivide the mesh.",
        )
    check_finite("garment vertices", mesh.vertices, error=MeshError)
    check_finite("garment uv", mesh.uv, error=MeshError)
    meshes.check_faces(mesh.faces, len(mesh.vertices), name="garment faces")
    meshes.check_faces(mesh.uv_faces, len(mesh.uv), name="garment uv faces")


def without_flat_faces(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` without faces that have no area or repeat an earlier face, with a note; ``mesh`` itself if there
    are none. Raises ``MeshError`` where no face is left."""
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    altitude = 2.0 * meshes.face_areas(mesh.vertices, mesh.faces) / np.maximum(longest, 1e-300)
    flat = (altitude <= FLAT_ALTITUDE * longest) | (longest == 0.0)
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    twice = np.ones(len(mesh.faces), dtype=bool)
    twice[first] = False
    if not (flat | twice).any():
        return mesh
    kept = mesh.take_faces(~(flat | twice))
    if len(kept.faces) == 0:
        raise MeshError(
            "garment faces", expected="faces with an area", got="none", cure="Export the garment's surface."
        )
    return kept.noted(f"dropped {int(flat.sum())} degenerate and {int((twice & ~flat).sum())} duplicated faces")


def check_edges(mesh: GarmentMesh) -> None:
    """Raises ``MeshError`` if an edge of ``mesh`` has more than two faces."""
    ends, counts = meshes.edge_uses(mesh.faces)
    heavy = np.flatnonzero(counts > 2)
    if len(heavy):
        edge = heavy[0]
        raise MeshError(
            "garment edges",
            expected="at most 2 faces at every edge",
            got=f"{len(heavy)} edges with more; edge {ends[edge].tolist()} (0-based vertices) has {counts[edge]}",
            cure="Split the surface along these edges, or delete the inner faces.",
        )


def place_on_avatar(
    mesh: GarmentMesh, avatar: Avatar, *, unit: Unit = "auto", up: Up = "auto", named: bool = True
) -> GarmentMesh:
    """Returns ``mesh`` in metres, y up, in the coordinates of ``avatar``: with the unit, up axis and origin in which it
    fits the avatar best; ``unit`` and ``up`` fix the first two. Metres, y up, at the avatar's origin win unless others
    fit clearly better. Unless somebody ``named`` the avatar the garment must fit it closely. Raises ``MeshError`` where
    nothing fits, or two units fit equally."""
    check_options(unit, up)
    used = np.unique(mesh.faces)
    sample = mesh.vertices[used[:: max(1, len(used) // SAMPLE_COUNT)]]
    floors = (False, True) if abs(avatar.vertices[:, 1].min()) > 0.02 else (False,)
    readings = itertools.product(
        tuple(UNITS_M) if unit == "auto" else (unit,), UP_AXES if up == "auto" else (up,), floors
    )
    normals = meshes.vertex_normals(avatar.vertices, avatar.faces)
    ranked = sorted(
        (misfit(reading.apply(sample, avatar), avatar, normals), reading)
        for reading in itertools.starmap(Placement, readings)
    )
    best, chosen = ranked[0]
    plain = next((cost for cost, reading in ranked if reading.plain), np.inf)
    if plain <= PLAIN_PREFERENCE * best:
        best, chosen = plain, Placement("m", "y", False)
    if not best <= (MISFIT_LIMIT if named else MISFIT_LIMIT_UNNAMED):
        extent = " x ".join(f"{length:.4g}" for length in np.ptp(sample, axis=0))
        whose = "its avatar" if named else "the standard body"
        raise MeshError(
            "garment",
            expected=f"a garment on {whose} ({np.ptp(avatar.vertices[:, 1]):.2f} m tall)",
            got=f"an extent of {extent} around {np.round(sample.mean(axis=0), 3).tolist()}",
            cure="Say which avatar it was modelled on (avatar), its unit (unit) and its up axis (up).",
        )
    rival = next((r for cost, r in ranked if r.unit != chosen.unit and cost < RIVAL_MARGIN * best), None)
    if rival is not None and not chosen.plain:
        raise MeshError(
            "garment unit",
            expected="one unit that fits the avatar",
            got=f"{chosen.unit} or {rival.unit}",
            cure="Say which one (unit).",
        )
    notes = [] if chosen.unit == "m" else [f"converted from {chosen.unit} to m"]
    notes += ["turned from z up to y up"] if chosen.up == "z" else []
    notes += ["moved from its floor to the avatar's origin"] if chosen.floor else []
    return replace(mesh, vertices=chosen.apply(mesh.vertices, avatar)).noted(*notes)


def check_options(unit: str, up: str) -> None:
    """Raises ``MeshError`` for an unknown ``unit`` or ``up`` axis."""
    for name, value, known in (("unit", unit, UNITS_M), ("up", up, UP_AXES)):
        if value not in ("auto", *known):
            expected = f"one of {', '.join(('auto', *known))}"
            raise MeshError(name, expected=expected, got=repr(value), cure="Correct the option.")


def misfit(points: np.ndarray, avatar: Avatar, normals: np.ndarray) -> float:
    """Returns how badly cloth at ``points`` [m] (N, 3) lies around ``avatar``, whose vertices have ``normals`` (V, 3):
    0 on the skin, infinite if the extent of the points is outside ``EXTENT_M``. It is the mean distance from the skin,
    plus four times the depth below ``SKIN_DEPTH_M`` inside it, over the extent. A garment read too small is near the
    skin only because it is small; the division by its extent makes up for that."""
    extent = float(np.ptp(points, axis=0).max())
    if not EXTENT_M[0] <= extent <= EXTENT_M[1]:
        return float("inf")
    distance, near = nearest_vertices(points, avatar.vertices)
    outside = np.einsum("nc,nc->n", points - avatar.vertices[near], normals[near])
    depth = np.maximum(-outside - SKIN_DEPTH_M, 0.0)
    return float((distance + 4.0 * depth).mean() / extent)


def orient_outward(mesh: GarmentMesh, avatar: Avatar) -> GarmentMesh:
    """Returns ``mesh`` wound consistently, each connected piece with its normals away from ``avatar``, with a note if
    faces were turned. Raises ``MeshError`` for a one-sided surface."""
    turn = consistent_turn(mesh.faces)
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    normals = meshes.area_vectors(mesh.vertices, faces)
    centres = mesh.vertices[faces].mean(axis=1)
    nearest = closest_point(centres, avatar.vertices, avatar.faces)
    outward = meshes.face_normals(avatar.vertices, avatar.faces)[nearest.face]
    piece = mesh_graphs.connected_components(faces, len(mesh.vertices))[faces[:, 0]]
    agreement = np.bincount(piece, np.einsum("fc,fc->f", normals, outward))
    inward = agreement[piece] < 0.0
    turn = turn ^ inward
    if not turn.any():
        return mesh
    uv_faces = mesh.uv_faces
    if len(uv_faces):
        uv_faces = np.where(turn[:, None], uv_faces[:, ::-1], uv_faces)
    turned = replace(mesh, faces=np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces), uv_faces=uv_faces)
    return turned.noted(f"turned {int(turn.sum())} of {len(turn)} faces so that normals point outward")


def consistent_turn(faces: np.ndarray) -> np.ndarray:
    """Returns which of ``faces`` (F, 3) to reverse, bool (F,), so that neighbours are wound alike: the fewest of each
    connected piece. Raises ``MeshError`` for a one-sided piece."""
    turn, piece = fewest_turned(faces)
    halves, first, second = meshes.edge_pairs(np.where(turn[:, None], faces[:, ::-1], faces))
    clash = halves[first, 0] == halves[second, 0]
    if clash.any():
        onesided = np.isin(piece, piece[first[clash] // 3])
        raise MeshError(
            "garment",
            expected="a surface with two sides",
            got=f"a one-sided (Moebius) piece at face {int(np.flatnonzero(onesided)[0])}",
            cure="Cut it open along a seam.",
        )
    return turn


def fewest_turned(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns which of ``faces`` (F, 3) to reverse, bool (F,), so that neighbours are wound alike: the fewest of each
    connected piece; and the number (F,) of the piece of each face. In a one-sided piece some neighbours still differ.
    Edges must have at most two faces."""
    oriented, piece = map(np.asarray, igl.bfs_orient(np.ascontiguousarray(faces, dtype=np.int64)))
    turn = (oriented != faces).any(axis=1)
    return turn ^ (2 * np.bincount(piece, turn) > np.bincount(piece))[piece], piece


def describe(mesh: GarmentMesh) -> list[str]:
    """Returns notes about ``mesh``: the numbers of its pieces, its openings and its unused vertices, and a warning
    about closed pieces."""
    label = mesh_graphs.connected_components(mesh.faces, len(mesh.vertices))
    used = np.unique(mesh.faces)
    pieces = np.unique(label[used])
    notes = []
    if len(pieces) > 1:
        sizes = sorted((int((label[used] == piece).sum()) for piece in pieces), reverse=True)
        notes.append(
            f"{len(pieces)} pieces with {', '.join(map(str, sizes[:8]))}{', ...' if len(sizes) > 8 else ''} vertices"
        )
    if len(used) < len(mesh.vertices):
        notes.append(
            f"{len(mesh.vertices) - len(used)} vertices belong to no face: they follow the nearest one that does"
        )
    loops = meshes.boundary_loops(mesh.faces)
    opened = np.unique(label[np.concatenate(loops)]) if loops else np.zeros(0, dtype=int)
    closed = len(pieces) - len(opened)
    if closed:
        notes.append(
            warning(f"{closed} closed piece{'s' if closed > 1 else ''}: cloth is a surface with openings, not a solid")
        )
    notes.append(f"{len(loops)} openings")
    return notes
