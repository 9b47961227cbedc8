"""Lays a garment on its target by springs and lets it go: for cloth that from flat panels falls into other folds.

A gathered skirt has many drapes at rest, and which one it finds depends on the way. Springs between both surfaces lay
it in the target's folds. Then it is let go as the catalogue's garments come to rest: in short damped steps with
friction. The long steps of ``recovery.drape.settle`` leave the folds.

A search goes on with the springs: Newton's drape of a gather takes hundreds of iterations, and from one pattern to
the next it snaps. Soft springs hold the folds and what the pattern does wrong shows as a distance that they leave. At
a drape that does not move any more the derivative of one implicit step with them is that of the drape.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.cloth.material import OrthotropicMaterial
from drape.geometry import closest, meshes
from recovery import progress
from recovery.drape.pattern_drape import Draped, SewingOptions
from recovery.drape.settle import SettledDrape, to_rest
from recovery.fit.chamfer import surface_distance
from recovery.fit.forward import RestDrape
from recovery.fit.objective import TargetSurface
from recovery.pattern import geometry
from recovery.pattern.pattern_mesh import PatternMesh, on_finer_mesh
from recovery.pattern.sewing_pattern import Pattern
from recovery.sim.cloth_model import ClothState, Parameters
from recovery.sim.implicit import ImplicitProblem, LinearisedStep, SpringForces, damped_step, linearised_step
from recovery.sim.newton_steps import Report, force_left
from recovery.sim.skin_contact import SignedDistance, SkinContact

GATHERED = 0.125  # one edge of a seam longer than the other by more than this share of their mean
EDGE_M = 0.03  # longest edges of cloth that is laid: 5 cm do not hold a gather's folds
HANGS_LONGER = 0.0036  # ``longer`` of ``hanging``: shorter edges fold in cloth that is stiffer by their square
SPRINGS_N_M3 = (*[1000.0] * 30, *[300.0] * 10)  # stiffness in each step that lays a garment; searches keep the last
ACROSS = 0.05  # share of the springs' stiffness across the way to the other surface: cloth slides along it
STEP_S, LONGEST_M = 0.1, 0.03
LAID_M = 2e-4  # root mean square of the moves in a step: cloth that moves less is laid
STEPS = 12  # most implicit steps of one drape in a search
FREE_STEPS, FREE_LONGEST_M, FREE_KEPT = 160, 0.0075, 0.5
STILL_M = 3e-4  # cloth is still if no node moves by more in one of those steps
OTHER_FOLDS_MM = 3.0  # mean distance of two drapes of a pattern: of two meshes in the same folds it is below 2 mm


def laying_options(drape: SewingOptions) -> SewingOptions:
    """Returns the options ``drape`` for cloth that springs will lay on its target: edges of at most ``EDGE_M``, stiffer
    cloth, and no Newton's method, since it need not come to rest before."""
    length = min(EDGE_M, drape.edge_length_m)
    return replace(drape, edge_length_m=length, iteration_limit=0, hangs_longer=HANGS_LONGER)


def is_laid(pattern: Pattern, parts: Sequence[str | None]) -> bool:
    """Returns whether a garment is laid on its target by springs: a seam of ``pattern`` gathers, and one of ``parts``,
    the parts of the body that go through its openings, is an arm."""
    gathers = any(abs(seam.mismatch) > GATHERED for seam in geometry.seams(pattern))
    return gathers and any("arm" in (part or "") for part in parts)


class LaidDrape(RestDrape):
    """The drape of ``mesh`` on ``body``, drawn to the ``target`` by springs, as a function of panel vertices. Nothing
    holds it but the body and the springs."""

    def __init__(
        self, mesh: PatternMesh, body: SignedDistance, cloth: OrthotropicMaterial, target: TargetSurface
    ) -> None:
        super().__init__(mesh, body, cloth)
        self.faces, self.target = mesh.faces, target

    def __call__(self, rest: Tensor, near: np.ndarray) -> tuple[Tensor, Report]:
        """As ``RestDrape``, but for the derivative: that of the last step alone."""
        stiffness = SPRINGS_N_M3[-1]
        x, moved, steps = torch.from_numpy(np.ascontiguousarray(near)), np.inf, 0
        given = self.parameters._replace(panels=rest)
        while moved > LAID_M and steps < STEPS - 1 and not progress.over():
            with torch.no_grad():
                after = self._step(x, given, stiffness)
            moved, steps, x = float((after - x).square().sum(dim=1).mean().sqrt()), steps + 1, after
        return self._step(x, given, stiffness), Report(steps + 1, 0.0, True)

    def begun(self, nodes: np.ndarray) -> np.ndarray:
        """Returns ``nodes`` [m] (N, 3) laid on the target: after one implicit step with each stiffness of
        ``SPRINGS_N_M3``."""
        x = torch.from_numpy(np.ascontiguousarray(nodes))
        with torch.no_grad():
            for number, stiffness in enumerate(SPRINGS_N_M3):
                if progress.over():
                    break
                progress.tick(f"laid on the target, step {number + 1} of {len(SPRINGS_N_M3)}")
                x = self._step(x, self.parameters, stiffness)
        return x.numpy()

    def ended(self, mesh: PatternMesh, nodes: np.ndarray) -> np.ndarray:
        """Returns where the cloth of ``mesh`` lies, [m] (N, 3), after it has fallen from ``nodes`` (N, 3) without
        springs until it is still (``let_fall``)."""
        return let_fall(mesh, nodes, self.contact.body, self.cloth).nodes

    def _step(self, x: Tensor, parameters: Parameters, stiffness: float) -> Tensor:
        pairs = springs_between(x.numpy(), self.faces, self.target, stiffness)
        start = ClothState(x, torch.zeros_like(x))
        after = linearised_step(self.model, start, parameters, dt_s=STEP_S, contact=self.contact, pairs=pairs).x
        size = float((after.detach() - x).norm(dim=1).max())
        return x + min(1.0, LONGEST_M / max(size, 1e-12)) * (after - x)

    def _problem(self, state: ClothState, parameters: Parameters) -> tuple[ImplicitProblem, Tensor, float]:
        pairs = springs_between(state.x.numpy(), self.faces, self.target, SPRINGS_N_M3[-1])
        step = LinearisedStep(self.model, self.contact, dt_s=STEP_S, pairs=pairs)
        return step, torch.zeros_like(state.x), STEP_S  # what is laid does not move


