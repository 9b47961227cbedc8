"""Lets a sewn garment fall and come to rest on a body: damped implicit steps with friction and self-contact.

``recovery.drape.settle`` finds a drape without friction, which a loss can be differentiated at. Here friction keeps the
folds with which the garment fell: the result depends on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from drape.cloth.fabric import Fabric, bending_angle, hinge_rigidity
from drape.cloth.material import Material
from drape.garment.sewing import near_lines
from drape.geometry import meshes
from recovery import progress
from recovery.pattern.design import Design
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters
from recovery.sim.linearised import damped_step
from recovery.sim.sdf import SignedDistance
from recovery.sim.self_contact import SelfContact
from recovery.sim.skin_contact import SkinContact

SOFTEST_N_PER_M = 400.0  # woven cloth is softened to this: its weight stretches it by less than 0.5 %
HEM_M = 0.02  # turned up this far
HEM_BENDING = 2.0  # two layers that slide on each other
SKIN_GAP_M = 0.0075  # beyond what intake keeps garments off the skin by
LAYERS_SHARE = 0.4  # of the mean edge: layers of cloth stay this far apart
FALLING, SETTLING = 0.9, 0.5  # share of one step's speed that is kept in the next: air and yarns, and more of it
MOVE_SHARE = 0.6  # of that distance in one step at most: two layers that meet must not pass


@dataclass(frozen=True)
class Settled:
    """Nodes [m] (N, 3) at rest after ``steps``; ``move_m`` is the longest move of the last one."""

    nodes: np.ndarray
    steps: int
    move_m: float


class Fall:
    """A fall of the garment ``design`` on ``mesh``, made of ``fabric``, over the body whose signed distance is
    ``skin``. The body alone holds it up; the nodes ``held`` (n,) stay where they are."""

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
        """Falls from ``nodes`` [m] (N, 3) until no node moves more than ``still_m`` in a step, or for ``steps``.

        ``kept`` is the share of a step's speed that the next begins with.
        """
        state = self.model.state(nodes)
        move = np.inf
        number = 0
        while number < steps and move > still_m:
            progress.tick(f"falling, step {number + 1} of {steps}, {1e3 * move:.1f} mm in the last")
            number += 1
            state, move = self._step(state, kept)
        return Settled(state.x.numpy(), number, move)

    def _step(self, state: ClothState, kept: float) -> tuple[ClothState, float]:
        return damped_step(
            self.model,
            state,
            self.parameters,
            self.contact,
            kept=kept,
            longest_m=MOVE_SHARE * self.cloth.thickness_m,
            pairs=self.cloth.springs(state.x.numpy()),
        )


# --- hems and folded seams -------------------------------------------------------------------------------------------


def hinge_bending(design: Design, mesh: PatternMesh, model: ClothModel, fabric: Fabric) -> np.ndarray:
    """Rigidity [J] (H,) of the hinges by their direction to the grain; hems and bound openings count twice.

    At a seam the mean of both panels.
    """
    edges = _hinge_edges(mesh, model)
    rigidity = np.mean([hinge_rigidity(fabric, bending_angle(edge)) for edge in edges], axis=0)
    names = [panel.name for panel in mesh.pattern.panels]
    lines = [(names.index(ref.panel), mesh.rest[mesh.edge_vertices[ref]]) for ref in design.hems]
    near_hem = near_lines(mesh.rest, mesh.panel, lines, HEM_M)
    turned = mesh.nodes_from(near_hem[:, None].astype(float))[:, 0] > 0.5
    return rigidity * np.where(turned[model.hinge_nodes[:, :2]].all(axis=1), HEM_BENDING, 1.0)


def seam_angles(design: Design, mesh: PatternMesh, model: ClothModel) -> np.ndarray:
    """Angle [rad] (H,) of every hinge at rest: zero except at folded seams."""
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
