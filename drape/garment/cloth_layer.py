"""One layer of cloth out of a mesh as people draw them: what is simulated in place of a mesh that is no cloth.

Vertices at the same place become one; faces without area, drawn twice, or beyond the second at an edge are left out;
of a wall with a thickness stays the side away from the body; what lies on other cloth (linings, belts, pockets) and
what is small (buttons, cards of fur) is left out too, and dense cloth is thinned. All that is left out hangs on the
cloth that stays (``drape.garment.bound``).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import igl
import numpy as np
from scipy.spatial import KDTree

from drape.cloth.coarse_mesh import coarse_mesh
from drape.errors import MeshError
from drape.garment.bound import BoundMesh, bind
from drape.garment.caps import without_caps
from drape.garment.facings import without_facings
from drape.garment.files.mesh import GarmentMesh, plain_mesh, weld
from drape.garment.mesh_checks import without_flat_faces
from drape.garment.rest_detail import cloth_of, rest_of
from drape.garment.sheets import (
    agreeing,
    border_share,
    cut_branches,
    pieces_of,
    samples_to,
    with_used_vertices,
    without_copies,
    without_cracks,
)
from drape.garment.sleeves import sleeve_of
from drape.garment.walls import SAME_M, outer_sides
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point

ON_M, ON_SHARE = 0.015, 0.8  # cloth that lies on other cloth with this share of its points is left out
# A ring no higher than BELT_HIGH_M is a belt, if its area is below BELT_SHARE of the largest piece's. It hangs on cloth
# up to BELT_M away.
BELT_HIGH_M, BELT_M, BELT_SHARE = 0.12, 0.05, 0.25
SMALL_M2, SMALL_SHARE, NEAR_M = 0.02, 0.05, 0.03  # of small things: area, also over the largest piece's; way to cloth
SEWN_M, SEWN_SHARE, TRIM_SHARE = 0.004, 0.4, 0.15  # a collar's border on its garment; its area over that
HUNG = ("corner", "weight", "offset", "kind")  # the arrays of a bound mesh that say what a vertex hangs on
LARGE_M = 0.25  # extent of a ring around a trunk, at least
WOUND_ALIKE = 0.7  # mean cosine between normals of a drawn piece and of its cloth
OPPOSED, ALIKE_M = 0.05, 0.008  # share of a piece nearest to cloth that looks the other way, and how far its own may be
STIFF_M = 0.06  # parts up to this size turn as a whole
VERTEX_LIMIT = 12_000
THINNED_M = 0.012  # edges of thinned cloth
SIMPLIFIED = (5 * VERTEX_LIMIT, 19 * VERTEX_LIMIT // 10)  # faces that quadrics leave, if edges stay too many


def join_sheets(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` as sheets of cloth: copies of a vertex become one, and no edge has more than two faces. Faces
    without area, faces drawn twice, and discs that close the end of a tube are left out. A mesh that needs no change is
    returned itself. Otherwise the vertices of ``mesh`` come first, in their rows and without faces, and then the
    vertices of the sheets."""
    sheets = cut_branches(without_flat_faces(without_cracks(without_copies(weld(mesh)))))
    if not (keep := without_caps(sheets.vertices, sheets.faces)).all():
        sheets = with_used_vertices(sheets.take_faces(keep)).noted(f"{int((~keep).sum())} faces close ends of tubes")
    if sheets is mesh:
        return mesh
    vertices = np.concatenate([mesh.vertices, sheets.vertices])
    return replace(sheets, vertices=vertices, faces=sheets.faces + len(mesh.vertices))


def cloth_layer(sheets: GarmentMesh, skin: np.ndarray, outer: np.ndarray | None = None) -> GarmentMesh:
    """Returns the one layer of ``sheets`` [m] (``join_sheets``) that is draped; ``sheets`` themselves, if it is all of
    them. Inner sides of walls, pieces that lie on other cloth, small things and facings are left out, and dense cloth
    is thinned. ``skin`` [m] (S, 3): points of the body inside. ``outer`` (F,) bool: the ``outer_sides`` of the sheets,
    if known. Raises ``MeshError`` for cloth that cannot be thinned to ``VERTEX_LIMIT``."""
    points, faces, notes, tree = sheets.vertices, sheets.faces, [], KDTree(skin)
    keep = outer_sides(points, faces, tree) if outer is None else outer.copy()
    if not keep.all():
        notes.append(f"{int((~keep).sum())} faces are the inner side of walls with a thickness")
    piece, _, bears = bearing_pieces(points, faces[keep])
    if not bears.all():
        notes.append(f"{int((~bears).sum())} of {len(bears)} pieces lie on the others and hang on them")
    keep[keep] = bears[piece]
    facing = np.flatnonzero(keep)[~without_facings(points, faces[keep], tree)]
    if len(facing):
        keep[facing] = False
        notes.append(f"{len(facing)} faces are turned in below others and hang on them")
    cloth = sheets if keep.all() else sheets.take_faces(keep)
    cloth = _thinned(cloth, notes)
    return cloth if cloth is sheets else cloth.noted(*notes)


