"""From a scan or a draped mesh to a sewing pattern and a garment that moves.

python -m recovery.run TARGET.obj [--base tshirt] --body BODY [--pose CLIP:FRAME] --out DIR

Writes NAME.json, .svg, .dxf, .pdf (the pattern), NAME.obj and NAME.glb (the simulated garment), NAME_rest.obj and
NAME-DIGEST.npz (the garment cache that the service reads), report.html and report.json. NAME.search.npz holds the
search: the same command goes on from it. Exit codes: 2 refused, 3 written but not at rest.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drape.body.assets import DEFAULT_BODY
from drape.cloth.material import DEFAULT_MATERIAL, FABRICS, MEASURED
from drape.errors import InputError, refusing, with_numbers_bound
from drape.files.atomic import write_whole
from drape.garment.mesh_checks import UNITS_M, UP_AXES
from recovery import progress
from recovery.commands import add_style_options, end_command, parser_of, style_of
from recovery.drape.pattern_drape import SewingOptions
from recovery.drape.placement import read_pose
from recovery.fit.optimise import REACH_M, FitOptions
from recovery.fit.rounds import RoundsOptions
from recovery.pattern.bases import BASES
from recovery.pattern.measurements import PATTERN_STEPS
from recovery.run.job import run_job
from recovery.run.refusal import placed_fault
from recovery.run.task import MINUTES, RecoveryJob
from recovery.scan.repair import ScanFault

# Fields of a job that are options of the same name.
OF_JOB = (
    "target",
    "out",
    "base",
    "body",
    "name",
    "label",
    "settings",
    "unit",
    "up",
    "front",
    "retarget",
    "garment",
    "minutes",
    "sizes",
)
EDGE_LENGTH_M = 0.05


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Returns the parsed command line, by default that of the process."""
    fit = FitOptions()
    parser = parser_of("recovery.run", __doc__)
    parser.add_argument("target", type=Path, help="OBJ, GLB, PLY or STL of one garment on its body")
    parser.add_argument("--out", type=Path, required=True, help="folder of the files")
    parser.add_argument("--base", help=f"{', '.join(BASES)}, or a pattern as JSON; by default what the openings tell")
    parser.add_argument(
        "--set", nargs="+", default=[], dest="settings", metavar="NAME=VALUE", help="parameters of the base [m]"
    )
    parser.add_argument(
        "--body", default=DEFAULT_BODY, help="name, SMPL file, or closed surface; 'fit': one is fitted inside"
    )
    parser.add_argument("--betas", help="shape of the body: numbers between commas")
    parser.add_argument("--pose", help="of the body: CLIP:FRAME of a motion file or a sample, or a JSON of 72 numbers")
    parser.add_argument("--name", help="of the garment; the file's otherwise")
    parser.add_argument("--label", help="material of the file that is the garment")
    parser.add_argument("--unit", default="auto", choices=("auto", *UNITS_M), help="of the target")
    parser.add_argument("--up", default="auto", choices=("auto", *UP_AXES), help="of the target")
    parser.add_argument(
        "--front",
        default="auto",
        choices=("auto", "kept", "turned"),
        help="with --body fit: the target looks along +z as in its file, or the other way",
    )
    parser.add_argument(
        "--fabric",
        default=DEFAULT_MATERIAL,
        choices=(*FABRICS, *MEASURED),
        help="of the target: one of the simulator's five or of the table",
    )
    parser.add_argument("--edge-length", type=float, default=EDGE_LENGTH_M, help="of the garment's mesh [m]")
    parser.add_argument(
        "--meshes",
        type=float,
        nargs="+",
        dest="meshes_m",
        metavar="M",
        help="edge lengths [m] of the rounds (default: three equal)",
    )
    parser.add_argument("--grid", type=float, default=0.02, help="spacing of the body's distance [m]")
    parser.add_argument("--adam", type=int, default=fit.iterations, help="steps of Adam")
    parser.add_argument("--closing", type=int, default=fit.closing, help="steps of Gauss and Newton after it")
    parser.add_argument(
        "--reach",
        type=float,
        metavar="M",
        default=REACH_M,
        help="the loss doubles where corners are this far [m] from the graded base, all of them together (%(default)g)",
    )
    parser.add_argument(
        "--minutes", type=float, default=MINUTES, help="after which the best so far is written (%(default)g)"
    )
    parser.add_argument(
        "--sizes", nargs="+", default=[], choices=PATTERN_STEPS, help="write the pattern, which is M, in these as well"
    )
    add_style_options(parser)
    parser.add_argument("--no-retarget", dest="retarget", action="store_false", help="leave out other bodies and poses")
    parser.add_argument("--no-garment", dest="garment", action="store_false", help="write no garment cache")
    return parser.parse_args(with_numbers_bound(arguments))


def job_of(given: argparse.Namespace) -> RecoveryJob:
    """Returns the job that the parsed command line asks for. Raises ``InputError`` for a value that is out of range."""
    return RecoveryJob(
        **{name: getattr(given, name) for name in OF_JOB},
        betas=None if given.betas is None else read_betas(given.betas),
        pose=None if given.pose is None else read_pose(given.pose),
        style=style_of(given),
        search=RoundsOptions(
            drape=SewingOptions(edge_length_m=given.edge_length, fabric=given.fabric, grid_m=given.grid),
            fit=FitOptions(iterations=given.adam, closing=given.closing),
            reach_m=given.reach,
            meshes_m=given.meshes_m,
        ),
    )


def read_betas(text: str) -> np.ndarray:
    """Returns the shape coefficients (S,) that ``text`` gives, numbers between commas. Raises ``InputError`` for other
    text."""
    try:
        return np.array([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(
            "--betas", expected="numbers between commas", got=text, cure="For example --betas 0.5,-1."
        ) from error


@refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code: 0, or with a sentence 2 for refused input and 3 for cloth that is not
    at rest."""
    given = parse(arguments)
    job = job_of(given)
    try:
        outcome = run_job(job, progress=progress.to_stderr)
    except ScanFault as unplaced:
        fault = placed_fault(unplaced, job)
        if fault.mesh is not None:
            from recovery.run.report_pictures import fault_picture

            print(write_whole(given.out / f"{given.target.stem}.refused.png", fault_picture(fault.mesh, fault.points)))
        raise fault from unplaced
    with progress.watched(), progress.stage("the report is drawn"):
        from recovery.run.report_text import page_of, record_of  # matplotlib takes a second to load

        page = write_whole(given.out / "report.html", page_of(outcome))
        record = write_whole(given.out / "report.json", json.dumps(record_of(outcome), indent=1) + "\n")
    at_rest = outcome.sewn.anew is not None and outcome.sewn.anew.draped.at_rest
    moving = "not at rest: see the report; try another mesh (--edge-length) or fabric (--fabric)"
    return end_command([*outcome.files, page, record], "" if at_rest else moving)


if __name__ == "__main__":
    sys.exit(main())
