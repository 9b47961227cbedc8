"""How a dynamic model moves: its hem after an abrupt stop, and the cloth's potential (docs/guide/training.md).

    python -m benchmarks.dynamics --model NAME [--garments dress skirt] [--motions FILE ...] [--save]

The stop: a clip is cut in its middle and the last pose is held for three seconds. The hem's distance from the static
drape says how far it swings; the first frame from which on every bit stays says when it rests.

The potential: the incremental potential of the cloth (energy, contact and inertia, as in training) over the moving
clips, with motion in full and with motion 0. "own" is after the frames that the same drape made before. "given" is
after those of the moving drape for both, so that both answer where the cloth should be next. Everything is computed by
the classes of the service, with the graph that it runs on a processor, on the garment's subdivided mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.hem import hem_vertices
from benchmarks.network import Network
from benchmarks.scenes import FPS
from benchmarks.tables import Row
from drape.artifacts import model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material, material
from drape.errors import Unavailable
from drape.garment.cache import Garment
from drape.graph.packing import pack_body
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion

HOLD_S = 3.0
REST_LIMIT_S = 2.0
AFTER_S = (0.0, 0.1, 0.2, 0.4, 0.8, 1.2, 1.6, 2.0)  # the stop; when the hem's distance is told
COLUMNS = {"kind": "s", "garment": "s", "clip": "s", "peak_mm": ".1f", "swings": "d", "millimetre_s": ".2f"}
COLUMNS |= {"rest_s": ".2f"} | {f"{after_s:g}s": ".2f" for after_s in AFTER_S} | {"frames": "d"}
COLUMNS |= {f"{kind}_{motion}_j": ".5f" for kind in ("own", "given", "inertia") for motion in ("dynamic", "static")}


@dataclass(frozen=True, eq=False)
class Subject:
    """A garment that the network drapes on a body, its subdivided mesh and that one's ``hem`` vertices."""

    garment: Garment
    network: Network
    body: BodyModel
    mesh: ClothMesh
    hem: np.ndarray

    @classmethod
    def of(cls, garment: Garment, network: Network, body: BodyModel) -> Subject:
        """``garment`` ready to be draped and measured."""
        rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
        return cls(garment, network, body, ClothMesh.from_rest(rest, faces), hem_vertices(rest, faces))

    def drape(self, clip: MotionClip, *, motion: float) -> np.ndarray:
        """Vertices [m] (F, V, 3) float32 relative to the root joint, frame by frame as a stream gets them."""
        return self.network.moving(self.garment, clip.poses, clip.trans, clip.fps, motion=motion)


def stopped(clip: MotionClip, *, hold_s: float = HOLD_S) -> tuple[MotionClip, int]:
    """The first half of ``clip`` at ``FPS`` with its last pose held, and the index of that pose."""
    paced = clip.resampled(FPS)
    stop = max(2, paced.frame_count // 2)
    index = np.minimum(np.arange(stop + 1 + round(hold_s * FPS)), stop)
    return replace(paced, poses=paced.poses[index], trans=paced.trans[index]), stop


def stop_row(what: Subject, clip: MotionClip) -> Row:
    """The hem's motion after the stop: times [s] since the stop, distances [mm] from the static drape."""
    held, stop = stopped(clip)
    after = what.drape(held, motion=1.0)[stop:]
    still = what.drape(held.window(stop, 1), motion=0.0)[0]
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


def potential_row(what: Subject, clip: MotionClip, cloth: Material, *, frames: int) -> Row:
    """Mean incremental potential [J] per frame of the moving and of the static drape over the middle of ``clip``."""
    paced = clip.resampled(FPS)
    count = min(frames, paced.frame_count)
    part = paced.window((paced.frame_count - count) // 2, count)
    way = (part.trans - part.trans[0])[:, None]
    world = {
        motion: what.drape(part, motion=knob).astype(np.float64) + way
        for motion, knob in (("dynamic", 1.0), ("static", 0.0))
    }
    body = what.body
    skin = body.posed_vertices(part.poses, part.trans) - part.trans[0] - pack_body(body).root
    contact, height = BodyContact(body.faces, body.vertex_count), metrics.mean_height(world["static"], what.mesh)
    row: Row = {"garment": what.garment.name, "clip": clip.name, "frames": count - 2}
    for motion, vertices in world.items():
        parts = metrics.static_parts(vertices, what.mesh, cloth, contact, skin, height_m=height)
        energy = np.stack(list(parts.values())).sum(axis=0)[2:]
        own, given = (_inertia(vertices, history, what.mesh, cloth) for history in (vertices, world["dynamic"]))
        row |= {
            f"own_{motion}_j": float((energy + own).mean()),
            f"given_{motion}_j": float((energy + given).mean()),
            f"inertia_{motion}_j": float(own.mean()),
            f"energy_{motion}_j": float(energy.mean()),
        }
    return row


def _inertia(vertices: np.ndarray, history: np.ndarray, mesh: ClothMesh, cloth: Material) -> np.ndarray:
    """Inertia's part [J] (F-2,) of ``vertices`` after the frames of ``history``."""
    return energies.inertia(vertices[2:], history[1:-1], history[:-2], mesh, cloth, dt_s=1.0 / FPS)


def open_network(folder: Path, body: BodyModel, *, threads: int) -> Network:
    """The dynamic model in ``folder``; refuses (``Unavailable``) a static one."""
    network = Network(folder, body, threads=threads)
    if not network.engine.dynamic:
        raise Unavailable(
            f"model {folder.name}",
            expected="a dynamic model",
            got="a static one, which does not move by itself",
            cure="Train with --preset dynamic and export that; benchmarks.quality measures static drapes.",
        )
    return network


def measure(what: Subject, clips: Sequence[MotionClip], frames: int) -> list[Row]:
    """Two rows for every clip: kind "stop" and kind "potential"."""
    rows: list[Row] = []
    for clip in clips:
        rows.append({"kind": "stop"} | stop_row(what, clip))
        rows.append({"kind": "potential"} | potential_row(what, clip, material(), frames=frames))
    return rows


@Benchmark(
    "dynamics",
    "Swinging, coming to rest and incremental potential.",
    COLUMNS,
    *inputs(("dress", "tshirt"), quick_garments=("dress",), quick_motions=("walk",)),
    Option("--frames", 90, "of each clip, for the potential", 12),
)
def main(run: Run) -> None:
    """Rows of every garment over every clip."""
    options, body = run.options, load_body()
    network = open_network(model_folder(options.model), body, threads=options.threads)
    clips = [read_motion(path) for path in find_motions(options.motions)]
    for path in find_garments(options.garments):
        run.rows += measure(Subject.of(open_garment(path, body), network, body), clips, options.frames)
    run.rows.sort(key=lambda row: row["kind"], reverse=True)
    run.extra |= {"model": options.model, "fps": FPS, **network.record()}


if __name__ == "__main__":
    main.command()
