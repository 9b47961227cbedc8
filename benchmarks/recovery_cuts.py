"""Recovery of ten targets of other cuts, as ``python -m recovery.run`` does it; nobody names the base.

Four are patterns of Garment-Pattern-Generator draped on the shipped body, with the texture that ``recovery.drape``
writes. One is a scan without a body, five are garments of the catalogue, cut with bands, darts and one-piece sleeves,
sewn and let fall with friction; these six have no texture.

    python -m benchmarks.recovery_cuts [--targets tee tank] [--pictures FOLDER] [--save]

The folder of ``--pictures`` gets the reports, target above result as NAME.png, and recovery_cuts.webp: all of those
that are there, also of runs before (docs/images/recovery_cuts.webp).
"""

from __future__ import annotations

import io
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.catalog import find_files
from drape.cloth.material import DEFAULT_MATERIAL
from drape.errors import InputError
from drape.files.atomic import write_whole
from drape.files.data import HOW_TO_SET_DATA, data_folder
from drape.garment.cache import GARMENTS_DIR, load_garment
from recovery.drape.output import panel_texture, sewn_obj_text
from recovery.drape.pattern_drape import SewingOptions, drape_pattern
from recovery.pattern.garmentcode import read_pattern
from recovery.progress import to_stderr
from recovery.run.__main__ import job_of, parse
from recovery.run.cut import Cut
from recovery.run.job import Outcome, run_job
from recovery.run.report_pictures import MeshArrays, target_above_result
from recovery.run.report_text import page_of, top_of
from recovery.run.task import RecoveryJob

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
COLUMNS = {
    "target": "s", "from": "s", "base": "s", "told": "s", "panels": "d", "mean_mm": ".1f", "chamfer_cm2": ".2f",
    "seam_max_pct": ".2f", "anew_mm": ".1f", "sewn_mm": ".1f", "minutes": ".1f", "processor_min": ".1f",
}  # fmt: skip
UNSEEN = "does not show its seams"
REFUSED = "refused"  # stands where the name of a base would
TILE, GAP, ACROSS = (150, 170), 10, 5  # pixels of half a picture and between two; how many stand side by side


