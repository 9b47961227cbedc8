"""How skirts fly: hems in a turn on the spot, a stop, a step up, a fall and in other clips, beside a simulator's.

    python -m benchmarks.swing
    python -m benchmarks.swing --garments dress --motions turn

In the turn on the spot (``spin``) the body goes from rest to ``--rate`` turns a second in 0.75 s, keeps that for 1.25 s
and stops in 0.3 s; ``WAYS`` has the stop, the step and the fall. Methods: ``static``, the network's drape of every
pose; ``network``, with what it has learned of motion; ``swing``, the nodes of ``drape.live``; ``swing_folds``, two
steps of folds on that; ``simulator``, the full mesh with the fabric's friction on the skin, the same air and damping
(``benchmarks.judge.simulator``), from the static drape on. A clip of it takes about twenty minutes, so scenes are run
one by one, and ``--save`` keeps the record's rows of all others.

``rise_mm`` is the most that the hem's mean height rises over that of the first frames, ``share`` of the simulator's.
``error_mm`` is the mean distance of the middles of the hem's twelve parts from the simulator's, ``jitter_ratio`` is
over that of ``static``. ``period_s``, ``over`` and ``settle_s`` are the hem's after the body has come to a stand
(``benchmarks.measure.hem.swinging``), and ``period_share`` and ``settle_share`` those of the simulator's.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.cases import FPS, CaseClip, CaseScene
from benchmarks.harness import RESULTS_DIR, Benchmark, Option, Run, inputs
from benchmarks.judge.physics import anchored_waistband
from benchmarks.judge.simulator import SimulatedCloth, SimulatedMotion, simulate
from benchmarks.measure.hem import hem_vertices, swinging
from benchmarks.measure.judged import jitter_ratio
from benchmarks.model_drape import ModelDrape
from benchmarks.stopwatch import Clock
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.swing_constants import swing_constants
from drape.live.swing_step import swing

SPIN, TURNS_PER_S = "spin", 1.0
FALL_M, GRAVITY_M_S2, LANDING_S = 1.0, 9.81, 0.12


def turn_yaw(time_s: np.ndarray, turns_per_s: float) -> np.ndarray:
    """Returns the yaw [rad] (F,) at the times ``time_s`` (F,) of a body that turns ``turns_per_s`` from 1.25 s to
    2.5 s, and stands before 0.5 s and after 2.8 s."""
    rate = np.interp(time_s, [0.5, 1.25, 2.5, 2.8], 2.0 * np.pi * turns_per_s * np.array([0.0, 1.0, 1.0, 0.0]))
    return _summed(rate, time_s)


def stop_way(time_s: np.ndarray) -> np.ndarray:
    """Returns the displacements [m] (F, 3) of the root at ``time_s`` (F,) of a body that goes forward with 1.4 m/s and
    stops within 0.2 s."""
    rate = np.interp(time_s, [0.5, 1.0, 1.6, 1.8], [0.0, 1.4, 1.4, 0.0])
    return _summed(rate, time_s)[:, None] * np.array([0.0, 0.0, 1.0])


def step_way(time_s: np.ndarray) -> np.ndarray:
    """Returns the displacements [m] (F, 3) of the root at ``time_s`` (F,) of a body that steps up and forward by 0.3 m
    in 0.4 s."""
    share = np.clip((time_s - 0.5) / 0.4, 0.0, 1.0)
    return (0.3 * share**2 * (3.0 - 2.0 * share))[:, None] * np.array([0.0, 1.0, 1.0])


def fall_way(time_s: np.ndarray) -> np.ndarray:
    """Returns the displacements [m] (F, 3) of the root at ``time_s`` (F,) of a body that falls freely by ``FALL_M`` and
    is at rest ``LANDING_S`` later."""
    free_s = np.sqrt(2.0 * FALL_M / GRAVITY_M_S2)
    rate = np.interp(time_s, 0.5 + np.array([0.0, free_s, free_s + LANDING_S]), [0.0, -GRAVITY_M_S2 * free_s, 0.0])
    return _summed(rate, time_s)[:, None] * np.array([0.0, 1.0, 0.0])


WAYS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"stop": stop_way, "step": step_way, "fall": fall_way}
MADE = (SPIN, *WAYS)


def made_clip(name: str, body: BodyModel, fps: float, seconds: float, turns_per_s: float = TURNS_PER_S) -> CaseClip:
    """Returns the clip ``name`` of ``MADE``, ``seconds`` long: ``body`` with lowered arms, turning or moving as that
    name says."""
    time_s = np.arange(round(seconds * fps)) / fps
    poses = np.zeros((len(time_s), 24, 3))
    poses[:, 16, 2], poses[:, 17, 2] = -1.1, 1.1
    if name == SPIN:
        poses[:, 0, 1] = (turn_yaw(time_s, turns_per_s) + np.pi) % (2.0 * np.pi) - np.pi
        return CaseClip.of(name, fps, poses, body)
    return CaseClip.of(name, fps, poses, body, trans=WAYS[name](time_s))


def _summed(rate: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])


PARTS, STILL_FRAMES = 12, 10
SCENE = ("garment", "fabric", "clip")
# Figures of a drape, and the name of their share of the simulator's.
SHARES = {"rise_mm": "share", "period_s": "period_share", "settle_s": "settle_share"}
COLUMNS = {
    "garment": "s", "fabric": "s", "clip": "s", "method": "s", "ms": ".2f", "rise_mm": ".1f", "share": ".2f",
    "period_s": ".2f", "period_share": ".2f", "over": ".2f", "settle_s": ".2f",
    "settle_share": ".2f", "error_mm": ".1f", "hem_mm": ".1f", "jitter_ratio": ".2f", "at_rest_pct": ".0f",
}  # fmt: skip


def swung(scene: CaseScene, static: np.ndarray, *, folds: int) -> tuple[np.ndarray, float]:
    """Returns the drapes ``static`` [m] (F, V, 3) of ``scene`` after swing and after ``folds`` steps of folds on that,
    [m] (F, V, 3), and the median processor time [ms] of swing in a frame."""
    clip, memory, folded, clock, drapes = scene.clip, None, None, Clock(), []
    swinging = swing_constants(scene.garment, scene.body, scene.fabric)
    for i, vertices in enumerate(static):
        x = vertices
        with clock:
            if swinging is not None:
                frame = Frame(vertices.astype(np.float32), clip.skin[i], i / clip.fps)
                x, memory = swing(swinging, memory, frame, clip.trans[i])
        if folds:
            frame = Frame(x.astype(np.float32), clip.skin[i], i / clip.fps)
            x, folded, _ = fold(scene.constants, folded, frame, FoldEffort(folds))
        drapes.append(x)
    return np.stack(drapes), float(np.median(clock.cpu_ms))


def simulate_scene(scene: CaseScene, static: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns what ``simulate`` returns for the delivered mesh of ``scene``, which begins at the first of the drapes
    ``static`` [m] (F, V, 3): vertices [m] (F, V, 3), and the share [%] of frames that came to rest."""
    garment, clip, body = scene.garment, scene.clip, scene.body
    mesh = ClothMesh.of(garment.delivered_rest(), garment.faces.astype(np.int64), garment.vertex_count)
    swings = swing_constants(garment, body, scene.fabric)
    damping_per_s = 0.0 if swings is None else swings.damping_per_s
    sheet = SimulatedCloth(mesh, Material.of(scene.fabric), scene.fabric.friction, damping_per_s)
    motion = SimulatedMotion(body, clip.poses, clip.trans, clip.fps)
    return simulate(sheet, motion, static[0].astype(np.float64), anchored_waistband(garment, body, static))


