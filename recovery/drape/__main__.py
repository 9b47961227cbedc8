"""Sews a pattern round a body and drapes it.

python -m recovery.drape PATTERN.json --out DIR [--body BODY] [--pose CLIP:FRAME] [--fabric jersey] [--scale 1.0]

Writes NAME.obj and NAME.glb (in the pose), NAME_rest.obj (in the T-pose), NAME.json (how it went), and the garment
cache NAME-DIGEST.npz that the service reads. Exit codes: 2 refused, 3 written but not at rest
or with cloth in the body.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from drape.body.assets import DEFAULT_BODY, load_body
from drape.cloth.material import DEFAULT_MATERIAL
from drape.errors import InputError, refusing
from drape.files.atomic import write_whole
from drape.garment.contours import lost_parts, lost_words, pierced_parts
from drape.garment.intake import garment_name
from recovery.commands import end_command, parser_of
from recovery.drape.output import panel_texture, write_rest, write_shape
from recovery.drape.pattern_drape import Draped, Hold, SewingOptions
from recovery.drape.placement import Axes, read_pose
from recovery.drape.settle import TOLERANCE_N
from recovery.fit.starts import DrapeStart, drape_worn
from recovery.pattern.garmentcode import read_pattern
from recovery.progress import watched


def _parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    default = SewingOptions()
    parser = parser_of("recovery.drape", __doc__)
    parser.add_argument("pattern", type=Path, help="JSON of Garment-Pattern-Generator or GarmentCode")
    parser.add_argument("--out", type=Path, required=True, help="folder of the files")
    parser.add_argument("--body", default=DEFAULT_BODY, help="name or file of a body")
    parser.add_argument("--pose", help="CLIP:FRAME of a motion file or a sample, or a JSON file of 72 numbers")
    parser.add_argument("--name", help="of the garment; the pattern's own otherwise")
    parser.add_argument(
        "--fabric", default=DEFAULT_MATERIAL, help="jersey, limp, soft, stiff or crisp, or one of the table of fabrics"
    )
    parser.add_argument("--scale", type=float, default=default.scale, help="sizes the pattern up or down")
    parser.add_argument("--edge-length", type=float, default=default.edge_length_m, help="of the mesh [m]")
    parser.add_argument("--axes", type=Axes, choices=list(Axes), default=default.axes, help="of the file's placements")
    parser.add_argument("--hold", type=Hold, choices=list(Hold), default=default.hold, help="auto: a belt at the waist")
    parser.add_argument("--grid", type=float, default=default.grid_m, help="spacing of the body's distance [m]")
    parser.add_argument(
        "--iterations", type=int, default=default.iteration_limit, help="of Newton; 0 for a quick look, not at rest"
    )
    parser.add_argument("--units-in-meter", type=float, help="overrides the file: 100 for centimetres")
    parser.add_argument("--no-garment", action="store_true", help="write no garment cache")
    return parser.parse_args(arguments)


@refusing
@watched()
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code: 0, or with a sentence 2 for refused input and 3 for cloth that is not
    at rest or lies in the body."""
    given = _parse(arguments)
    started = time.perf_counter()
    pattern = read_pattern(given.pattern, units_in_meter=given.units_in_meter)
    name = garment_name(given.name or pattern.name)
    body = load_body(given.body)
    pose = None if given.pose is None else read_pose(given.pose)
    options = SewingOptions(
        edge_length_m=given.edge_length,
        fabric=given.fabric,
        scale=given.scale,
        axes=given.axes,
        hold=given.hold,
        grid_m=given.grid,
        iteration_limit=given.iterations,
    )
    start = DrapeStart(body, options, pose, None, report=print)
    draped = drape_worn(pattern, start, rest=False)
    check_worn(draped, start)
    files = write_shape(given.out, name, draped.mesh, draped.nodes, panel_texture(draped.mesh))
    cached = not given.no_garment
    files += write_rest(given.out, name, draped, body, given.fabric, avatar="standard", garment=cached, report=print)
    seconds = round(time.perf_counter() - started, 1)
    record = {"pattern": pattern.name, "body": body.name, "fabric": given.fabric, "scale": given.scale}
    record |= {**draped.figures, "seconds": seconds}
    files.append(write_whole(given.out / f"{name}.json", json.dumps(record, indent=1) + "\n"))
    return end_command(files, left_words(draped))


def check_worn(draped: Draped, start: DrapeStart) -> None:
    """Raises ``InputError`` for a garment with a limb beside its opening, or with a bone through cloth, in the T-pose
    or in the pose."""
    in_t_pose = (draped.rest.nodes, draped.mesh.faces, start.body.joints_template)
    if lost := sorted({*start.lost(draped), *lost_parts(*in_t_pose, draped.placed.limbs), *pierced_parts(*in_t_pose)}):
        raise InputError(
            "garment",
            expected="every limb in its own opening, and no bone through the cloth",
            got=lost_words(lost),
            cure="Leave neck and limbs their openings, place halves of a sleeve before and behind its arm (of the "
            "T-pose, if the bodice is one panel with them), or try a finer mesh (--edge-length).",
        )


def left_words(draped: Draped) -> str:
    """Returns sentences on drapes that did not come to rest and on nodes in the body, with what to try then; empty if
    there are neither.

    A node of cloth that hangs on the skin is 2 to 4 mm off it.
    """
    drapes = {"T-pose": draped.rest, "pose": draped.posed}
    left = [f"{d.report.residual_n:.1e} N in the {name}" for name, d in drapes.items() if d and not d.report.converged]
    deepest = min(draped.figures[key]["clearance_mm"] for key in ("rest", "posed") if key in draped.figures)
    words = [
        f"not at rest: a node is left with {' and '.join(left)}, where {TOLERANCE_N:.0e} N is asked; the report says "
        '"converged": false. Try another mesh (--edge-length), a size up (--scale) or a stiffer fabric (--fabric).'
    ] * bool(left)
    if deepest < 0.0:
        words.append(f"in the body: a node lies {-deepest:.1f} mm below the skin. Try a finer mesh or a size up.")
    return " ".join(words)


if __name__ == "__main__":
    sys.exit(main())
