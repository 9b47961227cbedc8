"""Recovery of own patterns: a base that is off by 5 to 10 % finds back the pattern that a target was draped from.

The target is draped by our own simulator, on its own mesh, from a known pattern, so that every control point has an
error. A base is that pattern with its panels 5 to 10 % off in width and height: the truth is within its reach, and
whether the search gets there is measured.

    python -m benchmarks.recovery [--quick] [--seeds 3] [--edge-length 0.05] [--picture FILE.png] [--out FILE]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import common
from drape.body.assets import load_body
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.fit.compare import pattern_error
from recovery.fit.optimise import FitOptions
from recovery.fit.pipeline import recover_pattern
from recovery.pattern import geometry
from recovery.pattern.bases import skirt, tshirt
from recovery.pattern.coordinates import with_controls
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern
from recovery.pattern.symmetry import find_symmetries, free_controls, procrustes

GARMENTS = {"tshirt": tshirt, "skirt": skirt}
LEAST_OFF, MOST_OFF = 0.05, 0.10  # of all widths, and of all heights: other factors for a sleeve would unmatch its seam
COLUMNS = {
    "garment": "s",
    "seed": "d",
    "nodes": "d",
    "base_mm": ".1f",
    "graded_mm": ".2f",
    "mean_mm": ".2f",
    "max_mm": ".2f",
    "area_err": ".2f",
    "area_max": ".2f",
    "surface_mm": ".3f",
    "minutes": ".2f",
}


def off(truth: Pattern, seed: int) -> Pattern:
    """``truth`` with all widths, and all heights, 5 to 10 % too small or too large."""
    rng = np.random.default_rng(seed)
    size = 1.0 + rng.choice([-1.0, 1.0], size=2) * rng.uniform(LEAST_OFF, MOST_OFF, size=2)
    free = free_controls(truth, find_symmetries(truth))
    return with_controls(truth, free.controls, free.origin * size)


def recover(
    garment: str, seed: int, drape: DrapeOptions, fit: FitOptions, picture: Path | None = None
) -> dict[str, Any]:
    """One recovery and its errors."""
    body = load_body()
    truth = GARMENTS[garment](measure(body))
    target = drape_pattern(truth, body, drape)
    started = time.perf_counter()
    found = recover_pattern(
        target.nodes, target.mesh.faces, off(truth, seed), body, drape=drape, fit=fit, progress=True
    )
    minutes = (time.perf_counter() - started) / 60.0
    base, graded, end = (
        pattern_error(pattern, truth) for pattern in (off(truth, seed), found.graded.pattern, found.fitted.pattern)
    )
    if picture is not None:
        stages = {"base": off(truth, seed), "graded": found.graded.pattern, "recovered": found.fitted.pattern}
        draw(picture, truth, stages, found.fitted.history)
    areas = 100.0 * np.abs(end.areas)
    return {
        "garment": garment,
        "seed": seed,
        "nodes": found.start.mesh.node_count,
        "base_mm": 1e3 * float(base.controls_m.mean()),
        "graded_mm": 1e3 * float(graded.controls_m.mean()),
        "mean_mm": 1e3 * float(end.controls_m.mean()),
        "max_mm": 1e3 * float(end.controls_m.max()),
        "area_err": float(areas.mean()),
        "area_max": float(areas.max()),
        "surface_mm": 1e3 * float(np.sqrt(0.5 * found.fitted.history[:, 1].min())),
        "steps": len(found.fitted.history) - 1,
        "target_at_rest": target.at_rest,
        "minutes": minutes,
    }


def draw(path: Path, truth: Pattern, patterns: dict[str, Pattern], history: np.ndarray) -> None:
    """Outlines of ``patterns`` laid on those of ``truth``, panel by panel, and the distance of the surfaces by step."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    # Panels that mirror each other look the same; one of each is drawn.
    tied = {symmetry.second for symmetry in find_symmetries(truth).between}
    shown = [number for number in range(len(truth.panels)) if number not in tied]
    figure, axes = pyplot.subplots(1, len(shown) + 1, figsize=(3.2 * (len(shown) + 1), 4.2), layout="constrained")
    for axis, number in zip(axes, shown, strict=False):
        panel = truth.panels[number]
        here = panel.vertices.mean(axis=0)
        axis.fill(*(geometry.outline(panel) - here).T, color="0.9")
        axis.plot(*_closed(geometry.outline(panel) - here).T, color="black", linewidth=2.5, label="truth")
        for (name, pattern), style in zip(patterns.items(), ("C3:", "C1--", "C0-"), strict=True):
            own = pattern.panels[number]
            matrix, _ = procrustes(own.vertices, panel.vertices, reflect=False)
            line = (geometry.outline(own) - own.vertices.mean(axis=0)) @ matrix
            axis.plot(*_closed(line).T, style, linewidth=1.3, label=name)
        axis.set_title(panel.name)
        axis.set_aspect("equal")
        axis.axis("off")
    axes[0].legend(loc="lower center", fontsize=8)
    axes[-1].semilogy(1e3 * np.sqrt(0.5 * history[:, 1]), marker=".", label="surfaces")
    axes[-1].semilogy(1e3 * np.sqrt(0.5 * history[:, 2]), marker=".", label="contours")
    axes[-1].set_xlabel("step")
    axes[-1].set_title("distance to the target [mm]")
    axes[-1].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def _closed(line: np.ndarray) -> np.ndarray:
    return np.concatenate([line, line[:1]])


def main() -> int:
    """Command line entry."""
    default = FitOptions()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    common.add_options(parser)
    parser.add_argument("--garments", nargs="+", choices=sorted(GARMENTS), default=["tshirt"])
    parser.add_argument("--seeds", type=int, default=3, help="how many disturbed bases")
    parser.add_argument("--edge-length", type=float, default=0.05, help="of the mesh [m]")
    parser.add_argument("--grid", type=float, default=0.02, help="spacing of the body's distance [m]")
    parser.add_argument("--adam", type=int, default=default.iterations, help="steps of Adam")
    parser.add_argument("--closing", type=int, default=default.closing, help="steps of Gauss and Newton after it")
    parser.add_argument("--picture", type=Path, help="PNG of the first recovery: panels over the true ones")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    drape = DrapeOptions(edge_length_m=options.edge_length, grid_m=options.grid)
    fit = FitOptions(iterations=options.adam, closing=options.closing)
    seeds = 1 if options.quick else options.seeds
    rows: list[dict[str, Any]] = []
    for garment in options.garments:
        for seed in range(seeds):
            rows.append(recover(garment, seed, drape, fit, None if rows else options.picture))
    common.print_table(rows, COLUMNS)
    common.finish("recovery", rows, options)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
