"""Reads a scan and mends it: one garment's surface with holes closed, in the file's coordinates; or refuses it.

A fault that has one repair (copies of vertices, faces without area, branches, second layers, crumbs, turned hems,
holes) is repaired, with a note in the report. A fault that needs a choice (which of two garments) is refused with its
place and the cure.

The cloth of a hem that is turned in looks along the opening's axis, in a strip that ends at the fold. About a hole it
goes on so. Cloth far from all openings is a strip or a flat piece. Over a dressed head it is a bag: a large piece with
a short border.

A fine scan is thinned out: one vertex, at the mean, for a patch of cloth, so that noise averages out. Patches are the
Voronoi cells of seeds along the surface; where three meet there is a triangle. Borders have seeds of their own and
their vertices stay on them, so hems keep their place and a thin strap its two sides.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.errors import MeshError
from drape.garment.contours import Loop, borders, plainly_hole, plainly_opening
from drape.garment.files.mesh import GarmentMesh, read_mesh, weld
from drape.garment.mesh_checks import check_arrays, without_flat_faces
from drape.garment.sheets import agreeing, cut_branches, main_sheet, point_words, with_used_vertices, without_copies
from drape.geometry import mesh_graphs, meshes
from recovery import progress
from recovery.scan.holes import GROW, NOISE, SHRINK, SMOOTHINGS, close_holes

SCAN_VERTEX_LIMIT = 3_300_000  # 1,000,000 triangles of an STL, which does not share vertices
EXTENTS = (1e-3, 1e6)  # in a file's unit, whatever it is: squares and cubes stay far from the ends of the numbers
OPEN_SHARE = 0.7  # no hem and no neckline, however deep, goes over more of the height
TWISTED_SHARE = 0.02  # a scan that has to be cut at more edges than this share of its faces is no cloth
ACROSS = 0.5  # cosine between an opening's axis and the normals of a hem that is turned in; a cuff's cloth has 0.2
SMOOTH = 0.7  # cosine between neighbours of one strip: a fold is sharper
WIDE_SHARE = 0.06  # width over the root of the area: no hem is as wide, and the cloth about a hole is wider
ALL_ROUND = 0.9  # share of an edge's vertices that the strip of a hem has at least
LEVELS = 16  # distances from the openings at which pieces are looked at
LEAST_SHARE = 0.01  # least share of the area that a bag has
BAG = 0.3  # most of a border squared over its area, as a circle has 1: a hemisphere has 0.5, a hand with its wrist 0.1
# A target of more faces is thinned out to so many: 8 mm between vertices of a shirt; the search has edges of 17 to 50.
FACE_LIMIT, FACE_GOAL = 60_000, 30_000
ENOUGH = 0.7  # share of the goal that is near enough
ROUNDS = 2  # rounds of Lloyd's method: seeds go to the middles of their cells


def read_target(path: Path, *, label: str | None = None) -> GarmentMesh:
    """Returns the garment in the file at ``path``, in the file's coordinates: one connected sheet whose faces agree in
    orientation and whose plain holes are closed.

    ``label`` keeps the faces of one material. Raises ``ScanFault`` with the place for two garments and for one-sided
    cloth, ``MeshError`` for a solid without openings.
    """
    with progress.stage(f"{path.name} is read"):
        mesh = read_mesh(path, vertex_limit=SCAN_VERTEX_LIMIT)
    if label is not None:
        mesh = faces_of_label(mesh, label)
    with progress.stage("the scan is mended"):
        check_arrays(mesh, vertex_limit=SCAN_VERTEX_LIMIT)
        if not EXTENTS[0] <= (extent := float(np.ptp(mesh.vertices, axis=0).max())) <= EXTENTS[1]:
            raise MeshError(
                "target",
                expected="a garment in m, cm, dm, mm or inch",
                got=f"{extent:.3g} across",
                cure="Scale the file.",
            )
        return mend_sheet(mesh)


def mend_sheet(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` as one connected sheet: every edge has one face or two, neighbours agree in orientation, plain
    holes and bites (``bites_of``) are closed.

    Raises ``ScanFault`` or ``MeshError`` for what cannot be mended.
    """
    progress.tick("copies and flat faces")
    mesh = without_flat_faces(without_copies(weld(mesh)))
    progress.tick("branches")
    mesh = one_sheet(cut_branches(mesh))
    progress.tick("thinning out")
    thin = thin_mesh(mesh)
    if thin is not mesh:
        mesh = one_sheet(cut_branches(without_flat_faces(thin)))
    mesh = without_turned_hems(smooth_noise(orient_faces(mesh)))
    check_open(mesh, "a closed surface")
    closing = close_holes(mesh, lambda border: plainly_hole(border, mesh))
    check_open(closing.mesh, f"one that is closed once mended, with no border but holes ({closing.holes})")
    check_closed_round(closing.mesh)
    check_unworn(closing.mesh)
    return closing.mesh if closing.mesh is mesh else closing.mesh.noted(*closing.words(len(mesh.faces)))


