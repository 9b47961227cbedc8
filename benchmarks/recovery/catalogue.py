"""The sewn catalogue, judged: collisions, self-intersections, detail before and after intake, intake's time.

    python -m benchmarks.recovery.catalogue DIR

DIR is what ``python -m recovery.catalogue build --out DIR`` wrote. Detail is that of ``drape.cloth.detail``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.measure.intersections import intersecting_pairs
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.detail import LowPass
from drape.cloth.rest_state import flat
from drape.garment.files.mesh import read_mesh
from drape.garment.intake import intake


def detail_mm(vertices: np.ndarray, faces: np.ndarray) -> float:
    """``drape.cloth.detail`` of a surface against its own metric [mm]."""
    return float(LowPass.of(flat(vertices, faces), faces, len(vertices)).detail_mm(vertices))


def colliding_triangles(vertices: np.ndarray, faces: np.ndarray, body: BodyModel) -> int:
    """How many triangles of the cloth cross one of the body's."""
    both = np.concatenate([faces, body.faces + len(vertices)])
    pairs = intersecting_pairs(np.concatenate([vertices, body.v_template]), both)
    mixed = (pairs[:, 0] < len(faces)) & (pairs[:, 1] >= len(faces))
    return len(np.unique(pairs[mixed, 0]))


def judge(path: Path, body: BodyModel) -> dict[str, float | int | str]:
    """The row of one garment."""
    mesh = read_mesh(path)
    told = json.loads(path.with_suffix(".json").read_text())
    started = time.process_time()
    taken = intake(path, avatar="standard", body=body)
    seconds = time.process_time() - started
    before = detail_mm(mesh.vertices, mesh.faces)
    after = detail_mm(np.asarray(taken.vertices[: taken.vertex_count], dtype=np.float64), mesh.faces)
    return {
        "garment": told["name"],
        "fabric": told["fabric"],
        "panels": len(told["panels"]),
        "vertices": len(mesh.vertices),
        "edge_mm": told["figures"]["edge_mean_mm"],
        "sewn_s": told["figures"]["cpu_seconds"],
        "last_mm": told["figures"]["last_move_mm"],
        "stretch_pct": told["figures"]["stretch_median_pct"],
        "colliding": colliding_triangles(mesh.vertices, mesh.faces, body),
        "crossing": len(intersecting_pairs(mesh.vertices, mesh.faces)),
        "detail_mm": round(before, 2),
        "kept_pct": round(100.0 * after / before, 1),
        "intake_s": round(seconds, 1),
    }


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    body = load_body()
    paths = sorted(given.folder.glob("*.obj"))
    for path in paths:
        print(json.dumps(judge(path, body)), flush=True)


if __name__ == "__main__":
    main()
