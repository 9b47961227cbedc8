"""Lets a sewn garment come to rest on a body: quasi-static implicit steps, then Newton to a residual.

Nothing in Newton's problem holds a triangle that is squeezed flat, in an armpit for one, so it can end in a collapsed
triangle. If Newton fails, implicit steps, each solved by Newton, go before it: the inertia of a short step holds every
node, and each longer step lets it go further.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch

from drape.cloth.material import OrthotropicMaterial
from drape.errors import InputError
from drape.geometry import meshes
from recovery import progress
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters
from recovery.sim.implicit import linearised_step
from recovery.sim.newton_steps import Report, equilibrium, newton_step
from recovery.sim.skin_contact import SignedDistance, SkinContact

TOLERANCE_N = 1e-5  # a node weighs about 1e-3 N
ITERATION_LIMIT = 150  # most steps of Newton's method for the drape
PATIENT_DT_S = (0.05, 0.1, 0.2, 0.4, *[0.8] * 8)  # of implicit steps, where Newton's method alone does not arrive
PATIENT_LIMIT = 60  # most steps of Newton's method in one of them
PATIENT_TOLERANCE = 10.0  # times the drape's tolerance: such a step is solved to that, and the steps end there
FIRST_DT_S, LAST_DT_S = 0.02, 0.3
STEP_LIMIT = 120
LONGEST_MOVE_M = 0.03
# Largest distance [m] between the shapes before and after two steps at which the rest is left to Newton. Two, because
# the linearised repulsion throws nodes off the skin in one step and drops them in the next, by about its gap, for ever.
SETTLED_M = 1e-3
BELT_BAND_M = 0.06  # a belt holds the topmost opening from its highest node down to this


class SettledDrape(NamedTuple):
    """A garment at rest: ``nodes`` [m] (N, 3), those ``held`` (n,) by a belt, the ``report`` of Newton's method, and
    the number of quasi-static ``steps`` before it."""

    nodes: np.ndarray
    held: np.ndarray
    report: Report
    steps: int


def topmost_opening(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Returns the numbers (n,), sorted, of the nodes that a waistband or an elastic holds; empty for a closed mesh.

    Of all borders of the garment the one with the greatest mean height is taken. Its nodes that lie less than
    ``BELT_BAND_M`` below its own highest node are held. ``faces`` (F, 3), ``nodes`` [m] (N, 3), y up.
    """
    loops = meshes.boundary_loops(faces)
    if not loops:
        return np.zeros(0, dtype=np.int64)
    loop = max(loops, key=lambda nodes_of: float(nodes[nodes_of, 1].mean()))
    height = nodes[loop, 1]
    return np.sort(loop[height > height.max() - BELT_BAND_M])


def settle_at_rest(
    mesh: PatternMesh,
    nodes: np.ndarray,
    body: SignedDistance,
    cloth: OrthotropicMaterial,
    *,
    held: np.ndarray | Literal["belt"] | None = None,
    lowest_top_m: float = -np.inf,
    iteration_limit: int = ITERATION_LIMIT,
) -> SettledDrape:
    """Returns the garment at rest under its weight, from sewn ``nodes`` [m] (N, 3) near it, without friction.

    ``held`` are numbers (n,) of nodes that stay where they are, None for none. With "belt" the garment first closes
    round the body without weight, and then its ``topmost_opening`` is held there. ``iteration_limit`` is that of
    Newton's method; with 0 only the quasi-static steps are made. The report says converged if no node is left with a
    force above ``TOLERANCE_N``. Raises ``InputError`` for a garment that fell off: its highest node ends below the
    height ``lowest_top_m`` [m].
    """
    contact = SkinContact(body, friction=0.0)
    steps = 0
    if isinstance(held, str):
        model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, gravity_m_s2=0.0)
        nodes, steps = _quasi_static(model, model.parameters(mesh.rest, cloth), nodes, contact, STEP_LIMIT // 3)
        held = topmost_opening(mesh.faces, nodes)
    held = np.zeros(0, dtype=np.int64) if held is None else held
    model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, fixed=held)
    parameters = model.parameters(mesh.rest, cloth)
    start = nodes
    nodes, more = _quasi_static(model, parameters, nodes, contact, STEP_LIMIT)
    if (top := float(nodes[:, 1].max())) < lowest_top_m:
        raise InputError(
            "garment",
            expected="one that stays up",
            got=f"one that slid down by {100 * (float(start[:, 1].max()) - top):.0f} cm",
            cure="Give it a belt (--hold belt) or a smaller size (--scale).",
        )
    state, report = to_rest(model, model.state(nodes), parameters, contact, iteration_limit=iteration_limit)
    return SettledDrape(state.x.numpy(), held, report, steps + more)


def to_rest(
    model: ClothModel,
    start: ClothState,
    parameters: Parameters,
    contact: SkinContact,
    tolerance_n: float = TOLERANCE_N,
    iteration_limit: int = ITERATION_LIMIT,
) -> tuple[ClothState, Report]:
    """Returns the drape at rest near ``start``, and how the search for it ended. If none is found, the shape on the way
    with the least force is returned.

    Newton's method runs first. If it fails, implicit steps from rest and Newton's method again follow. The report
    counts the iterations of all.
    """
    total = 0

    def drape(state: ClothState, limit: int) -> tuple[ClothState, Report]:
        nonlocal total
        settled, report = equilibrium(
            model, state, parameters, contact=contact, tolerance_n=tolerance_n, iteration_limit=limit
        )
        total += report.iterations
        return settled, report

    drapes = [drape(start, iteration_limit)]
    if not drapes[0][1].converged:
        drapes.append(drape(start, 0))
        state = start
        for dt in PATIENT_DT_S:
            if progress.over():
                break
            state, step = newton_step(
                model,
                ClothState(state.x, torch.zeros_like(state.x)),
                parameters,
                dt_s=dt,
                contact=contact,
                tolerance_n=PATIENT_TOLERANCE * tolerance_n,
                iteration_limit=min(PATIENT_LIMIT, iteration_limit),
            )
            total += step.iterations
            drapes.append(drape(state, 0))
            if drapes[-1][1].residual_n <= PATIENT_TOLERANCE * tolerance_n:
                break
        drapes.append(drape(state, iteration_limit))
    state, report = min(drapes, key=lambda pair: pair[1].residual_n)
    return state, report._replace(iterations=total)


def _quasi_static(
    model: ClothModel, parameters: Parameters, nodes: np.ndarray, contact: SkinContact, limit: int
) -> tuple[np.ndarray, int]:
    """Nodes [m] (N, 3) after at most ``limit`` implicit steps, and how many there were.

    Each starts from rest, so that nothing swings; steps grow while the cloth does not have to be slowed down. They end
    when two steps of the last size change nothing.
    """
    dt, x = FIRST_DT_S, torch.tensor(nodes)
    before = x  # a step earlier than x
    for number in range(1, limit + 1):
        if progress.over():
            return x.numpy(), number - 1
        progress.tick(f"quasi-static step {number}")
        with torch.no_grad():
            after = linearised_step(model, ClothState(x, torch.zeros_like(x)), parameters, dt_s=dt, contact=contact).x
            size = float((after - x).norm(dim=1).max())
            after = x + min(1.0, LONGEST_MOVE_M / max(size, 1e-12)) * (after - x)
            change = float((after - before).norm(dim=1).max())
        before, x = x, after
        if dt >= LAST_DT_S and change < SETTLED_M:
            return x.numpy(), number
        if size < LONGEST_MOVE_M:
            dt = min(1.3 * dt, LAST_DT_S)
    return x.numpy(), limit
