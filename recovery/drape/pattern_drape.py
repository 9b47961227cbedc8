"""From a pattern and a body to a garment at rest: meshed, placed, sewn, draped in the T-pose, then in a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.cloth.material import DEFAULT_MATERIAL, Material, OrthotropicMaterial, material
from drape.cloth.relaxation import principal_stretches
from drape.errors import InputError
from drape.geometry import meshes
from recovery import progress
from recovery.drape.placement import Axes, PlacedPanels, place_panels, scale_pattern, to_pose
from recovery.drape.seam_threads import Sewn, in_numpy, sew, uncross_stitches
from recovery.drape.settle import ITERATION_LIMIT, SettledDrape, settle_at_rest
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.progress import Say
from recovery.sim.skin_contact import GridDistance, Grown, SignedDistance, bare

HANGS_LONGER = 0.01  # share by which hanging cloth, a metre long, is stretched by its own weight


class Hold(StrEnum):
    """What holds a garment up: a belt at its topmost opening, the body alone (``NOTHING``), or with ``AUTO`` a belt
    unless it hangs from the shoulders."""

    AUTO = "auto"
    BELT = "belt"
    NOTHING = "nothing"


@dataclass(frozen=True)
class SewingOptions:
    """The options of sewing and draping: ``edge_length_m`` [m] of the cloth's mesh, the name of its ``fabric``, the
    factor ``scale`` of the pattern, the ``axes`` of its placements, and what is to ``hold`` it up.

    ``grid_m`` [m] is the spacing of the grid that holds the body's distance. ``iteration_limit`` is that of Newton's
    method; 0 leaves the garment where the quasi-static steps end. Cloth rests ``off_skin_m`` [m] farther off the skin
    than the contact's own gap. A metre of cloth stretches by its own weight by at least the share ``hangs_longer``
    (``hanging``).
    """

    edge_length_m: float = 0.025
    fabric: str = DEFAULT_MATERIAL
    scale: float = 1.0
    axes: Axes = Axes.AUTO
    hold: Hold = Hold.AUTO
    grid_m: float = 0.01
    iteration_limit: int = ITERATION_LIMIT
    off_skin_m: float = 0.0
    hangs_longer: float = HANGS_LONGER

    def __post_init__(self) -> None:
        if self.iteration_limit < 0:
            raise InputError(
                "iterations", expected="a number from 0", got=f"{self.iteration_limit}", cure="Leave it at its default."
            )

    def skin(self, vertices: np.ndarray, faces: np.ndarray) -> SignedDistance:
        """Returns the signed distance of a closed surface, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), grown by
        ``off_skin_m``.

        Raises ``MeshError`` for an open surface.
        """
        distance = GridDistance.from_mesh(vertices, faces, spacing_m=self.grid_m)
        return Grown(distance, self.off_skin_m) if self.off_skin_m else distance


def hanging(name: str, longer: float = HANGS_LONGER) -> OrthotropicMaterial:
    """Returns the material of the fabric called ``name``, softened for draping: a metre of it that hangs by its own
    weight stretches by at least the share ``longer``.

    Triangles that lie across the yarns cannot bend without stretching them, so that on long edges a stiff, light cloth
    folds nowhere and hardly comes to rest (``Fabric.softened``).
    """
    cloth = material(name).woven
    most = cloth.density_kg_m2 * Material.gravity_m_s2 / longer
    across, along = min(cloth.h00, most), min(cloth.h11, most)
    coupled = float(np.sqrt(across * along / (cloth.h00 * cloth.h11)))
    return replace(cloth, h00=across, h11=along, h01=coupled * cloth.h01)


@dataclass(frozen=True, eq=False)
class Draped:
    """A garment at ``rest`` in the T-pose and, if a pose was asked for, ``posed`` in that; with its ``mesh``, the
    ``placed`` panels and the ``sewn`` shape that came before.

    ``figures``, for JSON: ``drape_figures`` under "rest" and, with a pose, "posed"; ``stretch_figures`` under "sewn";
    sentences on exchanged stitches under "repaired"; "edge_length_m" that was asked for, numbers of "nodes",
    "triangles" and "belt_nodes"; "axes", "lift_cm", "hangs_from" and "sleeves_turned_deg" as in ``PlacedPanels``;
    "seam_gap_mm", and "top_sank_cm", by which the highest node sank.
    """

    mesh: PatternMesh
    placed: PlacedPanels
    sewn: Sewn
    rest: SettledDrape
    posed: SettledDrape | None
    figures: dict[str, Any]

    @property
    def nodes(self) -> np.ndarray:
        """Nodes [m] (N, 3) in the pose that was asked for, by default the T-pose."""
        return self.rest.nodes if self.posed is None else self.posed.nodes

    @property
    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes [m] (N, 3) in the pose that was asked for, by default the T-pose, and faces (F, 3)."""
        return self.nodes, self.mesh.faces

    @property
    def at_rest(self) -> bool:
        """Whether all of its drapes came to rest: that in the T-pose, and that in a pose if there is one."""
        return self.rest.report.converged and (self.posed is None or self.posed.report.converged)


