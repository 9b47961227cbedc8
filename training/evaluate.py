"""A quick look at a checkpoint: energies of its drape beside skinning's, without export and without physics.

    python -m training.evaluate runs/first
    python -m training.evaluate runs/first/checkpoint.pt --garments tshirt jacket.obj --frames 12

Poses are the hard ones of the clips that the run held out, or of the shipped clips where no
motion folder is at hand. docs/reference/quality.md explains the columns; ``python -m benchmarks.quality`` measures the
exported model in full.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from drape.arrays.subnormals import flushed
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric as fabric_of
from drape.cloth.material import Material, material
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin
from drape.errors import ArtifactError
from drape.files.data import data_folder
from drape.garment.cache import Garment
from drape.garment.fabric_features import rest_grain
from drape.geometry.skinning import skin_points
from drape.graph.push_feed import push_feed
from drape.motion.clip import MotionClip
from drape.motion.hard_poses import HardPoses, hard_poses
from drape.motion.readers import MOTION_SUFFIXES, read_motion
from training import checkpoint
from training.batches import BodySource, partition_tensors
from training.config import TrainConfig
from training.disagreement import disagreement
from training.losses import vertices_from
from training.onefit import OneFit, Posed, paper_vertices, posed_coefficients

FRAMES = 8
CPU = torch.device("cpu")
COLUMNS = ("membrane_j", "bending_j", "gravity_j", "contact_j", "energy_j", "edge_pct", "area_pct", "share")


def load_network(path: Path) -> tuple[OneFit, TrainConfig, int]:
    """Returns the network at ``path``, a checkpoint or the folder of a run, in evaluation mode, its configuration, and
    how many steps it was trained.

    Raises ``ArtifactError`` where the file is no checkpoint or holds a network of another build.
    """
    path = path / "checkpoint.pt" if path.is_dir() else path
    payload, config = checkpoint.load_checkpoint(path)
    model = OneFit(config.model)
    try:
        model.load_state_dict(payload["model"])
        steps = int(payload["step"])
    except (KeyError, RuntimeError) as error:
        raise ArtifactError(
            f"checkpoint {path.name}",
            expected="the weights of a network of this version",
            got=" ".join(str(error).split())[:200],
            cure="Train again, or check out the version that wrote it.",
        ) from error
    return model.eval(), config, steps


def held_out_clips(config: TrainConfig, motions: Sequence[str]) -> list[MotionClip]:
    """Returns the clips that ``motions`` names, names or paths; if it is empty those that the run held out, or the
    shipped ones, which it may have seen, where the folder of data has none."""
    folder = data_folder("motions")
    if not motions and folder is not None:
        files = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in MOTION_SUFFIXES]
        motions = [str(p) for p in files if p.stem in config.data.held_out]
    return [read_motion(path) for path in find_motions(motions)]


def posed_patches(
    model: OneFit,
    garment: Garment,
    source: BodySource,
    poses: np.ndarray,
    *,
    passes: int | None = None,
    fabric: Fabric | None = None,
) -> tuple[np.ndarray, Posed]:
    """Returns the world vertices [m] (F, V, 3), float64, of the subdivided mesh at ``poses`` (F, 24, 3) [rad] on the
    body of mean shape, and the posed patches.

    ``passes`` of the corrections are taken, all by default. ``fabric`` is what the garment is made of, its own by
    default; networks that know no fabrics ignore it.
    """
    cloth = (fabric or fabric_of(garment.fabric)) if model.config.fabric else None
    partition = partition_tensors(garment, body_skin(source.body), device=CPU, grain=rest_grain(garment))
    body = source.pose(poses, np.zeros((len(poses), source.body.shape_count))).tensors
    with torch.no_grad():
        embedding = model.garment(partition.encoder_inputs(cloth))
        posed = model(body, partition.patches, embedding, charts=partition.consensus, passes=passes)
        vertices = vertices_from(posed_coefficients(posed, partition.patches.scale), partition)
        if model.config.variant == "paper":
            vertices = paper_vertices(vertices, torch.from_numpy(garment.skin_weights(source.body)), body)
    return vertices.double().numpy() + source.body.rest_joints()[0], posed


def evaluate(
    model: OneFit,
    garment: Garment,
    body: BodyModel,
    poses: HardPoses,
    *,
    passes: int | None = None,
    fabric: Fabric | None = None,
) -> list[dict[str, Any]]:
    """Returns four rows, of the methods "skinning", "skinning_push", "network" and "network_push" at ``poses``: mean
    energies [J], "energy_j" and each part as "PART_j"; mean strains of edges and areas, "edge_pct" and "area_pct"; and
    "share", the energy over that of "skinning_push". The row "network" also has the disagreement of its charts,
    "chart_gap_p99_mm" and "chart_normal_p99_deg".

    ``passes`` and ``fabric`` are those of ``posed_patches``. For a network that knows fabrics cloth rests as the
    garment says, otherwise as its mesh is modelled.
    """
    made_of = (fabric or fabric_of(garment.fabric)) if model.config.fabric else None
    cloth_material = material() if made_of is None else Material.of(made_of)
    contact = BodyContact(body.faces, body.vertex_count)
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth = ClothMesh.from_rest(rest, faces)
    if made_of is not None:
        cloth = ClothMesh.of(garment.rest_state(), faces, len(rest))
    rotations, translations = body.bones(poses.poses)
    still = np.broadcast_to(rest, (len(poses.poses), *rest.shape))
    skinned = skin_points(still, garment.skin_weights(body).astype(np.float64), rotations, translations)
    source = BodySource(body, device=CPU)
    draped, posed = posed_patches(model, garment, source, poses.poses, passes=passes, fabric=made_of)
    skin = body.posed_vertices(poses.poses)
    normals = np.asarray(contact.normals(skin))
    positions = {
        "skinning": skinned,
        "skinning_push": nearest_vertex_push(skinned, skin, normals),
        "network": draped,
        "network_push": push_out_of_bodies(draped, skin, body_skin(body), push_feed(garment, body)),
    }
    height = metrics.mean_height(skinned, cloth)
    rows = []
    for method, vertices in positions.items():
        parts = metrics.static_parts(vertices, cloth, cloth_material, contact, skin, height_m=height)
        rows.append(
            {
                "garment": garment.name,
                "method": method,
                **{f"{part}_j": float(value.mean()) for part, value in parts.items()},
                "energy_j": float(np.stack(list(parts.values())).sum(axis=0).mean()),
                "edge_pct": float(metrics.edge_strain_pct(vertices, rest, faces).mean()),
                "area_pct": float(metrics.area_strain_pct(vertices, rest, faces).mean()),
            }
        )
    baseline = rows[1]["energy_j"]
    for row in rows:
        row["share"] = row["energy_j"] / baseline if baseline > 0.0 else float("nan")
    charts = disagreement(garment, posed.jet.numpy(), _all_frames(posed), posed.centre.numpy())
    rows[2]["chart_gap_p99_mm"] = 1e3 * float(np.percentile(charts.gap_m, 99.0))
    rows[2]["chart_normal_p99_deg"] = float(np.degrees(np.percentile(charts.normal_rad, 99.0)))
    return rows


def _all_frames(posed: Posed) -> np.ndarray:
    """Rotations (F, K, 3, 3); the paper's variant has them once for all frames."""
    return posed.rotation.expand(*posed.centre.shape, 3).numpy()


