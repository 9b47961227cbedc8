"""Recovery of scans without a body, as ``python -m recovery.run SCAN --body fit`` does it; nobody names the base.

Three are raw scans of drapes of our own (``benchmarks.recovery.raw_scan``). The others are strangers' garments of the
data folder, as artists modelled and another simulator draped them; a jacket, open in front, is rightly refused. Without
the data folder these are left out. With some ``--targets``, ``--save`` keeps the other rows, also where another
process measures them at the same time.

    python -m benchmarks.recovery_scans [--targets raw_polo raw_dress] [--minutes 6] [--pictures FOLDER] [--save]

``longest_silence_s`` is the longest time by the clock between two lines that a user sees.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.harness import Benchmark, Option, Run
from benchmarks.recovery.raw_scan import SUBJECTS, raw_scan
from benchmarks.recovery.recovered import FIGURES, REFUSED, as_user, options, recover_all, recovered, told_words
from benchmarks.tables import Row
from drape.errors import Unavailable
from drape.files.data import HOW_TO_SET_DATA, data_folder

MINUTES = 6.0
RAW, ARTIST, SIMULATOR = "raw scan", "artist", "simulator"
STRANGERS = {  # file of the data folder: where it comes from, and its base by eye
    "scans/shirt_artist.obj": (ARTIST, "tshirt"),
    "scans/shirt_initial.obj": (ARTIST, "tshirt"),
    "garments/female_tshirt.obj": (SIMULATOR, "tshirt"),
    "garments/male_tshirt.obj": (SIMULATOR, "tshirt"),
    "garments/male_long_sleeve_shirt.obj": (SIMULATOR, "tshirt"),
    "garments/female_pencil_skirt.obj": (SIMULATOR, "skirt"),
    "garments/female_jeans.obj": (SIMULATOR, "trousers"),
    "garments/male_jeans.obj": (SIMULATOR, "trousers"),
    "garments/female_suit_jacket.obj": (SIMULATOR, REFUSED),
}
FILES = {Path(file).stem: file for file in STRANGERS}
NAMES = (*SUBJECTS, *FILES)
COLUMNS = {"target": "s", "from": "s", "base": "s", "told": "s", **FIGURES, REFUSED: "s"}


def written(name: str) -> tuple[Path, str, str]:
    """The file of a target, where it comes from, and its base. Raises ``Unavailable`` without the data folder."""
    if name in SUBJECTS:
        return raw_scan(name), RAW, SUBJECTS[name].base
    if (data := data_folder()) is None:
        raise Unavailable(name, expected="a garment of the data folder", got="no data folder", cure=HOW_TO_SET_DATA)
    return data / FILES[name], *STRANGERS[FILES[name]]


def row_of(name: str, folder: Path, run: Run) -> Row | None:
    """The row of one target; None and a note of ``run`` where it is not on this machine."""
    try:
        target, source, truth = written(name)
    except Unavailable as error:
        run.notes.append(str(error))
        return None
    job = as_user(target, folder / "out", "--body", "fit", "--minutes", f"{run.options.minutes:g}")
    figures = recovered(job, lambda cut, panels: told_words(truth, cut), run.options.pictures)
    return {"target": name, "from": source, **figures}


@Benchmark(
    "recovery_scans",
    "Recovery of scans without a body: base, fabric and wearer are not named.",
    COLUMNS,
    *options(NAMES, "female_tshirt"),
    Option("--minutes", MINUTES, "limit of each recovery"),
    order=NAMES,
)
def main(run: Run) -> None:
    """Rows of every target that is on this machine. Raises ``Unavailable`` for none."""
    recover_all(run, lambda name, folder: row_of(name, folder, run))
    if not run.rows:
        raise Unavailable("--targets", expected="some on this machine", got="none", cure=HOW_TO_SET_DATA)


if __name__ == "__main__":
    main.command()
