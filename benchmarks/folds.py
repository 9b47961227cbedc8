"""What folds make of a clip: energies, strain, detail, jitter and time of several sweeps on several starts.

    python -m benchmarks.folds
    python -m benchmarks.folds --garments tshirt --motions walk squat $DRAPE_DATA/motions/cmu_02_04.npz --save
    python -m benchmarks.folds --garments tshirt --fabrics satin --fps 15 --frames 900 --sweeps 2
    python -m benchmarks.folds --garments tshirt dress --fabrics jersey denim --motions walk --sheets docs/images

Every start gets the same solver: ``skinning`` with the nearest-vertex push, and the network after none and all of its
corrections. ``ms`` is the median processor time of a frame's folds on one thread; energies are those of the referee,
over frames spread over the clip and without push-out; jitter is against the start, skin counted in pictures from four
sides.
``--physics`` adds ``gain`` and ``detail_share`` against the optimum of up to six frames of the clip, minutes each;
``--apart`` adds ``gain_apart`` against what of it cloth can have that does not pass through itself.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.judge import ipc_optimum, physics
from benchmarks.judge.physics_cache import CACHE_DIR, stored_minimum
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.skin_pixels import PosedBody, covered_faces, skin_pixels_pct
from benchmarks.shared import common
from benchmarks.shared.network import Network, add_precision
from benchmarks.shared.render import PLAIN_CLOTH, RAKING_LIGHT, SKIN, Surface, render, save_png, sheet
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.detail import LowPass, dihedral_deg
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.contact.skin import shaped_skin
from drape.errors import ended
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.geometry import meshes
from drape.geometry.skinning import skin_points
from drape.live.fold_constants import FoldConstants, fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold, warm_up
from drape.motion.readers import read_motion

SWEEPS = (0, 1, 2, 4, 8)
FABRICS = ("jersey", "denim", "satin", "poplin")
FPS, FRAMES, QUICK_FRAMES = 30.0, 120, 12
MEASURED, COLLIDED, OPTIMA = 10, 3, 6  # frames of a clip whose energies, penetration and optimum are looked at
SHEET_FRAMES, SHEET_STEP, SHEET_SWEEPS = 5, 3, (0, 2, 8)
SHEET_SIZE, SHEET_MARGIN, SHEET_COLOURS = (360, 280), 1.15, 96
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "fps": ".0f", "method": "s", "sweeps": "d", "ms": ".2f",
    "energy_j": ".4f", "gain": ".3f", "gain_apart": ".3f", "edge_pct": ".2f", "edge_p999": ".3f",
    "detail_mm": ".2f", "detail_share": ".2f", "dihedral_deg": ".1f", "jitter_ratio": ".2f", "colliding_pct": ".2f",
    "skin_pixels_pct": ".3f", "self_intersections": ".0f", "resets": "d",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Clip:
    """F poses of a motion at ``fps``, their ``skin`` samples (F, S, 8), and bodies [m] of the ``measured`` frames."""

    name: str
    fps: float
    poses: np.ndarray
    skin: np.ndarray
    measured: np.ndarray
    body_vertices: np.ndarray

    @classmethod
    def read(cls, path: Path, fps: float, frames: int, body: BodyModel, *, looked_at: int = MEASURED) -> Clip:
        """The first ``frames`` of the motion at ``path``, resampled to ``fps``."""
        motion = read_motion(path)
        motion = motion if abs(motion.fps - fps) < 1e-6 else motion.resampled(fps)
        return cls.of(motion.name, fps, motion.poses[:frames], body, looked_at=looked_at)

    @classmethod
    def of(cls, name: str, fps: float, poses: np.ndarray, body: BodyModel, *, looked_at: int = MEASURED) -> Clip:
        """``poses`` (F, 24, 3) [rad], of which ``looked_at`` frames at most, spread over them, are measured."""
        table = shaped_skin(body).table(*body.bones(poses), np.zeros((len(poses), body.shape_count)))
        measured = np.unique(np.linspace(0, len(poses) - 1, looked_at).astype(int))
        skin = table.reshape(len(poses), -1, table.shape[-1])
        return cls(name, fps, poses, skin, measured, body.posed_vertices(poses[measured]))


@dataclass(frozen=True, eq=False)
class Folded:
    """All frames of a clip with folds: ``vertices`` [m] (F, V, 3), processor time [ms] (F,), frames begun anew."""

    vertices: np.ndarray
    ms: np.ndarray
    resets: int


def folded(made: FoldConstants, start: np.ndarray, clip: Clip, sweeps: int, *, cloth_contact: bool = False) -> Folded:
    """``start`` [m] (F, V, 3) with folds of ``sweeps`` each, none for 0."""
    if not sweeps:
        return Folded(start, np.zeros(len(start)), 0)
    memory, found, ms, resets = None, np.empty_like(start), np.zeros(len(start)), 0
    for i, vertices in enumerate(start):
        begin = time.thread_time()
        frame = Frame(vertices, clip.skin[i], i / clip.fps)
        found[i], memory, report = fold(made, memory, frame, FoldEffort(sweeps, cloth_contact=cloth_contact))
        ms[i] = 1e3 * (time.thread_time() - begin)
        resets += report.reset
    return Folded(found, ms, resets)


@dataclass(frozen=True, eq=False)
class Referee:
    """What a garment in a fabric is judged by over a clip; ``covered`` (Fb,): faces of the body, as of
    ``skin_pixels.covered_faces``."""

    garment: Garment
    clip: Clip
    body: BodyModel
    cloth: ClothMesh
    material: Material
    low_pass: LowPass
    height_m: np.ndarray
    covered: np.ndarray

    @classmethod
    def of(cls, garment: Garment, cloth: Fabric, clip: Clip, body: BodyModel, skinned: np.ndarray) -> Referee:
        """The referee of ``garment`` made of ``cloth``; heights are from those of ``skinned`` [m] (F, V, 3)."""
        state, faces, rest = garment.rest_state(), garment.fine_faces.astype(np.int64), garment.vertices
        mesh = ClothMesh.of(state, faces, len(rest))
        height = metrics.mean_height(skinned[clip.measured].astype(np.float64), mesh)
        covered = covered_faces(body.v_template, body.faces, rest.astype(np.float64), faces)
        low_pass = LowPass.of(state, faces, len(rest))
        return cls(garment, clip, body, mesh, Material.of(cloth), low_pass, height, covered)

    @cached_property
    def pictured(self) -> tuple[PosedBody, ...]:
        """Every ``body_vertices`` of the clip in pictures, which all drapes share."""
        return tuple(PosedBody.of(posed, self.body.faces) for posed in self.clip.body_vertices)

    def figures(self, found: Folded, start: np.ndarray) -> dict[str, Any]:
        """The columns of a row, but for what needs physics."""
        seen = found.vertices[self.clip.measured].astype(np.float64)
        rest, faces = self.garment.vertices.astype(np.float64), self.cloth.faces
        contact = BodyContact(self.body.faces, self.body.vertex_count)
        parts = physics.energy_parts(
            seen, self.cloth, self.material, contact, self.clip.body_vertices, height_m=self.height_m
        )
        edges = meshes.unique_edges(faces)
        strained = meshes.edge_lengths(found.vertices.astype(np.float64), edges) / meshes.edge_lengths(rest, edges)
        few = slice(None, None, max(1, len(seen) // COLLIDED))
        colliding = metrics.colliding_triangle_pct(seen[few], self.clip.body_vertices[few], self.body.faces)
        skin = [
            skin_pixels_pct(body, self.covered, vertices, faces)
            for body, vertices in zip(self.pictured[few], seen[few], strict=True)
        ]
        return {
            "ms": float(np.median(found.ms[1:])),
            "first_ms": float(found.ms[0]),
            "energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean()),
            **{f"{part}_j": float(value.mean()) for part, value in parts.items()},
            "edge_pct": float(metrics.edge_strain_pct(seen, rest, faces).mean()),
            "edge_p999": float(np.percentile(strained, 99.9)),
            "detail_mm": float(self.low_pass.detail_mm(seen).mean()),
            "dihedral_deg": float(dihedral_deg(seen, faces).mean()),
            "jitter_ratio": jitter_ratio(found.vertices, start),
            "colliding_pct": float(colliding.mean()),
            "skin_pixels_pct": float(np.nanmean(skin)),
            "self_intersections": float(intersection_count(seen[few], faces).mean()),
            "resets": found.resets,
            "frames": len(start),
        }


def jitter_ratio(vertices: np.ndarray, start: np.ndarray) -> float:
    """Root mean square third difference of ``vertices`` (F, V, 3) over that of ``start``; NaN where that is still."""
    still = metrics.third_difference_square(start)
    return float(np.sqrt(metrics.third_difference_square(vertices) / still)) if still > 0.0 else float("nan")


def starts(
    garment: Garment, cloth: Fabric, clip: Clip, body: BodyModel, networks: dict[str, Network]
) -> dict[str, Any]:
    """Vertices [m] (F, V, 3) float32 by what they come from; skinning is pushed off the skin."""
    rest = np.broadcast_to(garment.vertices.astype(np.float64), (len(clip.poses), *garment.vertices.shape))
    skinned = skin_points(rest, garment.skin_weights.astype(np.float64), *body.bones(clip.poses))
    posed = body.posed_vertices(clip.poses)
    normals = np.asarray(BodyContact(body.faces, body.vertex_count).normals(posed))
    found = {"skinning": nearest_vertex_push(skinned, posed, normals)}
    found |= {name: made.made_of(cloth).drape(garment, clip.poses).vertices for name, made in networks.items()}
    return {name: vertices.astype(np.float32) for name, vertices in found.items()}


def measure(
    garment: Garment,
    cloth: Fabric,
    clip: Clip,
    body: BodyModel,
    networks: dict[str, Network],
    options: argparse.Namespace,
) -> list[dict[str, Any]]:
    """The rows of ``garment`` made of ``cloth`` on one clip."""
    from_each = starts(garment, cloth, clip, body, networks)
    referee = Referee.of(garment, cloth, clip, body, from_each["skinning"])
    made = fold_constants(garment, body, cloth)
    named = {"garment": garment.name, "fabric": cloth.name, "clip": clip.name, "fps": clip.fps}
    rows, drawn = [], {}
    for method, start in from_each.items():
        for sweeps, contact in product(options.sweeps, options.cloth_contact):
            if contact and not sweeps:
                continue
            found = folded(made, start, clip, sweeps, cloth_contact=contact)
            knobs = {"method": method, "sweeps": sweeps, "cloth_contact": contact}
            rows.append(named | knobs | referee.figures(found, start))
            if method == "network_0" and sweeps in SHEET_SWEEPS:
                drawn[sweeps] = found.vertices
    if options.physics:
        least = bound(referee, from_each)
        add_physics(rows, least)
        rows.append(named | physics_row(referee, least))
    if options.apart:
        least = bound(referee, from_each, keeps_apart=True)
        for row in rows:
            row["gain_apart"] = metrics.gain(plain_row(rows)["energy_j"], row["energy_j"], least.energy_j)
            row["self_intersections_apart"] = float(intersection_count(least.vertices, referee.cloth.faces).mean())
    if options.sheets:
        picture = fold_sheet(drawn, referee)
        save_png(options.sheets / f"folds_{garment.name}_{cloth.name}.png", picture, colours=SHEET_COLOURS)
    return rows


@dataclass(frozen=True, eq=False)
class Bound:
    """The physics of a few frames of a clip: their numbers ``few`` among the measured ones, where the ``vertices`` [m]
    (n, V, 3) are, mean energy and detail, the processor time of a frame."""

    few: np.ndarray
    vertices: np.ndarray
    energy_j: float
    detail_mm: float
    processor_s: float


def bound(referee: Referee, from_each: dict[str, np.ndarray], *, keeps_apart: bool = False) -> Bound:
    """The optimum of ``OPTIMA`` of the measured frames, from the first and the last of the starts, or of cloth that
    ``keeps_apart`` from itself, from the last one; minutes, once."""
    clip = referee.clip
    few = np.linspace(0, len(clip.measured) - 1, min(OPTIMA, len(clip.measured))).astype(int)
    best = [from_each[name][clip.measured[few]].astype(np.float64) for name in from_each]
    contact = BodyContact(referee.body.faces, referee.body.vertex_count)
    task = physics.Task.of_garment(
        referee.garment, referee.body, referee.cloth, referee.material,
        contact=contact, body_vertices=clip.body_vertices[few], skinned=best[0],
        starts=(best[-1],) if keeps_apart else (best[0], best[-1]),
    )  # fmt: skip
    if keeps_apart:
        optimum, _ = ipc_optimum.stored_minimum(task, CACHE_DIR)
    else:
        optimum, _ = stored_minimum(task, physics.STEPS, CACHE_DIR)
    parts = physics.energy_parts(
        optimum.vertices, task.cloth, task.material, contact, task.body_vertices, height_m=referee.height_m[few]
    )
    return Bound(
        few,
        optimum.vertices,
        float(np.stack(list(parts.values())).sum(axis=0).mean()),
        float(referee.low_pass.detail_mm(optimum.vertices).mean()),
        float(optimum.processor_s.mean()),
    )


def plain_row(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Skinning's row without sweeps."""
    return next(row for row in rows if row["method"] == "skinning" and not row["sweeps"])