def hung(mesh: GarmentMesh, places: np.ndarray, cloth: GarmentMesh, joints: np.ndarray, skin: np.ndarray) -> BoundMesh:
    """Returns ``mesh``, its vertices at ``places`` [m] (D, 3), bound to ``cloth``, the layer that is draped in its
    place. The body inside has ``joints`` [m] (24, 3) and ``skin`` [m] (S, 3)."""
    distance, row = KDTree(cloth.vertices).query(places)
    row = np.where(distance <= SAME_M, row, -1)
    part, label = _stiff_parts(mesh, places, row)
    beyond = _through_walls(mesh, places, cloth, row, label)
    bound = bind(mesh, places, cloth.vertices, cloth.faces, row, part, beyond)
    beside = _loops_of_trunk(mesh, places, (row < 0) & (part < 0), label, joints, skin)
    if not beside.any():
        return bound
    sleeve = np.isin(sleeve_of(cloth.vertices, cloth.faces, joints, skin), (1, 2))
    trunk = bind(mesh, places, cloth.vertices, cloth.faces[~sleeve[cloth.faces].any(axis=1)], row, part)
    chosen = {name: (getattr(trunk, name), getattr(bound, name)) for name in HUNG}
    mixed = {name: np.where(beside.reshape(-1, *[1] * (a.ndim - 1)), a, b) for name, (a, b) in chosen.items()}
    return replace(bound, **mixed)


def _through_walls(
    mesh: GarmentMesh, places: np.ndarray, cloth: GarmentMesh, row: np.ndarray, label: np.ndarray
) -> np.ndarray:
    """Where [m] (D, 3) the ``cloth`` of each vertex is looked for: of those on the inner side of a wall, in a piece of
    the ``label`` (D,) that has vertices of the cloth (``row``), by its thickness through the wall.

    By nearness alone the inner side of a sleeve hangs on the trunk that its arm hung by, and makes webs. So does what
    thinned cloth leaves out, where a sleeve lies on the trunk: it is looked for on what faces its way.
    """
    beyond, hung_on = places.copy(), row >= 0
    normals = meshes.vertex_normals(places, mesh.faces)
    along = meshes.vertex_normals(cloth.vertices, cloth.faces)[np.maximum(row, 0)]
    agreed = np.einsum("dc,dc->d", normals, along)
    for number in np.unique(label[hung_on]):
        own, inner = (label == number) & hung_on, np.flatnonzero((label == number) & ~hung_on)
        sense = float(agreed[own].mean())
        if len(inner) and abs(sense) > WOUND_ALIKE:
            out, near = np.sign(sense) * normals[inner], closest_point(places[inner], cloth.vertices, cloth.faces)
            facing = meshes.face_normals(cloth.vertices, cloth.faces)
            opposed = np.einsum("dc,dc->d", facing[near.face], out) < 0.0
            if opposed.mean() < OPPOSED:
                beyond[inner[opposed]] = _on_opposite(places[inner[opposed]], near.face[opposed], cloth, facing)
            else:
                beyond[inner] -= float(np.median(near.distance)) * out
    return beyond


def _on_opposite(points: np.ndarray, face: np.ndarray, cloth: GarmentMesh, facing: np.ndarray) -> np.ndarray:
    """The place (D, 3) nearest to each of ``points`` [m] (D, 3) on the faces of ``cloth``, with the normals ``facing``
    (F, 3), that look the other way than its ``face`` (D,); the point itself, where none is within ``ALIKE_M``."""
    nearest, way = points.copy(), facing[face]
    for axis, sign in product(range(3), (-1.0, 1.0)):
        own = np.flatnonzero((np.abs(way).argmax(axis=1) == axis) & (sign * way[:, axis] > 0.0))
        faces = cloth.faces[sign * facing[:, axis] < 0.0]
        if len(own) and len(faces):
            near = closest_point(points[own], cloth.vertices, faces)
            close = near.distance < ALIKE_M
            nearest[own[close]] = near.point[close]
    return nearest


def _loops_of_trunk(
    mesh: GarmentMesh, places: np.ndarray, loose: np.ndarray, label: np.ndarray, joints: np.ndarray, skin: np.ndarray
) -> np.ndarray:
    """Which vertices (D,) of the pieces ``label`` (D,) that are ``loose`` belong to a large one without sleeves, as a
    belt: it hangs on the trunk, however near to it arms hang."""
    on_trunk = np.zeros(len(label), dtype=bool)
    for number in np.unique(label[loose]):
        own = label == number
        if np.ptp(places[own], axis=0).max() > LARGE_M and loose[own].all():
            used, faces = meshes.in_use(mesh.faces[own[mesh.faces].all(axis=1)])
            on_trunk |= own & (not sleeve_of(places[used], faces, joints, skin).any())
    return on_trunk


