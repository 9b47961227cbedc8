"""The mesh of a whole pattern: panels triangulated, seams joined, and the map from control points to vertices.

Triangles inside a panel are as even as its corners allow, without a new point on its outline. A triangular lattice
fills the inside; the constrained Delaunay triangulation (pythoncdt) joins it to the outline; a few rounds of moving the
inner points to the mean of their neighbours even it out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pythoncdt
import scipy.sparse
from scipy.sparse import csgraph

from drape.errors import InputError, MeshError
from drape.geometry import closest, mesh_graphs, meshes
from recovery.pattern import geometry
from recovery.pattern.coordinates import Controls, boundary_matrix, control_points, mean_value_weights
from recovery.pattern.geometry import boundary_distance, inside
from recovery.pattern.sewing_pattern import EdgeRef, Panel, Pattern

CLEARANCE_SHARE = 0.7  # no lattice point is nearer to the boundary than this share of an edge
ROUNDS, MOVES_PER_ROUND = 6, 2  # more rounds change the smallest angle by less than a degree
LARGEST_LATTICE = 2_000_000
MOST_FLIPS = 200  # most flips of inner edges at sewn corners


def triangulate(boundary: np.ndarray, edge_length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns points [m] (N, 2) and triangles (F, 3), counter-clockwise, inside the simple polygon ``boundary`` [m] (B,
    2), with sides of about ``edge_length_m`` [m].

    The first B points are those of ``boundary``, in order, and every one of its sides is a side of one triangle. Raises
    ``InputError`` for lengths that give too many points, ``MeshError`` for a polygon that is not simple.
    """
    boundary = np.array(boundary, dtype=np.float64)
    size = np.ptp(boundary, axis=0) / edge_length_m if edge_length_m > 0.0 else np.full(2, np.inf)
    if len(boundary) < 3 or not (size + 1.0).prod() < LARGEST_LATTICE:
        raise InputError(
            "edge_length_m",
            expected=f"a length > 0 that gives fewer than {LARGEST_LATTICE} points, and 3 or more boundary points",
            got=f"{edge_length_m} m for {len(boundary)} boundary points",
            cure="Take longer edges, and check that the pattern is in metres.",
        )
    points = np.concatenate([boundary, _lattice(boundary, edge_length_m)])
    count = len(boundary)
    faces = _delaunay(points, count)
    for _ in range(ROUNDS):
        to_mean = mesh_graphs.umbrella_laplacian(faces, len(points))[count:]
        for _ in range(MOVES_PER_ROUND):
            points[count:] += to_mean @ points
        faces = _delaunay(points, count)
    return points, faces