def drape_pattern(
    pattern: Pattern,
    body: BodyModel,
    options: SewingOptions = SewingOptions(),
    *,
    pose: np.ndarray | None = None,
    cloth: OrthotropicMaterial | None = None,
    skin: SignedDistance | None = None,
    report: Say | None = None,
) -> Draped:
    """Returns ``pattern`` sewn round ``body`` and at rest on it, in the T-pose and then in ``pose`` [rad] (24, 3).

    ``cloth`` replaces the fabric that the options name; ``skin`` is the body's signed distance in the T-pose, if the
    caller has it. ``report`` gets a line on each step. Raises ``InputError`` (or ``MeshError``) for a pattern that
    cannot be meshed, placed or closed round this body.
    """
    say = report or (lambda line: None)
    cloth = cloth or hanging(options.fabric, options.hangs_longer)
    pattern, notes = uncross_stitches(pattern)
    for note in notes:
        say(f"repaired  {note}")
    mesh = mesh_pattern(
        pattern if options.scale == 1.0 else scale_pattern(pattern, options.scale), options.edge_length_m
    )
    say(f"meshed    {mesh.node_count} nodes, {len(mesh.faces)} triangles, {len(pattern.stitches)} seams")
    skin = skin or options.skin(body.v_template, body.faces)
    distance = in_numpy(bare(skin))  # panels stand and close as they do for any cloth
    placed = place_panels(mesh, body, distance, axes=options.axes)
    say(
        f"placed    in the axes {placed.axes}, lifted by {100 * placed.lift_m:.0f} cm, moved outward by at most "
        f"{100 * placed.outward_m:.1f} cm; hangs from the {placed.hangs_from}"
        + (f"; sleeves turned onto the arms by {np.degrees(placed.turned_rad):.0f} degrees" * bool(placed.turned_rad))
    )
    sewn = sew(mesh, placed.positions, distance)
    say(f"sewn      seams within {1e3 * sewn.gap_m:.1f} mm; {describe_stretch(stretch_figures(sewn.stretch))}")
    belt = options.hold is Hold.BELT or (options.hold is Hold.AUTO and placed.hangs_from != "shoulders")
    knee = float(body.joints_template[JOINT_NAMES.index("left_knee"), 1])
    limit = options.iteration_limit
    progress.tick("the garment falls")
    held = "belt" if belt else None
    rest = settle_at_rest(mesh, sewn.nodes, skin, cloth, held=held, lowest_top_m=knee, iteration_limit=limit)
    fallen = float(sewn.nodes[:, 1].max() - rest.nodes[:, 1].max())
    figures: dict[str, Any] = {
        "repaired": list(notes),
        "edge_length_m": options.edge_length_m,
        "nodes": mesh.node_count,
        "triangles": len(mesh.faces),
        "axes": str(placed.axes),
        "lift_cm": round(100 * placed.lift_m, 2),
        "hangs_from": placed.hangs_from,
        "sleeves_turned_deg": round(float(np.degrees(placed.turned_rad)), 1),
        "belt_nodes": len(rest.held),
        "seam_gap_mm": round(1e3 * sewn.gap_m, 2),
        "sewn": stretch_figures(sewn.stretch),
        "top_sank_cm": round(100 * fallen, 2),
        "rest": drape_figures(mesh, rest, skin),
    }
    say(describe_drape("draped", figures["rest"]))
    posed = None
    if pose is not None:
        posed, figures["posed"] = drape_in_pose(mesh, rest, body, pose, options, cloth=cloth)
        say(describe_drape("posed", figures["posed"]))
    return Draped(mesh, placed, sewn, rest, posed, figures)


