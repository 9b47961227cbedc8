"""How well each form of patch could drape at best: the ceiling that no network passes.

    python -m benchmarks.papers.representation
    python -m benchmarks.papers.representation --garments tshirt --frames 4 --patches 50 100 200 --save
    python -m benchmarks.papers.representation --quick

Every frame's energy (membrane, bending, gravity, contact with the posed body) is minimised over the free
numbers of the patches, from the skinned start, by L-BFGS (representation_minimise.py); what a
form is stands in representation_space.py. ``--patches`` are shares [%] of the count by rule. ``free``, every vertex
for itself, starts from the better of the physics optimum of benchmarks.quality and the best form, and ends the scale
of the gain.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.judge import physics
from benchmarks.judge.physics_cache import CACHE_DIR
from benchmarks.measure.judged import Judged
from benchmarks.papers.held_out import figures, judged
from benchmarks.papers.representation_minimise import STEP_LIMIT, Minimum, minimise
from benchmarks.papers.representation_space import (
    REPRESENTATIONS,
    Charts,
    PatchSpace,
    Representation,
    VertexSpace,
    block_scaling,
    charts,
    repartitioned,
)
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import energies, metrics
from drape.cloth.material import Material, material
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.fitting import RestGarment
from drape.garment.partition import patch_count_for
from drape.garment.skin import BodyBinding
from drape.geometry.rotations import matrix_to_quaternion
from drape.geometry.skinning import blend_frames
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion

GARMENTS = ("tshirt", "trousers", "dress")
COLUMNS = {
    "garment": "s", "method": "s", "patches": "d", "numbers": "d", "membrane_j": ".4f", "energy_j": ".4f",
    "edge_pct": ".2f", "area_pct": ".2f", "colliding_vertex_pct": ".3f", "gain": ".3f", "steps": ".0f",
    "change": ".1e", "residual_j": ".1e", "seconds": ".0f",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Bench:
    """One garment on F posed bodies: what all forms of patch share."""

    judge: Judged
    rest: RestGarment
    bones: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, garment: Garment, body: BodyModel, poses: np.ndarray, cloth: Material) -> Bench:
        """The bench of ``garment`` in ``cloth`` on ``body`` at ``poses`` (F, 24, 3) [rad]."""
        binding = BodyBinding(garment.skin_weights.astype(np.float64), garment.shapedirs.astype(np.float64))
        rest = RestGarment(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64), binding, body)
        return cls(judged(garment, body, poses, cloth), rest, body.bones(poses))


class Objective:
    """The energy of one frame in the variables of a space."""

    def __init__(self, bench: Bench, frame: int, space: PatchSpace | VertexSpace) -> None:
        judge = bench.judge
        self._space, self._contact, self._material = space, judge.cloth.contact, judge.cloth.material
        self._cloth, self._height_m = judge.cloth.mesh.like(torch.zeros(1)), float(judge.height_m[frame])
        self._body = judge.body_vertices[frame][None], judge.body_normals[frame][None]
        self._planes = None

    def refresh(self, z: Tensor) -> None:
        with torch.no_grad():
            points = self._space.positions(z)
        self._planes = self._contact.planes(points[None].double().numpy(), *self._body).like(points)

    def value_and_gradient(self, z: Tensor) -> tuple[float, Tensor]:
        assert self._planes is not None
        moving = z.detach().requires_grad_()
        points = self._space.positions(moving)
        distance = self._planes.distance(points)[0]
        parts = energies.total(points, self._cloth, self._material, distance=distance, height_m=self._height_m)
        total = torch.stack([part.sum() for part in parts.values()]).sum()
        (gradient,) = torch.autograd.grad(total, moving)
        return float(total.detach()), gradient


@dataclass(frozen=True, eq=False)
class Drapes:
    """F frames minimised in ``spaces``: ``vertices`` [m] (F, V, 3), what was reached, and CPU ``seconds``."""

    spaces: Sequence[PatchSpace | VertexSpace]
    vertices: np.ndarray
    minima: Sequence[Minimum]
    seconds: float


def frame_spaces(bench: Bench, form: Representation, found: Charts) -> list[PatchSpace]:
    """What ``form`` can make of each frame, every patch scaled by itself."""
    scaling = block_scaling(form, found)
    if not form.skinned:
        return [PatchSpace(form, found, *frame, scaling) for frame in posed_frames(bench, found)]
    rotations, translations = bench.bones
    weights, frames = bench.rest.binding.weights, len(rotations)
    matrices = (weights @ rotations.reshape(frames, -1, 9)).reshape(frames, -1, 3, 3)
    skins = zip(matrices, weights @ translations, strict=True)
    return [PatchSpace(form, found, found.rotation, found.centre, scaling, skin=skin) for skin in skins]


def posed_frames(bench: Bench, found: Charts) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation (K, 3, 3) and centre (K, 3) [m] of the patches in each frame, moved rigidly by the bones."""
    rotations, translations = bench.bones
    rest = np.broadcast_to(found.centre, (len(rotations), *found.centre.shape))
    heaviest, quaternions = found.bones.argmax(axis=1), matrix_to_quaternion(rotations)
    rotation, centre = blend_frames(rest, found.bones, heaviest, rotations, translations, quaternions)
    return list(zip(rotation @ found.rotation, centre, strict=True))


