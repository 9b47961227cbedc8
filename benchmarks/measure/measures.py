"""One garment measured: five drapes of the same poses, and numbers that compare them (docs/reference/quality.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.judge import physics
from benchmarks.judge.physics_cache import stored_minimum
from benchmarks.measure.hem import hang_mm
from benchmarks.measure.intersections import intersection_count
from benchmarks.measure.jitter import Window, jitter
from benchmarks.shared.network import Draped, Network
from drape.body.model import BodyModel
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.detail import LowPass, dihedral_deg
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import RestState, modelled
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin, shaped_skin
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.geometry.skinning import skin_points
from drape.graph.push_feed import push_feed
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.motion.hard_poses import HardPoses
from training.disagreement import disagreement

METHODS = ("skinning", "skinning_push", "network", "network_push", "folds", "physics")
STEPS = 2  # of folds, as the service takes by default


@dataclass(frozen=True, eq=False)
class Bench:
    """What all garments share: the posed bodies, the contact surface, the drape network and the cloth.

    ``windows`` are what jitter is measured on; ``physics_folder`` keeps optima between runs, None does not.

    ``fabric``: what the garments are made of, in their own rest state; None for the cloth ``material`` of before
    fabrics, whose rest is the mesh as modelled. ``of_fabric`` sets it with the networks and the material.
    ``uncorrected`` is the network without corrections, from which folds start; without it, or a fabric, there are none.
    """

    body: BodyModel
    poses: HardPoses
    contact: BodyContact
    body_vertices: np.ndarray
    body_normals: np.ndarray
    network: Network
    material: Material
    step_limit: int
    windows: Sequence[Window] = ()
    physics_folder: Path | None = None
    fabric: Fabric | None = None
    uncorrected: Network | None = None

    def of_fabric(self, fabric: Fabric) -> Bench:
        """The same bench with all garments of ``fabric``."""
        uncorrected = None if self.uncorrected is None else self.uncorrected.made_of(fabric)
        network = self.network.made_of(fabric)
        return replace(self, fabric=fabric, material=Material.of(fabric), network=network, uncorrected=uncorrected)

    def rest_state(self, garment: Garment) -> RestState:
        """The cloth of ``garment`` without stress."""
        if self.fabric is not None:
            return garment.rest_state()
        return modelled(garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64))


def measure(garment: Garment, bench: Bench, *, trained: bool) -> list[dict[str, Any]]:
    """One row per method; what does not apply to a method is not in its row."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    state = bench.rest_state(garment)
    cloth, low_pass = ClothMesh.of(state, faces, len(rest)), LowPass.of(state, faces, len(rest))
    positions, draped, optimum, was_cached = drapes(garment, bench, cloth)
    height = metrics.mean_height(positions["skinning"], cloth)
    rows: dict[str, dict[str, Any]] = {}
    methods = [method for method in METHODS if method in positions]
    for method in methods:
        vertices = positions[method]
        parts = physics.energy_parts(
            vertices, cloth, bench.material, bench.contact, bench.body_vertices, height_m=height
        )
        rows[method] = {
            "garment": garment.name,
            "set": "trained" if trained else "unseen",
            "method": method,
            **({} if bench.fabric is None else {"fabric": bench.fabric.name}),
            "edge_pct": float(metrics.edge_strain_pct(vertices, rest, faces).mean()),
            "area_pct": float(metrics.area_strain_pct(vertices, rest, faces).mean()),
            "colliding_vertex_pct": float(
                metrics.colliding_vertex_pct(vertices, bench.body_vertices, bench.body_normals).mean()
            ),
            "colliding_triangle_pct": float(
                metrics.colliding_triangle_pct(vertices, bench.body_vertices, bench.body.faces).mean()
            ),
            "self_intersections": float(intersection_count(vertices, faces).mean()),
            "hang_mm": float(hang_mm(vertices, positions["skinning"], rest, faces).mean()),
            "detail_mm": float(low_pass.detail_mm(vertices).mean()),
            "dihedral_deg": float(dihedral_deg(vertices, faces).mean()),
            "energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean()),
            **{f"{part}_j": float(value.mean()) for part, value in parts.items()},
        }
    rows["network"] |= chart_figures(garment, draped)
    for method, found in jitter(garment, bench.network, bench.body, bench.contact, bench.windows).items():
        rows[method] |= {"jitter_ratio": found.ratio, "jitter_worst": found.worst, "jitter_by_clip": found.by_clip}
    add_comparisons(rows)
    rows["physics"] |= {
        "residual_n": float(optimum.residual_n.mean()),
        "weight_n": float(bench.material.gravity_m_s2 * cloth.vertex_mass(bench.material).sum()),
        "converged_pct": 100.0 * float(optimum.converged.mean()),
        "steps": float(optimum.steps.mean()),
        "seconds": optimum.seconds,
        "cached": was_cached,
    }
    rest_crossings = float(intersection_count(rest, faces))
    return [rows[method] | {"self_intersections_rest": rest_crossings} for method in methods]


