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

import numpy as np

from benchmarks.avatars import characters
from benchmarks.harness import Benchmark, Option, Run
from benchmarks.measure.dressed_characters import dressed_character, dressed_parts
from benchmarks.measure.skin_pixels import VIEWS_DEG, Camera
from benchmarks.network import Network
from benchmarks.scenes import Clip, Folding
from drape.artifacts import DEFAULT_MODEL
from drape.avatar.covered import DEEPER_M, tucked_faces
from drape.avatar.covered import covered_faces as faces_under
from drape.avatar.covering import POSES, rotvecs
from drape.avatar.own_clothes import LOWER, UPPER, halves_of, taken_off, tucked
from drape.avatar.wearer import Wearer, read_wearer, wearer_name
from drape.avatar.wears import reach_of, why_not
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import fabric
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.garment.tailor import tailored
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


def own_pixels_pct(surface: np.ndarray, wearer: Wearer, shown: np.ndarray, deeper: np.ndarray, cloth: np.ndarray,
                   faces: np.ndarray) -> float:  # fmt: skip
    """The share [%] of pixels of ``cloth`` [m] (V, 3), ``faces``, that ``shown`` (F,) faces of own clothes cover."""
    own = np.flatnonzero(wearer.attire.of_kinds(OWN) & shown)
    camera, seen, hit = Camera.around(np.concatenate([surface, cloth])), 0, 0
    for azimuth_deg in VIEWS_DEG:
        front = camera.see(cloth, faces, azimuth_deg)
        seen += int((front.face >= 0).sum())
        for rows, by_m in ((own[~deeper[own]], 0.0), (own[deeper[own]], DEEPER_M)):
            if len(rows):
                depth = camera.see(surface, wearer.faces[rows], azimuth_deg).depth - by_m
                hit += int(((front.face >= 0) & (depth > front.depth) & (depth < front.depth + NEAR_M)).sum())
    return 100.0 * hit / max(seen, 1)


def measured(wearer: Wearer, garment: Garment, body: BodyModel, run: Run) -> dict[str, object]:
    """Own clothes seen in ``POSES`` of ``wearer`` in ``garment``."""
    if (refusal := why_not(wearer.body, reach_of(garment, body), garment=garment.name)) is not None:
        return {"worn": f"no: {refusal.got}"}
    halves = halves_of([garment], body)
    below, off = wearer.body_under(halves), taken_off(wearer.attire, halves)
    cut = tailored(garment, body, below)
    poses = np.concatenate([np.repeat(rotvecs(one)[None], ROUNDS, axis=0) for one in POSES])
    start = Network.asked(run.options, below, passes=0).drape(cut, poses).vertices
    trans = np.zeros((len(poses), 3))
    skin = Clip.of("poses", FPS, poses, below).skin
    folds = Folding(fold_constants(cut, below, fabric(cut.fabric)), FoldEffort(run.options.folds, SETTLE, True), FPS)
    cloth, rows = folds.frames(start, skin), np.arange(ROUNDS - 1, len(poses), ROUNDS)
    surface = wearer.posed(poses[rows], trans[rows])
    off |= tucked_faces(
        wearer.vertices, wearer.faces, [(cut.vertices, cut.faces)], tucked(wearer.attire, halves) & ~off
    )
    deeper = faces_under(wearer.vertices, wearer.faces, [(cut.vertices, cut.faces)])
    nothing, every = np.zeros(len(off), dtype=bool), np.ones(len(off), dtype=bool)
    bulky = np.array([part.bulky for part in wearer.attire.parts])[wearer.attire.part]
    frames = list(zip(surface, cloth[rows], strict=True))
    before, after = (
        [own_pixels_pct(one, wearer, shown, deep, over, cut.faces) for one, over in frames]
        for shown, deep in ((every, nothing), (~off & ~bulky, deeper))
    )
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
