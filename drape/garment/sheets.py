"""Cuts a scan into sheets without branches, and finds the one that is the garment.

A placket, a doubled hem or a collar hangs on the shirt by edges with three and more faces. There the two faces that go
on most smoothly stay together and every other one is cut off (cutting before stitching: Guéziec, Taubin, Lazarus and
Horn 2001). What is cut off is a sheet of its own. Lengths are shares of the root of the garment's area, so no unit is
needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from drape.garment.files.mesh import GarmentMesh
from drape.garment.mesh_checks import fewest_turned
from drape.geometry import closest, mesh_graphs, meshes

COPY_SHARE = 1e-6  # vertices nearer than this share of the extent are one, written with other digits
# Vertices on borders are one where they are nearer than CRACK_SHARE of the extent and CRACK_EDGES of the edges there.
CRACK_SHARE, CRACK_EDGES = 1e-3, 0.25
CRUMB_SHARE = 0.02  # pieces with a smaller share of the whole area are crumbs
LAYER_SHARE = 0.03  # a sheet within this share of the root of the area, 2 to 4 cm, lies on the garment
LAYER_PART = 0.8  # share of a sheet's samples that must lie on the garment
SMOOTHINGS = 3
DISAGREEING = 2.0  # cost of faces wound differently, so that they stay together only if no other two can
FEW_CLASHES = 0.01  # share of the edges
OWN_SHARE = 0.2  # a sheet apart with a larger share of the largest's area may be the garment as well
SAMPLES = 400


def without_copies(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with vertices closer to each other than ``COPY_SHARE`` of its extent made one, with a note;
    ``mesh`` itself if there are none."""
    reach = COPY_SHARE * _extent(mesh)
    return _welded(mesh, KDTree(mesh.vertices).query_pairs(reach, output_type="ndarray"))


