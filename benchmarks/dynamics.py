"""How a dynamic model moves: what its hem does after an abrupt stop, and what motion costs (docs/guide/training.md).

    python -m benchmarks.dynamics --model NAME [--garments dress skirt] [--motions FILE ...] [--save]

The stop: a clip is cut in its middle and the last pose is held for three seconds. The hem's distance from the
static drape says how far it swings, the first frame from which on every bit stays says when it rests.

The potential: over the moving clips, the incremental potential of the cloth (energy, contact and inertia, as in
training) with motion in full and with motion 0. "own": after the frames that the same drape made before; "given":
both after those of the moving drape, so that they answer the same question, where the cloth should be next.
Everything is computed by the classes of the service, with the graph that it runs on a CPU, on the garment's
subdivided mesh.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure.hem import hem_vertices
from benchmarks.shared import common
from drape.artifacts import DEFAULT_MODEL, model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import check_body, find_garments, find_motions, open_garment
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material, material
from drape.errors import ArtifactError, DrapeError
from drape.garment.cache import Garment
from drape.graph.feeds import kinematics
from drape.graph.packing import pack_body
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion
from service.graphs.engine import Engine
from service.graphs.onnx_runtime import Device
from service.graphs.packing import Packer, ScenePlan
from service.stages.motion import Memory, Moment, advance

FPS = 30.0
HOLD_S = 3.0
REST_LIMIT_S = 2.0
AFTER_S = (0.0, 0.1, 0.2, 0.4, 0.8, 1.2, 1.6, 2.0)  # the stop; when the hem's distance is told
POTENTIAL_FRAMES, QUICK_FRAMES = 90, 12
STATIC_EXIT = 3  # so that scripts/bench can tell a model without dynamics from a failure
STOP_COLUMNS = {"garment": "s", "clip": "s", "peak_mm": ".1f", "swings": "d"}
STOP_COLUMNS |= {"millimetre_s": ".2f", "rest_s": ".2f"} | {f"{after_s:g}s": ".2f" for after_s in AFTER_S}
POTENTIAL_COLUMNS = {"garment": "s", "clip": "s", "frames": "d"} | {
    f"{kind}_{motion}_j": ".5f" for kind in ("own", "given", "inertia") for motion in ("dynamic", "static")
}


class NotDynamic(ArtifactError):
    """A static model, whose motion there is nothing to measure of."""


@dataclass(frozen=True, eq=False)
class Subject:
    """One garment on the body, its subdivided mesh in the store of the packed graph."""

    garment: Garment
    packer: Packer
    cloth: ClothMesh
    hem: np.ndarray  # vertices


def subject(engine: Engine, garment: Garment, body: BodyModel) -> Subject:
    """``garment`` ready for draping on ``body`` and measuring on its subdivided mesh."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    packer = Packer(engine, body)
    packer.add(garment.name, replace(garment, vertex_count=len(garment.vertices), faces=garment.fine_faces))
    return Subject(garment, packer, ClothMesh.from_rest(rest, faces), hem_vertices(rest, faces))


