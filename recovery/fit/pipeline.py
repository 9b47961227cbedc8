"""A base pattern and a draped target in, the target's pattern out: draped, graded, draped again, optimised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.material import material
from drape.cloth.orthotropic import OrthotropicMaterial
from drape.errors import InputError
from recovery.drape.pipeline import Draped, DrapeOptions, drape_pattern
from recovery.fit.contours import Match, match_contours, open_contours
from recovery.fit.forward import RestDrape
from recovery.fit.grading import Graded, grade
from recovery.fit.objective import DEFAULT_WEIGHTS, Objective, Target, Weights
from recovery.fit.optimise import DEFAULT_OPTIONS, FitOptions, Fitted, PatternSearch
from recovery.pattern.model import Pattern
from recovery.pattern.symmetry import Symmetries, find_symmetries, free_controls, symmetrised
from recovery.sim.sdf import GridDistance

DEFAULT_DRAPE = DrapeOptions()


@dataclass(frozen=True, eq=False)
class Recovered:
    """A recovery: what the base and the graded pattern draped to, the ``graded`` pattern, and what was ``fitted``.

    ``matches`` pair the graded drape's contours with the target's; ``holes`` are contours of the target that are left.
    ``search`` holds what was searched with: mesh, free numbers, simulator, loss.
    """

    symmetries: Symmetries
    base: Draped
    graded: Graded
    start: Draped
    matches: list[Match]
    holes: list[int]
    search: PatternSearch
    fitted: Fitted


def recover_pattern(
    vertices: np.ndarray,
    faces: np.ndarray,
    base: Pattern,
    body: BodyModel,
    *,
    drape: DrapeOptions = DEFAULT_DRAPE,
    fit: FitOptions = DEFAULT_OPTIONS,
    weights: Weights = DEFAULT_WEIGHTS,
    pose: np.ndarray | None = None,
    state_file: Path | None = None,
    progress: bool = False,
    report: Callable[[str], None] | None = None,
) -> Recovered:
    """The pattern whose drape on ``body`` is nearest to a target, in the T-pose or in ``pose`` (24, 3).

    The target, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), is one garment's surface, open where the garment is;
    ``base`` is a pattern of its kind with the same panels. Raises ``InputError`` where contours have no counterpart or
    a drape does not come to rest.
    """
    say = report or (lambda line: None)
    contours_there = open_contours(vertices, faces)
    symmetries = find_symmetries(base)
    base = symmetrised(base, symmetries)
    for line in symmetries.describe(base):
        say(f"symmetry  {line}")
    joints = body.joints_template if pose is None else posed_joints(body, pose)
    first = drape_pattern(base, body, drape, pose=pose)
    contours = open_contours(first.nodes, first.mesh.faces)
    matches, _ = match_contours(contours, contours_there, joints)
    graded = grade(first.mesh, first.nodes, contours, matches, symmetries)
    say(
        f"graded    widths times {graded.widths.min():.3f} to {graded.widths.max():.3f}, heights "
        f"{graded.heights.min():.3f} to {graded.heights.max():.3f}; misfit {100 * graded.misfit:.1f} %"
    )
    start = drape_pattern(graded.pattern, body, drape, pose=pose)
    if not start.at_rest:
        drapes = [one for one in (start.rest, start.posed) if one is not None]
        raise InputError(
            "graded pattern",
            expected="a drape at rest to start from",
            got=f"{max(one.report.residual_n for one in drapes):.1e} N left at a node",
            cure="Take another mesh (edge_length_m), more iterations, or a base nearer to the target.",
        )
    contours = open_contours(start.nodes, start.mesh.faces)
    matches, holes = match_contours(contours, contours_there, joints)
    target = Target.from_mesh(vertices, faces, contours_there)
    surface = body.v_template if pose is None else body.posed_vertices(pose[None])[0]
    skin = GridDistance.from_mesh(surface, body.faces, spacing_m=drape.grid_m)
    cloth = OrthotropicMaterial.from_isotropic(material(drape.fabric))
    search = PatternSearch(
        start.mesh,
        free_controls(graded.pattern, symmetries),
        RestDrape(start.mesh, skin, cloth, held=start.rest.held),
        Objective(start.mesh, target, contours, matches, weights, base=base),
    )
    say(f"search    {search.free.count} numbers are free, {start.mesh.node_count} nodes")
    fitted = search.run(start.nodes, fit, state_file=state_file, progress=progress)
    before, after = (1e3 * np.sqrt(0.5 * value) for value in (fitted.history[0, 1], fitted.history[:, 1].min()))
    say(f"fitted    surfaces {before:.2f} mm apart at the start, {after:.2f} mm at the end (root mean square)")
    return Recovered(symmetries, first, graded, start, matches, holes, search, fitted)


def posed_joints(body: BodyModel, pose: np.ndarray) -> np.ndarray:
    """Joints [m] (24, 3) of ``body`` in ``pose`` (24, 3)."""
    rotations, translations = body.bones(pose[None])
    return np.einsum("jab,jb->ja", rotations[0], body.joints_template) + translations[0]
