"""How skirts fly: the hem of a circle skirt in a turn on the spot and in other clips, beside a simulator's.

    python -m benchmarks.swing
    python -m benchmarks.swing --garments dress --motions turn

The turn on the spot (``spin``): from rest to ``--rate`` turns a second in 0.75 s, held for 1.25 s, stopped in 0.3 s.
Methods: ``static``, the network's drape of every pose; ``network``, with what it has learned of motion; ``swing``, the
nodes of ``drape.live``; ``swing_folds``, two steps of folds on that; ``simulator``: the fabric's full mesh with the
fabric's friction on the skin, the same air and damping (``benchmarks.judge.simulator``); ``slippery``: the same
without friction, whose cloth slips around the hips. Both start at the physics optimum of the first pose.

``rise_mm`` is the most that the hem's mean height rises over that of the first frames, ``share`` of the simulator's.
``error_mm``: mean distance of the hem's twelve parts' middles from the simulator's. ``jitter_ratio`` over static's.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from benchmarks.judge.physics import held_by_waist
from benchmarks.judge.simulator import Motion, Sheet, simulate
from benchmarks.measure.hem import hem_vertices
from benchmarks.shared import common
from benchmarks.shared.network import Network, add_precision
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.metrics import third_difference_square
from drape.contact.skin import shaped_skin
from drape.errors import ended
from drape.garment.cache import Garment
from drape.graph.feeds import kinematics
from drape.graph.packing import pack_body
from drape.live.fold_constants import delivered_rest, fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.swing_constants import swing_constants
from drape.live.swing_step import swing
from drape.motion.readers import read_motion
from service.graphs.engine import Engine
from service.graphs.onnx_runtime import Device
from service.graphs.packing import Packer, ScenePlan
from service.stages.motion import Memory, Moment, advance

SPIN, TURNS_PER_S = "spin", 1.0
FPS, SECONDS, QUICK_SECONDS = 30.0, 4.5, 1.5
PARTS, STILL_FRAMES = 12, 10
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "method": "s", "ms": ".2f", "rise_mm": ".1f", "share": ".2f",
    "slippery_share": ".2f", "error_mm": ".1f", "hem_mm": ".1f", "jitter_ratio": ".2f", "at_rest_pct": ".0f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Clip:
    """F poses with the root's places [m] (F, 3)."""

    name: str
    poses: np.ndarray
    trans: np.ndarray


def spin(fps: float, seconds: float, turns_per_s: float) -> Clip:
    """A body with its arms down that turns on the spot and stops."""
    time_s = np.arange(round(seconds * fps)) / fps
    rate = np.interp(time_s, [0.5, 1.25, 2.5, 2.8], 2.0 * np.pi * turns_per_s * np.array([0.0, 1.0, 1.0, 0.0]))
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / fps])
    poses = np.zeros((len(time_s), 24, 3))
    poses[:, 0, 1] = (yaw + np.pi) % (2.0 * np.pi) - np.pi
    poses[:, 16, 2], poses[:, 17, 2] = -1.1, 1.1
    return Clip(SPIN, poses, np.zeros((len(time_s), 3)))


@dataclass(frozen=True, eq=False)
class Scene:
    """A garment in a fabric over a clip, its static drape [m] (F, V, 3) and the skin's samples (F, S, 8)."""

    garment: Garment
    body: BodyModel
    fabric: Fabric
    clip: Clip
    static: np.ndarray
    skin: np.ndarray

    @classmethod
    def of(cls, garment: Garment, body: BodyModel, cloth: Fabric, clip: Clip, network: Network) -> Scene:
        static = network.made_of(cloth).drape(garment, clip.poses).vertices[:, : garment.vertex_count]
        table = shaped_skin(body).table(*body.bones(clip.poses), np.zeros((len(clip.poses), body.shape_count)))
        return cls(garment, body, cloth, clip, static, table.reshape(len(clip.poses), -1, table.shape[-1]))

    def frame(self, i: int, vertices: np.ndarray) -> Frame:
        return Frame(vertices.astype(np.float32), self.skin[i], i / FPS)


def learned(scene: Scene, engine: Engine) -> np.ndarray:
    """The network with its code of motion, frame by frame as a stream would get it."""
    body, clip, packer = scene.body, scene.clip, Packer(engine, scene.body)
    packer.add(scene.garment.name, scene.garment)
    key = packer.dressed(scene.garment.name, scene.fabric)
    shape, at = pack_body(body), kinematics(body, clip.poses, clip.trans)
    rows, memory, found = shape.rows(clip.poses), Memory.empty(engine), []
    for i in range(len(clip.poses)):
        (memory,) = advance(engine, [memory], [Moment(i / FPS, at[i])])
        arrays = {name: value[i : i + 1] for name, value in rows.items()} | {"dynamic_code": memory.code[None]}
        found.append(packer.run(ScenePlan(passes=0), arrays, [(key, 0)])[0].arrays["vertices"])
    return np.stack(found) + shape.root


def swung(scene: Scene, *, folds: int) -> tuple[np.ndarray, float]:
    """The static drape with swing, and ``folds`` steps on that; the median processor time [ms] of a frame's swing."""
    swinging = swing_constants(scene.garment, scene.body, scene.fabric)
    folding = fold_constants(scene.garment, scene.body, scene.fabric)
    memory, folded, found, ms = None, None, [], []
    for i, vertices in enumerate(scene.static):
        begin = time.thread_time()
        x = vertices
        if swinging is not None:
            x, memory = swing(swinging, memory, scene.frame(i, vertices), scene.clip.trans[i])
        ms.append(1e3 * (time.thread_time() - begin))
        if folds:
            x, folded, _ = fold(folding, folded, scene.frame(i, x), FoldEffort(folds))
        found.append(x)
    return np.stack(found), float(np.median(ms))