def hem_parts(x: np.ndarray, scene: CaseScene) -> np.ndarray:
    """Returns the mean places [m] (F, P, 3) of the P parts of the hem of ``x`` (F, V, 3): of the up to ``PARTS`` equal
    sectors around the body into which its vertices fall at rest."""
    rest = scene.garment.vertices[: scene.garment.vertex_count].astype(np.float64)
    hem = hem_vertices(rest, scene.garment.faces)
    way = rest[hem] - rest[hem].mean(axis=0)
    part = ((np.arctan2(way[:, 0], way[:, 2]) / (2.0 * np.pi) + 0.5) * PARTS).astype(int) % PARTS
    return np.stack([x[:, hem[part == p]].mean(axis=1) for p in np.unique(part)], axis=1)


def hem_figures(x: np.ndarray, scene: CaseScene, static: np.ndarray, simulator: np.ndarray | None) -> Row:
    """Returns the figures of the hem in a swinging drape ``x`` [m] (F, V, 3) of ``scene``, beside the drape without
    swing ``static`` (F, V, 3).

    "rise_mm" is the most that its mean height rises over that of the first frames, "hem_mm" its mean distance from the
    static hem, and "jitter_ratio" the jitter over that of ``static``. Where the body stops before the clip ends there
    are also those of ``swinging``. If ``simulator`` (F, V, 3) is given there is "error_mm", the mean distance from its
    hem.
    """
    still, own = (hem_parts(drape.astype(np.float64), scene) for drape in (static, x))
    moved, base = (drape.astype(np.float64) + scene.clip.trans[:, None] for drape in (x, static))
    height = own[..., 1].mean(axis=1)
    row = {
        "rise_mm": 1e3 * float((height - height[:STILL_FRAMES].mean()).max()),
        "hem_mm": 1e3 * float(np.linalg.norm(own - still, axis=-1).mean()),
        "jitter_ratio": jitter_ratio(moved, base),
    }
    places = np.concatenate([scene.clip.poses.reshape(len(x), -1), scene.clip.trans], axis=1)
    rests = 1 + np.flatnonzero(np.diff(places, axis=0).any(axis=1))
    if len(rests) and rests[-1] < len(x) - 1:
        row |= swinging(own[rests[-1] :], scene.clip.fps)
    if simulator is not None:
        row["error_mm"] = 1e3 * float(np.linalg.norm(own - hem_parts(simulator, scene), axis=-1).mean())
    return row


