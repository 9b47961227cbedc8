"""Thins a fine scan out: one vertex for a patch of cloth, at the mean of the patch, so that noise averages out.

Patches are the Voronoi cells of seeds along the surface; where three meet there is a triangle. Borders have seeds of
their own and their vertices stay on them, so hems keep their place and a thin strap its two sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes
from recovery import progress

FACE_LIMIT = 60_000  # a target of more faces is thinned out ...
FACE_GOAL = 30_000  # ... to about as many: 8 mm between vertices of a shirt, where the search has edges of 17 to 50
NOISE = 0.2  # of an edge: median second differences beyond it are noise; scans without any have up to 0.17
SHRINK, GROW, SMOOTHINGS = 0.5, -0.53, 8  # of Taubin's smoothing, which keeps what is larger than a few edges
ENOUGH = 0.7  # of the goal
ROUNDS = 2  # of Lloyd's: seeds go to the middles of their cells


def thin_mesh(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with about ``FACE_GOAL`` faces if it has more than ``FACE_LIMIT``. Edges have at most two
    faces.
    """
    if len(mesh.faces) <= FACE_LIMIT:
        return mesh
    area = float(meshes.face_areas(mesh.vertices, mesh.faces).sum())
    # A lattice of triangles of side s has two of area s^2 sqrt(3) / 4 a vertex.
    spacing = float(np.sqrt(area / FACE_GOAL * 4.0 / np.sqrt(3.0)))
    thin = thin_to_spacing(mesh, spacing)
    if len(thin.faces) > ENOUGH * FACE_GOAL:
        return thin
    # Noise had made the area larger than the cloth is.
    return thin_to_spacing(mesh, spacing * float(np.sqrt(len(thin.faces) / FACE_GOAL)))


def thin_to_spacing(mesh: GarmentMesh, spacing: float) -> GarmentMesh:
    """Returns ``mesh`` with vertices about ``spacing`` apart."""
    vertices, faces = mesh.vertices, mesh.faces
    graph = mesh_graphs.edge_graph(vertices, faces)
    loops = meshes.boundary_loops(faces)
    on_border = np.zeros(len(vertices), dtype=bool)
    on_border[meshes.boundary_vertices(faces)] = True
    rim = np.unique(np.concatenate([_along(vertices[loop], loop, spacing) for loop in loops] or [np.zeros(0, int)]))
    weight = meshes.vertex_areas(vertices, faces)
    seeds = np.concatenate([rim, _spread(vertices, ~on_border, rim, spacing)])
    label = _cells(graph, seeds)
    for number in range(ROUNDS):
        progress.tick(f"thinning out, round {number + 1} of {ROUNDS}")
        middle = _means(vertices, weight, label, len(seeds))
        away = ((vertices - middle[label]) ** 2).sum(axis=1) + np.where(on_border, np.inf, 0.0)
        order = np.lexsort((away, label))
        nearest = order[np.unique(label[order], return_index=True)[1]]
        moved = np.where(np.isfinite(away[nearest]), nearest, seeds)
        seeds = np.concatenate([rim, moved[len(rim) :]])
        label = _cells(graph, seeds)
    # A cell at the border is where its border is.
    points = _means(vertices, weight, label, len(seeds))
    edge_label = label[on_border]
    edge = _means(vertices[on_border], np.ones(int(on_border.sum())), edge_label, len(seeds))
    has_edge = np.bincount(edge_label, minlength=len(seeds)) > 0
    points[has_edge] = edge[has_edge]
    cells = label[faces]
    cells = cells[(cells[:, 0] != cells[:, 1]) & (cells[:, 1] != cells[:, 2]) & (cells[:, 2] != cells[:, 0])]
    cells = _once(cells)
    thin = replace(
        mesh,
        vertices=points,
        faces=cells,
        uv=np.zeros((0, 2)),
        uv_faces=np.zeros((0, 3), dtype=np.int64),
        material_names=("default",),
        face_material=np.zeros(len(cells), dtype=np.int64),
    )
    return thin.noted(f"thinned out from {len(faces):,} to {len(cells):,} faces")


