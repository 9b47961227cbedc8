"""Frames of vertices and of jets beside each other: bytes, rounding, what jets lack of the push-out, time at both ends.

    python -m benchmarks.speed.wire [--garments tshirt dress] [--frames 8]

Rounding is the distance between vertices made of the jets before and after the wire; ``f16`` and ``u16`` are that of
half floats and of 16-bit steps for every coefficient. ``off`` is the share of vertices that lie more than 0.1 mm from
the push-out's own place, ``left`` the longest way of one, its mean over the frames and the worst; ``colliding`` counts
the vertices that are in the body, by its triangles, as they arrive. Times are of the processor: ``encode`` packs a
frame, ``decode`` makes vertices of it with numpy.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shared import common
from drape.body.model import BodyModel
from drape.catalog import find_motions
from drape.cloth import metrics
from drape.errors import ended
from drape.geometry import jets
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from drape.wire import messages as wire
from drape.wire.jets import JetFrame, pack_jets, unpack_jets
from drape.wire.layout import JetLayout, unpack_layout
from drape.wire.options import DrapeOptions
from service.compute.drape_runtime import Drapery
from service.compute.garments import Entry
from service.settings import Settings
from service.stages import run
from service.stages.batch import PoseInput

FRAMES, QUICK_FRAMES = 12, 3
OFF_M = 1e-4
COLUMNS = {
    "garment": "s", "vertices": "d", "patches": "d", "vertices_bytes": "d", "jets_bytes": "d", "layout_bytes": "d",
    "rounding_p50_mm": ".3f", "rounding_p99_mm": ".3f", "rounding_max_mm": ".3f", "f16_p99_mm": ".3f",
    "u16_p99_mm": ".3f", "left_mean_mm": ".2f", "left_max_mm": ".2f", "off_pct": ".2f",
    "vertices_colliding_pct": ".3f", "jets_colliding_pct": ".3f",
    "vertices_encode_ms": ".2f", "jets_encode_ms": ".2f", "vertices_decode_ms": ".2f", "jets_decode_ms": ".2f",
}  # fmt: skip


def frames_of(drapery: Drapery, entry: Entry, poses: np.ndarray) -> tuple[list[JetFrame], list[wire.Frame]]:
    """Every pose (F, 24, 3) draped and pushed out, as jets and as vertices."""
    trans = np.zeros((len(poses), 3))
    clip = PoseInput(poses, trans, np.zeros(drapery.body.shape_count), np.zeros(len(poses)))
    posed, draped = (
        run(drapery.plan(entry, DrapeOptions(push_out=True, motion=0.0, folds=0, geometry=geometry)), [clip])
        for geometry in ("jets", "vertices")
    )
    of_jets, of_vertices, jets, vertices = [], [], posed.jets, draped.vertices
    for i in range(len(poses)):
        patches = {"jet": jets.jet[i], "rotation": jets.rotation[i], "centre": jets.centre[i]}
        of_jets.append(JetFrame(i, 0.0, 0.0, posed.root[i], **patches, left_m=float(posed.quality.left_m[i])))
        of_vertices.append(wire.Frame(i, 0.0, 0.0, draped.root[i], vertices[i]))
    return of_jets, of_vertices


def measure(
    entry: Entry,
    of_jets: Sequence[JetFrame],
    of_vertices: Sequence[wire.Frame],
    bodies: np.ndarray,
    body_faces: np.ndarray,
) -> dict[str, Any]:
    """The row of one garment on the posed ``bodies`` [m] (F, Vb, 3)."""
    layout = unpack_layout(entry.jet_layout)
    sent = [unpack_jets(pack_jets(frame)) for frame in of_jets]
    exact = [layout.positions(frame) for frame in of_jets]
    rounding = distances(layout, sent, exact)
    both = list(zip(of_jets, sent, strict=True))
    half = [replace(rounded, jet=frame.jet.astype(np.float16).astype(np.float32)) for frame, rounded in both]
    fine = [replace(rounded, jet=wire.dequantise(*wire.quantise(frame.jet))) for frame, rounded in both]
    off = [np.linalg.norm(a - b.positions, axis=1) > OFF_M for a, b in zip(exact, of_vertices, strict=True)]
    left = np.array([frame.left_m for frame in of_jets])
    jet, vertices = of_jets[0], of_vertices[0]

    def colliding_pct(vertices: list[np.ndarray]) -> float:
        return float(metrics.colliding_triangle_pct(np.stack(vertices), bodies, body_faces).mean())

    packed_jets, packed_vertices = pack_jets(jet), wire.pack_frame(vertices)
    return {
        "garment": entry.id,
        "vertices": entry.vertex_count,
        "patches": entry.patch_count,
        "vertices_bytes": len(packed_vertices),
        "jets_bytes": len(packed_jets),
        "layout_bytes": len(entry.jet_layout),
        "rounding_p50_mm": 1e3 * float(np.median(rounding)),
        "rounding_p99_mm": 1e3 * float(np.percentile(rounding, 99)),
        "rounding_max_mm": 1e3 * float(rounding.max()),
        "f16_p99_mm": 1e3 * float(np.percentile(distances(layout, half, exact), 99)),
        "u16_p99_mm": 1e3 * float(np.percentile(distances(layout, fine, exact), 99)),
        "left_mean_mm": 1e3 * float(left.mean()),
        "left_max_mm": 1e3 * float(left.max()),
        "off_pct": 100.0 * float(np.concatenate(off).mean()),
        "vertices_colliding_pct": colliding_pct(
            [wire.unpack_frame(wire.pack_frame(f)).vertices() for f in of_vertices]
        ),
        "jets_colliding_pct": colliding_pct([layout.vertices(frame) for frame in sent]),
        "vertices_encode_ms": processor_ms(lambda: wire.pack_frame(vertices)),
        "jets_encode_ms": processor_ms(lambda: pack_jets(jet)),
        "vertices_decode_ms": processor_ms(lambda: wire.unpack_frame(packed_vertices)),
        "jets_decode_ms": processor_ms(lambda: layout.positions(unpack_jets(packed_jets))),
    }


def distances(layout: JetLayout, frames: Sequence[JetFrame], exact: Sequence[np.ndarray]) -> np.ndarray:
    """Distances [m] (F V,) of the vertices of ``frames`` from ``exact``."""
    return np.concatenate(
        [np.linalg.norm(layout.positions(frame) - at, axis=1) for frame, at in zip(frames, exact, strict=True)]
    )


def processor_ms(task: Callable[[], object], *, runs: int = 20) -> float:
    """The processor's time [ms] of one run, the median of ``runs``."""
    taken = []
    for _ in range(runs):
        start = time.process_time()
        task()
        taken.append(time.process_time() - start)
    return 1e3 * float(np.median(taken))