def drape(bench: Bench, spaces: Sequence[PatchSpace | VertexSpace], *, step_limit: int) -> Drapes:
    """Every frame's energy minimised in its space, from zero, which is the skinned start."""
    began = time.process_time()
    minima = [
        minimise(Objective(bench, frame, space), torch.zeros(space.size), step_limit=step_limit)
        for frame, space in enumerate(spaces)
    ]
    seconds = time.process_time() - began
    with torch.no_grad():
        vertices = [space.positions(found.z).double().numpy() for space, found in zip(spaces, minima, strict=True)]
    return Drapes(spaces, np.stack(vertices), minima, seconds)


def measure(bench: Bench, options: argparse.Namespace) -> list[Row]:
    """One row per method, skinning first, ``free`` last."""
    judge, folder = bench.judge, None if options.no_physics_cache else CACHE_DIR
    cloth = judge.cloth
    rows = [row_of(bench, "skinning", judge.skinned), row_of(bench, "skinning_push", judge.pushed)]
    by_rule = patch_count_for(float(bench.rest.areas.sum()))
    best: tuple[float, np.ndarray] = np.inf, judge.skinned
    for percent in options.patches:
        garment = cloth.garment
        if percent != 100:
            garment = repartitioned(garment, bench.rest, round(by_rule * percent / 100.0))
        found = charts(garment, cloth.mesh, cloth.material)
        for form in (REPRESENTATIONS[name] for name in options.forms):
            if percent != 100 and (form.skinned or form.turns):
                continue
            drapes = drape(bench, frame_spaces(bench, form, found), step_limit=options.steps)
            size = {"patches": found.patch_count, "numbers": form.number_count, "percent": percent}
            rows.append(size | row_of(bench, form.name, drapes.vertices, drapes))
            best = min(best, (rows[-1]["energy_j"], drapes.vertices), key=lambda one: one[0])
    optimum, _ = judge.optimum((judge.pushed,), folder, min(physics.STEPS, options.steps))
    rows.append(row_of(bench, "physics", optimum.vertices) | {"steps": float(optimum.steps.mean())})
    start = min(best, (rows[-1]["energy_j"], optimum.vertices), key=lambda one: one[0])[1]
    stiffness = physics.vertex_stiffness(cloth.mesh, cloth.material)
    free = drape(bench, [VertexSpace(frame, stiffness) for frame in start], step_limit=2 * options.steps)
    rows.append(row_of(bench, "free", free.vertices, free))
    for row in rows:
        row["gain"] = metrics.gain(rows[1]["energy_j"], row["energy_j"], rows[-1]["energy_j"])
    return rows


def row_of(bench: Bench, method: str, vertices: np.ndarray, drapes: Drapes | None = None) -> Row:
    """The row of a method, printed as it comes."""
    row = {"garment": bench.judge.cloth.garment.name, "method": method} | figures(bench.judge, vertices)
    if drapes is not None:
        row |= {
            "steps": float(np.mean([m.steps for m in drapes.minima])),
            "change": max(m.change for m in drapes.minima),
            "residual_j": float(np.mean([m.residual_j for m in drapes.minima])),
            "seconds": drapes.seconds,
        }
    print(f"{row['garment']} {method}: {row['energy_j']:.4f} J", flush=True)
    return row


@Benchmark(
    "representation",
    "What each form of patch can reach at best.",
    COLUMNS,
    Option("--garments", GARMENTS, "names, files or folders", GARMENTS[:1]),
    Option("--motions", (), "names, files or folders"),
    Option("--frames", 2, "hard poses", 1),
    Option("--patches", (100, 50, 200), "patch counts in % of the rule", (100,)),
    Option("--forms", tuple(REPRESENTATIONS), "forms of patch", ("paper", "rigid_2"), choices=REPRESENTATIONS),
    Option("--steps", STEP_LIMIT, "most steps per frame", 60),
    Option("--no-physics-cache", False, "neither read nor store physics optima"),
)
def main(run: Run) -> None:
    """Rows of every garment."""
    options, body = run.options, load_body()
    if min(options.patches) <= 0:
        raise InputError("--patches", expected="shares above 0 %", got=str(options.patches), cure="Give 100, say.")
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    for path in find_garments(options.garments):
        run.rows += measure(Bench.of(open_garment(path, body), body, poses.poses, material()), options)
    run.extra |= {"frames": list(poses.labels), "steps": options.steps}


if __name__ == "__main__":
    main.command()
