"""Contact sheets of skinning, network and physics side by side on the hard poses, strain as colour.

    python -m benchmarks.strain_sheets --garments tshirt dress --motions ... --frames 4

Takes the options of ``benchmarks.quality``, and its stored physics optima. Columns are poses; rows are
skinning + push-out, the network, physics. White is at rest length; red is stretched, blue is pressed
together, full colour at 20 % of area.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.quality import open_bench, parse
from benchmarks.quality_measures import Bench, drapes
from benchmarks.render import SKIN, Surface, render, save_png, sheet
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.cloth.energies import ClothMesh
from drape.errors import ended
from drape.garment.cache import Garment
from drape.geometry import meshes

METHODS = ("skinning_push", "network", "physics")
FULL_COLOUR = 0.20  # of area
STRETCHED, PRESSED, UNCHANGED = np.array([0.85, 0.12, 0.12]), np.array([0.12, 0.25, 0.85]), np.array([0.93, 0.93, 0.93])
COLUMNS = 6
SIZE, EXTENT_M = (300, 230), 1.5
OUT = Path(__file__).resolve().parents[1] / "docs" / "images"


def strain_colours(vertices: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3) of the triangles by their change of area."""
    change = meshes.face_areas(vertices, faces) / meshes.face_areas(rest, faces) - 1.0
    share = np.clip(np.abs(change) / FULL_COLOUR, 0.0, 1.0)[:, None]
    return (1.0 - share) * UNCHANGED + share * np.where(change[:, None] > 0.0, STRETCHED, PRESSED)


def draw(garment: Garment, bench: Bench) -> np.ndarray:
    """The sheet of one garment."""
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    positions = drapes(garment, bench, ClothMesh.from_rest(rest, faces))[0]
    rows = []
    for method in METHODS:
        row = []
        for frame, vertices in enumerate(positions[method][:COLUMNS]):
            cloth = Surface(vertices, faces, strain_colours(vertices, rest, faces))
            skin = Surface(bench.body_vertices[frame], bench.body.faces, SKIN)
            centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            row.append(render([skin, cloth], size=SIZE, azimuth_deg=20.0, centre=centre, extent_m=EXTENT_M))
        rows.append(row)
    return sheet(rows)


def main(arguments: Sequence[str] | None = None) -> list[Path]:
    """Writes a sheet per garment and returns their paths."""
    own = argparse.ArgumentParser(add_help=False)
    own.add_argument("--images", type=Path, default=OUT)
    mine, others = own.parse_known_args(arguments)
    options = parse(others)
    torch.set_num_threads(options.threads)
    body = load_body()
    bench = open_bench(options, body)
    paths = []
    for path in find_garments(options.garments):
        garment = open_garment(path, body)
        paths.append(mine.images / f"strain_{garment.name}.png")
        save_png(paths[-1], draw(garment, bench))
        print(f"{paths[-1].name}  {paths[-1].stat().st_size // 1024} KB")
    return paths


if __name__ == "__main__":
    sys.exit(ended(main))
