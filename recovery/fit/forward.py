"""The drape at rest as a differentiable function of the panels, from the shape of a nearby pattern."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from drape.cloth.orthotropic import OrthotropicMaterial
from recovery.pattern.mesh import PatternMesh
from recovery.sim.contact import SkinContact
from recovery.sim.model import ClothModel, ClothState
from recovery.sim.newton import Report, equilibrium
from recovery.sim.sdf import SignedDistance

TOLERANCE_N = 1e-6  # a node weighs about 1e-3 N
ITERATION_LIMIT = 60


class RestDrape:
    """The garment of ``mesh`` at rest on ``body``; ``held`` nodes stay where they are.

    Without friction, so the shape depends on the panels and not on the way there, as long as it stays in one basin.
    """

    def __init__(
        self,
        mesh: PatternMesh,
        body: SignedDistance,
        cloth: OrthotropicMaterial,
        *,
        held: np.ndarray | None = None,
        tolerance_n: float = TOLERANCE_N,
        iteration_limit: int = ITERATION_LIMIT,
    ) -> None:
        self.model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, fixed=held)
        self.contact = SkinContact(body, friction=0.0)
        self.parameters = self.model.parameters(mesh.rest, cloth)
        self.tolerance_n, self.iteration_limit = tolerance_n, iteration_limit

    def __call__(self, rest: Tensor, near: np.ndarray) -> tuple[Tensor, Report]:
        """Nodes [m] (N, 3) for panel vertices ``rest`` [m] (P, 2), sought from ``near`` (N, 3), and how that ended.

        Differentiable by ``rest`` if the report says that it converged.
        """
        x = torch.from_numpy(np.ascontiguousarray(near))
        state, report = equilibrium(
            self.model,
            ClothState(x, torch.zeros_like(x)),
            self.parameters._replace(panels=rest),
            contact=self.contact,
            tolerance_n=self.tolerance_n,
            iteration_limit=self.iteration_limit,
        )
        return state.x, report