def obj_of(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Returns the text of an OBJ file of a mesh without texture, as a scanner writes it: vertices (V, 3), faces (F,
    3)."""
    rows = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices]
    return "\n".join([*rows, *(f"f {a} {b} {c}" for a, b, c in faces + 1)]) + "\n"


def write_target(name: str, folder: Path) -> tuple[Path, str]:
    """Returns the path of the mesh file of the target ``name``, in ``folder`` or the folder of data, and where it is
    from: "catalogue", "scan" or "drape". Raises ``SystemExit`` where a target needs the folder of data and it is not
    set."""
    path = folder / f"{name}.obj"
    if name in SHIPPED:
        garment = load_garment(find_files([name], GARMENTS_DIR, (".npz",), "garment")[0])
        return write_whole(path, obj_of(garment.vertices, garment.faces)), "catalogue"
    if (data := data_folder()) is None:
        raise SystemExit(HOW_TO_SET_DATA)
    if name in SCANS:
        return data / "scans" / f"{name}.obj", "scan"
    pattern = read_pattern(data / "patterns" / f"{name}.json")
    draped = drape_pattern(pattern, load_body(), SewingOptions(edge_length_m=TARGET_EDGE_M))
    return write_whole(path, sewn_obj_text(draped.mesh, draped.nodes, panel_texture(draped.mesh))), "drape"


def row_of(name: str, folder: Path, pictures: Path | None) -> Row:
    """Recovers the target ``name`` in the scratch ``folder`` and returns its row. ``pictures`` is that of
    ``recover_job``."""
    target, source = write_target(name, folder)
    fabric = SHIPPED[name][1] if name in SHIPPED else DEFAULT_MATERIAL
    job = as_user(target, folder / "out", "--fabric", fabric, *(("--body", "fit") if name in SCANS else ()))

    def judged(cut: Cut | None, panels: int) -> str:
        return verdict(BASES[name], cut, panels=name in DRAPED and panels == DRAPED[name][1])

    return {"target": name, "from": source, "fabric": fabric, **recover_job(job, judged, pictures)}


def as_user(target: Path, out: Path, *words: str) -> RecoveryJob:
    """Returns the job of ``python -m recovery.run TARGET --out OUT`` with more ``words``, without a garment's cache and
    without drapes on other bodies."""
    return job_of(parse([str(target), "--out", str(out), "--no-retarget", "--no-garment", *words]))


def recover_job(job: RecoveryJob, judged: Callable[[Cut | None, int], str], pictures: Path | None) -> Row:
    """Runs ``job`` and returns its row: figures of the recovered pattern, or the sentence of the refusal.

    ``judged`` takes the cut, None for a refusal, and the number of panels, and returns the cell that says whether the
    two are right. The folder ``pictures``, if there is one, gets the report and a picture under the target's name.
    """
    began, refusal, outcome = time.process_time(), "", None
    try:
        outcome = run_job(job, progress=to_stderr, say=print)
    except InputError as error:
        refusal = str(error)
    spent = {"processor_min": (time.process_time() - began) / 60.0}
    if outcome is None:
        return {"base": REFUSED, "told": judged(None, 0), **spent, "refused": refusal}
    if pictures is not None:
        write_whole(pictures / f"{job.target.stem}.html", page_of(outcome))
        write_whole(pictures / f"{job.target.stem}.png", tile_of(outcome))
    top, panels = top_of(outcome), len(outcome.pattern.panels)
    return {
        "base": outcome.task.cut.base,
        "told": judged(outcome.task.cut, panels),
        "panels": panels,
        "mean_mm": top["distance_mean_mm"],
        "chamfer_cm2": top["chamfer_cm2"],
        "seam_max_pct": top["seam_max_pct"],
        "anew_mm": top["sewn_anew_mm"],
        "sewn_mm": top["sewn_from_target_mm"],
        "cut": top["cut"],
        "rounds": len(outcome.recovered.rounds),
        "minutes": top["minutes"],
        **spent,
        "refused": "",
    }


def verdict(truth: str, cut: Cut | None, *, panels: bool = False) -> str:
    """Returns the cell of a table that says whether ``cut`` is right: "yes"; "base" if only the base is, with a hint
    where its seams cannot be seen; or "no" and the ``truth``, which is the name of a base.

    ``panels`` says whether the number of panels is right. ``cut`` is None for a target that was refused, which is right
    where ``truth`` is ``REFUSED``.
    """
    if (REFUSED if cut is None else cut.base) != truth:
        return f"no, {truth}"
    if cut is None or panels:
        return "yes"
    return "base; seams unseen" if any(UNSEEN in sentence for sentence in cut.differs) else "base"


def tile_of(outcome: Outcome) -> bytes:
    """Returns the bytes of a PNG: the target from the front, and below it what was recovered."""
    skin = outcome.task.wearer.skin
    target = MeshArrays(outcome.task.mesh.vertices, outcome.task.mesh.faces)
    result = MeshArrays(outcome.nodes, outcome.recovered.search.mesh.faces)
    return target_above_result(target, result, MeshArrays(skin.vertices - outcome.task.wearer.trans, skin.faces), TILE)


def sheet_of(folder: Path, names: Sequence[str]) -> bytes:
    """Returns the bytes of a WebP of those pictures ``NAME.png`` of ``names`` that ``folder`` has, ``ACROSS`` side by
    side; empty if it has none."""
    tiles = [Image.open(path) for name in names if (path := folder / f"{name}.png").exists()]
    if not tiles:
        return b""
    width, height = (side + GAP for side in tiles[0].size)
    sheet = Image.new("RGB", (min(ACROSS, len(tiles)) * width, -(-len(tiles) // ACROSS) * height), "white")
    for number, tile in enumerate(tiles):
        sheet.paste(tile, (number % ACROSS * width, number // ACROSS * height))
    packed = io.BytesIO()
    sheet.save(packed, "webp", quality=80, method=6)
    return packed.getvalue()


@Benchmark(
    "recovery_cuts",
    "Recovery of ten targets of other cuts, the base not named.",
    COLUMNS,
    Option("--targets", NAMES, "which", ("skirt_4_panels",), choices=NAMES),
    Option("--pictures", None, "writes the reports and their pictures into this folder", kind=Path),
)
def main(run: Run) -> None:
    """Recovers every target of ``--targets`` and adds a row for each to ``run``."""
    os.environ["OMP_NUM_THREADS"] = str(run.options.threads)
    pictures = run.options.pictures
    with tempfile.TemporaryDirectory() as scratch:
        for name in run.options.targets:
            folder = Path(scratch) / name
            folder.mkdir()
            run.add([row_of(name, folder, pictures)])
    if pictures is not None and (sheet := sheet_of(pictures, NAMES)):
        print(write_whole(pictures / "recovery_cuts.webp", sheet))


if __name__ == "__main__":
    main.command()