def physics_row(referee: Referee, least: Bound) -> dict[str, Any]:
    """What of a row the optimum has; ``ms`` is the processor time of one of its frames."""
    rest, faces = referee.garment.vertices.astype(np.float64), referee.cloth.faces
    return {
        "method": "physics",
        "sweeps": 0,
        "ms": 1e3 * least.processor_s,
        "energy_j": least.energy_j,
        "gain": 1.0,
        "edge_pct": float(metrics.edge_strain_pct(least.vertices, rest, faces).mean()),
        "detail_mm": least.detail_mm,
        "detail_share": 1.0,
        "self_intersections": float(intersection_count(least.vertices, faces).mean()),
    }


def add_physics(rows: list[dict[str, Any]], least: Bound) -> None:
    """Adds ``gain`` and ``detail_share`` to ``rows``: 0 is skinning's, the row without sweeps, 1 that of ``least``."""
    plain = plain_row(rows)
    for row in rows:
        row["gain"] = metrics.gain(plain["energy_j"], row["energy_j"], least.energy_j)
        row["detail_share"] = metrics.gain(-plain["detail_mm"], -row["detail_mm"], -least.detail_mm)


def fold_sheet(drawn: dict[int, np.ndarray], referee: Referee) -> np.ndarray:
    """A row for each number of sweeps, every third frame beside the other, as plain cloth under a raking light."""
    frames = len(referee.clip.poses) // 4 + SHEET_STEP * np.arange(SHEET_FRAMES)
    posed = referee.body.posed_vertices(referee.clip.poses[frames])
    extent = SHEET_MARGIN * max(float(np.ptp(vertices[frames, :, 1], axis=1).max()) for vertices in drawn.values())
    rows = []
    for vertices in drawn.values():
        row = []
        for frame, skin in zip(frames, posed, strict=True):
            cloth = vertices[frame].astype(np.float64)
            surfaces = [Surface(skin, referee.body.faces, SKIN), Surface(cloth, referee.cloth.faces, PLAIN_CLOTH)]
            centre = 0.5 * (cloth.min(axis=0) + cloth.max(axis=0))
            row.append(
                render(surfaces, size=SHEET_SIZE, azimuth_deg=20.0, centre=centre, extent_m=extent, light=RAKING_LIGHT)
            )
        rows.append(row)
    return sheet(rows)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.folds", description="What folds make of a clip.")
    common.add_inputs(parser)
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), metavar="NAME", help="default: all four")
    parser.add_argument("--sweeps", nargs="+", type=int, default=list(SWEEPS))
    parser.add_argument("--fps", type=float, default=FPS)
    parser.add_argument("--frames", type=int, help=f"of a clip at most (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument(
        "--cloth-contact", action="store_const", const=(False, True), default=(False,),
        help="also cloth that keeps to the room between its sheets",
    )  # fmt: skip
    parser.add_argument("--physics", action="store_true", help="also gain and share of detail, slow")
    parser.add_argument(
        "--apart", action="store_true", help="also gain beside cloth that keeps apart from itself, slow"
    )
    parser.add_argument("--sheets", type=Path, metavar="FOLDER", help="draw folds_GARMENT_FABRIC.png there")
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or (["tshirt"] if options.quick else ["tshirt", "dress"])
    options.motions = options.motions or (["walk"] if options.quick else ["walk", "squat"])
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    if options.quick:
        options.fabrics = options.fabrics[:1]
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body, folder = load_body(), model_folder(options.model)
    networks = {
        f"network_{'all' if passes is None else passes}": Network(
            folder, body, threads=options.threads, precision=options.precision, passes=passes
        )
        for passes in (0, None)
    }
    warm_up()
    rows: list[dict[str, Any]] = []
    for path in find_motions(options.motions):
        clip = Clip.read(path, options.fps, options.frames, body)
        for garment in (fine_garment(open_garment(path, body)) for path in find_garments(options.garments)):
            for cloth in map(fabric, options.fabrics):
                found = measure(garment, cloth, clip, body, networks, options)
                common.print_table(found, COLUMNS)
                rows += found
    print()
    common.print_table(rows, COLUMNS)
    return common.finish("folds", rows, options, frames=options.frames, model=options.model)


if __name__ == "__main__":
    sys.exit(ended(main))
