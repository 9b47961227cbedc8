"""Garments worn over each other: what comes through with and without layers, what that costs, how long it takes.

    python -m benchmarks.quality.outfits
    python -m benchmarks.quality.outfits --outfits trousers+tshirt tank+longsleeve --motions $DRAPE_DATA/motions --save

An outfit is written inner+outer, of names or files. Rows come in twos: "alone" is the outer garment pushed out of the
body only, "over" out of the inner garment as well; the inner one is the same in both. Percentages are of delivered
vertices, means over hard poses; times are of one frame through the service's packed graph and push-out, both garments
together: wall-clock median and least, and the processor's time, which other work on the machine moves little.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.jitter import Window, typical_windows
from benchmarks.shared import common
from benchmarks.shared.render import CLOTH, SKIN, Surface, render, save_png, sheet
from benchmarks.speed.setup import timed
from drape.artifacts import DEFAULT_MODEL, load_manifest, model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.errors import InputError, ended
from drape.garment.cache import GARMENTS_DIR, Garment, load_garment
from drape.geometry import closest
from drape.graph.feeds import garment_feed
from drape.graph.packing import pack_body
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from drape.push.projection import CLEARANCE_M
from model_export.folder import add_push_out
from service.engine import PUSH_OVER, Engine
from service.packing import Packer, ScenePlan
from service.push import Pusher
from service.runtime import Device

OUTFITS = ("trousers+tshirt", "trousers+longsleeve", "tank+longsleeve", "shorts+tshirt")
FRAMES, QUICK_FRAMES = 8, 1
SECONDS, QUICK_SECONDS = 6.0, 0.5
SHOWN_M = 0.03  # farther out, a vertex is another part of the body's: a hip beside a sleeve
INNER = (0.78, 0.30, 0.32)
PICTURE_SIZE, PICTURE_M = (420, 300), 1.6
COLUMNS = {
    "outfit": "s", "method": "s", "through_pct": ".3f", "through_worst_pct": ".2f", "inner_out_pct": ".2f",
    "edge_pct": ".2f", "edge_added_pp": ".2f", "area_added_pp": ".2f", "colliding_triangle_pct": ".3f",
    "jitter_ratio": ".2f", "p50_ms": ".2f", "min_ms": ".2f", "processor_ms": ".2f", "times_singles": ".2f",
}  # fmt: skip


class Worn:
    """An outfit of two in the service's packed graph and push-out, all bodies at rest and of the standard shape."""

    def __init__(self, engine: Engine, body: BodyModel, inner: Garment, outer: Garment) -> None:
        self.inner, self.outer = inner, outer
        self._keys = [inner.digest, outer.digest]
        self._packer, self._pusher = Packer(engine, body), Pusher(engine, body)
        self._shape = pack_body(body)
        for garment in (inner, outer):
            self._packer.add(garment.digest, garment)
            rest = garment.vertices[: garment.vertex_count]
            self._pusher.add(garment.digest, garment_feed(garment), rest, garment.faces)
        start = time.process_time()
        self._pusher.prepare(self._keys)
        self.prepared_s = time.process_time() - start

    @property
    def root(self) -> np.ndarray:
        """Where the root joint is [m] (3,), to which all vertices are relative."""
        return self._shape.root

    def drapes(self, poses: np.ndarray, keys: Sequence[str] | None = None) -> tuple[list[np.ndarray], np.ndarray]:
        """The network's vertices [m] (F, V, 3) of each garment, and the samples (F, R, 12, 8) of the posed skin."""
        keys, count = self._keys if keys is None else keys, len(poses)
        items = [(key, frame) for key in keys for frame in range(count)]
        found = [r.arrays for r in self._packer.run(ScenePlan(skin=True), self._shape.rows(poses), items)]
        layers = [found[i : i + count] for i in range(0, len(found), count)]
        skin = np.stack([one["skin"] for one in layers[0]])
        return [np.stack([one["vertices"] for one in layer]) for layer in layers], skin

    def alone(self, layer: int, vertices: np.ndarray, skin: np.ndarray) -> np.ndarray:
        """``vertices`` of a layer pushed out of the body."""
        return self._pusher.push(self._keys[layer : layer + 1], vertices, skin).vertices

    def over(self, vertices: np.ndarray, under: np.ndarray, skin: np.ndarray) -> np.ndarray:
        """``vertices`` of the outer garment pushed out of the body and of the inner one at ``under``."""
        return self._pusher.push(self._keys, vertices, skin, under=under).vertices

    def two_singles(self, pose: np.ndarray) -> None:
        """One frame of each garment by itself, as two requests."""
        for layer, key in enumerate(self._keys):
            (vertices,), skin = self.drapes(pose, [key])
            self.alone(layer, vertices, skin)

    def outfit(self, pose: np.ndarray) -> None:
        """One frame of both over each other, as one request."""
        (inner, outer), skin = self.drapes(pose)
        self.over(outer, self.alone(0, inner, skin), skin)