def hard(body: BodyModel, motions: Sequence[str], count: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """``count`` hard poses of ``motions`` and where they are."""
    chosen = hard_poses([read_motion(path) for path in find_motions(motions)], body, count)
    return chosen.poses, chosen.labels


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed.wire", description="Frames of vertices and of jets."
    )
    parser.add_argument("--garments", nargs="+", help="ids (default: the shipped ones; quick: shorts)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="wire-") as folder:
        drapery = Drapery(Settings(garments_dir=Path(folder), threads=options.threads))
    names = options.garments or (["shorts"] if options.quick else [entry.id for entry in drapery.garments.entries()])
    poses, labels = hard(drapery.body, options.motions, options.frames or (QUICK_FRAMES if options.quick else FRAMES))
    bodies, body_faces = drapery.body.posed_vertices(poses), drapery.body.faces
    rows = []
    for name in names:
        entry = drapery.garments.get(name)
        rows.append(measure(entry, *frames_of(drapery, entry, poses), bodies, body_faces))
    drapery.close()
    common.print_table(rows, COLUMNS)
    manifest = drapery.engine.manifest
    return common.finish(
        "wire", rows, options, frames=list(labels), model=manifest.name, model_digest=manifest.digest,
        numbers_per_jet=jets.FULL_COUNT,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(ended(main))
