"""How much skin shows through cloth that covers it at rest, in pictures of hard poses from four sides.

    python -m benchmarks.skin_pixels
    python -m benchmarks.skin_pixels --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --frames 12 --save
    python -m benchmarks.skin_pixels --garments $DRAPE_DATA/garments/female_jeans.obj --quick --sheets docs/images

``network`` is what is served without folds: all corrections, the delivered mesh, projected out of the skin. The others
are folds as they are served, on the network without corrections, a single pose each: in cloth that feels itself, and
lifted off the skin in the end, so that nothing is projected. ``fine`` is the mesh that they are made on, and
``wrapped``, of garments that were delivered coarse, the delivered mesh around it; ``folds`` would be theirs on the
delivered triangles. Skin is counted by ``benchmarks.measure.skin_pixels``; ``--sheets`` draws the pose in which
``network`` shows most of it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure.skin_pixels import VIEWS_DEG, PosedBody, covered_faces, skin_pixels_pct
from benchmarks.shared import common
from benchmarks.shared.network import Network, add_precision
from benchmarks.shared.render import CLOTH, SKIN, Surface, render, save_png, sheet
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin, shaped_skin
from drape.errors import ended
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment, has_finer
from drape.garment.wrapping import Wrapping
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold, warm_up
from drape.motion.hard_poses import HardPoses, hard_poses
from drape.motion.readers import read_motion
from service.stages.folds import SETTLE

FRAMES, QUICK_FRAMES = 12, 1
STEPS = 2  # of folds
SHEET_SIZE, SHEET_COLOURS = (300, 215), 64
COLUMNS = {
    "garment": "s", "method": "s", "vertices": "d", "skin_pixels_pct": ".3f", "worst_pct": ".2f", "worst": "s",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bench:
    """What all garments share: posed bodies with their pictures, the posed skin samples (F, S, 8), two networks."""

    body: BodyModel
    poses: HardPoses
    bodies: tuple[PosedBody, ...]
    skin: np.ndarray
    uncorrected: Network
    corrected: Network
    steps: int


def open_bench(options: argparse.Namespace) -> Bench:
    """Motions, bodies and networks as ``options`` ask."""
    body, folder = load_body(), model_folder(options.model)
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    table = shaped_skin(body).table(*body.bones(poses.poses), np.zeros((options.frames, body.shape_count)))
    bodies = tuple(PosedBody.of(posed, body.faces) for posed in body.posed_vertices(poses.poses))
    uncorrected, corrected = (
        Network(folder, body, threads=options.threads, precision=options.precision, passes=passes)
        for passes in (0, None)
    )
    skin = table.reshape(options.frames, -1, table.shape[-1])
    return Bench(body, poses, bodies, skin, uncorrected, corrected, options.folds)


def drapes(garment: Garment, bench: Bench) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Vertices [m] (F, V, 3) and faces of ``garment`` by method."""
    poses, fine = bench.poses.poses, fine_garment(garment)
    rest = np.broadcast_to(fine.vertices.astype(np.float64), (len(poses), *fine.vertices.shape))
    skinned = skin_points(rest, fine.skin_weights.astype(np.float64), *bench.body.bones(poses))
    started = bench.uncorrected.drape(garment, poses).vertices
    delivered = np.s_[:, : garment.vertex_count]
    corrected = bench.corrected.drape(garment, poses).vertices[delivered]
    found = {"skinning": (skinned, fine.faces), "network": (pushed(corrected, garment, bench), garment.faces)}
    folds = folded(started, fine, bench)
    if has_finer(garment):
        wrapping = Wrapping(garment)
        found["folds"] = folded(started[delivered], garment, bench), garment.faces
        found["wrapped"] = np.stack([wrapping.wrap(cloth) for cloth in folds]), garment.faces
    return found | {"fine": (folds, fine.faces)}