def springs_between(x: np.ndarray, faces: np.ndarray, target: TargetSurface, stiffness: float) -> SpringForces:
    """Returns springs of ``stiffness`` [N/m^3], per area, between cloth at ``x`` [m] (V, 3) and the target, both ways.

    Each node is drawn to the nearest point of the target, and the nearest point of the cloth to the middle of each of
    the target's triangles; faces of the target that close a hole draw nothing.
    """
    there = closest.closest_point(x, target.vertices, target.faces)
    middles = target.vertices[target.faces].mean(axis=1)
    here = closest.closest_point(middles, x, faces)
    nearest = (here.barycentric[:, :, None] * x[faces[here.face]]).sum(axis=1)
    rows = [
        _pulls(
            np.arange(len(x))[:, None],
            np.ones((len(x), 1)),
            there.point - x,
            target.known[there.face] * meshes.vertex_areas(x, faces),
        ),
        _pulls(
            faces[here.face],
            here.barycentric,
            middles - nearest,
            target.known * meshes.face_areas(target.vertices, target.faces),
        ),
    ]
    slopes = scipy.sparse.vstack(
        [scipy.sparse.csr_matrix((v, (r, c)), shape=(len(gap), 3 * len(x))) for v, r, c, gap in rows]
    )
    force = stiffness * (slopes.T @ np.concatenate([gap for *_, gap in rows]))
    return SpringForces(torch.from_numpy(force.reshape(-1, 3)), (stiffness * (slopes.T @ slopes)).tocsc())