def measure(worn: Worn, body: BodyModel, poses: np.ndarray, window: Window | None) -> list[dict[str, Any]]:
    """The two rows of an outfit, less their times."""
    inner_faces, faces = worn.inner.faces.astype(np.int64), worn.outer.faces.astype(np.int64)
    rest = worn.outer.vertices[: worn.outer.vertex_count].astype(np.float64)
    (below, drapes), skin = worn.drapes(poses)
    under = worn.alone(0, below, skin)
    posed = body.posed_vertices(poses) - worn.root
    rows: list[dict[str, Any]] = []
    for method in ("alone", "over"):
        found = worn.alone(1, drapes, skin) if method == "alone" else worn.over(drapes, under, skin)
        through = metrics.through_pct(found, under, inner_faces)
        row = {
            "method": method,
            "through_pct": float(through.mean()),
            "through_worst_pct": float(through.max()),
            "inner_out_pct": float(inner_out_pct(under, found, faces).mean()),
            "edge_pct": float(metrics.edge_strain_pct(found, rest, faces).mean()),
            "area_pct": float(metrics.area_strain_pct(found, rest, faces).mean()),
            "colliding_triangle_pct": float(metrics.colliding_triangle_pct(found, posed, body.faces).mean()),
        }
        row["edge_added_pp"] = row["edge_pct"] - (rows[0] if rows else row)["edge_pct"]
        row["area_added_pp"] = row["area_pct"] - (rows[0] if rows else row)["area_pct"]
        if window is not None:
            row["jitter_ratio"] = _jitter(worn, method, window.poses)
        rows.append(row)
    return rows


def picture(worn: Worn, body: BodyModel, pose: np.ndarray) -> list[np.ndarray]:
    """The outfit in ``pose`` (1, 24, 3): with the outer garment pushed out of the body only, and over the inner one."""
    (below, drapes), samples = worn.drapes(pose)
    under, skin = worn.alone(0, below, samples)[0], body.posed_vertices(pose)[0] - worn.root
    shown = []
    for outer in (worn.alone(1, drapes, samples)[0], worn.over(drapes, under[None], samples)[0]):
        surfaces = [
            Surface(skin, body.faces, SKIN),
            Surface(under, worn.inner.faces, INNER),
            Surface(outer, worn.outer.faces, CLOTH),
        ]
        shown.append(render(surfaces, size=PICTURE_SIZE, azimuth_deg=25.0, centre=np.zeros(3), extent_m=PICTURE_M))
    return shown


def inner_out_pct(inner: np.ndarray, outer: np.ndarray, outer_faces: np.ndarray) -> np.ndarray:
    """Share of the vertices ``inner`` (B, U, 3) that show: within ``SHOWN_M`` before the outer garment's triangles."""
    shares = []
    for under, over in zip(inner, outer, strict=True):
        beside = closest.on_border(closest.closest_point(under, over, outer_faces), outer_faces)
        distance = closest.signed_distance(under, over, outer_faces)
        shares.append((~beside & (distance > 0.0) & (distance < SHOWN_M)).mean())
    return 100.0 * np.array(shares)


def _jitter(worn: Worn, method: str, poses: np.ndarray) -> float:
    (below, drapes), skin = worn.drapes(poses)
    found = worn.alone(1, drapes, skin)
    if method == "over":
        found = worn.over(drapes, worn.alone(0, below, skin), skin)
    base = metrics.third_difference_square(drapes)
    return float(np.sqrt(metrics.third_difference_square(found) / base))


