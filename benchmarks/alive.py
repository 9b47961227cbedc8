"""Clothes that a character came in: how much of its legs shows through its own skirt, carried, on springs, and alive.

    python -m benchmarks.alive
    python -m benchmarks.alive --outfits circle_skirt --save

Made characters, our body in a skirt or a dress of its own. Five poses, each reached within 0.7 s and held as long, and
a walk. A pixel counts that shows skin that the skirt covers at rest with cloth less than 3 cm behind it, of all pixels
of the skirt, from four sides. ``carried``: the file's own skin weights; ``springs``: chains of spring bones on the same
file (``benchmarks.measure.skirt_springs``); ``alive``: the skirt draped, and ``drawn``: with covered skin drawn deeper,
as our clients do. ``intake_s`` is the processor time in which the clothes became garments.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

import drape
from benchmarks.harness import Benchmark, Option, Run
from benchmarks.measure.dressed_characters import dressed_character, dressed_parts
from benchmarks.measure.skin_pixels import PosedBody, covered_faces, skin_pixels_pct
from benchmarks.measure.skirt_springs import SkirtSprings, legs_of
from drape.artifacts import DEFAULT_MODEL
from drape.avatar.covered import DEEPER_M
from drape.avatar.covered import covered_faces as faces_under
from drape.avatar.covering import POSES, rotvecs
from drape.avatar.own_garments import OWN, own_faces
from drape.avatar.wearer import Wearer
from drape.catalog import find_garments, open_garment
from drape.export.surface import by_layer
from drape.geometry.skinning import skin_points
from drape.library import Drape, Worn
from drape.motion.clip import MotionClip

FPS, REACHED_S = 60.0, 0.7  # springs step once a picture
KINDS = {"skirt": "skirt", "circle_skirt": "skirt", "dress": "dress"}
WAYS = ("carried", "springs", "alive", "drawn")
COLUMNS = {
    "outfit": "s", "intake_s": ".1f", **{f"{way}_{what}_pct": ".3f" for what in ("poses", "walk") for way in WAYS},
    **{f"{way}_worst_pct": ".2f" for way in WAYS},
}  # fmt: skip


def posing() -> tuple[MotionClip, list[int]]:
    """A clip that reaches and holds each of ``POSES``, and the frames in which it has held them."""
    steps, keys = round(REACHED_S * FPS), [rotvecs(one) for one in POSES]
    rows = [keys[0][None]]
    for before, after in zip([keys[0], *keys], keys, strict=False):
        share = np.minimum(np.arange(1, 2 * steps + 1) / steps, 1.0)[:, None, None]
        rows.append((1.0 - share) * before + share * after)
    poses = np.concatenate(rows)
    return MotionClip(poses, np.zeros((len(poses), 3)), FPS, "poses"), [2 * steps * (n + 1) for n in range(len(keys))]


class Skirt:
    """The skirt or dress of its own that a made character wears, with its rest, and the legs below it."""

    def __init__(self, worn: Worn, wearer: Wearer) -> None:
        self.worn, self.wearer = worn, wearer
        (self.layer,) = (n for n, one in enumerate(worn.layers) if one.manifest[OWN]["kind"] in KINDS.values())
        own = np.flatnonzero(own_faces(wearer, [worn.layers[self.layer]]))
        self.used, faces = np.unique(wearer.faces[own], return_inverse=True)
        self.faces = faces.reshape(-1, 3)
        self.skin = wearer.faces[wearer.attire.of_kinds(("skin",))]
        rest = wearer.vertices[self.used].astype(np.float64)
        surface = wearer.vertices.astype(np.float64)
        self.covered = covered_faces(surface, self.skin, rest, self.faces)
        self.deeper = faces_under(surface, self.skin, [(rest, self.faces)])
        self.springs = SkirtSprings(rest, wearer.body.joints_template)
        self.legs = legs_of(surface, wearer.weights, wearer.body.joints_template)

    def shown_pct(self, clip: MotionClip, rows: list[int]) -> dict[str, np.ndarray]:
        """The skin that is seen (n,) in each of the frames ``rows`` of ``clip``, by ``WAYS``."""
        wearer, bones = self.wearer, self.wearer.body.bones(clip.poses, clip.trans)
        rest = self.springs.rest
        carried = skin_points(np.broadcast_to(rest, (len(clip.poses), *rest.shape)), wearer.weights[self.used], *bones)
        vertices = np.stack([one.vertices for one in self.worn.play(clip, fps=clip.fps, as_recorded=True)])
        garment = self.worn.garments[self.layer]
        alive = by_layer(self.worn.garments, vertices)[self.layer], garment.faces
        ways = {"carried": (carried, self.faces), "alive": alive, "drawn": alive}
        ways["springs"] = self.springs.over(carried, *bones, self.legs, clip.fps), self.faces
        found: dict[str, list[float]] = {way: [] for way in WAYS}
        for row, surface in zip(rows, wearer.posed(clip.poses[rows], clip.trans[rows]), strict=True):
            plain = PosedBody.of(surface, self.skin)
            drawn = PosedBody.of(surface, self.skin, deeper=self.deeper, by_m=DEEPER_M)
            for way, (cloth, faces) in ways.items():
                seen = skin_pixels_pct(drawn if way == "drawn" else plain, self.covered, cloth[row], faces)
                found[way].append(float(np.nanmean(seen)))
        return {way: np.array(values) for way, values in found.items()}


def measured(opened: Drape, outfit: str, every: int) -> dict[str, object]:
    """A row of the made character that came in ``outfit``, looked at in one of ``every`` frames of the walk."""
    body = opened.body
    held = {KINDS[outfit]: outfit} | ({} if outfit == "dress" else {"top": "tshirt"})
    parts = dressed_parts(body, {kind: open_garment(find_garments([name])[0], body) for kind, name in held.items()})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"made_in_{outfit}.glb"
        file.write_bytes(dressed_character(body, parts))
        opened.wear("tank", on=file)  # the character is read before the clock starts
        begun_s = time.process_time()
        worn = opened.wear(on=file, alive=True)
        row: dict[str, object] = {"outfit": outfit, "intake_s": time.process_time() - begun_s}
        assert worn.wearer is not None
        skirt = Skirt(worn, worn.wearer)
        clip, held_at = posing()
        walk = worn.placed("walk", fps=FPS)
        found = {
            "poses": skirt.shown_pct(clip, held_at),
            "walk": skirt.shown_pct(walk, list(range(0, len(walk.poses), every))),
        }
    row |= {f"{way}_{what}_pct": float(shown.mean()) for what, ways in found.items() for way, shown in ways.items()}
    return row | {f"{way}_worst_pct": max(float(ways[way].max()) for ways in found.values()) for way in WAYS}


@Benchmark(
    "alive",
    "Clothes that a character came in, carried, on springs and draped.",
    COLUMNS,
    Option("--outfits", tuple(KINDS), "of the made characters", ("skirt",), choices=tuple(KINDS)),
    Option("--every", 8, "one of so many frames of the walk is looked at", 64),
    Option("--model", DEFAULT_MODEL, "name under drape/assets/models, or a folder"),
)  # fmt: skip
def main(run: Run) -> None:
    """A row for every outfit."""
    opened = drape.load(run.options.model)
    for outfit in run.options.outfits:
        run.add([measured(opened, outfit, run.options.every)])


if __name__ == "__main__":
    main.command()
