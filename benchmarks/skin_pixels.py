"""How much skin shows through cloth that covers it at rest, in pictures of hard poses from four sides.

    python -m benchmarks.skin_pixels
    python -m benchmarks.skin_pixels --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --frames 12 --save

``network`` is served without folds: all corrections, the delivered mesh, projected out of the skin. The others are
folds as served, on the network without corrections, a single pose each: in cloth that feels itself, lifted off the skin
in the end. ``fine`` is the mesh that they are made on; ``wrapped`` is the delivered mesh around it, of garments that
were delivered coarse; ``folds`` would be folds on the delivered triangles. Skin is counted by
``benchmarks.measure.skin_pixels``.
"""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Benchmark, Option, Run, inputs
from benchmarks.measure.skin_pixels import VIEWS_DEG, PosedBody, covered_faces, skin_pixels_pct
from benchmarks.network import Network
from benchmarks.scenes import Clip, folded_poses, skinned
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_garments, find_motions, open_garment
from drape.contact.projection import push_out_of_bodies
from drape.contact.skin import body_skin
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment, has_finer
from drape.garment.wrapping import Wrapping
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort
from drape.motion.hard_poses import hard_poses
from drape.motion.readers import read_motion
from drape.stages.folds import SETTLE

COLUMNS = {
    "garment": "s", "method": "s", "vertices": "d", "skin_pixels_pct": ".3f", "worst_pct": ".2f", "worst": "s",
}  # fmt: skip


def drapes(
    garment: Garment, clip: Clip, networks: dict[int | None, Network], steps: int
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Vertices [m] (F, V, 3) and faces of ``garment`` by method; ``networks`` by the corrections that run."""
    fine, delivered = fine_garment(garment), np.s_[:, : garment.vertex_count]
    effort = FoldEffort(steps, SETTLE, cloth_contact=True)
    started = networks[0].drape(garment, clip.poses).vertices

    def folded(start: np.ndarray, mesh: Garment) -> np.ndarray:
        return folded_poses(fold_constants(mesh, clip.body), start, clip.skin, effort)

    corrected = networks[None].drape(garment, clip.poses).vertices[delivered]
    found = {
        "skinning": (skinned(fine, clip.body, clip.poses), fine.faces),
        "network": (projected(corrected, garment, clip), garment.faces),
    }
    folds = folded(started, fine)
    if has_finer(garment):
        wrapping = Wrapping(garment)
        found["folds"] = folded(started[delivered], garment), garment.faces
        found["wrapped"] = np.stack([wrapping.wrap(cloth) for cloth in folds]), garment.faces
    return found | {"fine": (folds, fine.faces)}


def projected(vertices: np.ndarray, garment: Garment, clip: Clip) -> np.ndarray:
    """The delivered mesh of ``garment`` at ``vertices`` [m] (F, V, 3), out of the bodies as the service projects it."""
    skin, rest = body_skin(clip.body), garment.vertices[: garment.vertex_count]
    return push_out_of_bodies(vertices, clip.body_vertices, skin, pack_push(garment_feed(garment), rest, skin))


def measure(
    garment: Garment, clip: Clip, pictured: list[PosedBody], networks: dict[int | None, Network], steps: int
) -> list[Row]:
    """A row for each method; ``pictured`` are the bodies of the clip in pictures."""
    fine = fine_garment(garment)
    body, rest = clip.body, fine.vertices.astype(np.float64)
    covered = covered_faces(body.v_template, body.faces, rest, fine.faces.astype(np.int64))
    rows = []
    for method, (vertices, faces) in drapes(garment, clip, networks, steps).items():
        seen = zip(pictured, vertices, strict=True)
        share = np.array([skin_pixels_pct(one, covered, cloth, faces) for one, cloth in seen])
        frame, side = np.unravel_index(np.nanargmax(share), share.shape)
        row = {"garment": garment.name, "method": method, "vertices": vertices.shape[1]}
        row |= {"skin_pixels_pct": float(np.nanmean(share)), "worst_pct": float(share[frame, side])}
        rows.append(row | {"worst": f"{clip.labels[frame]} from {VIEWS_DEG[side]:.0f}"})
    return rows


@Benchmark(
    "skin_pixels",
    "Skin that shows through.",
    COLUMNS,
    *inputs(quick_garments=("tshirt",)),
    Option("--frames", 12, "hard poses", 1),
    Option("--folds", 2, "steps of folds"),
)
def main(run: Run) -> None:
    """Rows of every garment."""
    options, body = run.options, load_body()
    poses = hard_poses([read_motion(path) for path in find_motions(options.motions)], body, options.frames)
    clip = Clip.hard(poses, body)
    networks = {passes: Network.asked(options, body, passes=passes) for passes in (0, None)}
    pictured = [PosedBody.of(posed, body.faces) for posed in clip.body_vertices]
    for path in find_garments(options.garments):
        run.add(measure(open_garment(path, body), clip, pictured, networks, options.folds))
    run.extra |= {"poses": list(poses.labels), "folds": options.folds, **networks[None].record()}


if __name__ == "__main__":
    main.command()
