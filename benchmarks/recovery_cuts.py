"""Recovery of ten targets of other cuts, as ``python -m recovery.run`` does it; nobody names the base.

Four are patterns of Garment-Pattern-Generator draped on the shipped body, with the texture that ``recovery.drape``
writes. One is a scan without a body, five are garments of the catalogue, cut with bands, darts and one-piece sleeves,
sewn and let fall with friction; these six have no texture. With some ``--targets``, ``--save`` keeps the other rows.

    python -m benchmarks.recovery_cuts [--targets tee tank] [--pictures FOLDER] [--save]

The folder of ``--pictures`` gets the reports, target above result as NAME.png, and ``SHEET``: all of those that are
there, also of runs before (docs/images/recovery_cuts.webp).
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.harness import RESULTS_DIR, Benchmark, Option, Run
from benchmarks.tables import Row
from drape.body.assets import DEFAULT_BODY, load_body
from drape.catalog import find_files
from drape.cloth.material import DEFAULT_MATERIAL
from drape.errors import InputError
from drape.files.atomic import write_whole
from drape.files.data import HOW_TO_SET_DATA, data_folder
from drape.garment.cache import GARMENTS_DIR, load_garment
from recovery.drape.output import obj_text, panel_texture
from recovery.drape.pipeline import DrapeOptions, drape_pattern
from recovery.fit.objective import DEFAULT_WEIGHTS
from recovery.pattern.garmentcode import read_pattern
from recovery.run.__main__ import EDGE_LENGTH_M, SCAN_REACH_M
from recovery.run.cut import Cut
from recovery.run.job import FIT_INSIDE, Job, Outcome, run_job
from recovery.run.pictures import Mesh, target_above_result
from recovery.run.report_text import page_of, top_of

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
UNSEEN = "does not show its seams"
NAMES = (*DRAPED, *SCANS, *SHIPPED)
SHEET = "recovery_cuts.webp"  # all pictures in one
TILE, GAP, ACROSS = (150, 170), 10, 5  # pixels of half a picture and between two; how many stand side by side

COLUMNS = {
    "target": "s", "from": "s", "base": "s", "told": "s", "panels": "d", "mean_mm": ".1f", "chamfer_cm2": ".2f",
    "seam_max_pct": ".2f", "anew_mm": ".1f", "sewn_mm": ".1f",
    "minutes": ".1f", "processor_min": ".1f",
}  # fmt: skip


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


def recovered(name: str, folder: Path, pictures: Path | None) -> Row:
    """The row of one target; one that is refused has the reason in place of figures."""
    target, source = written(name, folder)
    fabric = SHIPPED[name][1] if name in SHIPPED else DEFAULT_MATERIAL
    scan = name in SCANS
    job = Job(
        target=target,
        out=folder / "out",
        base=None,
        body=FIT_INSIDE if scan else DEFAULT_BODY,
        drape=DrapeOptions(edge_length_m=EDGE_LENGTH_M, fabric=fabric, grid_m=0.02),
        weights=DEFAULT_WEIGHTS._replace(reach_m=SCAN_REACH_M) if scan else DEFAULT_WEIGHTS,
        retarget=False,
        garment=False,
    )
    row: Row = {"target": name, "from": source, "fabric": fabric}
    began = time.process_time()
    try:
        outcome = run_job(job, progress=True)
    except InputError as error:
        return row | {"base": "refused", "told": "no", "why": str(error)}
    if pictures is not None:
        write_whole(pictures / f"{name}.html", page_of(outcome))
        write_whole(pictures / f"{name}.png", tile_of(outcome))
    top, panels = top_of(outcome), len(outcome.pattern.panels)
    return row | {
        "base": outcome.cut.base,
        "told": told_words(name, outcome.cut, panels),
        "panels": panels,
        "mean_mm": top["distance_mean_mm"],
        "chamfer_cm2": top["chamfer_cm2"],
        "seam_max_pct": top["seam_max_pct"],
        "anew_mm": top["sewn_anew_mm"],
        "sewn_mm": top["sewn_from_target_mm"],
        "cut": top["cut"],
        "rounds": len(outcome.found.rounds),
        "minutes": top["minutes"],
        "processor_min": (time.process_time() - began) / 60.0,
    }


def told_words(name: str, cut: Cut, panels: int) -> str:
    """Whether the base is right, and the panels too or a sentence says that they may not be."""
    base = SCANS[name] if name in SCANS else {**DRAPED, **SHIPPED}[name][0]
    if cut.base != base:
        return f"no, {base}"
    if name in DRAPED and panels == DRAPED[name][1]:
        return "yes"
    return "base; seams unseen" if any(UNSEEN in sentence for sentence in cut.differs) else "base"


def tile_of(outcome: Outcome) -> bytes:
    """A PNG of the target, and below it of what was recovered, from the front."""
    skin = outcome.wearer.skin
    there = Mesh(outcome.target.vertices, outcome.target.faces)
    found = Mesh(outcome.nodes, outcome.found.search.mesh.faces)
    return target_above_result(there, found, Mesh(skin.vertices - outcome.wearer.trans, skin.faces), TILE)


def sheet_of(folder: Path) -> bytes:
    """A WebP of the pictures of targets that ``folder`` has, ``ACROSS`` side by side. Needs one of them."""
    tiles = [Image.open(path) for name in NAMES if (path := folder / f"{name}.png").exists()]
    width, height = (side + GAP for side in tiles[0].size)
    sheet = Image.new("RGB", (min(ACROSS, len(tiles)) * width, -(-len(tiles) // ACROSS) * height), "white")
    for number, tile in enumerate(tiles):
        sheet.paste(tile, (number % ACROSS * width, number // ACROSS * height))
    packed = io.BytesIO()
    sheet.save(packed, "webp", quality=80, method=6)
    return packed.getvalue()


def recover_all(names: Sequence[str], pictures: Path | None) -> list[Row]:
    """Rows of all targets."""
    with tempfile.TemporaryDirectory() as scratch:
        rows = []
        for name in names:
            folder = Path(scratch) / name
            folder.mkdir()
            rows.append(recovered(name, folder, pictures))
    return rows


def with_others(rows: Sequence[Row], record: Path) -> list[Row]:
    """``rows``, and from ``record`` those of targets that they leave out, each with the commit that it was made at."""
    made = json.loads(record.read_text(encoding="utf-8"))
    kept = {row["target"]: {"commit": made["commit"], **row} for row in made["rows"]}
    every = kept | {row["target"]: row for row in rows}
    return [every[name] for name in NAMES if name in every]


@Benchmark(
    "recovery_cuts",
    "Recovery of ten targets of other cuts, the base not named.",
    COLUMNS,
    Option("--targets", NAMES, "which", ("skirt_4_panels",), choices=NAMES),
    Option("--pictures", None, "writes the reports and their pictures into this folder", kind=Path),
)
def main(run: Run) -> None:
    """Rows of every target."""
    os.environ["OMP_NUM_THREADS"] = str(run.options.threads)
    run.rows += recover_all(run.options.targets, pictures := run.options.pictures)
    if pictures is not None and any(row["base"] != "refused" for row in run.rows):
        print(write_whole(pictures / SHEET, sheet_of(pictures)))
    if run.options.save and len(run.rows) < len(NAMES):
        run.rows[:] = with_others(run.rows, RESULTS_DIR / "recovery_cuts.json")


if __name__ == "__main__":
    main.command()
