"""Lets a sewn garment fall and come to rest on a body: damped implicit steps with friction and self-contact.

``recovery.drape.settle`` finds a drape without friction, which a loss can be differentiated at. Here friction keeps the
folds with which the garment fell: the result depends on the way.

Cloth meets itself by springs between vertices and triangles, and between edges, that come too close. Every near pair is
a signed distance d = n . sum_i w_i x_i of four nodes, n constant during a step. It is pushed apart by the energy
k / 2 max(0, h - d)^2 while d is below the thickness h. A pair keeps the side that it has at the beginning of a step:
what has passed through stays through, so steps must be short.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch

from drape.cloth.fabric import Fabric, bending_angle, hinge_rigidity
from drape.cloth.material import Material
from drape.garment.sewing import near_lines
from drape.geometry import mesh_graphs, meshes
from drape.geometry.triangle_pairs import pairs_within
from recovery import progress
from recovery.pattern.design import Design
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.cloth_model import ClothModel, Parameters
from recovery.sim.implicit import SpringForces, damped_step
from recovery.sim.skin_contact import SignedDistance, SkinContact

SMALLEST_GAP = 1e-9
SOFTEST_N_PER_M = 400.0  # woven cloth is softened to this: its weight stretches it by less than 0.5 %
HEM_M = 0.02  # turned up this far
HEM_BENDING = 2.0  # two layers that slide on each other
SKIN_GAP_M = 0.0075  # more than intake keeps garments off the skin by
LAYERS_SHARE = 0.4  # layers of cloth stay this share of the mean edge apart
# Share of one step's speed that the next begins with: air and yarns take the rest. Settling cloth is damped more.
FALLING, SETTLING = 0.9, 0.5
MOVE_SHARE = 0.6  # longest move in a step over the distance of layers: two that meet must not pass each other


class Near(NamedTuple):
    """Pairs of elements of cloth that are too near, each with four ``nodes`` (n, 4): a vertex and a triangle, or two
    edges.

    The way between their nearest points is the sum of the nodes' positions times ``weights`` (n, 4). It has the unit
    direction ``normals`` (n, 3) and the length ``gap_m`` [m] (n,).
    """

    nodes: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gap_m: np.ndarray


class SelfContact:
    """The repulsion of cloth of ``faces`` (F, 3) from itself below ``thickness_m`` [m]. Nodes ``fixed`` (V,), bool, do
    not move.

    Elements that share a node, or whose nodes are joined by an edge, are never a pair.
    """

    def __init__(
        self, faces: np.ndarray, fixed: np.ndarray, *, thickness_m: float = 0.003, stiffness_n_per_m: float = 100.0
    ) -> None:
        self.faces, self.edges = faces, meshes.unique_edges(faces)
        self.thickness_m, self.stiffness = thickness_m, stiffness_n_per_m
        self.count = len(fixed)
        self._free = ~np.repeat(fixed, 3)
        graph = mesh_graphs.adjacency(faces, self.count)
        ring = (graph + scipy.sparse.identity(self.count, format="csr")).tocsr()
        ring.sort_indices()
        self._keys = np.repeat(np.arange(self.count), np.diff(ring.indptr)) * self.count + ring.indices

    def springs(self, x: np.ndarray) -> SpringForces:
        """Returns the springs that push near pairs of elements (``near``) apart, for nodes at ``x`` [m] (V, 3); they
        are zero at fixed nodes."""
        near = self.near(x)
        push = self.stiffness * (self.thickness_m - near.gap_m)
        along = near.weights[:, :, None] * near.normals[:, None]  # (n, 4, 3): derivative of the gap
        force = np.zeros((self.count, 3))
        np.add.at(force, near.nodes, push[:, None, None] * along)
        force.reshape(-1)[~self._free] = 0.0
        index = (3 * near.nodes[:, :, None] + np.arange(3)).reshape(-1)
        rows = np.repeat(np.arange(len(near.gap_m)), 12)
        values = (np.sqrt(self.stiffness) * along).reshape(-1) * self._free[index]
        gradient = scipy.sparse.csr_matrix((values, (rows, index)), shape=(len(near.gap_m), 3 * self.count))
        return SpringForces(torch.from_numpy(force), (gradient.T @ gradient).tocsc())

    def near(self, x: np.ndarray) -> Near:
        """Returns the pairs nearer than the thickness, nodes at ``x`` [m] (V, 3)."""
        pairs, weights, ways = pairs_within(np.ascontiguousarray(x), self.faces, self.edges, self.thickness_m)
        gap = np.linalg.norm(ways, axis=1)
        is_triangle = np.arange(len(gap)) < pairs.triangles
        keep = gap > SMALLEST_GAP
        keep &= is_triangle | (weights != 0.0).all(axis=1)  # ends of edges belong to vertices over triangles
        keep &= ~np.where(is_triangle, self._joined(pairs.corner, 1), self._joined(pairs.corner, 2))
        return Near(pairs.corner[keep].astype(np.int64), weights[keep], ways[keep] / gap[keep, None], gap[keep])

    def _joined(self, nodes: np.ndarray, split: int) -> np.ndarray:
        """Whether any of the first ``split`` columns of ``nodes`` (n, 4) is any of the others or next to it."""
        joined = np.zeros(len(nodes), dtype=bool)
        for i in range(split):
            for j in range(split, 4):
                key = nodes[:, i].astype(np.int64) * self.count + nodes[:, j]
                place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
                joined |= self._keys[place] == key
        return joined


@dataclass(frozen=True)
class Settled:
    """The end of a fall: ``nodes`` [m] (N, 3), the number of ``steps``, and the longest move ``move_m`` [m] of a node
    in the last one."""

    nodes: np.ndarray
    steps: int
    move_m: float


class Fall:
    """The simulation of the garment ``design`` on ``mesh``, made of ``fabric``, that falls over the body whose signed
    distance is ``skin``. The nodes ``held`` (n,) stay where they are; nothing else but the body holds it up."""

    def __init__(
        self, design: Design, mesh: PatternMesh, fabric: Fabric, skin: SignedDistance, *, held: np.ndarray | None = None
    ) -> None:
        self.model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, fixed=held)
        self.model.rest_angle = torch.from_numpy(seam_angles(design, mesh, self.model))
        soft = fabric.softened(SOFTEST_N_PER_M)
        parameters = self.model.parameters(mesh.rest, Material.of(soft).woven)
        self.parameters: Parameters = parameters._replace(
            bending_j=torch.from_numpy(hinge_bending(design, mesh, self.model, fabric))
        )
        self.contact = SkinContact(skin, friction=fabric.friction, gap_m=SKIN_GAP_M)
        edges = meshes.edge_lengths(mesh.rest, meshes.unique_edges(mesh.panel_faces))
        self.cloth = SelfContact(mesh.faces, self.model.fixed, thickness_m=LAYERS_SHARE * float(edges.mean()))

    def run(self, nodes: np.ndarray, *, steps: int, still_m: float, kept: float = FALLING) -> Settled:
        """Lets the garment fall from ``nodes`` [m] (N, 3), and returns where it is when no node moves more than
        ``still_m`` [m] in a step, or after ``steps``.

        ``kept`` is the share of a step's speed that the next begins with.
        """
        state, move, number = self.model.state(nodes), np.inf, 0
        longest_m = MOVE_SHARE * self.cloth.thickness_m
        while number < steps and move > still_m:
            progress.tick(f"falling, step {number + 1} of {steps}, {1e3 * move:.1f} mm in the last")
            number += 1
            pairs = self.cloth.springs(state.x.numpy())
            state, move = damped_step(
                self.model, state, self.parameters, self.contact, kept=kept, longest_m=longest_m, pairs=pairs
            )
        return Settled(state.x.numpy(), number, move)


# --- hems and folded seams -------------------------------------------------------------------------------------------


def hinge_bending(design: Design, mesh: PatternMesh, model: ClothModel, fabric: Fabric) -> np.ndarray:
    """Returns the bending rigidity [J] (H,) of the hinges of ``model``, which follows from their direction to the
    grain; at a seam it is the mean of both panels.

    Hems and bound openings are ``HEM_BENDING`` times as stiff.
    """
    edges = _hinge_edges(mesh, model)
    rigidity = np.mean([hinge_rigidity(fabric, bending_angle(edge)) for edge in edges], axis=0)
    names = [panel.name for panel in mesh.pattern.panels]
    lines = [(names.index(ref.panel), mesh.rest[mesh.edge_vertices[ref]]) for ref in design.hems]
    near_hem = near_lines(mesh.rest, mesh.panel, lines, HEM_M)
    turned = mesh.nodes_from(near_hem[:, None].astype(float))[:, 0] > 0.5
    return rigidity * np.where(turned[model.hinge_nodes[:, :2]].all(axis=1), HEM_BENDING, 1.0)


def seam_angles(design: Design, mesh: PatternMesh, model: ClothModel) -> np.ndarray:
    """Returns the angle at rest [rad] (H,) of every hinge of ``model``: zero but at seams that ``design`` folds."""
    angles = np.zeros(len(model.hinge_nodes))
    for number, name in enumerate(design.seam_names):
        if name in design.seam_angles:
            on_seam = np.zeros(mesh.node_count, dtype=bool)
            on_seam[mesh.node_of_panel_vertex[mesh.seam_pairs[mesh.seam_of_pair == number]]] = True
            angles[on_seam[model.hinge_nodes[:, :2]].all(axis=1)] = design.seam_angles[name]
    return angles


def _hinge_edges(mesh: PatternMesh, model: ClothModel) -> list[np.ndarray]:
    """Rest edges [m] (H, 2) of the hinges, as the panel on each side has them."""
    sides = meshes.hinge_faces(mesh.faces)
    edges = []
    for side in range(2):
        faces, panel = mesh.faces[sides[:, side]], mesh.panel_faces[sides[:, side]]
        ends = [(faces == model.hinge_nodes[:, k, None]).argmax(axis=1) for k in range(2)]
        rows = np.arange(len(faces))
        edges.append(mesh.rest[panel[rows, ends[1]]] - mesh.rest[panel[rows, ends[0]]])
    return edges