def print_rows(rows: list[dict[str, Any]]) -> None:
    """Prints ``rows`` of ``evaluate`` as a table. Lines of rows that have the disagreement of charts end with it."""
    width = max(len(row["garment"]) for row in rows)
    print(f"{'garment':{width}}  {'method':13}  " + "  ".join(f"{column:>10}" for column in COLUMNS))
    for row in rows:
        line = f"{row['garment']:{width}}  {row['method']:13}  " + "  ".join(f"{row[c]:10.4f}" for c in COLUMNS)
        if "chart_gap_p99_mm" in row:
            line += f"  charts {row['chart_gap_p99_mm']:.1f} mm, {row['chart_normal_p99_deg']:.0f} deg (p99)"
        print(line)


@flushed()
def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Runs the command line: prints a table and one line of JSON. Returns what that line holds."""
    parser = argparse.ArgumentParser(
        prog="python -m training.evaluate", description="Energies of a checkpoint's drape beside skinning's."
    )
    parser.add_argument("checkpoint", type=Path, help="a checkpoint, or the folder of a run")
    parser.add_argument("--garments", nargs="+", default=[], help="names, files or folders (default: the shipped ones)")
    parser.add_argument("--motions", nargs="+", default=[], help="names, files or folders (default: held-out clips)")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"hard poses (default {FRAMES})")
    parser.add_argument("--fabric", help="of a network that knows fabrics (default: each garment's own)")
    parser.add_argument("--passes", type=int, help="of the corrections (default: all)")
    parser.add_argument("--threads", type=int, help="of torch")
    options = parser.parse_args(arguments)
    model, config, steps = load_network(options.checkpoint)
    torch.set_num_threads(options.threads or config.threads)
    body = load_body()
    poses = hard_poses(held_out_clips(config, options.motions), body, options.frames)
    chosen = fabric_of(options.fabric) if options.fabric else None
    rows: list[dict[str, Any]] = []
    for path in find_garments(options.garments):
        rows += evaluate(model, open_garment(path, body), body, poses, passes=options.passes, fabric=chosen)
    print_rows(rows)
    record = {
        "evaluate": str(options.checkpoint.name),
        "step": steps,
        "frames": list(poses.labels),
        "passes": len(model.corrections[: options.passes]),
        "rows": [{key: _plain(value) for key, value in row.items()} for row in rows],
    }
    print(json.dumps(record, allow_nan=False), flush=True)
    return record


def _plain(value: Any) -> Any:
    """``value`` for JSON: floats at six digits, None for what is not finite."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None


if __name__ == "__main__":
    main()