def stopped(clip: MotionClip, *, fps: float = FPS, hold_s: float = HOLD_S) -> tuple[MotionClip, int]:
    """The first half of ``clip`` at ``fps`` with its last pose held, and the index of that pose."""
    paced = clip.resampled(fps)
    stop = max(2, paced.frame_count // 2)
    index = np.minimum(np.arange(stop + 1 + round(hold_s * fps)), stop)
    return replace(paced, poses=paced.poses[index], trans=paced.trans[index]), stop


def drape(engine: Engine, body: BodyModel, what: Subject, clip: MotionClip, *, motion: float) -> np.ndarray:
    """Vertices [m] (F, V, 3) float32 relative to the root joint, frame by frame as a stream would get them."""
    rows, at = pack_body(body).rows(clip.poses), kinematics(body, clip.poses, clip.trans)
    memory, frames = Memory.empty(engine), []
    for i in range(clip.frame_count):
        if motion > 0.0:
            (memory,) = advance(engine, [memory], [Moment(i / clip.fps, at[i])])
        code = np.float32(motion) * memory.code[None]
        arrays = {key: value[i : i + 1] for key, value in rows.items()} | {"dynamic_code": code}
        frames.append(what.packer.run(ScenePlan(), arrays, [(what.garment.name, 0)])[0].arrays["vertices"])
    return np.stack(frames)


def stop_row(engine: Engine, body: BodyModel, what: Subject, clip: MotionClip) -> dict[str, Any]:
    """What the hem does after the stop; times [s] since the stop, distances [mm] from the static drape."""
    held, stop = stopped(clip)
    after = drape(engine, body, what, held, motion=1.0)[stop:]
    still = drape(engine, body, what, held.window(stop, 1), motion=0.0)[0]
    away = after[:, what.hem].astype(np.float64) - still[what.hem]
    distance_mm = 1e3 * np.linalg.norm(away, axis=-1).mean(axis=1)
    differs = [not np.array_equal(frame, still) for frame in after]
    rest = 1 + max((i for i, other in enumerate(differs) if other), default=-1)
    rests = rest < len(after)
    over = np.flatnonzero(distance_mm > 1.0)
    row = {
        "garment": what.garment.name,
        "clip": held.name,
        "peak_mm": float(distance_mm.max()),
        "swings": swings(away.mean(axis=1)),
        "millimetre_s": float(over[-1] + 1 if len(over) else 0) / FPS,
        "rest_s": rest / FPS if rests else None,
        "rests_in_time": rests and rest <= REST_LIMIT_S * FPS,
        "still_frames": len(after) - rest,
        "bits_stay": rests and all(frame.tobytes() == after[-1].tobytes() for frame in after[rest:]),
    }
    return row | {f"{after_s:g}s": float(distance_mm[round(after_s * FPS)]) for after_s in AFTER_S}


def swings(way: np.ndarray, *, least_m: float = 5e-4) -> int:
    """How often ``way`` (F, 3) [m] goes through its end along its main direction, to ``least_m`` on the other side."""
    main = np.linalg.svd(way, full_matrices=False)[2][0]
    along = way @ main
    sides = np.sign(along[np.abs(along) >= least_m])
    return int(np.count_nonzero(np.diff(sides)))


def potential_row(
    engine: Engine,
    body: BodyModel,
    what: Subject,
    clip: MotionClip,
    contact: BodyContact,
    cloth_material: Material,
    *,
    frames: int,
) -> dict[str, Any]:
    """Mean incremental potential [J] per frame of the moving and of the static drape over the middle of ``clip``."""
    paced = clip.resampled(FPS)
    count = min(frames, paced.frame_count)
    part = paced.window((paced.frame_count - count) // 2, count)
    way = (part.trans - part.trans[0])[:, None]
    world = {
        motion: drape(engine, body, what, part, motion=knob).astype(np.float64) + way
        for motion, knob in (("dynamic", 1.0), ("static", 0.0))
    }
    skin = body.posed_vertices(part.poses, part.trans) - part.trans[0] - pack_body(body).root
    height = metrics.mean_height(world["static"], what.cloth)
    row: dict[str, Any] = {"garment": what.garment.name, "clip": clip.name, "frames": count - 2}
    for motion, vertices in world.items():
        parts = metrics.static_parts(vertices, what.cloth, cloth_material, contact, skin, height_m=height)
        energy = np.stack(list(parts.values())).sum(axis=0)[2:]
        own, given = (_inertia(vertices, history, what, cloth_material) for history in (vertices, world["dynamic"]))
        row |= {
            f"own_{motion}_j": float((energy + own).mean()),
            f"given_{motion}_j": float((energy + given).mean()),
            f"inertia_{motion}_j": float(own.mean()),
            f"energy_{motion}_j": float(energy.mean()),
        }
    return row


def _inertia(vertices: np.ndarray, history: np.ndarray, what: Subject, cloth_material: Material) -> np.ndarray:
    """Inertia's part [J] (F-2,) of ``vertices`` after the frames of ``history``."""
    return energies.inertia(
        vertices[2:], history[1:-1], history[:-2], what.cloth, cloth_material, dt_s=1.0 / FPS
    )  # fmt: skip


def open_engine(folder: Path, body: BodyModel, *, threads: int) -> Engine:
    """The dynamic model in ``folder``; a static one is refused."""
    engine = Engine(folder, device=Device(threads=threads))
    check_body(f"model {folder.name}", engine.manifest.body_digest, body)
    if not engine.dynamic:
        raise NotDynamic(
            f"model {folder.name}",
            expected="a dynamic model",
            got="a static one, which does not move by itself",
            cure="Train with --preset dynamic and export that; benchmarks.quality measures static drapes.",
        )
    return engine


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.dynamics", description="Swinging, coming to rest and incremental potential."
    )
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"name under assets/models, or a folder (default {DEFAULT_MODEL})"
    )
    parser.add_argument("--garments", nargs="+", default=["dress", "tshirt"], help="names, files or folders")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--frames", type=int, default=POTENTIAL_FRAMES, help="of each clip, for the potential")
    common.add_options(parser)
    options = parser.parse_args(arguments)
    if options.quick:
        options.garments, options.motions = options.garments[:1], options.motions or ["walk"]
        options.frames = min(options.frames, QUICK_FRAMES)
    return options


def measure(engine: Engine, body: BodyModel, garment: Garment, clips: Sequence[MotionClip], frames: int) -> list[dict]:
    """Two rows for every clip: kind "stop" and kind "potential"."""
    contact, cloth_material, what = (
        BodyContact(body.faces, body.vertex_count),
        material(),
        subject(engine, garment, body),
    )
    rows: list[dict[str, Any]] = []
    for clip in clips:
        rows.append({"kind": "stop"} | stop_row(engine, body, what, clip))
        potential = potential_row(engine, body, what, clip, contact, cloth_material, frames=frames)
        rows.append({"kind": "potential"} | potential)
    return rows


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Prints the tables and the record, and returns the record."""
    options = parse(arguments)
    body = load_body()
    engine = open_engine(model_folder(options.model), body, threads=options.threads)
    clips = [read_motion(path) for path in find_motions(options.motions)]
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        rows += measure(engine, body, open_garment(path, body), clips, options.frames)
    for kind, columns in (("stop", STOP_COLUMNS), ("potential", POTENTIAL_COLUMNS)):
        common.print_table([row for row in rows if row["kind"] == kind], columns)
        print()
    return common.finish(
        "dynamics",
        rows,
        options,
        model=options.model,
        model_digest=engine.manifest.digest,
        fps=FPS,
        graph="packed_int8" if engine.int8 else "packed",
    )


if __name__ == "__main__":
    try:
        main()
    except DrapeError as error:
        print(error, file=sys.stderr)
        sys.exit(STATIC_EXIT if isinstance(error, NotDynamic) else 2)
