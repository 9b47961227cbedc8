"""What a garment does after an abrupt stop: columns in time, a row per clip, colour by the way from the static drape.

    python -m benchmarks.swing_sheets --model NAME [--garment dress] [--motions walk turn] [--out FILE]

Each clip is cut in its middle and its last pose held, as in ``benchmarks.dynamics``. White cloth lies where the static
drape has it, red cloth ``FULL_COLOUR_M`` or more from there.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.dynamics import FPS, Subject, drape, open_engine, stopped, subject
from benchmarks.render import SKIN, Surface, render, save_png, sheet
from drape.artifacts import DEFAULT_MODEL, model_folder
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, find_motions, open_garment
from drape.errors import DrapeError
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion
from service.engine import Engine

AFTER_S = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
FULL_COLOUR_M = 0.03
UNMOVED, MOVED = np.array([0.93, 0.93, 0.95]), np.array([0.86, 0.20, 0.16])
SIZE, EXTENT_M = (300, 190), 1.15


def swing_colours(vertices: np.ndarray, still: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3) of the triangles by how far ``vertices`` are from the static drape ``still`` [m]."""
    share = np.clip(np.linalg.norm(vertices - still, axis=-1)[faces].mean(axis=1) / FULL_COLOUR_M, 0.0, 1.0)[:, None]
    return (1.0 - share) * UNMOVED + share * MOVED


def strip(engine: Engine, body: BodyModel, what: Subject, clip: MotionClip) -> list[np.ndarray]:
    """Pictures at ``AFTER_S`` after the stop in the middle of ``clip``."""
    held, stop = stopped(clip)
    moving = drape(engine, body, what, held, motion=1.0)[[stop + round(s * FPS) for s in AFTER_S]]
    end = held.window(stop, 1)
    still = drape(engine, body, what, end, motion=0.0)[0]
    skin = body.posed_vertices(end.poses, end.trans)[0]
    skin = skin - (end.trans[0] + body.rest_joints()[0])
    faces = what.garment.fine_faces.astype(np.int64)
    centre = 0.5 * (still.min(axis=0) + still.max(axis=0))
    return [
        render(
            [Surface(skin, body.faces, SKIN), Surface(vertices, faces, swing_colours(vertices, still, faces))],
            size=SIZE, azimuth_deg=35.0, centre=centre, extent_m=EXTENT_M,
        )
        for vertices in moving.astype(np.float64)
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> Path:
    """Writes the sheet and returns its path."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.swing_sheets")
    parser.add_argument("--model", default=DEFAULT_MODEL, help="name under assets/models, or a folder")
    parser.add_argument("--garment", default="dress", help="name or file")
    parser.add_argument("--motions", nargs="+", default=["walk", "turn"], help="names, files or folders")
    parser.add_argument("--out", type=Path, help="default docs/images/swing_GARMENT.png")
    options = parser.parse_args(arguments)
    body = load_body()
    engine = open_engine(model_folder(options.model), body, threads=1)
    (path,) = find_garments([options.garment])
    what = subject(engine, open_garment(path, body), body)
    rows = [strip(engine, body, what, read_motion(clip)) for clip in find_motions(options.motions)]
    out = options.out or common.ROOT / "docs" / "images" / f"swing_{what.garment.name}.png"
    save_png(out, sheet(rows))
    print(f"{out.name}  {out.stat().st_size // 1024} KB")
    return out


if __name__ == "__main__":
    try:
        main()
    except DrapeError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
