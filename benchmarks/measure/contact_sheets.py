"""Contact sheets of draped garments, made through a running service.

    make serve                                                        # in another terminal
    python -m benchmarks.measure.contact_sheets --garments tshirt dress --motion walk --out docs/images

Garments are ids of the service or files, which are taken in first; the motion is a sample
clip's name or a motion file. A sheet has six frames, front above and side below.

    python -m benchmarks.measure.contact_sheets --line-up --garments trousers+sweat dress shorts+tank

draws one picture of outfits, inner+outer, each on another frame of the clip.
"""

from __future__ import annotations

import argparse
import sys
from itertools import cycle
from pathlib import Path

import numpy as np

from benchmarks.shared.render import CLOTH, SKIN, Surface, render, save_png, sheet
from clients.client import DrapeClient
from drape.body.assets import load_body
from drape.errors import refusing
from drape.motion.clip import MotionClip
from drape.motion.readers import read_motion

FRAMES = 6
VIEWS_DEG = (0.0, 90.0)
SIZE = (380, 250)
EXTENT_M = 2.3
LINE_UP_SIZE, LINE_UP_M = (440, 230), 1.85
LINE_UP_LIGHT = np.array([0.58, 0.5, 0.64])  # from the side, but no side lies in the dark
SHARPER = 3  # times as many pixels along each side before they are averaged
COLOURS = (CLOTH, (0.78, 0.30, 0.32), (0.25, 0.55, 0.42), (0.55, 0.42, 0.70), (0.80, 0.60, 0.25), (0.20, 0.50, 0.62))


def clip_of(client: DrapeClient, motion: str) -> MotionClip:
    """A sample clip of the service by name, or a motion file placed on the ground."""
    path = Path(motion)
    return client.placed(read_motion(path)) if path.suffix else client.motion(motion)


def frame_numbers(clip: MotionClip, count: int) -> np.ndarray:
    """``count`` numbers of frames, spread evenly over the clip, away from its ends."""
    return np.linspace(0, clip.frame_count - 1, count + 2).astype(int)[1:-1]


def frames_of(clip: MotionClip, count: int) -> MotionClip:
    """The frames of ``frame_numbers``."""
    index = frame_numbers(clip, count)
    return MotionClip(clip.poses[index], clip.trans[index], clip.fps, clip.name)


def draw(client: DrapeClient, garment: str, clip: MotionClip) -> np.ndarray:
    """The sheet of one garment: views below each other, frames beside each other."""
    body = load_body()
    chosen = frames_of(clip, FRAMES)
    cloth = client.drape(garment, clip)[frame_numbers(clip, FRAMES)]  # the whole clip: folds come from frame to frame
    skin = client.posed_body(body.name, chosen)
    faces = np.asarray(client.mesh(garment)["faces"])
    rows = []
    for azimuth in VIEWS_DEG:
        row = []
        for frame in range(FRAMES):
            heading = _heading_deg(skin[frame])
            centre = np.array([*chosen.trans[frame, :1], 1.05, *chosen.trans[frame, 2:]])
            surfaces = [Surface(skin[frame], body.faces, SKIN), Surface(cloth[frame], faces, CLOTH)]
            row.append(render(surfaces, size=SIZE, azimuth_deg=azimuth + heading, centre=centre, extent_m=EXTENT_M))
        rows.append(row)
    return sheet(rows)


def line_up(client: DrapeClient, outfits: list[str], clip: MotionClip) -> np.ndarray:
    """One row: each outfit on another frame of the clip, seen from the front and a little from the side."""
    body, colours = load_body(), cycle(COLOURS)
    numbers = frame_numbers(clip, len(outfits))
    skin = client.posed_body(body.name, frames_of(clip, len(outfits)))
    row = []
    for place, (outfit, number) in enumerate(zip(outfits, numbers, strict=True)):
        garments = outfit.split("+")
        layers = client.drape_outfit(garments, clip, tier="accurate")
        surfaces = [Surface(skin[place], body.faces, SKIN)]
        for garment, layer in zip(garments, layers, strict=True):
            surfaces.append(Surface(layer[number], np.asarray(client.mesh(garment)["faces"]), next(colours)))
        centre = 0.5 * (skin[place].min(axis=0) + skin[place].max(axis=0))
        azimuth = _heading_deg(skin[place]) + (25.0 if place % 2 else -25.0)
        fine = SHARPER * LINE_UP_SIZE[0], SHARPER * LINE_UP_SIZE[1]
        image = render(surfaces, size=fine, azimuth_deg=azimuth, centre=centre, extent_m=LINE_UP_M, light=LINE_UP_LIGHT)
        row.append(image.reshape(LINE_UP_SIZE[0], SHARPER, LINE_UP_SIZE[1], SHARPER, 3).mean(axis=(1, 3)))
    return sheet([row])


def _heading_deg(skin: np.ndarray) -> float:
    """The angle about the vertical from which the body is seen from the front."""
    body = load_body()
    left, right = (skin[body.weights[:, joint] > 0.9].mean(axis=0) for joint in (1, 2))
    across = left - right
    return float(np.degrees(np.arctan2(-across[2], across[0])))


@refusing
def main() -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(description="Contact sheets of draped garments, through a running service.")
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument(
        "--garments",
        nargs="+",
        required=True,
        help="ids of the service, or garment files; with --line-up ids, inner+outer",
    )
    parser.add_argument("--motion", default="walk", help="a sample clip's name, or a motion file")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--line-up", action="store_true", help="one picture, each outfit on another frame")
    options = parser.parse_args()
    with DrapeClient(options.url) as client:
        clip = clip_of(client, options.motion)
        if options.line_up:
            save_png(options.out / "hero.png", line_up(client, options.garments, clip), colours=192)
            return 0
        for wanted in options.garments:
            garment = client.upload_garment(wanted) if Path(wanted).suffix else wanted
            path = options.out / f"drape_{Path(wanted).stem}.png"
            save_png(path, draw(client, garment, clip))
            print(f"{path}  {path.stat().st_size // 1024} KB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
