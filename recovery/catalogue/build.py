"""From a design and a body to a sewn garment at rest: sewn on a coarse mesh, let fall, refined, let fall again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.cloth.relaxation import principal_stretches
from drape.errors import NotFound
from drape.geometry import meshes
from recovery.catalogue.closing import on_finer_mesh, sew_design
from recovery.catalogue.fall import SETTLING, Fall
from recovery.catalogue.garments import CATALOGUE
from recovery.drape.pattern_drape import stretch_figures
from recovery.drape.seam_threads import in_numpy
from recovery.pattern.design import Design, check_laid_flat, check_seams
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.size_grades import in_size
from recovery.sim.sdf import GridDistance, SignedDistance

Report = Callable[[str], None]


@dataclass(frozen=True)
class BuildOptions:
    """Lengths [m] of both meshes' edges, the most steps on each, and the move in a step that counts as rest."""

    coarse_m: float = 0.025
    fine_m: float = 0.0115  # the mean edge of a mesh is 3 % longer
    coarse_steps: int = 160
    fine_steps: int = 120
    coarse_still_m: float = 4e-4
    still_m: float = 3e-4
    grid_m: float = 0.01


QUICK = BuildOptions(coarse_m=0.06, fine_m=0.045, coarse_steps=12, fine_steps=4, grid_m=0.02)  # a look, not at rest


@dataclass(frozen=True, eq=False)
class SewnGarment:
    """``nodes`` [m] (N, 3) of ``mesh`` at rest on the body in its T-pose, and ``figures`` on how it went."""

    design: Design
    mesh: PatternMesh
    nodes: np.ndarray
    figures: dict[str, Any]

    @property
    def at_rest(self) -> bool:
        """Whether it came to rest within the steps."""
        return bool(self.figures["at_rest"])


def body_distance(body: BodyModel, options: BuildOptions = BuildOptions()) -> GridDistance:
    """The signed distance of ``body`` in its rest pose. It takes seconds and serves all garments."""
    return GridDistance.from_mesh(body.v_template, body.faces, spacing_m=options.grid_m)


def design(name: str, body: BodyMeasurements, size: str = "M") -> Design:
    """Returns the catalogue's garment ``name`` drafted in ``size``. ``body`` are the measurements of the body that size
    M fits. Raises ``NotFound`` for a garment or a size that the catalogue does not have."""
    if name not in CATALOGUE:
        raise NotFound("garment", expected=f"one of {', '.join(CATALOGUE)}", got=name, cure="Check the name.")
    return CATALOGUE[name](in_size(body, size))


def build(
    made: Design, skin: SignedDistance, options: BuildOptions = BuildOptions(), *, report: Report | None = None
) -> SewnGarment:
    """Sews the design ``made`` round the body whose signed distance is ``skin``, lets it fall, and returns it at rest.

    Raises ``InputError`` for seams that do not match, for panels wider than the cloth, and for a garment that cannot
    close round the body.
    """
    say = report or (lambda line: None)
    check_seams(made)
    check_laid_flat(made)
    started = time.process_time()
    distance = in_numpy(skin)
    cloth = fabric(made.fabric)
    coarse = mesh_pattern(made.pattern, options.coarse_m)
    sewn = sew_design(made, coarse, distance)
    say(f"sewn      {coarse.node_count} nodes, seams within {1e3 * sewn.gap_m:.1f} mm")
    first = Fall(made, coarse, cloth, skin).run(sewn.nodes, steps=options.coarse_steps, still_m=options.coarse_still_m)
    say(f"fell      {first.steps} steps, the last by {1e3 * first.move_m:.2f} mm")
    fine = mesh_pattern(made.pattern, options.fine_m)
    start = on_finer_mesh(coarse, first.nodes, fine)
    last = Fall(made, fine, cloth, skin).run(start, steps=options.fine_steps, still_m=options.still_m, kept=SETTLING)
    seconds = time.process_time() - started
    say(f"settled   {fine.node_count} nodes, {last.steps} steps, the last by {1e3 * last.move_m:.2f} mm")
    edges = meshes.unique_edges(fine.faces)
    stretch = principal_stretches(fine.faces, fine.rest[fine.panel_faces], last.nodes)
    figures = {
        "nodes": fine.node_count,
        "triangles": len(fine.faces),
        "panels": len(made.pattern.panels),
        "edge_mean_mm": round(1e3 * float(meshes.edge_lengths(last.nodes, edges).mean()), 2),
        "seam_gap_mm": round(1e3 * sewn.gap_m, 2),
        "steps": [first.steps, last.steps],
        "last_move_mm": round(1e3 * last.move_m, 3),
        "at_rest": bool(last.move_m <= options.still_m),
        "clearance_mm": round(1e3 * float(distance(last.nodes)[0].min()), 2),
        **stretch_figures(stretch),
        "cpu_seconds": round(seconds, 1),
    }
    return SewnGarment(made, fine, last.nodes, figures)
