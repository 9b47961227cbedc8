"""Recovery from targets of an independent simulator, beside table 2 of Yu, Cordier and Seo (2024).

As the paper does, patterns of Garment-Pattern-Generator are draped by a simulator that is not ours (Newton's Style3D
solver, ``newton_drape.py``; there 3ds Max) and recovered from the mesh alone. It is another cloth, another
bending, another contact, and a finer mesh. The base is the same template in another size: all widths and all heights 5
to 10 % off (``benchmarks.recovery.compare``). The templates are sized to the shipped body; shorts are our own draft.

    python -m benchmarks.recovery_targets --newton PYTHON [--garments tee pants] [--seeds 1] [--edge-length 0.035]
        [--targets FOLDER] [--save]

PYTHON is an interpreter that has the package newton (Apache-2.0; not a dependency). --targets keeps the drapes.

A round has four closing steps of Gauss and Newton: with ten the pattern makes up for the difference of the simulators.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, Benchmark, Option, Run
from benchmarks.recovery.compare import off, pattern_error
from benchmarks.recovery.published import ahead
from benchmarks.recovery.surfaces import surface_error
from benchmarks.recovery.turning import turning_distance
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.material import Material, material
from drape.errors import Unavailable
from drape.files.data import HOW_TO_SET_DATA, data_folder
from recovery.drape.pipeline import Draped, DrapeOptions, drape_pattern
from recovery.drape.placement import scaled
from recovery.fit.objective import Weights
from recovery.fit.optimise import FitOptions
from recovery.fit.pipeline import recover_pattern
from recovery.pattern import geometry
from recovery.pattern.bases import trousers
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.measurements import measure
from recovery.pattern.model import Pattern

FLATTEN_M = 1e-3  # of outlines whose turning functions are compared
TARGET_EDGE_M = 0.025
GAP_M = 0.005  # from skin to cloth in the target: no edge of it cuts the body
NEWTON_LIMIT_S = 1800
TEMPLATES = {  # file and size beside the body that it was drawn for
    "tee": ("tee", 1.15),
    "dress": ("dress_sleeveless", 1.15),
    "pants": ("pants_straight_sides", 1.1),
    "skirt": ("skirt_4_panels", 1.05),
}
OWN: dict[str, Callable[[BodyModel], Pattern]] = {
    "shorts": lambda body: replace(trousers(measure(body), inseam_m=0.22, hem_girth_m=0.62), name="shorts")
}
GARMENTS = (*TEMPLATES, *OWN)


COLUMNS = {
    "garment": "s", "seed": "d", "nodes": "d", "chamfer_cm2": ".3f", "normal": ".4f", "turning_deg": ".2f",
    "area_err": ".4f", "ahead": "d", "minutes": ".1f", "mean_mm": ".2f", "controls_mm": ".1f",
    "truth_chamfer_cm2": ".3f", "truth_normal": ".4f", "floor_cm2": ".3f", "base_turning_deg": ".2f",
    "base_area_err": ".3f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Target:
    """A pattern draped by Newton: ``nodes`` [m] (N, 3), ``faces``; ``own`` is our drape of the same pattern and mesh.

    ``moved_mm`` is how far a node still moved in the last second.
    """

    truth: Pattern
    own: Draped
    nodes: np.ndarray
    moved_mm: float

    @property
    def faces(self) -> np.ndarray:
        """Triangles (F, 3)."""
        return self.own.mesh.faces


def true_pattern(garment: str, body: BodyModel) -> Pattern:
    """The pattern that is draped and should be found."""
    if garment in OWN:
        return OWN[garment](body)
    folder = data_folder()
    if folder is None:
        raise SystemExit(HOW_TO_SET_DATA)
    file, size = TEMPLATES[garment]
    return scaled(read_pattern(folder / "patterns" / f"{file}.json"), size)


def newton_target(
    garment: str, body: BodyModel, python: str, grid_m: float, folder: Path | None, fabric: str = "jersey"
) -> Target:
    """The target of ``garment``, draped in the interpreter ``python``, or read from ``folder`` if it was before.

    Newton's weft and warp get the stiffness of a strip of our cloth that is free to narrow, E = H00 - H01^2 / H11.
    """
    truth = true_pattern(garment, body)
    own = drape_pattern(truth, body, DrapeOptions(edge_length_m=TARGET_EDGE_M, grid_m=grid_m, fabric=fabric))
    cloth, preset = material(fabric).woven, material(fabric)
    scene = {
        "nodes": own.sewn.nodes, "faces": own.mesh.faces, "panels": own.mesh.rest, "held": own.rest.held,
        "panel_faces": own.mesh.panel_faces, "body_vertices": body.v_template, "body_faces": body.faces,
        "stretch": cloth.h00 - cloth.h01**2 / cloth.h11, "shear": 0.5 * cloth.h22, "bending": preset.bending_j,
        "density": preset.density_kg_m2, "gravity": Material.gravity_m_s2, "friction": 0.0, "gap_m": GAP_M,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        found = newton_drape(garment, scene, python, Path(scratch) if folder is None else folder)
    return Target(truth, own, found["nodes"], float(found["moved_mm"]))


def newton_drape(name: str, scene: dict[str, Any], python: str, folder: Path) -> dict[str, np.ndarray]:
    """The drape of ``scene`` by ``newton_drape.py``, kept in ``folder`` under the digest of scene and program."""
    program = ROOT / "benchmarks/recovery/newton_drape.py"
    digest = hashlib.sha256(program.read_bytes())
    for key in sorted(scene):
        digest.update(np.ascontiguousarray(scene[key]).tobytes())
    kept = folder / f"{name}-{digest.hexdigest()[:12]}.npz"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as scratch:
            asked, part = Path(scratch) / "scene.npz", Path(scratch) / "out.npz"
            np.savez(asked, **scene)
            command = [python, str(program), str(asked), str(part)]
            try:
                done = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=NEWTON_LIMIT_S, check=False)
            except (OSError, subprocess.TimeoutExpired) as error:
                raise SystemExit(f"--newton {python}: {error}") from error
            if done.returncode:
                raise SystemExit(f"--newton {python}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
            kept.write_bytes(part.read_bytes())
    with np.load(kept) as found:
        return {key: found[key] for key in found.files}


def turning_deg(found: Pattern, truth: Pattern) -> np.ndarray:
    """Turning distances [deg] (P,) between the panels of two patterns, which have the same panels in order."""
    outlines = (
        [geometry.outline(panel, FLATTEN_M) for panel in panels]
        for panels in zip(found.panels, truth.panels, strict=True)
    )
    return np.degrees([turning_distance(first, second) for first, second in outlines])


def recover(
    garment: str, target: Target, seed: int, body: BodyModel, drape: DrapeOptions, fit: FitOptions, weights: Weights
) -> Row:
    """The row of one recovery from the base of ``seed``."""
    truth, base = target.truth, off(target.truth, seed)
    started = time.perf_counter()
    found = recover_pattern(
        target.nodes, target.faces, base, body, drape=drape, fit=fit, weights=weights, progress=True, report=print
    )
    minutes = (time.perf_counter() - started) / 60.0
    recovered, faces = found.fitted.pattern, found.start.mesh.faces
    surface = surface_error(found.fitted.nodes, faces, target.nodes, target.faces)
    own = surface_error(target.own.nodes, target.faces, target.nodes, target.faces)
    floor = surface_error(target.nodes, target.faces, target.nodes, target.faces)
    turned, error = turning_deg(recovered, truth), pattern_error(recovered, truth)
    graded = pattern_error(found.graded.pattern, truth)
    row: Row = {
        "garment": garment,
        "seed": seed,
        "nodes": found.start.mesh.node_count,
        **surface._asdict(),
        "turning_deg": float(turned.mean()),
        "turning_max": float(turned.max()),
        "area_err": float(np.abs(error.areas).mean()),
        "area_signed": float(error.areas.mean()),
        "controls_mm": 1e3 * float(error.controls_m.mean()),
        "graded_mm": 1e3 * float(graded.controls_m.mean()),
        "graded_area_err": float(np.abs(graded.areas).mean()),
        "graded_turning_deg": float(turning_deg(found.graded.pattern, truth).mean()),
        "base_turning_deg": float(turning_deg(base, truth).mean()),
        "base_area_err": float(np.abs(pattern_error(base, truth).areas).mean()),
        "truth_chamfer_cm2": own.chamfer_cm2,
        "truth_normal": own.normal,
        "floor_cm2": floor.chamfer_cm2,
        "steps": len(found.fitted.history) - 1,
        "target_nodes": len(target.nodes),
        "target_moved_mm": target.moved_mm,
        "minutes": minutes,
    }
    return row | {"ahead": ahead(row)}


@Benchmark(
    "recovery_targets",
    "Recovery of patterns from drapes by Newton's simulator.",
    COLUMNS,
    Option("--newton", None, "an interpreter that has the package newton"),
    Option("--garments", GARMENTS, "which", GARMENTS[:1], choices=GARMENTS),
    Option("--seeds", 1, "how many bases of other sizes", 1),
    Option("--edge-length", 0.035, "of the recovery's mesh [m]"),
    Option("--grid", 0.01, "spacing of the body's distance [m]"),
    Option("--adam", FitOptions().iterations, "steps of Adam"),
    Option("--closing", 4, "steps of Gauss and Newton after it"),
    Option("--seams", 0.01, "weight of the seams' lengths"),
    Option("--targets", None, "keeps Newton's drapes in this folder", kind=Path),
)
def main(run: Run) -> None:
    """Rows of every garment and base."""
    options = run.options
    if options.newton is None:
        raise Unavailable(
            "--newton", expected="an interpreter that has the package newton", got="none", cure="Give --newton PYTHON."
        )
    os.environ["OMP_NUM_THREADS"] = str(options.threads)
    body, weights = load_body(), Weights(seams=options.seams)
    drape = DrapeOptions(edge_length_m=options.edge_length, grid_m=options.grid)
    fit = FitOptions(iterations=options.adam, closing=options.closing)
    for garment in options.garments:
        target = newton_target(garment, body, options.newton, options.grid, options.targets)
        for seed in range(options.seeds):
            run.rows.append(recover(garment, target, seed, body, drape, fit, weights))


if __name__ == "__main__":
    main.command()