def without_cracks(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with borders that run along each other joined, with a note: their vertices become one where they
    are much nearer to each other than edges are long. If there are none, ``mesh`` itself is returned. Panels that were
    rounded each by itself, as by a compressed file, have cracks between them."""
    border = meshes.boundary_edges(mesh.faces)
    reach = np.full(len(mesh.vertices), CRACK_SHARE * _extent(mesh))
    np.minimum.at(reach, border, CRACK_EDGES * meshes.edge_lengths(mesh.vertices, border)[:, None])
    own = np.unique(border)
    pairs = own[KDTree(mesh.vertices[own]).query_pairs(float(reach.max()), output_type="ndarray")]
    pairs = pairs[meshes.edge_lengths(mesh.vertices, pairs) < reach[pairs].min(axis=1)]
    # Only whole edges are joined; hems of two garments that touch in a point stay apart.
    label = mesh_graphs.joined_parts(len(mesh.vertices), *pairs.T)
    ends, counts = np.unique(np.sort(label[border], axis=1), axis=0, return_counts=True)
    return _welded(mesh, pairs[np.isin(label[pairs[:, 0]], ends[counts > 1])])


def _extent(mesh: GarmentMesh) -> float:
    """The longest side of the box of the faces: vertices of none may lie anywhere."""
    return float(np.ptp(mesh.vertices[mesh.faces], axis=(0, 1)).max())


def _welded(mesh: GarmentMesh, pairs: np.ndarray) -> GarmentMesh:
    """``mesh`` with the two vertices of each of the ``pairs`` (P, 2) made one."""
    if not len(pairs):
        return mesh
    count = len(mesh.vertices)
    label = mesh_graphs.joined_parts(count, *pairs.T)
    _, first = np.unique(label, return_index=True)
    welded = replace(mesh, vertices=mesh.vertices[first], faces=label[mesh.faces])
    return welded.noted(f"{count} vertices welded into {len(first)}")


def branch_edges(faces: np.ndarray) -> int:
    """Returns the number of edges of ``faces`` (F, 3) that have more than two faces."""
    _, counts = meshes.edges_of_halves(meshes.half_edges(faces))
    return int((counts > 2).sum())


def cut_branches(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` cut apart where an edge has more than two faces and where sheets touch in a single vertex:
    vertices there are split. ``mesh`` itself if there is no such place and every vertex has a face. Vertices without a
    face are left out. Faces keep their order; where two pairs of faces cannot be told apart, because they meet again at
    both ends of their edge, one pair is left out."""
    branches = branch_edges(mesh.faces)
    cut = _split(mesh, *_joined(mesh.vertices, mesh.faces))
    if not branches and len(cut.vertices) == len(np.unique(mesh.faces)):
        return mesh
    while branch_edges(cut.faces):
        halves, first, second = _joined(cut.vertices, cut.faces)
        inverse, counts = meshes.edges_of_halves(halves)
        crowded = np.flatnonzero(counts[inverse] > 2)
        kept = np.zeros(len(halves), dtype=bool)
        _, at = np.unique(inverse[first], return_index=True)  # the first pair of an edge bends least
        kept[first[at]] = kept[second[at]] = True
        gone = np.zeros(len(cut.faces), dtype=bool)
        gone[crowded[~kept[crowded]] // 3] = True
        cut = with_used_vertices(cut.take_faces(~gone))
        cut = _split(cut, *_joined(cut.vertices, cut.faces))
    return cut.noted(f"cut apart at {branches} edges with more than two faces") if branches else cut


def _split(mesh: GarmentMesh, halves: np.ndarray, first: np.ndarray, second: np.ndarray) -> GarmentMesh:
    """``mesh`` joined only where the half-edges ``first`` and ``second`` (P,) of ``halves`` (3 F, 3) lie together."""
    # Corners that meet at an edge that joins two faces are one vertex. Half-edge 3 f + c starts at corner c of face f.
    following = np.arange(len(halves)).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    same = halves[first, 0] == halves[second, 0]  # neighbours that disagree in orientation
    ends = np.concatenate([first, following[first]])
    others = np.concatenate([np.where(same, second, following[second]), np.where(same, following[second], second)])
    label = mesh_graphs.joined_parts(len(halves), ends, others)
    count = int(label.max(initial=-1)) + 1
    vertex = np.zeros(count, dtype=np.int64)
    vertex[label] = halves[:, 0]
    order = np.argsort(vertex, kind="stable")  # vertices keep their order where they can
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    return replace(mesh, vertices=mesh.vertices[vertex[order]], faces=rank[label].reshape(-1, 3))


def agreeing(mesh: GarmentMesh) -> tuple[GarmentMesh, np.ndarray]:
    """Returns ``mesh`` with faces reversed so that neighbours are wound alike, and the middles (C, 3) of edges that
    were cut open for it, none in most meshes. Only one-sided (Moebius) sheets have to be cut, across the strip. Edges
    must have at most two faces."""
    turn, _ = fewest_turned(mesh.faces)
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    halves, first, second = meshes.edge_pairs(faces)
    clash = halves[first, 0] == halves[second, 0]
    if not (turn.any() or clash.any()):
        return mesh, np.zeros((0, 3))
    turned = replace(mesh, faces=faces).noted(f"turned {int(turn.sum())} faces so that neighbours agree")
    if not clash.any():
        return turned, np.zeros((0, 3))
    middles = mesh.vertices[halves[first[clash], :2]].mean(axis=1)
    return _split(turned, halves, first[~clash], second[~clash]), middles


def _joined(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the half-edges (3 F, 3), and the index arrays of the two half-edges of each edge that stay together."""
    halves, first, second = meshes.edge_pairs(faces)
    inverse, counts = meshes.edges_of_halves(halves)
    plain = counts[inverse[first]] == 2
    clash = plain & (halves[first, 0] == halves[second, 0])
    if clash.sum() < FEW_CLASHES * len(first):  # where all else agrees, two sheets were glued along their ends
        plain &= ~clash
    kept = [np.stack([first[plain], second[plain]], axis=1)]
    averaging = mesh_graphs.umbrella_laplacian(faces, len(vertices))
    for _ in range(SMOOTHINGS):  # because noise tilts single faces
        vertices = vertices + averaging @ vertices
    crowded = np.flatnonzero(counts[inverse] > 2)
    crowded = crowded[np.argsort(inverse[crowded], kind="stable")]
    groups = [group for group in np.split(crowded, np.flatnonzero(np.diff(inverse[crowded])) + 1) if len(group)]
    bends = [_bends(vertices, halves, group) for group in groups]
    patch = mesh_graphs.joined_parts(len(faces), first[plain] // 3, second[plain] // 3)
    # Along a line on which three patches meet the same two go on everywhere, or the sheet would be slit.
    mean = _means_of_pairs([(patch[group // 3], bend) for group, bend in zip(groups, bends, strict=True)])
    for group, bend in zip(groups, bends, strict=True):
        own = patch[group // 3]
        cost = np.array([[mean[_pair(a, b)] for b in own] for a in own])
        cost = np.where(own[:, None] == own, bend, cost)
        start = halves[group, 0]
        kept.append(_smoothest(group, cost + DISAGREEING * (start[:, None] == start)))
    pairs = np.concatenate(kept)
    return halves, pairs[:, 0], pairs[:, 1]


def _pair(a: int, b: int) -> tuple[int, int]:
    return (int(min(a, b)), int(max(a, b)))


def _means_of_pairs(bends: list[tuple[np.ndarray, np.ndarray]]) -> dict[tuple[int, int], float]:
    """The mean of the bends between every two patches that meet somewhere."""
    sums: dict[tuple[int, int], list[float]] = {}
    for own, bend in bends:
        for i, a in enumerate(own):
            for j, b in enumerate(own):
                if i != j:
                    sums.setdefault(_pair(a, b), []).append(float(bend[i, j]))
    means = {pair: float(np.mean(values)) for pair, values in sums.items()}
    return means | {_pair(a, a): 1.0 for own, _ in bends for a in own}


def _bends(vertices: np.ndarray, halves: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Cosines (n, n) between the faces of the half-edges ``group`` at one edge: -1 where two lie in one plane."""
    low, high = np.sort(halves[group[0], :2])
    along = vertices[high] - vertices[low]
    arms = vertices[halves[group, 2]] - vertices[low]
    arms = arms - np.outer(arms @ along, along) / max(float(along @ along), 1e-300)
    arms = arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-300)
    return arms @ arms.T


def _smoothest(group: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Pairs (P, 2) of the half-edges ``group`` at one edge, of the least ``cost`` (n, n) first."""
    cost = cost + 6.0 * np.eye(len(group))
    pairs = []
    while len(group) - 2 * len(pairs) >= 2:
        a, b = np.unravel_index(int(cost.argmin()), cost.shape)
        pairs.append((group[a], group[b]))
        cost[[a, b]] = cost[:, [a, b]] = 9.0
    return np.array(pairs)


def pieces_of(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the number (F,) of the connected piece of each face, 0 for the piece of the largest area and so on, and
    the pieces' areas (P,), in the unit of ``points`` (N, 3) squared."""
    piece = mesh_graphs.connected_components(faces, len(points))[faces[:, 0]]
    _, piece = np.unique(piece, return_inverse=True)
    area = np.bincount(piece, meshes.face_areas(points, faces))
    order = np.argsort(-area, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank[piece], area[order]


def main_sheet(mesh: GarmentMesh) -> tuple[GarmentMesh, list[np.ndarray]]:
    """Returns the largest sheet of ``mesh``, with notes of what is left out, and the middles, each (3,), of other
    sheets that may be garment as well; none in most meshes. Crumbs and second layers (collars, facings, plackets,
    doubled hems) are left out. A sheet that lies apart is among the middles if its area is more than ``OWN_SHARE`` of
    the largest's; a smaller one is left out and noted."""
    piece, area = pieces_of(mesh.vertices, mesh.faces)
    total = float(area.sum())
    tree_faces = mesh.faces[piece == 0]
    layers, apart, rivals = 0.0, [], []
    for number in range(1, len(area)):
        if area[number] <= CRUMB_SHARE * total:
            break
        places, distance, border = samples_to(mesh.vertices, mesh.faces[piece == number], tree_faces)
        middle, on = places.mean(axis=0), (distance < LAYER_SHARE * np.sqrt(total)) & ~border
        if on.mean() >= LAYER_PART:
            layers += float(area[number])
        elif area[number] > OWN_SHARE * area[0]:
            rivals.append(middle)
        else:
            apart.append((area[number] / total, middle))
    crumbs = int((area <= CRUMB_SHARE * total).sum())
    kept = with_used_vertices(mesh.take_faces(piece == 0))
    notes = [f"left out {crumbs} small loose pieces"] if crumbs else []
    if layers:
        notes.append(
            f"left out second layers, {100 * layers / total:.0f} % of the area: cloth that lies on the garment, such "
            "as a collar, a placket or a doubled hem"
        )
    notes += [
        f"left out a piece of {100 * share:.0f} % of the area that hangs on nothing, at {point_words(middle)} of the "
        "file"
        for share, middle in apart
    ]
    return kept.noted(*notes), rivals


def point_words(point: np.ndarray) -> str:
    """Returns ``point`` (3,) as text such as "(0.12, 1.3, 0.08)"."""
    return f"({', '.join(f'{value:.3g}' for value in point)})"


def with_used_vertices(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` without the vertices that no face uses; others keep their order."""
    used, faces = meshes.in_use(mesh.faces)
    return replace(mesh, vertices=mesh.vertices[used], faces=faces)


def border_share(points: np.ndarray, own: np.ndarray, others: np.ndarray, within_m: float, *, rims: bool) -> float:
    """Returns the share in [0, 1] of the length of the border of the faces ``own`` that lies within ``within_m`` of the
    faces ``others``; with ``rims`` its nearest point must be on their border. It is 0 without a border. ``points`` [m]
    (N, 3): the vertices of both."""
    border = meshes.boundary_edges(own)
    if not len(border):
        return 0.0
    near = closest.closest_point(points[border].mean(axis=1), points, others)
    there, length = near.distance < within_m, meshes.edge_lengths(points, border)
    there = there & closest.on_border(near, others) if rims else there
    return float(length[there].sum()) / float(length.sum())


def samples_to(points: np.ndarray, own: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns S random places (S, 3) on the faces ``own``, drawn by area; their distances (S,) to the faces ``others``;
    and bool (S,), True where the nearest point of ``others`` is on the border of these, so that the place lies beyond
    it. Places and distances are in the unit of ``points`` (N, 3), the vertices of both."""
    share = meshes.face_areas(points, own)
    chosen = np.random.default_rng(0).choice(len(own), SAMPLES, p=share / share.sum())
    places = points[own[chosen]].mean(axis=1)
    near = closest.closest_point(places, points, others)
    return places, near.distance, closest.on_border(near, others)
