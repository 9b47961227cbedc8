"""The drape at rest as a differentiable function of panels, from the shape of a nearby pattern."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from drape.cloth.material import OrthotropicMaterial
from recovery.fit.belt import Belt
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters
from recovery.sim.implicit import ImplicitProblem
from recovery.sim.newton_steps import Minimum, Report, equilibrium
from recovery.sim.sdf import SignedDistance
from recovery.sim.skin_contact import SkinContact

TOLERANCE_N = 1e-6  # a node weighs about 1e-3 N
ITERATION_LIMIT = 60


class RestDrape:
    """The garment of ``mesh`` at rest on ``body``; ``held`` nodes stay where they are, those of a ``belt`` go with it.

    Without friction, so the shape depends on the panels and not on the way there, as long as it stays in one basin.
    ``drapes`` counts how often it was asked for one.
    """

    def __init__(
        self,
        mesh: PatternMesh,
        body: SignedDistance,
        cloth: OrthotropicMaterial,
        *,
        held: np.ndarray | None = None,
        belt: Belt | None = None,
        tolerance_n: float = TOLERANCE_N,
        iteration_limit: int = ITERATION_LIMIT,
    ) -> None:
        self.belt = belt
        self.model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, fixed=held if belt is None else belt.held)
        self.contact = SkinContact(body, friction=0.0)
        self.cloth = cloth
        self.parameters = self.model.parameters(mesh.rest, cloth)
        self.tolerance_n, self.iteration_limit = tolerance_n, iteration_limit
        self.drapes = 0

    def __call__(self, rest: Tensor, near: np.ndarray) -> tuple[Tensor, Report]:
        """Nodes [m] (N, 3) for panel vertices ``rest`` [m] (P, 2), sought from ``near`` (N, 3), and how that ended.

        Differentiable by ``rest`` if the report says that it converged.
        """
        self.drapes += 1
        x = self._laid(torch.from_numpy(np.ascontiguousarray(near)), rest)
        state, report = equilibrium(
            self.model,
            ClothState(x, torch.zeros_like(x)),
            self.parameters._replace(panels=rest),
            contact=self.contact,
            tolerance_n=self.tolerance_n,
            iteration_limit=self.iteration_limit,
        )
        return state.x, report

    def begun(self, nodes: np.ndarray) -> np.ndarray:
        """Returns the nodes [m] (N, 3) at which a search begins, from the drape ``nodes`` (N, 3)."""
        return nodes

    def ended(self, mesh: PatternMesh, nodes: np.ndarray) -> np.ndarray:
        """Returns the drape [m] (N, 3) of ``mesh``, which a search has left at ``nodes`` (N, 3)."""
        return nodes

    def sensitivity(self, rest: Tensor, nodes: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3, Z) of the drape ``nodes`` [m] (N, 3) along ``moves`` (P, 2, Z) of the panel vertices.

        One factorisation for all of them: the adjoint's scalar is linear in its weights, so that its derivative by them
        is the right side of a direction.
        """
        x = torch.from_numpy(np.ascontiguousarray(nodes))
        state = ClothState(x, torch.zeros_like(x))
        at = self.parameters._replace(panels=rest.detach())
        problem, solution, per_s = self._problem(state, at)
        factor = problem.factor(solution, state, at)
        held = self._held_moves(at.panels, nodes, moves)
        with torch.enable_grad():
            leaves = [leaf.clone().requires_grad_(True) for leaf in (x, at.panels)]
            weights = torch.zeros_like(x).requires_grad_(True)
            parameters = at._replace(panels=leaves[1])
            scalar = problem.adjoint(weights, solution, ClothState(leaves[0], state.v), parameters)
            slopes = torch.autograd.grad(scalar, leaves, create_graph=True)
            columns = []
            for k in range(moves.shape[2]):
                parts = [torch.from_numpy(np.ascontiguousarray(part[:, :, k])) for part in (held, moves)]
                along = torch.stack([(slope * part).sum() for slope, part in zip(slopes, parts, strict=True)]).sum()
                (right,) = torch.autograd.grad(along, weights, retain_graph=True)
                found = factor.solve(np.ascontiguousarray((problem.free * right).numpy()).reshape(-1))
                columns.append(per_s * found + held[:, :, k].reshape(-1))
        return np.stack(columns, axis=1).reshape(len(nodes), 3, -1)

    def _problem(self, state: ClothState, parameters: Parameters) -> tuple[ImplicitProblem, Tensor, float]:
        """The equations of the drape at ``state``, their solution, and nodes [m] for one unit of it."""
        problem = Minimum(self.model, self.contact, dt_s=None, tolerance_n=self.tolerance_n, iteration_limit=0)
        return problem, problem.solve(state, parameters), 1.0

    def _laid(self, x: Tensor, rest: Tensor) -> Tensor:
        """``x`` with the nodes of the belt where they belong for ``rest``."""
        if self.belt is None:
            return x
        return x.index_copy(0, torch.from_numpy(self.belt.held), self.belt.places(rest))

    def _held_moves(self, rest: Tensor, nodes: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3, Z) of the nodes that the belt holds along ``moves``; zero at the others."""
        held = np.zeros((*nodes.shape, moves.shape[2]))
        if self.belt is not None:
            slopes = torch.autograd.functional.jacobian(self.belt.places, rest)
            held[self.belt.held] = np.einsum("hcpd,pdz->hcz", slopes.numpy(), moves)  # type: ignore[union-attr]
        return held