def measure_scene(scene: CaseScene, network: ModelDrape, *, simulator: bool) -> list[Row]:
    """Returns a row for each method of ``scene``: "static", "network", "swing", "swing_folds" and, if ``simulator`` is
    true, "simulator". All rows then also have the ratios ``SHARES`` to the simulator's figures."""
    garment, clip, of_fabric = scene.garment, scene.clip, network.made_of(scene.fabric)
    static = of_fabric.drape(garment, clip.poses)
    delivered = static.vertices[:, : garment.vertex_count]
    learned = of_fabric.moving(garment, clip.poses, clip.trans, clip.fps)[:, : garment.vertex_count] + static.root
    swinging, ms = swung(scene, delivered, folds=0)
    drapes = {"static": delivered, "network": learned, "swing": swinging}
    drapes["swing_folds"], _ = swung(scene, delivered, folds=2)
    more: dict[str, dict[str, Any]] = {"swing": {"ms": ms}}
    if simulator:
        drapes["simulator"], at_rest = simulate_scene(scene, delivered)
        more["simulator"] = {"at_rest_pct": at_rest}
    rows = [
        {
            **scene.name,
            "method": name,
            **hem_figures(x, scene, delivered, drapes.get("simulator")),
            **more.get(name, {}),
        }
        for name, x in drapes.items()
    ]
    beside = {row["method"]: row for row in rows}
    for row in rows if simulator else ():
        for name, share in SHARES.items():
            row[share] = row[name] / beside["simulator"][name] if beside["simulator"].get(name) else np.nan
    return rows


def of_other_scenes(rows: list[Row]) -> list[Row]:
    """Returns the rows of the record ``swing.json`` whose scene is that of none of ``rows``."""
    path = RESULTS_DIR / "swing.json"
    stored = json.loads(path.read_text())["rows"] if path.is_file() else []
    own = {tuple(row[name] for name in SCENE) for row in rows}
    return [row for row in stored if tuple(row[name] for name in SCENE) not in own]


@Benchmark(
    "swing",
    "How skirts fly.",
    COLUMNS,
    *inputs(("circle_skirt", "dress"), MADE, quick_garments=("circle_skirt",), quick_motions=(SPIN,)),
    Option("--fabrics", ("jersey",), "what garments are made of"),
    Option("--rate", TURNS_PER_S, "turns a second of the spin"),
    Option("--seconds", 4.5, "of a clip", 1.5),
    Option("--no-simulator", False, "without the simulator, which takes minutes", True),
)
def main(run: Run) -> None:
    """Adds to ``run`` the rows of every garment in every fabric over every clip, and those of the record of other
    scenes."""
    options, body = run.options, load_body()
    network = ModelDrape.asked(options, body, passes=0)
    others = [name for name in options.motions if name not in MADE]
    own = [name for name in MADE if name in options.motions]
    clips = [made_clip(name, body, FPS, options.seconds, options.rate) for name in own]
    frames = round(options.seconds * FPS)
    clips += [CaseClip.read(path, FPS, frames, body) for path in (find_motions(others) if others else ())]
    for path in find_garments(options.garments):
        garment = open_garment(path, body)
        for cloth in map(fabric, options.fabrics):
            for clip in clips:
                run.add(measure_scene(CaseScene(garment, cloth, clip), network, simulator=not options.no_simulator))
    run.rows += of_other_scenes(run.rows)
    run.extra |= {"fps": FPS, "model": options.model}


if __name__ == "__main__":
    main.command()
