"""From a design and a body to a sewn garment at rest: sewn on a coarse mesh, let fall, refined, let fall again.

It is written as mesh files for intake, and a JSON for what a mesh file has no place for. ``NAME.obj``: v are nodes [m],
vt the panels laid out side by side in metres, unscaled, the grain along +y; a corner's pair v/vt is the map of the
seams. ``NAME.glb``: the same, split at the seams. ``NAME.json``: its ``Sewing``.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.cloth.relaxation import Distance, principal_stretches
from drape.errors import NotFound
from drape.files.atomic import write_whole
from drape.garment.sewing import FreeEdge, Seam, Sewing
from drape.geometry import meshes
from recovery.catalogue.cuts import CATALOGUE
from recovery.catalogue.fall import HEM_BENDING, HEM_M, SETTLING, Fall
from recovery.drape.output import panel_texture, write_shape
from recovery.drape.pattern_drape import stretch_figures
from recovery.drape.placement import move_clear
from recovery.drape.seam_threads import SEWING_GAP_M, Sewn, in_numpy, sew
from recovery.pattern.design import Design, check_laid_flat, check_seams
from recovery.pattern.measurements import BodyMeasurements, in_size
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern, on_finer_mesh
from recovery.progress import Say
from recovery.sim.skin_contact import GridDistance, SignedDistance

OVER_GAP_M = 0.032  # distance from the skin of panels over others while they are sewn


@dataclass(frozen=True)
class BuildOptions:
    """The options of a build: lengths ``coarse_m`` and ``fine_m`` [m] of both meshes' edges, the most steps on each,
    the moves ``coarse_still_m`` and ``still_m`` [m] in a step that count as rest, and the spacing ``grid_m`` [m] of the
    body's distance."""

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
    """A sewn ``design``: ``nodes`` [m] (N, 3) of its ``mesh`` at rest on the body in its T-pose.

    ``figures`` are for JSON: counts of "nodes", "triangles" and "panels"; "edge_mean_mm", "seam_gap_mm" and
    "clearance_mm", the least distance from the skin; "steps" on the coarse and the fine mesh, "last_move_mm" and
    "at_rest"; ``stretch_figures``; "cpu_seconds" of the processor.
    """

    design: Design
    mesh: PatternMesh
    nodes: np.ndarray
    figures: dict[str, Any]

    @property
    def at_rest(self) -> bool:
        """Whether it came to rest within the steps."""
        return bool(self.figures["at_rest"])


def body_distance(body: BodyModel, options: BuildOptions = BuildOptions()) -> GridDistance:
    """Returns the signed distance of ``body`` in its rest pose. It takes seconds and serves all garments."""
    return GridDistance.from_mesh(body.v_template, body.faces, spacing_m=options.grid_m)


def design(name: str, body: BodyMeasurements, size: str = "M") -> Design:
    """Returns the catalogue's garment ``name`` drafted in ``size``, where ``body`` has the measurements of size M.

    Raises ``NotFound`` for a garment or a size that the catalogue does not have.
    """
    if name not in CATALOGUE:
        raise NotFound("garment", expected=f"one of {', '.join(CATALOGUE)}", got=name, cure="Check the name.")
    return CATALOGUE[name](in_size(body, size))


def drape_design(
    design: Design, skin: SignedDistance, options: BuildOptions = BuildOptions(), *, report: Say | None = None
) -> SewnGarment:
    """Returns ``design`` sewn round the body whose signed distance is ``skin``, fallen and at rest, as far as the steps
    of the options allow.

    ``report`` gets lines on each step. Raises ``InputError`` for seams that do not match, for panels wider than the
    cloth, and for a garment that cannot close round the body.
    """
    say = report or (lambda line: None)
    check_seams(design)
    check_laid_flat(design)
    started = time.process_time()
    distance = in_numpy(skin)
    cloth = fabric(design.fabric)
    coarse = mesh_pattern(design.pattern, options.coarse_m)
    sewn = sew_design(design, coarse, distance)
    say(f"sewn      {coarse.node_count} nodes, seams within {1e3 * sewn.gap_m:.1f} mm")
    first = Fall(design, coarse, cloth, skin).run(
        sewn.nodes, steps=options.coarse_steps, still_m=options.coarse_still_m
    )
    say(f"fell      {first.steps} steps, the last by {1e3 * first.move_m:.2f} mm")
    fine = mesh_pattern(design.pattern, options.fine_m)
    start = on_finer_mesh(coarse, first.nodes, fine)
    last = Fall(design, fine, cloth, skin).run(start, steps=options.fine_steps, still_m=options.still_m, kept=SETTLING)
    seconds = time.process_time() - started
    say(f"settled   {fine.node_count} nodes, {last.steps} steps, the last by {1e3 * last.move_m:.2f} mm")
    edges = meshes.unique_edges(fine.faces)
    stretch = principal_stretches(fine.faces, fine.rest[fine.panel_faces], last.nodes)
    figures = {
        "nodes": fine.node_count,
        "triangles": len(fine.faces),
        "panels": len(design.pattern.panels),
        "edge_mean_mm": round(1e3 * float(meshes.edge_lengths(last.nodes, edges).mean()), 2),
        "seam_gap_mm": round(1e3 * sewn.gap_m, 2),
        "steps": [first.steps, last.steps],
        "last_move_mm": round(1e3 * last.move_m, 3),
        "at_rest": bool(last.move_m <= options.still_m),
        "clearance_mm": round(1e3 * float(distance(last.nodes)[0].min()), 2),
        **stretch_figures(stretch),
        "cpu_seconds": round(seconds, 1),
    }
    return SewnGarment(design, fine, last.nodes, figures)