def corner_angles_deg(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the angles [deg] (F, 3) at the corners of the triangles ``faces`` (F, 3) of ``points`` (N, 2)."""
    corners = points[faces]
    first = np.roll(corners, -1, axis=1) - corners
    second = np.roll(corners, 1, axis=1) - corners
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return np.degrees(np.arctan2(np.abs(cross), (first * second).sum(axis=-1)))


def _lattice(polygon: np.ndarray, edge: float) -> np.ndarray:
    """Points of the triangular lattice inside ``polygon``, symmetric about the middle of its box."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    middle = 0.5 * (low + high)
    height = 0.5 * np.sqrt(3.0) * edge
    rows = np.arange(-np.ceil((high - middle)[1] / height), np.ceil((high - middle)[1] / height) + 1)
    columns = np.arange(-np.ceil((high - middle)[0] / edge) - 1, np.ceil((high - middle)[0] / edge) + 2)
    x = columns[None, :] * edge + np.where(rows % 2 == 0, 0.0, 0.5 * edge)[:, None]
    y = np.broadcast_to((rows * height)[:, None], x.shape)
    points = middle + np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
    return points[inside(points, polygon) & (boundary_distance(points, polygon) > CLEARANCE_SHARE * edge)]


def _delaunay(points: np.ndarray, boundary_count: int) -> np.ndarray:
    """Triangles (F, 3) of the constrained Delaunay triangulation inside the first ``boundary_count`` points."""
    start = np.arange(boundary_count, dtype=np.uintc)
    # Typed loosely: numpy's stubs do not know the buffer protocol before Python 3.12.
    vertices: Any = np.ascontiguousarray(points)
    sides: Any = np.ascontiguousarray(np.stack([start, np.roll(start, -1)], axis=1))
    try:
        mesh = pythoncdt.Triangulation(
            pythoncdt.VertexInsertionOrder.AUTO, pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED, 0.0
        )
        mesh.insert_vertices(vertices)
        mesh.insert_edges(sides)
        mesh.erase_outer_triangles()
        faces = mesh.triangles_array()["vertices"].astype(np.int64)
    except RuntimeError as error:
        raise _not_simple(str(error).splitlines()[0]) from error
    # A disk with B boundary and I inner points has B + 2 I - 2 triangles.
    expected = 2 * len(points) - boundary_count - 2
    if len(faces) != expected or mesh.vertices_count() != len(points):
        raise _not_simple(f"{len(faces)} triangles instead of {expected}")
    return faces


def _not_simple(got: str) -> MeshError:
    return MeshError(
        "boundary",
        expected="a simple polygon with distinct points",
        got=got,
        cure="Remove crossings and doubled points; take shorter edges where curved sides come close.",
    )


@dataclass(frozen=True, eq=False)
class PatternMesh:
    """The triangulated panels of a ``pattern`` and their seams. A panel vertex belongs to one panel; a node of the sewn
    garment is one panel vertex or several.

    ``rest`` [m] (P, 2): panel vertices, each in its panel's frame. ``panel`` (P,) and ``face_panel`` (F,): numbers of
    panels. ``panel_faces`` (F, 3): triangles as panel vertices, and ``faces`` (F, 3) as nodes, both counter-clockwise
    from outside (a panel sewn right to wrong is turned in both). ``node_of_panel_vertex`` (P,), onto ``node_count``
    nodes: the one-to-many map of the seams. ``seam_pairs`` (S, 2): panel vertices that are sewn together, and
    ``seam_of_pair`` (S,) the number of the stitch. ``edge_vertices``: the panel vertices along every edge, both ends
    included. ``rest`` as (2 P,) is ``weights`` (2 P, 2 K) times the positions of ``controls`` as (2 K,).
    """

    pattern: Pattern
    rest: np.ndarray
    panel: np.ndarray
    panel_faces: np.ndarray
    face_panel: np.ndarray
    faces: np.ndarray
    node_of_panel_vertex: np.ndarray
    node_count: int
    seam_pairs: np.ndarray
    seam_of_pair: np.ndarray
    edge_vertices: Mapping[EdgeRef, np.ndarray]
    controls: Controls
    weights: scipy.sparse.csr_matrix

    def rest_at(self, positions: np.ndarray) -> np.ndarray:
        """Returns the panel vertices [m] (P, 2) for control points at ``positions`` [m] (K, 2)."""
        return (self.weights @ positions.reshape(-1)).reshape(-1, 2)

    def folded(self, rest: np.ndarray) -> np.ndarray:
        """Returns the numbers (n,) of the triangles that are turned over or flat when the panel vertices lie at
        ``rest`` [m] (P, 2)."""
        areas = meshes.signed_areas(rest, self.panel_faces)
        return np.nonzero(areas * np.sign(meshes.signed_areas(self.rest, self.panel_faces)) <= 0.0)[0]

    def placed(self) -> np.ndarray:
        """Returns world positions [m] (P, 3) of the panel vertices, panels placed flat and not yet sewn."""
        world = np.zeros((len(self.rest), 3))
        for number, panel in enumerate(self.pattern.panels):
            mine = self.panel == number
            world[mine] = panel.placement.apply(self.rest[mine])
        return world

    def nodes_from(self, values: np.ndarray) -> np.ndarray:
        """Returns for each node the mean (N, C) of ``values`` (P, C) over its panel vertices."""
        total = np.zeros((self.node_count, values.shape[1]))
        np.add.at(total, self.node_of_panel_vertex, values)
        return total / np.bincount(self.node_of_panel_vertex, minlength=self.node_count)[:, None]

    def smallest_angles_deg(self) -> dict[str, float]:
        """Returns the smallest angle [deg] of any triangle of each panel, by the panel's name."""
        least = corner_angles_deg(self.rest, self.panel_faces).min(axis=1)
        return {
            panel.name: float(least[self.face_panel == number].min())
            for number, panel in enumerate(self.pattern.panels)
        }


def segment_counts(pattern: Pattern, edge_length_m: float) -> dict[EdgeRef, int]:
    """Returns the number of segments of every edge in a mesh of ``edge_length_m`` [m]; both edges of a stitch have as
    many. Raises ``InputError`` for a length that is not positive."""
    if not 0.0 < edge_length_m < np.inf:
        raise InputError("edge_length_m", expected="a length > 0", got=f"{edge_length_m}", cure="Pass metres.")
    lengths = {ref: geometry.edge_length(pattern.panel(ref.panel), ref.edge) for ref in pattern.edge_refs()}
    counts = {ref: max(1, round(length / edge_length_m)) for ref, length in lengths.items()}
    for stitch in pattern.stitches:
        mean = 0.5 * (lengths[stitch.first] + lengths[stitch.second])
        counts[stitch.first] = counts[stitch.second] = max(1, round(mean / edge_length_m))
    return counts


def mesh_pattern(pattern: Pattern, edge_length_m: float) -> PatternMesh:
    """Returns the mesh of ``pattern``: its panels, checked, triangulated with sides of about ``edge_length_m`` [m] and
    joined at the stitches.

    Raises ``InputError`` for an unfit pattern and ``MeshError`` where sewing does not give a surface.
    """
    geometry.check_pattern(pattern)
    counts = segment_counts(pattern, edge_length_m)
    controls = control_points(pattern)
    rest, faces, blocks = [], [], []
    edge_vertices: dict[EdgeRef, np.ndarray] = {}
    first = 0
    for number, panel in enumerate(pattern.panels):
        refs = [EdgeRef(panel.name, edge) for edge in range(len(panel.edges))]
        own = controls.positions[controls.panel == number]
        block, triangles = _panel_mesh(panel, own, [counts[ref] for ref in refs], edge_length_m)
        # The vertices are what the map gives, so that they agree to the last bit.
        rest.append((block @ own.reshape(-1)).reshape(-1, 2))
        blocks.append(block)
        faces.append(triangles + first)
        ends = np.cumsum([0, *(counts[ref] for ref in refs)])
        for ref, start, end in zip(refs, ends[:-1], ends[1:], strict=True):
            edge_vertices[ref] = first + np.arange(start, end + 1) % ends[-1]
        first += len(rest[-1])
    sizes = [len(vertices) for vertices in rest]
    panel_index = np.repeat(np.arange(len(sizes)), sizes)
    panel_faces = np.concatenate(faces)
    face_panel = panel_index[panel_faces[:, 0]]
    pairs, of_stitch = _seam_pairs(pattern, edge_vertices)
    node_count, node_of = _merged(pairs, first)
    panel_faces = _opened_tips(np.concatenate(rest), panel_faces, node_of)
    turned = _turned_panels(pattern)[face_panel]
    panel_faces[turned] = panel_faces[turned][:, ::-1]
    sewn = node_of[panel_faces]
    joined = sum(counts[stitch.first] for stitch in pattern.stitches)
    _check_surface(pattern, sewn, face_panel, expected_edges=len(meshes.unique_edges(panel_faces)) - joined)
    return PatternMesh(
        pattern=pattern,
        rest=np.concatenate(rest),
        panel=panel_index,
        panel_faces=panel_faces,
        face_panel=face_panel,
        faces=sewn,
        node_of_panel_vertex=node_of,
        node_count=node_count,
        seam_pairs=pairs,
        seam_of_pair=of_stitch,
        edge_vertices=edge_vertices,
        controls=controls,
        weights=scipy.sparse.csr_matrix(scipy.sparse.block_diag(blocks)),
    )


def _panel_mesh(
    panel: Panel, corners: np.ndarray, counts: list[int], edge_length_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """The map (2 P, 2 C) from a panel's ``corners`` [m] (C, 2) to its vertices, those of the outline first; triangles.

    ``counts`` (C,) are the segments of its edges.
    """
    parameters = [geometry.equal_parameters(edge, count)[:-1] for edge, count in zip(panel.edges, counts, strict=True)]
    matrix = boundary_matrix(panel, parameters)
    boundary = (matrix @ corners.reshape(-1)).reshape(-1, 2)
    points, triangles = triangulate(boundary, edge_length_m)
    inner = np.kron(mean_value_weights(points[len(boundary) :], boundary), np.eye(2)) @ matrix
    return np.concatenate([matrix, inner]), triangles


def _seam_pairs(pattern: Pattern, edge_vertices: Mapping[EdgeRef, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    pairs, of_stitch = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for number, stitch in enumerate(pattern.stitches):
        second = edge_vertices[stitch.second]
        second = second if stitch.right_to_wrong else second[::-1]
        pairs.append(np.stack([edge_vertices[stitch.first], second], axis=1))
        of_stitch.append(np.full(len(second), number))
    return np.concatenate(pairs), np.concatenate(of_stitch)


def _merged(pairs: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Nodes: panel vertices that chains of pairs join, numbered by their first panel vertex."""
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, label = csgraph.connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return len(first), rank[inverse.reshape(-1)].astype(np.int64)


def _opened_tips(points: np.ndarray, faces: np.ndarray, node_of: np.ndarray) -> np.ndarray:
    """``faces`` (F, 3) with inner edges flipped where sewing would close a corner or lay edges on each other.

    Where both sides of a corner are sewn to each other the triangle in the corner would collapse; where they are
    sewn to the sides of another corner, the inner edges of both corner triangles would coincide.
    """
    faces = faces.copy()
    for _ in range(MOST_FLIPS):
        halves = meshes.half_edges(faces)
        ends = np.sort(node_of[halves[:, :2]], axis=1)
        _, inverse, counts = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        spoilt = (ends[:, 0] == ends[:, 1]) | (counts[inverse.reshape(-1)] > 2)
        if not any(_flip(points, faces, *divmod(int(half), 3)) for half in np.flatnonzero(spoilt)):
            break
    return faces


def _flip(points: np.ndarray, faces: np.ndarray, number: int, start: int) -> bool:
    """Flips in place the edge that starts at corner ``start`` of a face; False at a border or a bent pair."""
    b, c, a = np.roll(faces[number], -start)
    across = np.argwhere((faces == c) & (np.roll(faces, -1, axis=1) == b))
    if len(across) != 1:
        return False
    other, corner = across[0]
    d = faces[other][(corner + 2) % 3]
    pair = np.array([(a, b, d), (a, d, c)])
    if meshes.signed_areas(points, pair).min() <= 0.0:
        return False
    faces[[number, other]] = pair
    return True


def _turned_panels(pattern: Pattern) -> np.ndarray:
    """True for panels (number of panels,) that show their wrong side outside, so that neighbouring triangles agree.

    The first panel of every connected part shows its right side.
    """
    number_of = {panel.name: number for number, panel in enumerate(pattern.panels)}
    turned = np.full(len(pattern.panels), -1)
    for seed in range(len(turned)):
        if turned[seed] >= 0:
            continue
        turned[seed] = 0
        open_panels = [seed]
        while open_panels:
            here = open_panels.pop()
            for stitch in pattern.stitches:
                ends = [number_of[stitch.first.panel], number_of[stitch.second.panel]]
                if here not in ends:
                    continue
                there = ends[1] if ends[0] == here else ends[0]
                wanted = turned[here] ^ int(stitch.right_to_wrong)
                if turned[there] < 0:
                    turned[there] = wanted
                    open_panels.append(there)
                elif turned[there] != wanted:
                    raise MeshError(
                        "stitches",
                        expected="a surface with an outside",
                        got=f"a one-sided band through {stitch.first} and {stitch.second}",
                        cure="Turn one of the right-to-wrong stitches around.",
                    )
    return turned == 1


def _check_surface(pattern: Pattern, faces: np.ndarray, face_panel: np.ndarray, *, expected_edges: int) -> None:
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if collapsed.any():
        name = pattern.panels[int(face_panel[collapsed][0])].name
        raise MeshError(
            "stitches",
            expected="triangles whose corners stay apart when sewn",
            got=f"{int(collapsed.sum())} collapsed ones, the first in panel {name}",
            cure="Take shorter mesh edges, or check that the stitches join the right edges.",
        )
    halves = meshes.half_edges(faces)[:, :2]
    coincide = expected_edges - len(meshes.unique_edges(faces))
    if coincide > 0 or len(np.unique(halves, axis=0)) < len(halves):
        raise MeshError(
            "stitches",
            expected="edges that meet only where a stitch joins them, neighbours facing the same way",
            got=f"{coincide} edges that fall onto others",
            cure="Take shorter mesh edges, or check that the stitches join the right edges.",
        )


def on_finer_mesh(coarse: PatternMesh, nodes: np.ndarray, fine: PatternMesh) -> np.ndarray:
    """Returns ``nodes`` (M, 3), positions or moves [m] of the nodes of ``coarse``, interpolated in its triangles at the
    nodes of ``fine``: (N, 3).

    A node of ``fine`` is found in ``coarse`` by its place in the flat panel. In ``fine`` parts may have been cut off a
    panel. The rest then keeps the panel's name; a part keeps its frame and is called NAME_PART.
    """
    there, here = ([panel.name for panel in mesh.pattern.panels] for mesh in (coarse, fine))
    whole = [_whole(name, there) for name in here]
    positions = np.zeros((len(fine.rest), 3))
    flat = np.column_stack([coarse.rest, np.zeros(len(coarse.rest))])
    for number, parent in enumerate(whole):
        mine, faces = fine.panel == number, coarse.face_panel == parent
        points = np.column_stack([fine.rest[mine], np.zeros(mine.sum())])
        triangles = coarse.panel_faces[faces]
        nearest = closest.closest_point(points, flat, triangles).face
        # Points outside a coarse chord are carried on along the nearest triangle.
        weights = closest.barycentric(points, flat[triangles[nearest]])
        positions[mine] = np.einsum("nk,nkc->nc", weights, nodes[coarse.faces[faces][nearest]])
    return fine.nodes_from(positions)


def _whole(name: str, names: list[str]) -> int | None:
    """The number of the panel called ``name``, or of the one that it was cut off; None where there is none."""
    while name not in names and "_" in name:
        name = name.rpartition("_")[0]
    return names.index(name) if name in names else None