def drape_in_pose(
    mesh: PatternMesh,
    rest: SettledDrape,
    body: BodyModel,
    pose: np.ndarray,
    options: SewingOptions = SewingOptions(),
    *,
    cloth: OrthotropicMaterial | None = None,
) -> tuple[SettledDrape, dict[str, Any]]:
    """Returns the garment of ``mesh`` at rest on ``body`` in ``pose`` [rad] (24, 3), and its ``drape_figures``.

    ``rest`` is its drape in the T-pose; ``cloth`` replaces the fabric that the options name.
    """
    pose = np.asarray(pose, dtype=np.float64).reshape(JOINT_COUNT, 3)
    moved = to_pose(mesh, rest.nodes, body, pose)
    skin = options.skin(body.posed_vertices(pose[None])[0], body.faces)
    cloth = cloth or hanging(options.fabric, options.hangs_longer)
    posed = settle_at_rest(mesh, moved, skin, cloth, held=rest.held, iteration_limit=options.iteration_limit)
    return posed, drape_figures(mesh, posed, skin)


def drape_figures(mesh: PatternMesh, drape: SettledDrape, skin: SignedDistance) -> dict[str, Any]:
    """Returns the figures by which a drape can be trusted: "converged", "force_left_n", "newton_iterations", "steps",
    "clearance_mm", "edges_in_body_pct" and those of ``stretch_figures``.

    The clearance is the least distance of a node from the skin, negative in the body. An edge is in the body if its
    middle is. Both are from the bare ``skin``, also where this was grown.
    """
    distance = in_numpy(bare(skin))
    edges = meshes.unique_edges(mesh.faces)
    middles = distance(drape.nodes[edges].mean(axis=1))[0]
    stretch = principal_stretches(mesh.faces, mesh.rest[mesh.panel_faces], drape.nodes)
    return {
        "converged": drape.report.converged,
        "force_left_n": drape.report.residual_n,
        "newton_iterations": drape.report.iterations,
        "steps": drape.steps,
        "clearance_mm": round(1e3 * float(distance(drape.nodes)[0].min()), 3),
        "edges_in_body_pct": round(100.0 * float((middles < 0.0).mean()), 3),
        **stretch_figures(stretch),
    }


def stretch_figures(stretch: np.ndarray) -> dict[str, float]:
    """Returns "stretch_median_pct" and "stretch_p99_pct": median and 99th percentile of the strain of triangles along
    their direction of largest stretch. ``stretch`` (F, 2) are their principal stretches, the larger first."""
    larger = 100.0 * (stretch[:, 0] - 1.0)
    return {
        "stretch_median_pct": round(float(np.median(larger)), 2),
        "stretch_p99_pct": round(float(np.quantile(larger, 0.99)), 2),
    }


def describe_stretch(figures: dict[str, Any]) -> str:
    """Returns a phrase with the numbers of ``stretch_figures``."""
    return f"stretched by {figures['stretch_median_pct']:.1f} % (99th percentile {figures['stretch_p99_pct']:.1f} %)"


def describe_drape(what: str, figures: dict[str, Any]) -> str:
    """Returns a line on how the drape called ``what`` ended, from its ``drape_figures``."""
    end = "at rest" if figures["converged"] else "NOT at rest"
    return (
        f"{what:9s} {end}, force left {figures['force_left_n']:.1e} N; clearance {figures['clearance_mm']:.1f} mm, "
        f"{figures['edges_in_body_pct']:.1f} % of edges cut the body; {describe_stretch(figures)}"
    )
