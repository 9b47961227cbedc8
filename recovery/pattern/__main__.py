"""Shows, converts and drafts sewing patterns.

python -m recovery.pattern show PATTERN.json [--out DIR] [--edge-length 0.02]
python -m recovery.pattern convert PATTERN.json --out DIR [--format svg dxf pdf json] [--style waistband=0.04]
python -m recovery.pattern draft tshirt --out DIR [--body NAME] [--set length_m=1.05 flare_m=0.12]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drape.body.assets import DEFAULT_BODY, load_body
from drape.errors import refusing
from recovery.commands import add_style_options, end_command, parser_of, style_of
from recovery.pattern import geometry
from recovery.pattern.bases import BASES, base_pattern
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.measurements import measure_body
from recovery.pattern.pattern_files import FORMATS, export_pattern
from recovery.pattern.pattern_mesh import mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.style import add_style_lines, finish_pattern

SEAM_LIMIT = 0.02


def _parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = parser_of("recovery.pattern", __doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    show = commands.add_parser("show", help="list panels, seams and mesh; draw them with --out")
    convert = commands.add_parser("convert", help="write the pattern in other formats")
    draft = commands.add_parser("draft", help="draft a base pattern for a body")
    for command in (show, convert):
        command.add_argument("pattern", type=Path, help="JSON of Garment-Pattern-Generator or GarmentCode")
        command.add_argument("--units-in-meter", type=float, help="overrides the file: 100 for centimetres")
    show.add_argument("--edge-length", type=float, default=0.02, help="of the mesh [m]")
    show.add_argument("--out", type=Path, help="folder of the picture")
    draft.add_argument("base", choices=sorted(BASES))
    draft.add_argument("--body", default=DEFAULT_BODY, help="name or file of a body")
    draft.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="parameters of the base")
    for command in (convert, draft):
        command.add_argument("--out", type=Path, required=True, help="folder of the files")
        command.add_argument("--format", nargs="+", default=list(FORMATS), choices=FORMATS)
        add_style_options(command)
        command.add_argument("--name", help="of the files; the pattern's own otherwise")
        command.add_argument("--allowance", type=float, default=0.01, help="seam allowance [m]")
        command.add_argument("--page", choices=("A4", "single"), default="A4", help="of the PDF")
        command.add_argument("--dxf-unit-mm", type=float, default=1.0, choices=(1.0, 10.0))
        command.add_argument("--dxf-dialect", choices=("aama", "gerber"), default="aama")
    return parser.parse_args(arguments)


def print_pattern(pattern: Pattern) -> None:
    """Prints a table of the panels of ``pattern`` and one of its seams, with notes on seams that look wrong."""
    print(f"{pattern.name}: {len(pattern.panels)} panels, {len(pattern.stitches)} stitches")
    print(f"\n{'panel':<24}{'edges':>6}{'area cm2':>10}{'outline cm':>12}")
    for panel in pattern.panels:
        outline = sum(geometry.edge_length(panel, number) for number in range(len(panel.edges)))
        print(f"{panel.name:<24}{len(panel.edges):>6}{1e4 * geometry.area(panel):>10.1f}{100 * outline:>12.1f}")
    print(f"\n{'seam':>4}  {'first':<24}{'second':<24}{'cm':>8}{'cm':>8}{'differ %':>10}")
    for number, seam in enumerate(geometry.seams(pattern), start=1):
        stitch, notes = seam.stitch, []
        if abs(seam.mismatch) > SEAM_LIMIT:
            notes.append("lengths differ: gathers or a mistake")
        ends = geometry.stitch_ends(pattern, stitch).sum()
        if ends > 1.1 * geometry.stitch_ends(pattern, stitch, reverse=True).sum():
            notes.append("ends would be nearer the other way round: a twisted seam?")
        lengths = f"{100 * seam.first_m:>8.2f}{100 * seam.second_m:>8.2f}{100 * seam.mismatch:>10.2f}"
        print(f"{number:>4}  {stitch.first!s:<24}{stitch.second!s:<24}{lengths}  {'; '.join(notes)}".rstrip())


def print_notes(pattern: Pattern) -> None:
    """Prints what reading changed in ``pattern``, a line for each change."""
    for note in pattern.notes:
        print(f"note: {note}")


def show(options: argparse.Namespace) -> None:
    """Prints the pattern that the parsed ``options`` name, and the size of its mesh; draws both if a folder is
    given."""
    pattern = read_pattern(options.pattern, units_in_meter=options.units_in_meter)
    print_pattern(pattern)
    print_notes(pattern)
    mesh = mesh_pattern(pattern, options.edge_length)
    least = min(mesh.smallest_angles_deg().values())
    print(
        f"\nmesh: {len(mesh.rest)} panel vertices, {mesh.node_count} nodes, {len(mesh.faces)} triangles, "
        f"smallest angle {least:.1f} degrees"
    )
    if options.out is not None:
        from recovery.pattern.preview import draw_pattern  # matplotlib takes a second to load

        options.out.mkdir(parents=True, exist_ok=True)
        path = options.out / f"{pattern.name}.png"
        draw_pattern(mesh, path)
        print(path)


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit code: 0, or 2 with a sentence if input is refused."""
    options = _parse(arguments)
    if options.command == "show":
        show(options)
        return 0
    if options.command == "draft":
        pattern = base_pattern(options.base, measure_body(load_body(options.body)), options.set)
    else:
        pattern = read_pattern(options.pattern, units_in_meter=options.units_in_meter)
    print_notes(pattern)
    if style := style_of(options):
        pattern = finish_pattern(add_style_lines(pattern, style), style)
    pattern = replace(pattern, name=options.name or pattern.name)
    paths = export_pattern(
        pattern,
        options.out,
        options.format,
        allowance_m=options.allowance,
        page=options.page,
        dxf_unit_mm=options.dxf_unit_mm,
        dxf_dialect=options.dxf_dialect,
    )
    return end_command(paths, "")


if __name__ == "__main__":
    sys.exit(main())