def folded(start: np.ndarray, garment: Garment, bench: Bench) -> np.ndarray:
    """The delivered mesh of ``garment`` from ``start`` [m] (F, V, 3), with the folds of single poses, off the skin."""
    made, effort = (
        fold_constants(garment, bench.body),
        FoldEffort(bench.steps, SETTLE, cloth_contact=True),
    )  # as is served
    frames = (Frame(vertices, skin, 0.0) for vertices, skin in zip(start, bench.skin, strict=True))
    return np.stack([fold(made, None, frame, effort)[0] for frame in frames]).astype(np.float64)


def pushed(vertices: np.ndarray, garment: Garment, bench: Bench) -> np.ndarray:
    """The delivered mesh of ``garment`` at ``vertices`` [m] (F, V, 3), pushed out of the bodies."""
    skin, rest = body_skin(bench.body), garment.vertices[: garment.vertex_count]
    posed = np.stack([body.vertices for body in bench.bodies])
    return push_out_of_bodies(vertices, posed, skin, pack_push(garment_feed(garment), rest, skin))


def measure(garment: Garment, bench: Bench, sheets: Path | None = None) -> list[dict[str, Any]]:
    """A row for each method."""
    fine = fine_garment(garment)
    covered = covered_faces(
        bench.body.v_template, bench.body.faces, fine.vertices.astype(np.float64), fine.faces.astype(np.int64)
    )
    found, rows, shares = drapes(garment, bench), [], {}
    for method, (vertices, faces) in found.items():
        seen = [
            skin_pixels_pct(body, covered, cloth, faces) for body, cloth in zip(bench.bodies, vertices, strict=True)
        ]
        shares[method] = share = np.array(seen)
        frame, view = np.unravel_index(np.nanargmax(share), share.shape)
        rows.append(
            {
                "garment": garment.name,
                "method": method,
                "vertices": vertices.shape[1],
                "skin_pixels_pct": float(np.nanmean(share)),
                "worst_pct": float(share[frame, view]),
                "worst": f"{bench.poses.labels[frame]} from {VIEWS_DEG[view]:.0f}",
            }
        )
    if sheets:
        frame = int(np.nanargmax(np.nanmean(shares["network"], axis=1)))
        save_png(sheets / f"skin_{garment.name}.png", drawn(found, bench.bodies[frame], frame), colours=SHEET_COLOURS)
    return rows


def drawn(found: dict[str, tuple[np.ndarray, np.ndarray]], body: PosedBody, frame: int) -> np.ndarray:
    """A row of four sides for each method but skinning."""
    rows = []
    for vertices, faces in list(found.values())[1:]:
        cloth = vertices[frame]
        surfaces = [Surface(body.vertices, body.faces, SKIN), Surface(cloth, faces, CLOTH)]
        centre, extent_m = 0.5 * (cloth.min(axis=0) + cloth.max(axis=0)), 1.2 * float(np.ptp(cloth, axis=0).max())
        rows.append(
            [
                render(surfaces, size=SHEET_SIZE, azimuth_deg=azimuth, centre=centre, extent_m=extent_m)
                for azimuth in VIEWS_DEG
            ]
        )
    return sheet(rows)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.skin_pixels", description="Skin that shows through.")
    common.add_inputs(parser)
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--folds", type=int, default=STEPS, help="steps of folds (%(default)s)")
    parser.add_argument("--sheets", type=Path, metavar="FOLDER", help="draw skin_GARMENT.png there")
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or (["tshirt"] if options.quick else [])
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    return options


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    bench = open_bench(options)
    warm_up()
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        found = measure(open_garment(path, bench.body), bench, options.sheets)
        common.print_table(found, COLUMNS)
        rows += found
    print()
    common.print_table(rows, COLUMNS)
    extra = {"poses": list(bench.poses.labels), "folds": options.folds, **bench.corrected.record()}
    return common.finish("skin_pixels", rows, options, **extra)


if __name__ == "__main__":
    sys.exit(ended(main))