def _once(cells: np.ndarray) -> np.ndarray:
    """Each triangle of ``cells`` (F, 3) once, the way round that most have; none where as many go the other way."""
    low = cells.argmin(axis=1)
    cells = cells[np.arange(len(cells))[:, None], (low[:, None] + np.arange(3)) % 3]
    way = np.where(cells[:, 1] < cells[:, 2], 1, -1)
    _, first, inverse = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    total = np.bincount(inverse.reshape(-1), way, len(first))
    kept = cells[first]
    kept[total != 0] = np.where((way[first] * total)[:, None] < 0, kept[:, ::-1], kept)[total != 0]
    return kept[total != 0]


def _along(points: np.ndarray, loop: np.ndarray, spacing: float) -> np.ndarray:
    """Vertices of a closed border, about ``spacing`` apart along it."""
    length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    run = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    count = max(3, round(float(length.sum()) / spacing))
    return loop[np.unique(np.searchsorted(run, np.linspace(0.0, run[-1], count, endpoint=False)))]


def _spread(vertices: np.ndarray, allowed: np.ndarray, rim: np.ndarray, spacing: float) -> np.ndarray:
    """Vertices among those ``allowed``, one for each cube of ``spacing`` that has any, the first in a random order.

    Those in a cube with a vertex of ``rim`` are left out: it is a seed already.
    """
    side = 0.93 * spacing  # a cube meets the surface in 1.15 side^2 on average; a lattice has 0.87 spacing^2 a vertex
    cube = np.floor((vertices - vertices.min(axis=0)) / side).astype(np.int64)
    size = cube.max(axis=0) + 1
    key = (cube[:, 0] * size[1] + cube[:, 1]) * size[2] + cube[:, 2]
    order = np.random.default_rng(0).permutation(np.flatnonzero(allowed & ~np.isin(key, key[rim])))
    return order[np.unique(key[order], return_index=True)[1]]


def _cells(graph: scipy.sparse.csr_matrix, seeds: np.ndarray) -> np.ndarray:
    """The number (V,) of the seed that is nearest to each vertex along the surface."""
    source = csgraph.dijkstra(graph, directed=False, indices=seeds, min_only=True, return_predecessors=True)[2]
    number = np.full(len(source), -1)
    number[seeds] = np.arange(len(seeds))
    return number[source]


def _means(points: np.ndarray, weight: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    total = np.maximum(np.bincount(label, weight, count), 1e-300)[:, None]
    sums = np.stack([np.bincount(label, weight * points[:, axis], count) for axis in range(3)], axis=1)
    return sums / total


def roughness(mesh: GarmentMesh) -> float:
    """The median second difference of the vertices inside ``mesh``, over the mean length of its edges."""
    matrix = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    inside = np.ones(len(mesh.vertices), dtype=bool)
    inside[meshes.boundary_vertices(mesh.faces)] = False
    edges = meshes.edge_lengths(mesh.vertices, meshes.unique_edges(mesh.faces))
    second = np.linalg.norm(matrix @ (matrix @ mesh.vertices), axis=1)[inside]
    return float(np.median(second) / edges.mean()) if inside.any() else 0.0


def smooth_noise(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` without the noise of its vertices, if there is any: smoothed as by Taubin (1995); borders stay
    lines.
    """
    if roughness(mesh) <= NOISE:
        return mesh
    matrix = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    border = meshes.boundary_edges(mesh.faces)
    rim = np.unique(border)
    line = mesh_graphs.edge_matrix(border, np.ones(len(border)), len(mesh.vertices))
    degree = np.maximum(np.asarray(line.sum(axis=1)).reshape(-1), 1.0)
    along = (scipy.sparse.diags(1.0 / degree) @ line - scipy.sparse.identity(len(degree))).tocsr()
    inside = np.ones(len(mesh.vertices))
    inside[rim] = 0.0
    matrix = scipy.sparse.diags(inside) @ matrix + scipy.sparse.diags(1.0 - inside) @ along
    vertices = mesh.vertices
    for _ in range(SMOOTHINGS):
        for step in (SHRINK, GROW):
            vertices = vertices + step * (matrix @ vertices)
    moved = float(np.linalg.norm(vertices - mesh.vertices, axis=1).mean())
    root = float(np.sqrt(meshes.face_areas(vertices, mesh.faces).sum()))
    return replace(mesh, vertices=vertices).noted(
        f"smoothed out noise: vertices moved by {1e3 * moved / root:.1f} thousandths of the root of the area on average"
    )
