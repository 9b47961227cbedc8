"""Recovery of ten targets of other cuts, as ``python -m recovery.run`` does it; nobody names the base.

Four are patterns of Garment-Pattern-Generator draped on the shipped body, with the texture that ``recovery.drape``
writes. One is a scan without a body, five are garments of the catalogue, cut with bands, darts and one-piece sleeves,
sewn and let fall with friction; these six have no texture. With some ``--targets``, ``--save`` keeps the other rows.

    python -m benchmarks.recovery_cuts [--targets tee tank] [--pictures FOLDER] [--save]

The folder of ``--pictures`` gets the reports, target above result as NAME.png, and recovery_cuts.webp: all of those
that are there, also of runs before (docs/images/recovery_cuts.webp).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Run
from benchmarks.recovery.recovered import FIGURES, as_user, options, recover_all, recovered, told_words
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_files
from drape.cloth.material import DEFAULT_MATERIAL
from drape.files.atomic import write_whole
from drape.files.data import HOW_TO_SET_DATA, data_folder
from drape.garment.cache import GARMENTS_DIR, load_garment
from recovery.drape.output import obj_text, panel_texture
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.pattern.garmentcode import read_pattern
from recovery.run.cut import Cut

TARGET_EDGE_M = 0.025
DRAPED = {  # pattern of the data folder: its base and panels
    "dress_sleeveless": ("dress", 4),
    "skirt_4_panels": ("skirt", 4),
    "pants_straight_sides": ("trousers", 4),
    "tee": ("tshirt", 6),
}
SCANS = {"tshirt_panels": "tshirt"}
SHIPPED = {  # garment of the catalogue: its base, and the fabric that it is sewn of
    "tank": ("tank", "rib"),
    "longsleeve": ("tshirt", DEFAULT_MATERIAL),
    "dress": ("sleeved_dress", "satin"),
    "trousers": ("trousers", "ponte"),
    "skirt": ("skirt", "stretch_denim"),
}
BASES = {name: base for name, (base, _) in {**DRAPED, **SHIPPED}.items()} | SCANS
NAMES = (*DRAPED, *SCANS, *SHIPPED)
COLUMNS = {"target": "s", "from": "s", "base": "s", "told": "s", "panels": "d", **FIGURES}


def obj_of(vertices: np.ndarray, faces: np.ndarray) -> str:
    """An OBJ of a mesh, without texture: a surface as a scanner leaves it."""
    rows = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices]
    return "\n".join([*rows, *(f"f {a} {b} {c}" for a, b, c in faces + 1)]) + "\n"


def written(name: str, folder: Path) -> tuple[Path, str]:
    """The file of a target, and where it comes from. Raises ``SystemExit`` without the data folder."""
    path = folder / f"{name}.obj"
    if name in SHIPPED:
        garment = load_garment(find_files([name], GARMENTS_DIR, (".npz",), "garment")[0])
        return write_whole(path, obj_of(garment.vertices, garment.faces)), "catalogue"
    if (data := data_folder()) is None:
        raise SystemExit(HOW_TO_SET_DATA)
    if name in SCANS:
        return data / "scans" / f"{name}.obj", "scan"
    pattern = read_pattern(data / "patterns" / f"{name}.json")
    draped = drape_pattern(pattern, load_body(), DrapeOptions(edge_length_m=TARGET_EDGE_M))
    return write_whole(path, obj_text(draped.mesh, draped.nodes, panel_texture(draped.mesh))), "drape"


def row_of(name: str, folder: Path, pictures: Path | None) -> Row:
    """The row of one target."""
    target, source = written(name, folder)
    fabric = SHIPPED[name][1] if name in SHIPPED else DEFAULT_MATERIAL
    job = as_user(target, folder / "out", "--fabric", fabric, *(("--body", "fit") if name in SCANS else ()))

    def told(cut: Cut | None, panels: int) -> str:
        return told_words(BASES[name], cut, panels=name in DRAPED and panels == DRAPED[name][1])

    return {"target": name, "from": source, "fabric": fabric, **recovered(job, told, pictures)}


@Benchmark(
    "recovery_cuts",
    "Recovery of ten targets of other cuts, the base not named.",
    COLUMNS,
    *options(NAMES, "skirt_4_panels"),
    order=NAMES,
)
def main(run: Run) -> None:
    """Rows of every target."""
    recover_all(run, lambda name, folder: row_of(name, folder, run.options.pictures))


if __name__ == "__main__":
    main.command()
