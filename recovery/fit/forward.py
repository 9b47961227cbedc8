"""The drape at rest as a differentiable function of panels, from the shape of a nearby pattern; the belt it hangs from.

The waist of a drape is laid on that of its target, which shows where the wearer's belt is. Without friction a belt
closes at the height where the body is as wide as the waist of the pattern. On hips that widen by a millimetre a
centimetre, or in another simulator, that is centimetres off. A search that may not move the belt makes up for it with
the lengths of the panels.

Along the waist each piece takes the share that its edge has of the pattern's waist, as it is sewn to a waistband. Nodes
that stayed where they were while a search changes the pattern would stretch one piece's edge and squeeze another's,
and what is sewn of it hangs otherwise.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.cloth.material import OrthotropicMaterial
from drape.garment.contours import Contour, Match, open_contours
from drape.geometry import meshes
from recovery.drape.pattern_drape import Draped
from recovery.drape.settle import settle_at_rest
from recovery.fit.objective import nearest_on_line
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters
from recovery.sim.implicit import ImplicitProblem
from recovery.sim.newton_steps import Minimum, Report, equilibrium
from recovery.sim.skin_contact import SignedDistance, SkinContact

TOLERANCE_N = 1e-6  # a node weighs about 1e-3 N
ITERATION_LIMIT = 60


class Belt(NamedTuple):
    """A belt on the closed ``line`` [m] (m, 3): the nodes ``held`` (H,) by it, in their order along the pattern's
    waist.

    ``edges`` (H, 2) are the panel vertices at the ends of the edge from each node to the next. The nodes follow the
    line in ``direction`` (1 or -1). Their lengths along it, from its first point, are ``origin_m`` [m] on average.
    """

    held: np.ndarray
    edges: np.ndarray
    line: Tensor
    direction: float
    origin_m: float

    def places(self, rest: Tensor) -> Tensor:
        """Returns the positions [m] (H, 3) of the held nodes for panel vertices ``rest`` [m] (P, 2), differentiable by
        these."""
        way = torch.roll(self.line, -1, dims=0) - self.line
        length = torch.linalg.vector_norm(way, dim=1)
        ends = torch.cumsum(length, dim=0)
        at = torch.remainder(self.origin_m + self.direction * ends[-1] * self._shares(rest), ends[-1])
        segment = torch.clamp(torch.searchsorted(ends, at.detach(), right=True), max=len(ends) - 1)
        share = (at - ends[segment] + length[segment]) / torch.clamp(length[segment], min=1e-12)
        return self.line[segment] + share[:, None] * way[segment]

    def _shares(self, rest: Tensor) -> Tensor:
        """The way (H,) along the pattern's waist, 1 for all of it, from the nodes' mean to each."""
        length = torch.linalg.vector_norm(rest[self.edges[:, 1]] - rest[self.edges[:, 0]], dim=1)
        way = torch.cumsum(length, dim=0) - length
        return (way - way.mean()) / length.sum()


def belt_on(mesh: PatternMesh, nodes: np.ndarray, held: np.ndarray, line: np.ndarray) -> Belt | None:
    """Returns the belt of the nodes ``held`` (H,) of ``mesh`` at ``nodes`` [m] (N, 3), laid on the closed ``line`` [m]
    (m, 3).

    Along the line each node keeps its share of the pattern's waist. All are shifted until they lie, on average, at the
    points of the line nearest to them. None if they are not a whole border, or do not go round the line once.
    """
    loop = next((loop for loop in meshes.boundary_loops(mesh.faces) if set(loop) == set(held)), None)
    if loop is None:
        return None
    halves = zip(meshes.half_edges(mesh.faces)[:, :2], meshes.half_edges(mesh.panel_faces)[:, :2], strict=True)
    panels = {frozenset(ends.tolist()): (ends, vertices) for ends, vertices in halves}
    edges = []
    for start, end in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
        ends, vertices = panels[frozenset((start, end))]
        edges.append(vertices if ends[0] == start else vertices[::-1])
    waist = torch.from_numpy(line)
    best, t = (part.numpy() for part in nearest_on_line(torch.from_numpy(nodes[loop]), waist))
    length = np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1)
    total = float(length.sum())
    at = np.cumsum(length)[best] - (1.0 - t) * length[best]
    steps = (np.roll(at, -1) - at + 0.5 * total) % total - 0.5 * total
    if round(abs(float(steps.sum())) / total) != 1:
        return None
    along = at[0] + np.concatenate([[0.0], np.cumsum(steps[:-1])])
    return Belt(loop, np.array(edges), waist, float(np.sign(steps.sum())), float(along.mean()))


def belt_of(draped: Draped, matches: list[Match], there: list[Contour]) -> Belt | None:
    """Returns the belt that ``draped`` hangs from, laid on the contour of the target that its border is matched with;
    None without a belt or a match.

    ``there`` are the target's contours; ``matches`` pair those of the drape with them.
    """
    waists = _waist(draped, matches, there)
    return None if waists is None else belt_on(draped.mesh, draped.nodes, draped.rest.held, waists[1].points)


def hold_as_target(
    draped: Draped, matches: list[Match], there: list[Contour], skin: SignedDistance, cloth: OrthotropicMaterial
) -> Draped:
    """Returns ``draped`` with the nodes that its belt holds laid on the waist of the target, and the others settled.

    ``there`` are the target's contours; ``matches`` pair those of the drape with them. The whole garment is first
    moved, so that both waists have one centre. Then the held nodes are laid on the target's waist as by ``belt_on``,
    or where that gives None, each at the nearest point. The others settle round ``skin``, the body's distance in the
    drape's pose. Returns ``draped`` itself without a belt or a match, or if the garment does not come to rest so.
    """
    waists = _waist(draped, matches, there)
    if waists is None:
        return draped
    own, theirs = waists
    held, line = draped.rest.held, theirs.points
    nodes = draped.nodes + (theirs.centre - own.centre)
    belt = belt_on(draped.mesh, nodes, held, line)
    if belt is None:
        best, t = (part.numpy() for part in nearest_on_line(torch.from_numpy(nodes[held]), torch.from_numpy(line)))
        nodes[held] = line[best] + t[:, None] * (np.roll(line, -1, axis=0) - line)[best]
    else:
        nodes[belt.held] = belt.places(torch.from_numpy(draped.mesh.rest)).numpy()
    settled = settle_at_rest(draped.mesh, nodes, skin, cloth, held=held)
    if not settled.report.converged:
        return draped
    return replace(draped, rest=settled) if draped.posed is None else replace(draped, posed=settled)


def _waist(draped: Draped, matches: list[Match], there: list[Contour]) -> tuple[Contour, Contour] | None:
    """The contour that the belt of ``draped`` holds, and its match; None without a belt or a match."""
    held = draped.rest.held
    if not len(held):
        return None
    own = open_contours(*draped.surface)
    match = next((match for match in matches if np.isin(held, own[match.source].loop).all()), None)
    return None if match is None else (own[match.source], there[match.target])


class RestDrape:
    """The drape at rest of ``mesh`` on ``body``, as a function that gives the nodes [m] (N, 3) for panel vertices [m]
    (P, 2). The nodes ``held`` (n,) stay where they are. With a ``belt`` they are those that it holds, and they lie at
    ``Belt.places``.

    There is no friction, so the shape depends on the panels and not on the way there, as long as it stays in one basin.
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

    def __call__(self, rest: Tensor, near: np.ndarray) -> tuple[Tensor, Report]:
        """Nodes [m] (N, 3) for panel vertices ``rest`` [m] (P, 2), sought from ``near`` (N, 3), and how that ended.

        Differentiable by ``rest`` if the report says that it converged.
        """
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
        """Returns the nodes [m] (N, 3) at which a search from a drape at ``nodes`` (N, 3) begins: the same."""
        return nodes

    def ended(self, mesh: PatternMesh, nodes: np.ndarray) -> np.ndarray:
        """Returns the nodes [m] (N, 3) of ``mesh`` that a search ending at ``nodes`` (N, 3) gives: the same."""
        return nodes

    def sensitivity(self, rest: Tensor, nodes: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """Returns the derivatives (N, 3, Z) of the drape at ``nodes`` [m] (N, 3) along Z ``moves`` (P, 2, Z) of the
        panel vertices ``rest`` [m] (P, 2).

        One factorisation serves all moves. What ``ImplicitProblem.adjoint`` returns is linear in its weights, so its
        derivative by them gives the right side for each move.
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
                column = factor.solve(np.ascontiguousarray((problem.free * right).numpy()).reshape(-1))
                columns.append(per_s * column + held[:, :, k].reshape(-1))
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
