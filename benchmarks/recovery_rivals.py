"""Recovery of own patterns beside what else can be done: flattening, and a search on the same drape without gradients.

The task is that of ``benchmarks.recovery``: a target draped by our own simulator, a base 5 to 10 % off. Methods, one
after the other in one run:

- *base*, *graded*: where every search begins;
- *lscm*, *arap*: the target's mesh cut along its seams, which these are told, and every piece laid flat. The corners of
  the pieces are the control points; curves and symmetries are the base's;
- *recovered*: ``recover_pattern``;
- *cma*, *cma, 4 times*: CMA-ES over the same free numbers, from the graded pattern, on the loss and the mesh of our
  first round, for as long as our own recovery took from the base to its end, and for four times as long.

Times are those of the processor, so that other work on the machine does not count. *restarts* are drapes from the flat
panels, *drapes* those from the shape of a pattern nearby. *surface* is how far the found pattern's drape is from the
target; flattened patterns are draped from scratch for it, the others on the mesh they were searched on.

Interrupted, the record holds what was finished.

    python -m benchmarks.recovery_rivals [--quick] [--seeds 2] [--garments skirt tshirt] [--picture FILE.png] [--save]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import common
from benchmarks.recovery import GARMENTS, off, target_of
from benchmarks.recovery_evolution import evolve
from benchmarks.recovery_flatten import Method, flattened
from benchmarks.recovery_targets import turning_deg
from drape.body.assets import load_body
from drape.body.model import BodyModel
from recovery.drape.pipeline import Draped, DrapeOptions, drape_pattern
from recovery.fit.compare import pattern_error
from recovery.fit.objective import Objective, Target, polyline_chamfer
from recovery.fit.optimise import FitOptions, PatternSearch
from recovery.fit.pipeline import GRADINGS, ROUNDS, Recovered, recover_pattern
from recovery.pattern import geometry
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.mesh import PatternMesh
from recovery.pattern.model import EdgeRef, Panel, Pattern
from recovery.pattern.symmetry import find_symmetries, procrustes, symmetrised

TIMES = (1.0, 4.0)  # ours, that the search without gradients gets
SIGMA_MM = 1.0  # its first step in every free number; grading leaves 0.3 to 4 mm
MAGNIFIED = 10.0  # the picture's distances from the truth
STYLES = ("C1--", "C3:", "C2-.", "C0-")
SAMPLES = np.linspace(0.0, 1.0, 17)  # of an edge in the picture
COLUMNS = {
    "garment": "s",
    "seed": "d",
    "method": "s",
    "controls_mm": ".2f",
    "controls_max_mm": ".2f",
    "areas_pct": ".2f",
    "border_mm": ".2f",
    "turning_deg": ".2f",
    "surface_mm": ".3f",
    "minutes": ".2f",
    "restarts": "d",
    "drapes": "d",
}


def errors(found: Pattern, truth: Pattern) -> dict[str, float]:
    """Control points [mm], areas [%], borders [mm] and turning distance [deg] of ``found`` against ``truth``."""
    error = pattern_error(found, truth)
    return {
        "controls_mm": 1e3 * float(error.controls_m.mean()),
        "controls_max_mm": 1e3 * float(error.controls_m.max()),
        "areas_pct": 100.0 * float(np.abs(error.areas).mean()),
        "areas_signed_pct": 100.0 * float(error.areas.mean()),
        "border_mm": float(
            np.mean(
                [
                    border_mm(geometry.outline(own), own.vertices, geometry.outline(true), true.vertices)
                    for own, true in zip(found.panels, truth.panels, strict=True)
                ]
            )
        ),
        "turning_deg": float(turning_deg(found, truth).mean()),
    }


def border_mm(border: np.ndarray, corners: np.ndarray, true_border: np.ndarray, true_corners: np.ndarray) -> float:
    """Root mean square distance [mm] of closed outlines [m] (n, 2), (m, 2), laid on each other by corners."""
    turn, _ = procrustes(corners, true_corners, reflect=False)
    laid = (border - corners.mean(axis=0)) @ turn + true_corners.mean(axis=0)
    squared = polyline_chamfer(torch.from_numpy(laid), torch.from_numpy(np.ascontiguousarray(true_border)))
    return 1e3 * float(np.sqrt(0.5 * float(squared)))


def surface_mm(draped: Draped, target: Draped) -> float | None:
    """Root mean square distance [mm] of both surfaces, as the loss has it; None for a drape that is not at rest."""
    if not draped.at_rest:
        return None
    objective = Objective(draped.mesh, Target.from_mesh(target.nodes, target.mesh.faces, []), [], [])
    return 1e3 * float(np.sqrt(0.5 * float(objective.surface(torch.from_numpy(draped.nodes)))))


def flatten_target(
    target: Draped, truth: Pattern, base: Pattern, method: Method, body: BodyModel, drape: DrapeOptions
) -> tuple[Pattern, dict[str, Any]]:
    """The pattern that flattening gives, and its row. The border is that of the flattened pieces themselves."""
    began = time.process_time()
    mesh = target.mesh
    places = flattened(mesh, target.nodes, method, mesh.rest_at(control_points(base).positions))
    controls = control_points(base)
    corners = np.array([places[mesh.edge_vertices[ref][0]] for ref in base.edge_refs()])
    found = symmetrised(with_controls(base, controls, corners), find_symmetries(base))
    minutes = (time.process_time() - began) / 60.0
    draped = drape_pattern(found, body, drape)
    true = control_points(truth)
    away = []
    for number in range(len(truth.panels)):
        line, mine = border_of(mesh, number), controls.panel == number
        away.append(border_mm(places[line], corners[mine], mesh.rest[line], true.positions[mine]))
    row = {**errors(found, truth), "border_mm": float(np.mean(away)), "surface_mm": surface_mm(draped, target)}
    return found, {"method": str(method), **row, "minutes": minutes, "restarts": 0, "drapes": 0}


def border_of(mesh: PatternMesh, number: int) -> np.ndarray:
    """The panel vertices along the outline of panel ``number``, in its order."""
    panel = mesh.pattern.panels[number]
    return np.concatenate([mesh.edge_vertices[EdgeRef(panel.name, edge)][:-1] for edge in range(len(panel.edges))])


def recover(
    target: Draped, truth: Pattern, base: Pattern, body: BodyModel, drape: DrapeOptions, fit: FitOptions
) -> tuple[Recovered, list[dict[str, Any]], tuple[float, float]]:
    """Ours; the rows *base*, *graded*, *recovered*; and the seconds of grading and of everything."""
    began, graded_s = time.process_time(), 0.0

    def note(line: str) -> None:
        nonlocal graded_s
        if line.startswith("graded"):
            graded_s = time.process_time() - began

    found = recover_pattern(target.nodes, target.mesh.faces, base, body, drape=drape, fit=fit, report=note)
    total_s = time.process_time() - began
    history = found.fitted.history
    ends = [found.rounds[0].fitted.history[0, 1], history[history[:, 0].argmin(), 1]]
    graded_mm, mm = (1e3 * float(np.sqrt(0.5 * one)) for one in ends)
    restarts = 1 + GRADINGS
    rows: list[dict[str, Any]] = [
        {"method": "base", **errors(base, truth), "surface_mm": surface_mm(found.base, target)},
        {
            "method": "graded",
            **errors(found.graded.pattern, truth),
            "surface_mm": graded_mm,
            "minutes": graded_s / 60.0,
            "restarts": restarts,
            "drapes": 0,
        },
        {
            "method": "recovered",
            **errors(found.fitted.pattern, truth),
            "surface_mm": mm,
            "minutes": total_s / 60.0,
            # A round that was left had draped its pattern as well.
            "restarts": restarts + min(len(found.rounds), ROUNDS - 1),
            "drapes": sum(one.search.forward.drapes for one in found.rounds),
            "free": found.search.free.count,
            "nodes": found.start.mesh.node_count,
            "rounds": len(found.rounds),
            "first_controls_mm": 1e3 * float(pattern_error(found.rounds[0].fitted.pattern, truth).controls_m.mean()),
        },
    ]
    return found, rows, (graded_s, total_s)


def evolve_pattern(
    search: PatternSearch, nodes: np.ndarray, truth: Pattern, seed: int, budgets: list[float], **clock: Any
) -> tuple[Pattern, list[dict[str, Any]]]:
    """CMA-ES on the loss of ``search`` from the drape ``nodes`` (N, 3); the last pattern, a row for each budget [s]."""
    near, least = nodes, np.inf

    def loss(values_mm: np.ndarray) -> float | None:
        """The loss [mm^2]; every drape is sought from that of the best pattern so far."""
        nonlocal near, least
        judged = search.loss(1e-3 * values_mm, near)
        if judged is None:
            return None
        if judged[0] < least:
            least, near = judged
        return 1e6 * judged[0]

    rows, pattern = [], search.mesh.pattern
    for best in evolve(loss, np.zeros(search.count), SIGMA_MM, budgets, seed=seed, **clock):
        values = 1e-3 * best.values
        pattern = with_controls(search.mesh.pattern, search.mesh.controls, search.free.positions(values))
        end = search.evaluate(values, near)
        rows.append(
            {
                **errors(pattern, truth),
                "surface_mm": None if end is None else 1e3 * float(np.sqrt(0.5 * end.terms[1])),
                "loss_mm2": best.loss,
                "minutes": best.spent / 60.0,
                "drapes": best.evaluations,
                "failed": best.failed,
                "stopped": list(best.stopped),
            }
        )
    return pattern, rows


def run(
    garments: list[str], seeds: int, drape: DrapeOptions, fit: FitOptions
) -> Iterator[tuple[str, Pattern, list[dict[str, Any]], dict[str, Pattern]]]:
    """Garment, truth, new rows and new patterns by name: of both flattenings first, then of every base."""
    body = load_body()
    for garment in garments:
        truth, target = target_of(garment, drape)
        pieces = [(method, *flatten_target(target, truth, off(truth, 0), method, body, drape)) for method in Method]
        rows = [{"garment": garment, **row} for _, _, row in pieces]
        yield garment, truth, rows, {method.upper(): pattern for method, pattern, _ in pieces}
        for seed in range(seeds):
            found, own, (graded_s, total_s) = recover(target, truth, off(truth, seed), body, drape, fit)
            first, budgets = found.rounds[0], [times * total_s - graded_s for times in TIMES]
            pattern, evolved = evolve_pattern(first.search, first.start.nodes, truth, seed, budgets)
            for times, row in zip(TIMES, evolved, strict=True):
                row |= {"method": "cma" if times == 1.0 else f"cma, {times:g} times", "restarts": 1 + GRADINGS}
                row["minutes"] += graded_s / 60.0
            rows = [{"garment": garment, "seed": seed, **row} for row in [*own, *evolved]]
            yield garment, truth, rows, {"CMA-ES": pattern, "recovered": found.fitted.pattern}


def draw(path: Path, shown: dict[str, tuple[Pattern, dict[str, Pattern]]]) -> None:
    """Outlines of the patterns of each garment over the true panels, their distances from them magnified."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    panels = []
    for garment, (truth, patterns) in shown.items():
        tied = {symmetry.second for symmetry in find_symmetries(truth).between}
        panels += [(garment, truth, patterns, n) for n in range(len(truth.panels)) if n not in tied]
    figure, axes = pyplot.subplots(
        1, len(panels), figsize=(3.4 * len(panels), 4.4), layout="constrained", squeeze=False
    )
    for axis, (garment, truth, patterns, number) in zip(axes[0], panels, strict=True):
        true = truth.panels[number]
        axis.fill(*outline(true).T, color="0.9")
        axis.plot(*outline(true).T, color="black", linewidth=2.5, label="truth")
        for (name, pattern), style in zip(patterns.items(), STYLES, strict=False):
            own = pattern.panels[number]
            turn, _ = procrustes(own.vertices, true.vertices, reflect=False)
            laid = (outline(own) - own.vertices.mean(axis=0)) @ turn + true.vertices.mean(axis=0)
            axis.plot(*(outline(true) + MAGNIFIED * (laid - outline(true))).T, style, linewidth=1.5, label=name)
        axis.set_title(f"{garment}: {true.name}")
        axis.set_aspect("equal")
        axis.axis("off")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)
    figure.suptitle(f"distances from the truth {MAGNIFIED:g} times as large", fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


def outline(panel: Panel) -> np.ndarray:
    """The outline [m] (n, 2), its first point repeated, at the same places of every edge for panels of one cut."""
    points = [geometry.edge_points(panel, edge, SAMPLES[:-1]) for edge in range(len(panel.edges))]
    return np.concatenate([*points, points[0][:1]])


def main() -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    common.add_options(parser)
    parser.add_argument("--garments", nargs="+", choices=sorted(GARMENTS), default=["skirt", "tshirt"])
    parser.add_argument("--seeds", type=int, default=2, help="how many disturbed bases")
    parser.add_argument("--edge-length", type=float, default=0.05, help="of the mesh [m]")
    parser.add_argument("--grid", type=float, default=0.02, help="spacing of the body's distance [m]")
    parser.add_argument("--closing", type=int, default=10, help="our steps of Gauss and Newton")
    parser.add_argument("--picture", type=Path, help="PNG: panels of each method over the true ones")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    edge = 0.1 if options.quick else options.edge_length
    garments, seeds = (options.garments[:1], 1) if options.quick else (options.garments, options.seeds)
    drape = DrapeOptions(edge_length_m=edge, grid_m=options.grid)
    fit = FitOptions(iterations=0, closing=options.closing)
    rows: list[dict[str, Any]] = []
    shown: dict[str, tuple[Pattern, dict[str, Pattern]]] = {}
    complete = False
    try:
        for garment, truth, new, patterns in run(garments, seeds, drape, fit):
            rows += new
            shown[garment] = truth, {**shown.get(garment, (truth, {}))[1], **patterns}
            common.print_table(new, COLUMNS)
            print(flush=True)
        complete = True
    except KeyboardInterrupt:
        print("interrupted: the record holds what was finished")
    if options.picture is not None:
        draw(options.picture, shown)
    common.print_table(rows, COLUMNS)
    common.finish("recovery_rivals", rows, options, complete=complete)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