def _pulls(
    nodes: np.ndarray, shares: np.ndarray, gap: np.ndarray, area: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Values, rows and columns of the derivatives of weighted gaps, and those gaps (4 n,).

    Gap number i, ``gap`` [m] (n, 3), closes as the ``shares`` (n, q) of ``nodes`` (n, q) go along it, or, with less
    weight, any way. Weights are roots of ``area`` (n,).
    """
    length = np.linalg.norm(gap, axis=1, keepdims=True)
    along = gap / np.maximum(length, 1e-12)
    ways = np.concatenate([along[:, None], np.broadcast_to(np.sqrt(ACROSS) * np.eye(3), (len(gap), 3, 3))], axis=1)
    ways = np.sqrt(area)[:, None, None] * ways  # (n, 4, 3)
    values = ways[:, :, None, :] * shares[:, None, :, None]
    columns = np.broadcast_to((3 * nodes[:, :, None] + np.arange(3))[:, None], values.shape)
    rows = np.repeat(np.arange(4 * len(gap)), values[0, 0].size)
    return values.reshape(-1), rows, columns.reshape(-1), np.einsum("nwc,nc->nw", ways, gap).reshape(-1)


def let_fall(mesh: PatternMesh, nodes: np.ndarray, skin: SignedDistance, cloth: OrthotropicMaterial) -> SettledDrape:
    """Returns the garment after short damped steps with friction from ``nodes`` [m] (N, 3), until no node moves more
    than ``STILL_M`` in one.

    The report says converged if that was reached; the force that it tells is without friction.
    """
    forward = RestDrape(mesh, skin, cloth)
    model, parameters, contact = forward.model, forward.parameters, SkinContact(skin)
    state, move, number = model.state(nodes), np.inf, 0
    while move > STILL_M and number < FREE_STEPS and not progress.over():
        number += 1
        progress.tick(f"let go, step {number}, {1e3 * move:.1f} mm in the last")
        state, move = damped_step(model, state, parameters, contact, kept=FREE_KEPT, longest_m=FREE_LONGEST_M)
    left = force_left(model, state, parameters, forward.contact)
    return SettledDrape(state.x.numpy(), np.zeros(0, dtype=np.int64), Report(0, left, move <= STILL_M), number)


def lay_on_target(draped: Draped, target: TargetSurface, skin: SignedDistance, cloth: OrthotropicMaterial) -> Draped:
    """Returns ``draped`` with its nodes laid on the ``target`` by springs. ``skin`` is the body's signed distance in
    the drape's pose, ``cloth`` the garment's material."""
    return _with_nodes(draped, LaidDrape(draped.mesh, skin, cloth, target).begun(draped.nodes))


class DressedDrape(NamedTuple):
    """A pattern sewn from flat panels: ``loose`` as it comes to rest by itself, ``worn`` as it lies once it is put on
    as the target wears it."""

    loose: Draped
    worn: Draped


class Shown(NamedTuple):
    """A drape that a pattern was recovered with: its ``mesh``, and ``nodes`` [m] (N, 3) in the pose of the target."""

    mesh: PatternMesh
    nodes: np.ndarray

    @property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [m] (N, 3) and faces (F, 3)."""
        return self.nodes, self.mesh.faces


@dataclass(frozen=True, eq=False)
class Dressing:
    """The means by which a garment that was sewn from flat panels is put on as the target wears it.

    ``skin`` is the body's signed distance in the garment's pose, ``cloth`` the garment's material. ``laid`` says
    whether it gathers and is laid on the target. ``hold`` lays a belt on the target's waist. ``lost`` returns the parts
    of the body that are beside their opening. Where there are two ways to put the garment on, the drape with the lower
    ``rank`` is taken.
    """

    skin: SignedDistance
    cloth: OrthotropicMaterial
    laid: bool
    hold: Callable[[Draped], Draped]
    lost: Callable[[Draped], Sequence[str]]
    rank: Callable[[Draped], Any]

    def worn_as(self, loose: Draped, shown: Shown) -> Draped:
        """Returns the drape ``loose`` put on as the target wears it: with its belt laid on the target's waist.

        A garment without a belt is hung in the folds of ``shown``, a drape of the same pattern, if it gathers, or if it
        fell into other folds by itself.
        """
        if self.laid:
            return hung_as(loose, shown, self.skin, self.cloth)
        belt = bool(len(loose.rest.held))
        worn = put_on(loose, shown, self.hold) if belt and self.lost(loose) else self.hold(loose)
        if belt or not (in_other_folds(worn, shown) or self.lost(worn) or not worn.at_rest):
            return worn
        return min((worn, hung_at_rest(loose, shown, self.skin, self.cloth)), key=self.rank)


def hung_as(draped: Draped, shown: Shown, skin: SignedDistance, cloth: OrthotropicMaterial) -> Draped:
    """Returns ``draped`` put where ``shown`` lies, a drape of the same pattern on another mesh, and fallen from there
    until it is still (``let_fall``)."""
    return let_go(_placed_as(draped, shown), skin, cloth)


def hung_at_rest(draped: Draped, shown: Shown, skin: SignedDistance, cloth: OrthotropicMaterial) -> Draped:
    """Returns ``draped`` put where ``shown`` lies, a drape of the same pattern on another mesh, fallen from there
    (``let_fall``), and brought to rest without friction, as garments are that do not gather."""
    hung, forward = hung_as(draped, shown, skin, cloth), RestDrape(draped.mesh, skin, cloth)
    state, report = to_rest(forward.model, forward.model.state(hung.nodes), forward.parameters, forward.contact)
    return _lying(hung, SettledDrape(state.x.numpy(), draped.rest.held, report, 0))


def put_on(draped: Draped, shown: Shown, hold: Callable[[Draped], Draped]) -> Draped:
    """Returns ``draped`` put where ``shown`` lies, a drape of the same pattern on another mesh, with its belt laid by
    ``hold``. Where ``hold`` changes nothing there, ``draped`` itself is returned."""
    placed = _placed_as(draped, shown)
    worn = hold(placed)
    return draped if worn is placed else worn


def in_other_folds(draped: Draped, shown: Shown) -> bool:
    """Returns whether no belt holds ``draped`` and it lies elsewhere than ``shown``, a drape of the same pattern on
    another mesh: more than ``OTHER_FOLDS_MM`` apart on average."""
    far = surface_distance(draped.surface, shown.surface)
    return not len(draped.rest.held) and far.mean_mm > OTHER_FOLDS_MM


def _placed_as(draped: Draped, shown: Shown) -> Draped:
    return _with_nodes(draped, on_finer_mesh(shown.mesh, shown.nodes, draped.mesh))


def let_go(draped: Draped, skin: SignedDistance, cloth: OrthotropicMaterial) -> Draped:
    """Returns ``draped`` after it has fallen from where it lies until it is still (``let_fall``). ``skin`` is the
    body's signed distance in its pose."""
    return _lying(draped, let_fall(draped.mesh, draped.nodes, skin, cloth))


def _with_nodes(draped: Draped, nodes: np.ndarray) -> Draped:
    return _lying(draped, (draped.posed or draped.rest)._replace(nodes=nodes))


def _lying(draped: Draped, drape: SettledDrape) -> Draped:
    """``draped`` with this drape in the pose that was asked for."""
    return replace(draped, rest=drape) if draped.posed is None else replace(draped, posed=drape)