def start_positions(design: Design, mesh: PatternMesh, distance: Distance) -> np.ndarray:
    """Returns where panel vertices begin before sewing, [m] (P, 3): panels of ``Design.wraps`` are bent, flat
    ones moved outward until clear of the body."""
    positions = move_clear(mesh, mesh.placed(), distance, leave=design.wraps)[0]
    for number, panel in enumerate(design.pattern.panels):
        if panel.name in design.wraps:
            mine = mesh.panel == number
            positions[mine] = design.wraps[panel.name].place(mesh.rest[mine])
    return positions


def sew_design(design: Design, mesh: PatternMesh, distance: Distance) -> Sewn:
    """Returns ``design`` sewn on ``mesh`` round the body with this signed ``distance``. Raises ``InputError`` where a
    seam cannot close."""
    folded = [number for number, name in enumerate(design.seam_names) if name in design.seam_angles]
    creases = np.unique(mesh.node_of_panel_vertex[mesh.seam_pairs[np.isin(mesh.seam_of_pair, folded)]])
    over = [panel.name in design.over for panel in design.pattern.panels]
    gaps = np.where(np.array(over)[mesh.panel], OVER_GAP_M, SEWING_GAP_M)
    return sew(mesh, start_positions(design, mesh, distance), distance, gap_m=gaps, creases=creases)


# --- files -----------------------------------------------------------------------------------------------------------


def edge_kind(name: str) -> str:
    """Returns the kind of an edge by its name: "hem" if it is turned up, "opening" if it is bound or banded, "free" for
    any other."""
    return next((kind for kind in ("hem", "opening") if name.startswith(kind)), "free")


def sewing(garment: SewnGarment, *, name: str, size: str, body: str) -> Sewing:
    """Returns the seams, free edges, fabric and figures of ``garment`` in ``size`` on ``body``, which NAME.json
    holds."""
    design, mesh = garment.design, garment.mesh
    seams = []
    for number, (stitch, seam) in enumerate(zip(design.pattern.stitches, design.seam_names, strict=True)):
        pairs = mesh.seam_pairs[mesh.seam_of_pair == number]
        panels = (stitch.first.panel, stitch.second.panel)
        nodes = mesh.node_of_panel_vertex[pairs[:, 0]].tolist()
        seams.append(Seam(seam, panels, design.seam_angles.get(seam, 0.0), nodes, pairs.T.tolist()))
    edges = []
    for ref, named in design.edge_names.items():
        if ref not in design.pattern.sewn:
            line = np.asarray(mesh.edge_vertices[ref])
            edges.append(
                FreeEdge(named, edge_kind(named), ref.panel, mesh.node_of_panel_vertex[line].tolist(), line.tolist())
            )
    return Sewing(
        name=name,
        size=size,
        body=body,
        fabric=design.fabric,
        mesh=f"{name}.obj",
        uv_unit_m=1.0,
        hem_bending=HEM_BENDING,
        hem_width_m=HEM_M,
        panels=[panel.name for panel in design.pattern.panels],
        seams=seams,
        edges=edges,
        ease_m=dict(design.ease_m),
        figures=garment.figures,
    )


def write_garment(garment: SewnGarment, folder: Path, *, name: str, size: str, body: str) -> list[Path]:
    """Writes ``NAME.obj``, ``NAME.glb`` and ``NAME.json`` to ``folder`` and returns their paths."""
    texture = panel_texture(garment.mesh, unit_m=1.0)
    text = json.dumps(sewing(garment, name=name, size=size, body=body).to_json(), indent=1) + "\n"
    path = write_whole(folder / f"{name}.json", text)
    return [*write_shape(folder, name, garment.mesh, garment.nodes, texture), path]
