"""A target recovered as ``python -m recovery.run`` does it: its row in a benchmark, and its pictures."""

from __future__ import annotations

import io
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from PIL import Image

from benchmarks.harness import Option, Run
from benchmarks.tables import Columns, Row
from drape.errors import InputError
from drape.files.atomic import write_whole
from recovery.progress import to_stderr
from recovery.run.__main__ import job_of, parse
from recovery.run.cut import Cut
from recovery.run.job import Job, Outcome, run_job
from recovery.run.pictures import Mesh, target_above_result
from recovery.run.report_text import page_of, top_of

FIGURES: Columns = {
    "mean_mm": ".1f", "chamfer_cm2": ".2f", "seam_max_pct": ".2f", "anew_mm": ".1f",
    "by_itself_mm": ".1f", "sewn_mm": ".1f", "minutes": ".1f", "processor_min": ".1f", "longest_silence_s": ".1f",
}  # fmt: skip
UNSEEN = "does not show its seams"
REFUSED = "refused"  # in place of a base
TILE, GAP, ACROSS = (150, 170), 10, 5  # pixels of half a picture and between two; how many stand side by side


class Silence:
    """The longest time [s] between two lines of a command that begins now, or from the last one to ``ended``."""

    def __init__(self) -> None:
        self.longest_s, self._last = 0.0, time.monotonic()

    def ended(self) -> None:
        """A line comes, or the end."""
        now = time.monotonic()
        self.longest_s, self._last = max(self.longest_s, now - self._last), now

    def through(self, write: Callable[[str], None]) -> Callable[[str], None]:
        """``write`` for a line, of which this takes note."""

        def line(text: str) -> None:
            self.ended()
            write(text)

        return line


def options(names: Iterable[str], quick: str) -> tuple[Option, ...]:
    """``--targets``, by default all ``names``, and ``--pictures``."""
    return (
        Option("--targets", tuple(names), "which", (quick,), choices=tuple(names)),
        Option("--pictures", None, "writes the reports and their pictures into this folder", kind=Path),
    )


def as_user(target: Path, out: Path, *words: str) -> Job:
    """The job of ``python -m recovery.run TARGET`` with more ``words``, without other bodies and a garment cache."""
    return job_of(parse([str(target), "--out", str(out), "--no-retarget", "--no-garment", *words]))


def recover_all(run: Run, recover: Callable[[str, Path], Row | None]) -> None:
    """Adds to ``run`` the row of every target that it asks for: ``recover`` gets a name and an empty folder.

    It gives None for a target that is not on this machine. With ``--save`` each row is kept as soon as it is there.
    """
    os.environ["OMP_NUM_THREADS"] = str(run.options.threads)
    with tempfile.TemporaryDirectory() as scratch:
        for name in run.options.targets:
            folder = Path(scratch) / name
            folder.mkdir()
            row = recover(name, folder)
            if row is not None:
                run.add([row])
                if run.options.save:
                    run.save()
    if (pictures := run.options.pictures) is not None and (sheet := sheet_of(pictures, run.order)):
        print(write_whole(pictures / f"{run.name}.webp", sheet))


def recovered(job: Job, told: Callable[[Cut | None, int], str], pictures: Path | None) -> Row:
    """The figures of ``job``; a target that is refused has the sentence in place of them.

    ``told`` says of the cut, None for a refusal, and the number of panels whether they are right. The folder
    ``pictures`` gets the report and a picture under the target's name.
    """
    began, silence = time.process_time(), Silence()
    refusal, outcome = "", None
    try:
        outcome = run_job(job, progress=silence.through(to_stderr), say=silence.through(print))
    except InputError as error:
        refusal = str(error)
    silence.ended()
    spent = {"processor_min": (time.process_time() - began) / 60.0, "longest_silence_s": silence.longest_s}
    if outcome is None:
        return {"base": REFUSED, "told": told(None, 0), **spent, "refused": refusal}
    if pictures is not None:
        write_whole(pictures / f"{job.target.stem}.html", page_of(outcome))
        write_whole(pictures / f"{job.target.stem}.png", tile_of(outcome))
    top, panels = top_of(outcome), len(outcome.pattern.panels)
    return {
        "base": outcome.cut.base,
        "told": told(outcome.cut, panels),
        "panels": panels,
        "mean_mm": top["distance_mean_mm"],
        "chamfer_cm2": top["chamfer_cm2"],
        "seam_max_pct": top["seam_max_pct"],
        "anew_mm": top["sewn_anew_mm"],
        "by_itself_mm": None if outcome.anew is None else outcome.anew.by_itself.mean_mm,
        "sewn_mm": top["sewn_from_target_mm"],
        "cut": top["cut"],
        "rounds": len(outcome.found.rounds),
        "minutes": top["minutes"],
        **spent,
        "refused": "",
    }


def told_words(truth: str, cut: Cut | None, *, panels: bool = False) -> str:
    """Whether the base is ``truth``, and the ``panels`` are right too or a sentence says that they may not be.

    A ``cut`` of None is a refusal, which ``REFUSED`` as the truth asks for.
    """
    if (REFUSED if cut is None else cut.base) != truth:
        return f"no, {truth}"
    if cut is None or panels:
        return "yes"
    return "base; seams unseen" if any(UNSEEN in sentence for sentence in cut.differs) else "base"


def tile_of(outcome: Outcome) -> bytes:
    """A PNG of the target, and below it of what was recovered, from the front."""
    skin = outcome.wearer.skin
    there = Mesh(outcome.target.vertices, outcome.target.faces)
    found = Mesh(outcome.nodes, outcome.found.search.mesh.faces)
    return target_above_result(there, found, Mesh(skin.vertices - outcome.wearer.trans, skin.faces), TILE)


def sheet_of(folder: Path, names: Sequence[str]) -> bytes:
    """A WebP of the pictures of targets that ``folder`` has, ``ACROSS`` side by side; empty if it has none."""
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