def times(worn: Worn, pose: np.ndarray, seconds: float) -> dict[str, dict[str, Any]]:
    """Milliseconds of one frame of both garments, by method; the two take turns, so that a busy machine hits both."""
    calls: dict[str, Callable[[np.ndarray], None]] = {"alone": worn.two_singles, "over": worn.outfit}
    spent: dict[str, list[float]] = {method: [] for method in calls}
    clocks = {method: timed(lambda call=call: call(pose), seconds=seconds) for method, call in calls.items()}
    for _ in range(clocks["over"].calls):
        for method, call in calls.items():
            start = time.process_time()
            call(pose)
            spent[method].append(1e3 * (time.process_time() - start))
    found: dict[str, dict[str, Any]] = {}
    for method, clock in clocks.items():
        found[method] = {
            "p50_ms": clock.p50_ms,
            "min_ms": clock.min_ms,
            "processor_ms": float(np.median(spent[method])),
        }
    found["over"]["times_singles"] = found["over"]["processor_ms"] / found["alone"]["processor_ms"]
    return found


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality.outfits", description="Garments over each other."
    )
    parser.add_argument("--outfits", nargs="+", default=[], help=f"inner+outer (default: {' '.join(OUTFITS)})")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, help=f"poses (default {FRAMES}, quick {QUICK_FRAMES})")
    parser.add_argument("--picture", type=Path, help="draw every outfit, without layers above and with them below")
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"name under assets/models, or a folder (default {DEFAULT_MODEL})"
    )
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.outfits = options.outfits or (OUTFITS[2:3] if options.quick else OUTFITS)
    options.frames = options.frames or (QUICK_FRAMES if options.quick else FRAMES)
    return options


def open_engine(model: Path, folder: Path, threads: int) -> Engine:
    """The model, in a copy in ``folder`` with the graphs of the push-out where it does not have them."""
    if PUSH_OVER not in load_manifest(model).graphs:
        copy = folder / model.name
        shutil.copytree(model, copy)
        add_push_out(copy, load_garment(next(iter(sorted(GARMENTS_DIR.glob("shorts-*.npz"))))))
        model = copy
    return Engine(model, device=Device(threads=threads))


def open_outfit(text: str, body: BodyModel) -> tuple[Garment, Garment]:
    """Inner and outer garment of ``text``; refuses any other number."""
    names = text.split("+")
    if len(names) != 2:
        raise InputError("--outfits", expected="inner+outer", got=text, cure="For example trousers+tshirt.")
    inner, outer = (open_garment(find_garments([name])[0], body) for name in names)
    return inner, outer


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    body = load_body()
    clips = [read_motion(path) for path in find_motions(options.motions)]
    poses = hard_poses(clips, body, options.frames)
    windows = [] if options.quick else typical_windows(clips)
    rows: list[dict[str, Any]] = []
    drawn: list[list[np.ndarray]] = []
    with tempfile.TemporaryDirectory(prefix="outfits-") as folder:
        engine = open_engine(model_folder(options.model), Path(folder), options.threads)
        for text in options.outfits:
            worn = Worn(engine, body, *open_outfit(text, body))
            found = measure(worn, body, poses.poses, windows[0] if windows else None)
            taken = times(worn, poses.poses[:1], QUICK_SECONDS if options.quick else SECONDS)
            rows += [{"outfit": text} | row | taken[row["method"]] for row in found]
            rows[-1]["prepared_s"] = worn.prepared_s
            if options.picture:
                drawn.append(picture(worn, body, poses.poses[len(drawn) % len(poses.poses)][None]))
            print(f"{text}: measured, tables in {worn.prepared_s:.1f} s of the processor", flush=True)
        if options.picture:
            save_png(options.picture, sheet([list(row) for row in zip(*drawn, strict=True)]))
        print()
        common.print_table(rows, COLUMNS)
        return common.finish(
            "outfits",
            rows,
            options,
            frames=list(poses.labels),
            window=windows[0].label if windows else None,
            model=options.model,
            model_digest=load_manifest(model_folder(options.model)).digest,
            clearance_m=CLEARANCE_M,
        )


if __name__ == "__main__":
    sys.exit(ended(main))