def drapes(
    garment: Garment, bench: Bench, cloth: ClothMesh
) -> tuple[dict[str, np.ndarray], Draped, physics.Optimum, bool]:
    """World vertices [m] (F, V, 3) by method, the network's charts, the optimum, and whether that was stored."""
    poses = bench.poses.poses
    rest = garment.vertices.astype(np.float64)
    rotations, translations = bench.body.bones(poses)
    skinned = skin_points(
        np.broadcast_to(rest, (len(poses), *rest.shape)),
        garment.skin_weights.astype(np.float64),
        rotations,
        translations,
    )
    draped = bench.network.drape(garment, poses)
    pushed = nearest_vertex_push(skinned, bench.body_vertices, bench.body_normals)

    task = physics.Task.of_garment(
        garment,
        bench.body,
        cloth,
        bench.material,
        contact=bench.contact,
        body_vertices=bench.body_vertices,
        skinned=skinned,
        starts=(pushed, draped.vertices),
    )
    optimum, was_cached = stored_minimum(task, bench.step_limit, bench.physics_folder)
    positions = {
        "skinning": skinned,
        "skinning_push": pushed,
        "network": draped.vertices,
        "network_push": push_out_of_bodies(
            draped.vertices, bench.body_vertices, body_skin(bench.body), push_feed(garment, bench.body)
        ),
        "physics": optimum.vertices,
    }
    if bench.uncorrected is not None and bench.fabric is not None:
        positions["folds"] = folded(garment, bench)
    return positions, draped, optimum, was_cached


def folded(garment: Garment, bench: Bench) -> np.ndarray:
    """World vertices [m] (F, V, 3) of the poses, each a frame without a past, with the folds of the service's default:
    on the subdivided mesh, from the network without corrections, no push-out."""
    assert bench.uncorrected is not None
    poses = bench.poses.poses
    made = fold_constants(fine_garment(garment), bench.body, bench.fabric)
    table = shaped_skin(bench.body).table(*bench.body.bones(poses), np.zeros((len(poses), bench.body.shape_count)))
    start = bench.uncorrected.drape(garment, poses).vertices
    frames = (
        Frame(vertices, skin, 0.0)
        for vertices, skin in zip(start, table.reshape(len(poses), -1, table.shape[-1]), strict=True)
    )
    return np.stack([fold(made, None, frame, FoldEffort(STEPS))[0] for frame in frames]).astype(np.float64)


def chart_figures(garment: Garment, draped: Draped) -> dict[str, float]:
    """How much overlapping charts disagree before blending: 99th percentiles over all entries and vertices."""
    found = disagreement(garment, draped.jet, draped.rotation, draped.centre)
    return {
        "chart_gap_p99_mm": 1e3 * float(np.percentile(found.gap_m, 99.0)),
        "chart_normal_p99_deg": float(np.degrees(np.percentile(found.normal_rad, 99.0))),
    }


def add_comparisons(rows: dict[str, dict[str, Any]]) -> None:
    """Adds to each method's row its gain, and its strain over the physics optimum in percentage points; to the
    network's their share of the detail that physics has beyond skinning."""
    best, skin = rows["physics"], rows["skinning_push"]["energy_j"]
    for row in rows.values():
        row["gain"] = metrics.gain(skin, row["energy_j"], best["energy_j"])
        row["edge_over_physics_pp"] = row["edge_pct"] - best["edge_pct"]
        row["area_over_physics_pp"] = row["area_pct"] - best["area_pct"]
    # As the gain, of what is to rise: NaN where physics has no more detail than skinning.
    for method in ("network", "network_push", "folds"):
        if method not in rows:
            continue
        rows[method]["detail_share"] = metrics.gain(
            -rows["skinning"]["detail_mm"], -rows[method]["detail_mm"], -best["detail_mm"]
        )


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the garments of each set and fabric, one row per method; gain and share are those of the means."""
    found = []
    for group in dict.fromkeys((row["set"], row.get("fabric")) for row in rows):
        means = {}
        for method in METHODS:
            own = [row for row in rows if (row["set"], row.get("fabric")) == group and row["method"] == method]
            if not own:
                continue
            numbers = [key for key, value in own[0].items() if isinstance(value, float)]
            named = {key: own[0][key] for key in ("set", "method", "fabric") if key in own[0]}
            means[method] = (
                {"garment": "all"} | named | {key: float(np.mean([row[key] for row in own])) for key in numbers}
            )
        add_comparisons(means)
        found += means.values()
    return found
