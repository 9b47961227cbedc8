"""Finds the openings for arms and legs, and stands sleeves that were drawn for lowered arms round those of the T-pose.

No panel has to bear a name: a cuff is an opening beside the middle, a sleeve what hangs between it and its armhole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.sparse
from scipy.sparse import csgraph

from drape.geometry import meshes
from recovery.pattern.model import Placement
from recovery.pattern.pattern_mesh import PatternMesh

BESIDE = 0.4  # of an opening's width, from the middle plane to its centre: half, if it touches that plane
STANDS_RAD = 0.35  # between sleeve and arm: threads close nearer ones round the arm as they stand


def limb_openings(mesh: PatternMesh, placed: np.ndarray, *, top: bool, crotch_m: float) -> dict[str, np.ndarray]:
    """The nodes (n,) of the opening for each arm of a ``top``, or for each leg; panels ``placed`` at [m] (P, 3).

    A top with three openings, two of them below the height ``crotch_m``, has legs and no arms.
    """
    nodes, loops = mesh.nodes_from(placed), meshes.boundary_loops(mesh.faces)
    beside = [one for one in loops if abs(nodes[one, 0].mean()) > BESIDE * np.ptp(nodes[one, 0])]
    beside.sort(key=lambda one: float(nodes[one, 1].mean()))  # the uppermost on a side stays: below it may be a leg's
    arms = top and (len(loops) > 3 or any(nodes[one, 1].mean() > crotch_m for one in beside))
    return {f"{'left' if nodes[one, 0].mean() > 0.0 else 'right'}_{'arm' if arms else 'leg'}": one for one in beside}


def sleeve_panels(mesh: PatternMesh, cuff: np.ndarray) -> np.ndarray:
    """Numbers of the panels that touch no opening but the nodes ``cuff``, and lie nearest to it along the cloth."""
    edges = meshes.unique_edges(mesh.panel_faces)
    lengths = np.concatenate([meshes.edge_lengths(mesh.rest, edges), np.full(len(mesh.seam_pairs), 1e-9)])
    ends = np.concatenate([edges, mesh.seam_pairs]).T
    graph = scipy.sparse.csr_matrix((lengths, ends), shape=(len(mesh.rest),) * 2)
    own = np.isin(mesh.node_of_panel_vertex, cuff)
    other = np.isin(mesh.node_of_panel_vertex, meshes.boundary_vertices(mesh.faces)) & ~own
    near, far = (csgraph.dijkstra(graph, False, np.flatnonzero(one), min_only=True) for one in (own, other))
    return np.setdiff1d(np.flatnonzero(np.bincount(mesh.panel, near - far) < 0.0), mesh.panel[other])


def round_spread_arms(
    mesh: PatternMesh, openings: Mapping[str, np.ndarray], joints: Mapping[str, np.ndarray]
) -> tuple[PatternMesh, float]:
    """Returns ``mesh`` with its sleeves turned to point as the arms do whose ``joints`` [m] (3,) are given by name, and
    the largest turn [rad].

    A sleeve points to where its cloth ends in its cuff, one of the ``openings``. One that points elsewhere is turned
    about the z axis and moved, in that plane, to its armhole. Without such a sleeve the turn is 0.
    """
    plane, panels, largest = mesh.placed() @ [1.0, 1.0j, 0.0], list(mesh.pattern.panels), 0.0
    for side in (limb.removesuffix("arm") for limb in openings if limb.endswith("arm")):
        cuff = np.isin(mesh.node_of_panel_vertex, openings[f"{side}arm"])
        # Outward across an edge of a panel that runs counter-clockwise: a quarter turn to the right, seen from outside.
        ends = [(panels[mesh.panel[v[0]]], v) for v in mesh.edge_vertices.values() if cuff[v].all()]
        across = (
            p.placement.matrix()[:2, :2] @ [[0.0, 1.0], [-1.0, 0.0]] @ (mesh.rest[v[-1]] - mesh.rest[v[0]])
            for p, v in ends
        )
        arm, way = joints[f"{side}wrist"] - joints[f"{side}shoulder"], sum(across, np.zeros(2))
        turn = float(np.angle(complex(arm[0], arm[1]) * complex(way[0], -way[1])))
        sleeve = sleeve_panels(mesh, openings[f"{side}arm"])
        own = np.isin(mesh.panel[mesh.seam_pairs], sleeve)
        armhole, own = mesh.seam_pairs[own[:, 0] != own[:, 1]], own[own[:, 0] != own[:, 1]]
        if abs(turn) < STANDS_RAD or not len(armhole):
            continue
        spin, largest = np.exp(1.0j * turn), max(largest, abs(turn))
        shift = plane[armhole[~own]].mean() - spin * plane[armhole[own]].mean()
        for number in sleeve:
            (a, b, c), (x, y, z) = panels[number].placement.rotation_deg, panels[number].placement.translation_m
            at = spin * complex(x, y) + shift
            turned = Placement((a, b, c + float(np.degrees(turn))), (at.real, at.imag, z))
            panels[number] = replace(panels[number], placement=turned)
    return replace(mesh, pattern=replace(mesh.pattern, panels=tuple(panels))) if largest else mesh, largest