def simulated(scene: Scene, *, friction: float) -> tuple[np.ndarray, float]:
    """What ``benchmarks.judge.simulator`` makes of it."""
    garment, clip, body = scene.garment, scene.clip, scene.body
    mesh = ClothMesh.of(delivered_rest(garment), garment.faces.astype(np.int64), garment.vertex_count)
    made = swing_constants(garment, body, scene.fabric)
    sheet = Sheet(mesh, Material.of(scene.fabric), friction, 0.0 if made is None else made.damping_per_s)
    motion = Motion(body, clip.poses, clip.trans, FPS)
    return simulate(sheet, motion, scene.static[0].astype(np.float64), held_by_waist(garment, body, scene.static))


def hem_parts(x: np.ndarray, scene: Scene) -> np.ndarray:
    """Middles [m] (F, ``PARTS``, 3) of the hem's parts by their direction at rest."""
    rest = scene.garment.vertices[: scene.garment.vertex_count].astype(np.float64)
    hem = hem_vertices(rest, scene.garment.faces)
    way = rest[hem] - rest[hem].mean(axis=0)
    part = ((np.arctan2(way[:, 0], way[:, 2]) / (2.0 * np.pi) + 0.5) * PARTS).astype(int) % PARTS
    return np.stack([x[:, hem[part == p]].mean(axis=1) for p in np.unique(part)], axis=1)


def figures(x: np.ndarray, scene: Scene, simulator: np.ndarray | None) -> dict[str, Any]:
    """The columns of a row."""
    static, own = (hem_parts(one.astype(np.float64), scene) for one in (scene.static, x))
    square, base = (
        third_difference_square(one.astype(np.float64) + scene.clip.trans[:, None]) for one in (x, scene.static)
    )
    height = own[..., 1].mean(axis=1)
    row = {
        "rise_mm": 1e3 * float((height - height[:STILL_FRAMES].mean()).max()),
        "hem_mm": 1e3 * float(np.linalg.norm(own - static, axis=-1).mean()),
        "jitter_ratio": float(np.sqrt(square / base)) if base > 0.0 else float("nan"),
    }
    if simulator is not None:
        row["error_mm"] = 1e3 * float(np.linalg.norm(own - hem_parts(simulator, scene), axis=-1).mean())
    return row


def measure(scene: Scene, engine: Engine, *, judged: bool) -> list[dict[str, Any]]:
    """The rows of a scene."""
    named = {"garment": scene.garment.name, "fabric": scene.fabric.name, "clip": scene.clip.name}
    simulators = {}
    if judged:
        simulators = {
            "simulator": simulated(scene, friction=scene.fabric.friction), "slippery": simulated(scene, friction=0.0)
        }  # fmt: skip
    simulator = simulators["simulator"][0] if judged else None
    swinging, ms = swung(scene, folds=0)
    drapes = {
        "static": scene.static, "network": learned(scene, engine), "swing": swinging,
        "swing_folds": swung(scene, folds=2)[0],
    }  # fmt: skip
    drapes |= {name: x for name, (x, _) in simulators.items()}
    rows = [{**named, "method": name, **figures(x, scene, simulator)} for name, x in drapes.items()]
    for row in rows:
        if row["method"] == "swing":
            row["ms"] = ms
        if row["method"] in simulators:
            row["at_rest_pct"] = simulators[row["method"]][1]
        for key, name in (("share", "simulator"), ("slippery_share", "slippery")):
            if judged:
                row[key] = row["rise_mm"] / next(one["rise_mm"] for one in rows if one["method"] == name)
    return rows


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.swing", description="How skirts fly.")
    common.add_inputs(parser)
    parser.add_argument("--fabrics", nargs="+", default=["jersey"], metavar="NAME")
    parser.add_argument("--rate", type=float, default=TURNS_PER_S, help="turns a second of the spin")
    parser.add_argument("--seconds", type=float, help=f"of a clip (default {SECONDS}, quick {QUICK_SECONDS})")
    parser.add_argument("--no-simulator", action="store_true", help="without the simulator, which takes minutes")
    add_precision(parser)
    common.add_options(parser)
    options = parser.parse_args(arguments)
    options.garments = options.garments or ["circle_skirt"]
    options.motions = options.motions or [SPIN]
    options.seconds = options.seconds or (QUICK_SECONDS if options.quick else SECONDS)
    options.no_simulator = options.no_simulator or options.quick
    return options


def clips_of(options: argparse.Namespace) -> list[Clip]:
    """The clips that are asked for, at ``FPS``."""
    clips = [spin(FPS, options.seconds, options.rate)] if SPIN in options.motions else []
    others = [name for name in options.motions if name != SPIN]
    for path in find_motions(others) if others else []:
        motion, count = read_motion(path).resampled(FPS), round(options.seconds * FPS)
        clips.append(Clip(motion.name, np.array(motion.poses[:count]), np.array(motion.trans[:count])))
    return clips


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the table and the record, and returns the record."""
    options = parse(arguments)
    torch.set_num_threads(options.threads)
    body, folder = load_body(), model_folder(options.model)
    network = Network(folder, body, threads=options.threads, precision=options.precision, passes=0)
    engine = Engine(folder, device=Device(threads=options.threads), int8=options.precision == "int8")
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        garment = open_garment(path, body)
        for cloth in map(fabric, options.fabrics):
            for clip in clips_of(options):
                scene = Scene.of(garment, body, cloth, clip, network)
                rows += measure(scene, engine, judged=not options.no_simulator)
                common.print_table(rows[-6:], COLUMNS)
    return common.finish("swing", rows, options, fps=FPS, model=options.model)


if __name__ == "__main__":
    sys.exit(ended(main))
