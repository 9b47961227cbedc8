"""Garments on characters that came in clothes: how much of these, and of what they carry, comes through the cloth.

    python -m benchmarks.dressed
    python -m benchmarks.dressed --avatars me.vrm --garments tshirt dress --save

Made characters, whose parts are known, and files: garments are cut for them and draped in five poses with folds. A
pixel of a garment shows own clothes where one of their faces lies before it, nearer than ``NEAR_M``. ``as_it_came_pct``
is with everything on, as it was before parts were told; ``own_pct`` as clients draw it, without what the garment takes
off, and with covered faces deeper; a bag that stays on hangs before the cloth, and is not counted. ``told_pct``: faces
of made characters that are rightly told.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.avatars import characters
from benchmarks.harness import Benchmark, Option, Run
from benchmarks.measure.dressed_characters import dressed_character, dressed_parts
from benchmarks.measure.skin_pixels import VIEWS_DEG, Camera
from benchmarks.network import Network
from benchmarks.scenes import Clip, Folding
from drape.artifacts import DEFAULT_MODEL
from drape.avatar.covered import DEEPER_M
from drape.avatar.covered import covered_faces as faces_under
from drape.avatar.covering import POSES, rotvecs
from drape.avatar.own_clothes import LOWER, UPPER, Halves, halves_of
from drape.avatar.own_garments import undressed
from drape.avatar.wearer import Wearer, read_wearer, wearer_name
from drape.avatar.wears import reach_of, why_not
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import fabric
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.garment.tailor import tailored
from drape.geometry.skinning import skin_points
from drape.live.fold_constants import fold_constants
from drape.live.fold_step import FoldEffort
from drape.stages.folds import SETTLE

FPS, ROUNDS = 30.0, 4  # a pose is held so long, until its folds stand
NEAR_M = 0.05  # own clothes before the cloth by more hang before it, as a shirt over a lap
OWN = {*UPPER, *LOWER, "carried"}
OUTFITS = {"made_in_trousers": {"top": "tshirt", "trousers": "trousers"}, "made_in_a_dress": {"dress": "dress"}}
COLUMNS = {
    "avatar": "s", "garment": "s", "told_pct": ".1f", "worn": "s", "as_it_came_pct": ".2f", "own_pct": ".3f",
    "worst_pct": ".2f",
}  # fmt: skip


def files(given: tuple[str, ...], body: BodyModel) -> dict[str, tuple[bytes, list[str]]]:
    """Characters by name: their files, and of made ones the kind of each triangle."""
    found = {wearer_name(path.stem): (path.read_bytes(), []) for path in (characters(given) if given else [])}
    for name, outfit in {} if given else OUTFITS.items():
        garments = {kind: open_garment(find_garments([one])[0], body) for kind, one in outfit.items()}
        for suffix, cut_away in (("", False), ("_cut_away", True)):
            parts = dressed_parts(body, garments, cut_away=cut_away)
            kinds = [part.kind for part in parts for _ in range(len(part.faces))]
            found[f"{name}{suffix}"] = dressed_character(body, parts, maker="nameless"), kinds
    return found


def told_pct(wearer: Wearer, kinds: list[str]) -> float:
    """How many faces are of the ``kinds`` (T,) of their triangles; a bare face is skin too."""
    if not kinds or wearer.file is None:
        return float("nan")
    same = {"face": "skin"}
    true = np.array([same.get(kind, kind) for kind in kinds])[wearer.file.triangle]
    found = np.array([same.get(part.kind, part.kind) for part in wearer.attire.parts])[wearer.attire.part]
    return 100.0 * float((true == found).mean())


class Drawn(NamedTuple):
    """What is drawn of a character's own clothes: ``vertices`` [m] (V, 3) at rest with ``weights`` (V, 24), ``faces``
    (F, 3), and which are drawn ``deeper`` (F,)."""

    vertices: np.ndarray
    weights: np.ndarray
    faces: np.ndarray
    deeper: np.ndarray

    @classmethod
    def as_it_came(cls, wearer: Wearer) -> Drawn:
        """All of them."""
        faces = wearer.faces[wearer.attire.of_kinds(OWN)]
        return cls(wearer.vertices, wearer.weights, faces, np.zeros(len(faces), dtype=bool))

    @classmethod
    def in_garment(cls, wearer: Wearer, cloth: tuple[np.ndarray, np.ndarray], halves: Halves) -> Drawn:
        """As clients draw them in a garment, ``cloth``, on these ``halves``."""
        left = undressed(wearer, np.zeros(len(wearer.faces), dtype=bool), [cloth], halves)
        bulky = np.array([part.bulky for part in wearer.attire.parts])[wearer.attire.part]
        shown = wearer.attire.of_kinds(OWN) & ~left.off & ~bulky
        deeper = faces_under(wearer.vertices, wearer.faces, [cloth])[shown]
        found = cls(wearer.vertices, wearer.weights, wearer.faces[shown], deeper)
        if (top := left.tucked) is None:
            return found
        more = top.vertices, top.weights, top.faces + len(wearer.vertices), np.ones(len(top.faces), dtype=bool)
        return cls(*(np.concatenate(pair) for pair in zip(found, more, strict=True)))

    def posed(self, wearer: Wearer, poses: np.ndarray) -> np.ndarray:
        """Its vertices [m] (F, V, 3) in ``poses`` (F, 24, 3) [rad]."""
        bones = wearer.body.bones(poses, np.zeros((len(poses), 3)))
        return skin_points(np.broadcast_to(self.vertices, (len(poses), *self.vertices.shape)), self.weights, *bones)


def own_pixels_pct(surface: np.ndarray, own: Drawn, cloth: np.ndarray, faces: np.ndarray) -> float:
    """The share [%] of pixels of ``cloth`` [m] (V, 3), ``faces``, that ``own`` clothes cover, which are at ``surface``
    [m] (Vo, 3)."""
    camera, seen, hit = Camera.around(np.concatenate([surface, cloth])), 0, 0
    for azimuth_deg in VIEWS_DEG:
        front = camera.see(cloth, faces, azimuth_deg)
        seen += int((front.face >= 0).sum())
        for rows, by_m in ((~own.deeper, 0.0), (own.deeper, DEEPER_M)):
            if rows.any():
                depth = camera.see(surface, own.faces[rows], azimuth_deg).depth - by_m
                hit += int(((front.face >= 0) & (depth > front.depth) & (depth < front.depth + NEAR_M)).sum())
    return 100.0 * hit / max(seen, 1)


def measured(wearer: Wearer, garment: Garment, body: BodyModel, run: Run) -> dict[str, object]:
    """Own clothes seen in ``POSES`` of ``wearer`` in ``garment``."""
    if (refusal := why_not(wearer.body, reach_of(garment, body), garment=garment.name)) is not None:
        return {"worn": f"no: {refusal.got}"}
    halves = halves_of([garment], body)
    below = wearer.body_under(halves)
    cut = tailored(garment, body, below)
    poses = np.concatenate([np.repeat(rotvecs(one)[None], ROUNDS, axis=0) for one in POSES])
    start = Network.asked(run.options, below, passes=0).drape(cut, poses).vertices
    skin = Clip.of("poses", FPS, poses, below).skin
    folds = Folding(fold_constants(cut, below, fabric(cut.fabric)), FoldEffort(run.options.folds, SETTLE, True), FPS)
    cloth, rows = folds.frames(start, skin), np.arange(ROUNDS - 1, len(poses), ROUNDS)
    below_it = Drawn.as_it_came(wearer), Drawn.in_garment(wearer, (cut.vertices, cut.faces), halves)
    before, after = (
        [own_pixels_pct(surface, one, over, cut.faces)
         for surface, over in zip(one.posed(wearer, poses[rows]), cloth[rows], strict=True)]
        for one in below_it
    )  # fmt: skip
    return {"worn": "yes", "as_it_came_pct": np.mean(before), "own_pct": np.mean(after), "worst_pct": np.max(after)}


@Benchmark(
    "dressed",
    "Garments on characters that came in clothes.",
    COLUMNS,
    Option("--avatars", (), "GLB or VRM files (made characters)", kind=str),
    Option("--garments", ("tshirt", "trousers", "dress"), "names", ("tshirt",)),
    Option("--model", DEFAULT_MODEL, "name under drape/assets/models, or a folder"),
    Option("--folds", 2, "steps of folds"),
)
def main(run: Run) -> None:
    """A row for every character and garment."""
    body = load_body()
    for name, (payload, kinds) in files(run.options.avatars, body).items():
        wearer = read_wearer(payload, name=name, body=body)
        for path in find_garments(run.options.garments):
            garment = fine_garment(open_garment(Path(path), body))
            row = {"avatar": name, "garment": garment.name, "told_pct": told_pct(wearer, kinds)}
            run.add([row | measured(wearer, garment, body, run)])


if __name__ == "__main__":
    main.command()