def check_open(mesh: GarmentMesh, otherwise: str) -> None:
    """Raises ``MeshError`` for a mesh without borders; the refusal says that it is ``otherwise``, such as a closed
    surface."""
    if not meshes.boundary_loops(mesh.faces):
        raise MeshError(
            "target",
            expected="a garment: a surface with openings",
            got=otherwise,
            cure="Cut the garment out of the scan, without the body, and open neck, cuffs and hem.",
        )


def check_closed_round(mesh: GarmentMesh) -> None:
    """Raises ``ScanFault`` for a jacket that is open in front: its longest border goes round the hem and up to the
    neck."""
    points = mesh.vertices[borders(mesh)[0].loop]
    low, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    # y or z is up, the other one the depth, which every hem has.
    if (np.ptp(points, axis=0) < OPEN_SHARE * size)[1:].any():
        return
    up = 1 if size[1] > size[2] else 2
    height = (points[:, up] - low[up]) / size[up]
    edges = points[np.abs(height - height[np.abs(height - 0.5).argmin()]) < 0.2]
    raise ScanFault(
        "target",
        expected="a garment that is closed all round",
        got=f"one that is open from hem to neck, as a jacket's front is: {in_box(edges[0], mesh.vertices)}",
        cure="Join the two edges (button it up): no base opens in front.",
    ).at(mesh, edges)


def faces_of_label(mesh: GarmentMesh, label: str) -> GarmentMesh:
    """Returns the faces of ``mesh`` with the first material called ``label``. Raises ``MeshError`` for none."""
    if label not in mesh.material_names:
        names = ", ".join(mesh.material_names)
        raise MeshError("--label", expected=f"one of {names}", got=label, cure="Name a material of the file.")
    keep = mesh.face_material == mesh.material_names.index(label)
    if not keep.any():
        raise MeshError("--label", expected=f"faces of {label}", got="none", cure="Name another material of the file.")
    return mesh.take_faces(keep).noted(f"kept {int(keep.sum())} of {len(keep)} faces: those of material {label}")


def one_sheet(mesh: GarmentMesh) -> GarmentMesh:
    """Returns the largest connected sheet of ``mesh``. Raises ``ScanFault`` where a second large one lies apart."""
    sheet, rivals = main_sheet(mesh)
    if rivals:
        labels = f" Materials: {', '.join(mesh.material_names)}." if len(mesh.material_names) > 1 else ""
        raise ScanFault(
            "target",
            expected="one garment in one piece",
            got=f"{len(rivals) + 1} pieces of cloth; another one is {in_box(rivals[0], mesh.vertices)}",
            cure=f"Save the garment alone, name its material (--label), or join what was torn.{labels}",
        ).at(mesh, np.array(rivals))
    return sheet


