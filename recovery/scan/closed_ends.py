"""Refuses a surface that closes over something, as a scan of a dressed person closes over head, hands and feet.

Cloth beyond some distance from all openings is a strip or a flat piece. Over a head it is a bag: a large piece with a
short border.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csgraph

from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes
from recovery.scan.places import ScanFault, in_box

LEVELS = 16  # distances from the openings at which pieces are looked at
LEAST_SHARE = 0.01  # of the area that a bag has
BAG = 0.3  # of a circle's border squared over its area: a hemisphere has 0.5, a hand with its wrist 0.1


def check_unworn(mesh: GarmentMesh) -> None:
    """Refuses a scan in which cloth and wearer are one surface, with the tip of a bag, farthest from the openings."""
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