def bearing_pieces(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the connected piece (F,) of each face, numbered from 0 by falling area; the pieces' areas (P,) [m^2]; and
    which pieces (P,) bool are cloth by themselves. A piece is not if it lies on other cloth, is sewn to a much larger
    piece, or is a small thing near one."""
    piece, area = pieces_of(points, faces)
    small = area < min(SMALL_M2, SMALL_SHARE * area[0])
    bears = np.zeros(len(area), dtype=bool)
    bears[0] = True
    for number in np.flatnonzero(~small)[1:]:
        own, larger = faces[piece == number], [k for k in range(number) if area[number] < TRIM_SHARE * area[k]]
        _, distance, border = samples_to(points, own, faces[bears[piece]])
        on_larger = (border_share(points, own, faces[piece == k], SEWN_M, rims=False) for k in larger if bears[k])
        sewn = any(share > SEWN_SHARE for share in on_larger)
        belt = area[number] < BELT_SHARE * area[0] and _is_low_ring(points[own])
        on = (distance < BELT_M) & (~border | (distance < NEAR_M)) if belt else (distance < ON_M) & ~border
        bears[number] = on.mean() < ON_SHARE and not sewn
    for number in np.flatnonzero(small & (area > 0.1 * SMALL_M2)):
        _, distance, _ = samples_to(points, faces[piece == number], faces[bears[piece]])
        bears[number] = (distance < NEAR_M).mean() < 0.5
    return piece, area, bears


def _is_low_ring(corners: np.ndarray) -> bool:
    """Whether a piece with ``corners`` [m] (F, 3, 3) is low and as wide as what goes round a waist."""
    wide, high, deep = np.ptp(corners, axis=(0, 1))
    return bool(high < BELT_HIGH_M < min(wide, deep))


def _thinned(mesh: GarmentMesh, notes: list[str]) -> GarmentMesh:
    """``mesh`` with at most ``VERTEX_LIMIT`` vertices; where it has more, without texture coordinates."""
    used, faces = meshes.in_use(mesh.faces)
    if len(used) <= VERTEX_LIMIT:
        return mesh
    points = mesh.vertices[used]
    area = float(meshes.face_areas(points, faces).sum())
    edge_m = max(THINNED_M, float(np.sqrt(area / (0.5 * np.sqrt(3.0) * 0.95 * VERTEX_LIMIT))))
    thin = _evenly_thinned(mesh.name, points, faces, edge_m)
    if len(thin.vertices) > VERTEX_LIMIT:  # wrinkles and slivers let no edge collapse
        # Simplification by quadrics needs faces that are wound alike, and sheets that do not touch at a vertex.
        wound, _ = agreeing(cut_branches(plain_mesh(mesh.name, points, faces)))
        for most in SIMPLIFIED:
            fewer, corners = map(np.asarray, igl.qslim(wound.vertices, wound.faces.astype(np.int64), most)[:2])
            if len(corners):
                thin = _evenly_thinned(mesh.name, fewer, corners.astype(np.int64), edge_m)
            if len(thin.vertices) <= VERTEX_LIMIT:
                break
    if len(thin.vertices) > VERTEX_LIMIT:
        raise MeshError(
            "garment",
            expected=f"cloth that {VERTEX_LIMIT:,} vertices can have the shape of",
            got=f"{len(used):,} vertices, of which {len(thin.vertices):,} cannot be left out",
            cure="Simplify the mesh, and weld the vertices of its pieces.",
        )
    notes.append(f"{len(used):,} vertices of cloth are simulated as {len(thin.vertices):,}")
    return thin.noted(*mesh.notes)


def _evenly_thinned(name: str, points: np.ndarray, faces: np.ndarray, edge_m: float) -> GarmentMesh:
    """A mesh on some of ``points`` [m] (N, 3) of ``faces`` (F, 3), its edges ``edge_m`` [m] where creases let them."""
    plain = plain_mesh(name, points, faces)
    cloth = cloth_of(points, faces, (plain.uv, plain.uv_faces), (plain.material_names, plain.face_material))
    thin = coarse_mesh(rest_of(cloth, "modelled")[0], points, faces, edge_m)
    return plain_mesh(name, points[thin.vertex], thin.faces)


def _stiff_parts(mesh: GarmentMesh, places: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number (D,) of the stiff part that a vertex belongs to, -1 for what bends, and of the piece (D,)."""
    label = mesh_graphs.connected_components(mesh.faces, len(places))
    _, first, at = np.unique(places, axis=0, return_index=True, return_inverse=True)
    # Pieces that only a seam of the texture separates are one.
    label = mesh_graphs.joined_parts(len(places), label, label[first[at.reshape(-1)]])[label]
    count = int(label.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, places)
    np.maximum.at(high, label, places)
    stiff = np.linalg.norm(high - low, axis=1) < STIFF_M
    stiff[label[row >= 0]] = False
    return np.where(stiff[label], label, -1), label
