"""Sews the catalogue's garments and lets them come to rest on the body.

python -m recovery.catalogue build [NAME ...] --out DIR [--size M] [--body BODY] [--edge-length 0.0115] [--garments DIR]
python -m recovery.catalogue grade [NAME ...] [--garments drape/assets/garments]
python -m recovery.catalogue list

``build`` writes NAME.obj, NAME.glb and NAME.json, in other sizes than M as NAME_SIZE. ``grade`` writes what the service
makes sizes of, beside the caches that ``build --garments`` wrote. Exit codes: 2 refused, 3 written but not at rest.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from drape.body.assets import DEFAULT_BODY, load_body
from drape.catalog import find_files, open_garment
from drape.errors import refusing
from drape.garment.cache import GARMENTS_DIR
from drape.garment.intake import intake
from drape.garment.sizes import save_table, table_path
from recovery.catalogue.cuts import CATALOGUE
from recovery.catalogue.design_drape import QUICK, BuildOptions, body_distance, design, drape_design, write_garment
from recovery.catalogue.size_tables import grade_sizes
from recovery.commands import end_command, parser_of
from recovery.pattern.measurements import PATTERN_STEPS, measure_body
from recovery.progress import watched


def _parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    default = BuildOptions()
    parser = parser_of("recovery.catalogue", __doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    builder = commands.add_parser("build", help="sew garments and write them")
    builder.add_argument("names", nargs="*", metavar="NAME", help="all of the catalogue where none is named")
    builder.add_argument("--out", type=Path, required=True, help="folder of the files")
    builder.add_argument("--garments", type=Path, help="folder of caches: what is written is taken in, too")
    builder.add_argument("--size", default="M", help=", ".join(PATTERN_STEPS))
    builder.add_argument("--body", default=DEFAULT_BODY, help="name or file of a body; it is size M")
    builder.add_argument("--edge-length", type=float, default=default.fine_m, help="of the finished mesh [m]")
    builder.add_argument("--quick", action="store_true", help="a look on a coarse mesh, not at rest")
    grader = commands.add_parser("grade", help="make the other sizes of garments that were taken in")
    grader.add_argument("names", nargs="*", metavar="NAME", help="all of the catalogue where none is named")
    grader.add_argument("--garments", type=Path, default=GARMENTS_DIR, help="folder of their caches (%(default)s)")
    commands.add_parser("list", help="names, fabrics and panels")
    return parser.parse_args(arguments)


@refusing
@watched()
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code: 0, or with a sentence 2 for refused input and 3 for cloth that is not
    at rest."""
    given = _parse(arguments)
    if given.command == "list":
        measurements = measure_body(load_body())
        for name in CATALOGUE:
            draft = design(name, measurements)
            ease = ", ".join(f"{where} {100 * much:+.0f} cm" for where, much in draft.ease_m.items())
            print(f"{name:14s} {draft.fabric:14s} {len(draft.pattern.panels):2d} panels; {ease}")
        return 0
    if given.command == "grade":
        return _grade(given.names or list(CATALOGUE), given.garments)
    body = load_body(given.body)
    options = QUICK if given.quick else BuildOptions(fine_m=given.edge_length)
    measurements = measure_body(body)
    designs = {name: design(name, measurements, given.size) for name in given.names or CATALOGUE}
    skin = body_distance(body, options)
    moving = []
    for name, drafted in designs.items():
        called = name if given.size == "M" else f"{name}_{given.size.lower()}"
        print(f"--- {called}, {drafted.fabric}")
        garment = drape_design(drafted, skin, options, report=print)
        paths = write_garment(garment, given.out, name=called, size=given.size, body=body.name)
        print(*paths, sep="\n")
        if given.garments is not None:
            intake(paths[0], avatar="standard", body=body, folder=given.garments, report=print)
        if not garment.at_rest:
            moving.append(f"{called} by {garment.figures['last_move_mm']:.2f} mm")
    words = f"not at rest, the last step moved a node of {', '.join(moving)}. Leave out --quick, or take another size."
    return end_command([], words if moving else "")


def _grade(names: Sequence[str], folder: Path) -> int:
    """Writes the tables of sizes of ``names``, whose caches are in ``folder``."""
    body = load_body()
    measurements, skin = measure_body(body), body_distance(body)
    for name in names:
        (path,) = find_files([name], folder, (".npz",), "garment")
        garment = open_garment(path, body)
        print(f"--- {name}")
        table = grade_sizes(name, garment, body, measurements, skin, report=lambda line: print(line, flush=True))
        save_table(table, written := table_path(folder, garment))
        print(f"{written}, {written.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