def orient_faces(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with faces that agree in orientation, cut at twists. Raises ``ScanFault`` for many twists."""
    turned, cuts = agreeing(mesh)
    if len(cuts) > TWISTED_SHARE * len(mesh.faces):
        raise ScanFault(
            "target",
            expected="cloth with two sides",
            got=f"{len(cuts)} edges at which it turns to its other side, the first {in_box(cuts[0], mesh.vertices)}",
            cure="Let the scanner make a surface whose faces agree.",
        ).at(mesh, cuts)
    if not len(cuts):
        return turned
    words = f"cut open a twisted strip at {len(cuts)} edges, the first {in_box(cuts[0], mesh.vertices)}"
    return one_sheet(turned.noted(words))


# --- hems that are turned in -----------------------------------------------------------------------------------------


def without_turned_hems(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh``, whose faces agree in orientation, without hems that are turned in: cut off at their folds."""
    normals = meshes.face_normals(mesh.vertices, mesh.faces)
    pairs = np.stack(meshes.edge_pairs(mesh.faces)[1:]) // 3
    pairs = pairs[:, (normals[pairs[0]] * normals[pairs[1]]).sum(axis=1) > SMOOTH]
    strips = [_strip(mesh, border, normals, *pairs) for border in borders(mesh) if not plainly_opening(border)]
    strips = [strip for strip in strips if strip.any()]
    if not strips:
        return mesh
    bare = with_used_vertices(mesh.take_faces(~np.any(strips, axis=0)))
    return bare.noted(f"cut off {len(strips)} hems that are turned in, at their folds")


def _strip(mesh: GarmentMesh, edge: Loop, normals: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The faces (F,) of the hem with this ``edge``, True for them; none where it is not turned in.

    ``a`` and ``b`` (P,) are neighbours without a fold between them.
    """
    across = np.abs(normals @ edge.axis) > ACROSS
    on = across[a] & across[b]
    graph = scipy.sparse.coo_matrix((np.ones(on.sum()), (a[on], b[on])), shape=(len(normals),) * 2)
    piece = csgraph.connected_components(graph, directed=False)[1]
    strip = across & np.isin(piece, piece[np.isin(mesh.faces, edge.loop).any(axis=1) & across])
    area = meshes.face_areas(mesh.vertices, mesh.faces)
    wide = WIDE_SHARE * np.sqrt(area.sum())
    most = wide * (edge.length + np.pi * wide)
    if np.isin(edge.loop, mesh.faces[strip]).mean() < ALL_ROUND or area[strip].sum() > most:
        return np.zeros_like(strip)
    # The fold is longer than the edge. What leaves no fold, or more than one, is no hem.
    folds = [loop for loop in borders(mesh.take_faces(~strip)) if np.isin(loop.loop, mesh.faces[strip]).all()]
    return strip & (len(folds) == 1 and folds[0].length > edge.length)


# --- cloth and wearer in one surface ---------------------------------------------------------------------------------


def check_unworn(mesh: GarmentMesh) -> None:
    """Raises ``ScanFault`` for a scan in which cloth and wearer are one surface, as where it closes over a head or a
    hand.

    Such a surface has a bag: a part far from the openings with a narrow mouth. The place of the fault is the bag's tip.
    """
    rim = meshes.boundary_vertices(mesh.faces)
    graph = mesh_graphs.edge_graph(mesh.vertices, mesh.faces)
    far = csgraph.dijkstra(graph, directed=False, indices=rim, min_only=True)
    area = meshes.face_areas(mesh.vertices, mesh.faces)
    for level in np.linspace(0.0, far.max(), LEVELS, endpoint=False)[1:]:
        beyond = (far[mesh.faces] > level).all(axis=1)
        piece = mesh_graphs.connected_components(mesh.faces[beyond], len(mesh.vertices))[mesh.faces[:, 0]]
        size = np.bincount(piece[beyond], area[beyond])
        for number in np.flatnonzero(size > LEAST_SHARE * area.sum()).tolist():
            faces = mesh.faces[beyond & (piece == number)]
            loops = meshes.boundary_loops(faces)
            points = mesh.vertices[np.concatenate(loops)]
            length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()
            if len(loops) == 1 and length**2 < BAG * 4.0 * np.pi * size[number]:
                tip = mesh.vertices[faces].reshape(-1, 3)[far[faces].argmax()]
                raise ScanFault(
                    "target",
                    expected="a garment without its wearer",
                    got=f"a surface that closes as over a head, a hand or a foot: {in_box(tip, mesh.vertices)}",
                    cure="Cut the wearer off along neck, cuffs and hem in a mesh editor (Blender, Edit Mode: delete "
                    "faces), or give the cloth a material of its own and name it (--label).",
                ).at(mesh, tip)


class ScanFault(MeshError):
    """The refusal of a scan with a fault that cannot be repaired safely. ``points`` (P, 3) are its places on the
    ``mesh``, in the mesh's coordinates; there are none until ``at`` sets them."""

    mesh: GarmentMesh | None = None
    points: np.ndarray = np.zeros((0, 3))

    def at(self, mesh: GarmentMesh, points: np.ndarray) -> ScanFault:
        """Sets the place of the fault, ``points`` (P, 3) on ``mesh``, and returns the fault."""
        self.mesh, self.points = mesh, np.asarray(points, dtype=np.float64).reshape(-1, 3)
        return self


def in_box(point: np.ndarray, vertices: np.ndarray) -> str:
    """Returns a phrase on where ``point`` (3,) lies in the box around ``vertices`` (V, 3), for a file whose body is not
    known. The garment's front is at +z, up at +y.
    """
    low, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-300)
    across, up, out = (point - low) / size
    side = "left" if across > 0.6 else "right" if across < 0.4 else "middle"
    return (
        f"{'front' if out >= 0.5 else 'back'}, {side}, {100 * up:.0f} % of the height from below, at "
        f"{point_words(point)} of the file"
    )


def thin_mesh(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` with about ``FACE_GOAL`` faces if it has more than ``FACE_LIMIT``; otherwise as it is. Edges of
    ``mesh`` have at most two faces; those of what is returned may have more."""
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
    """Returns ``mesh`` with vertices about ``spacing`` apart, in its unit, without texture coordinates and
    materials."""
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
    cells = _once(cells[(np.diff(np.sort(cells, axis=1), axis=1) > 0).all(axis=1)])
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
    """Returns how rough ``mesh`` is: the median size of the squared umbrella Laplacian at the vertices inside, over the
    mean length of the edges. It is 0 for a mesh without vertices inside."""
    matrix = mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices))
    inside = np.ones(len(mesh.vertices), dtype=bool)
    inside[meshes.boundary_vertices(mesh.faces)] = False
    edges = meshes.edge_lengths(mesh.vertices, meshes.unique_edges(mesh.faces))
    second = np.linalg.norm(matrix @ (matrix @ mesh.vertices), axis=1)[inside]
    return float(np.median(second) / edges.mean()) if inside.any() else 0.0


def smooth_noise(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh``, smoothed as by Taubin (1995) if its ``roughness`` is above ``NOISE``. Border vertices are
    smoothed along their border only."""
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
