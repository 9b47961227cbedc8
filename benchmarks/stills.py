"""Cloth at rest in poses of clips: what moving cloth is measured against (``benchmarks.moving``), made once.

    python -m benchmarks.stills --save
    python -m benchmarks.stills --garments $DRAPE_DATA/garments --motions $DRAPE_DATA/motions --save
    python -m benchmarks.stills --captured $DRAPE_DATA/motions/cmu_02_04.npz --save
    python -m benchmarks.stills --motions walk squat --exact --save

A row is a garment's still in one pose, its ``frame`` of the clip: every pose in which moving cloth is measured has its
own, since a body that rises out of a squat has others from frame to frame. The ``settled`` one is ``accurate`` with
eight steps in forty rounds; ``--exact`` makes the minimum of energy beside it (``drape.exact``), from there, in
minutes. ``curvature`` is its total Gaussian curvature [rad]. The record keeps rows that it has, so that stills do not
move with the engine, and ``commit`` says by which code each was made; ``--anew`` makes them again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path

import numpy as np

from benchmarks.cases import FPS, CaseClip, lively_clips, read_case_clips
from benchmarks.harness import RESULTS_DIR, Benchmark, Option, Run, commit_of_tree, inputs
from benchmarks.measure.cloth_looks import BANDS, ClothLooks
from benchmarks.served import Stream, plan_of
from benchmarks.tables import Row
from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_outfit
from drape.cloth.fabric_table import fabric as fabric_named
from drape.exact.frame import ExactCloth, exact
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.stages.batch import Batch, PoseInput
from drape.wire.options import Advanced
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings

STEPS, ROUNDS = 8, 40
PLACES = (0.55, 1.0)  # shares of a clip at which moving cloth is measured
BEFORE = (0, 3, 6, 9)  # frames before such a place whose poses have a still
SETTLED, EXACT = "settled", "exact"
COLUMNS = {
    "garment": "s", "clip": "s", "frame": "d", "still": "s", "curvature": ".1f", "dihedral_deg": ".1f",
    "area_m2": ".4f", **{f"{band}_mm": ".3f" for band in BANDS}, "hem_mm": ".3f",
}  # fmt: skip
KEY = ("garment", "digest", "clip", "frame", "still")
CAPTURED = (
    Option("--captured", (), "names, files or folders of captured motion"),
    Option("--captured-garments", ("tshirt", "longsleeve", "trousers"), "that are worn in it", ("tshirt",)),
    Option("--captured-frames", 60, "of such a clip", 20),
)


def posed_at(clip: CaseClip) -> list[list[int]]:
    """Returns the numbers of those frames of ``clip`` whose poses have a still: for each of ``PLACES`` an ascending
    list of the frames that are ``BEFORE`` frames before that place."""
    places = [round(place * (len(clip.poses) - 1)) for place in PLACES]
    return [sorted({max(0, place - before) for before in BEFORE}) for place in places]


def looks_of(garment: Garment) -> ClothLooks:
    """Returns what measures the looks of ``garment``, which is a fine one (``drape.garment.fine``), on its delivered
    mesh."""
    at_rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    return ClothLooks(garment.delivered_rest(), garment.faces.astype(np.int64), at_rest)


def input_of(clip: CaseClip, frame: int) -> PoseInput:
    """Returns the pose of one ``frame`` of ``clip`` as the input of a drape, on the body of mean shape."""
    rows, shape = slice(frame, frame + 1), np.zeros(clip.body.shape_count)
    return PoseInput(clip.poses[rows], clip.trans[rows], shape, np.array([frame / clip.fps]))


def still_figures(looks: ClothLooks, vertices: np.ndarray) -> Row:
    """Returns a row of cloth at ``vertices`` [m] (V, 3): "curvature" [rad], "dihedral_deg", "area_m2", "hem_mm" and the
    relief of each band of ``BANDS`` as "BAND_mm" (``ClothLooks`` says what they are)."""
    frame = vertices[None]
    relief = dict(zip((f"{band}_mm" for band in BANDS), looks.relief_mm(frame)[0].tolist(), strict=True))
    measures = {
        "curvature": looks.curvature,
        "dihedral_deg": looks.dihedral_deg,
        "area_m2": looks.area_m2,
        "hem_mm": looks.hem_mm,
    }
    return {name: float(measure(frame)[0]) for name, measure in measures.items()} | relief


class Stills:
    """The rows of stills of garments in poses of clips: those of the record at ``path``, unless ``anew`` is true, and
    others, which are computed when they are first asked for."""

    def __init__(self, drapery: DrapeRuntime, path: Path = RESULTS_DIR / "stills.json", *, anew: bool = False) -> None:
        rows = json.loads(path.read_text())["rows"] if path.is_file() and not anew else []
        self.rows: dict[tuple[object, ...], Row] = {tuple(row[name] for name in KEY): row for row in rows}
        self._drapery = drapery

    @cached_property
    def _commit(self) -> str:
        return commit_of_tree()

    def of(self, garments: list[Garment], clip: CaseClip, frame: int) -> list[Row]:
        """Returns the row of the settled still of each of ``garments``, worn together, in the pose of a ``frame`` of
        ``clip``."""
        keys = [(garment.name, worn_digest(garments, garment), clip.name, frame, SETTLED) for garment in garments]
        if any(key not in self.rows for key in keys):
            world = self._settled(garments, clip.body, input_of(clip, frame)).world()[0].astype(np.float64)
            fine = [fine_garment(garment) for garment in garments]
            parts = np.split(world, np.cumsum([garment.vertex_count for garment in fine])[:-1])
            for key, garment, vertices in zip(keys, fine, parts, strict=True):
                self._keep(key, still_figures(looks_of(garment), vertices))
        return [self.rows[key] for key in keys]

    def exact_of(self, garment: Garment, clip: CaseClip, frame: int, *, computes: bool = False) -> Row | None:
        """Returns the row of the exact drape of ``garment``, worn alone, in the pose of a ``frame`` of ``clip``.

        Where the record has none it is computed if ``computes`` is true; otherwise None is returned.
        """
        key = garment.name, worn_digest([garment], garment), clip.name, frame, EXACT
        if key not in self.rows and computes:
            start, body, fine = input_of(clip, frame), clip.body, fine_garment(garment)
            at_rest = PoseInput(np.zeros((1, 24, 3)), np.zeros((1, 3)), start.betas, np.zeros(1))
            rest, x = (self._settled([garment], body, pose).vertices[0] for pose in (at_rest, start))
            sheet = ExactCloth.of(garment, fabric_named(garment.fabric), body, start.betas, rest)
            drape, report = exact(sheet, start.poses[0], x)
            left = {"crossings": report.crossings, "force_share": report.force_share}
            self._keep(key, still_figures(looks_of(fine), drape.x) | left)
        return self.rows.get(key)

    def _keep(self, key: tuple[object, ...], figures: Row) -> None:
        self.rows[key] = dict(zip(KEY, key, strict=True)) | figures | {"commit": self._commit}

    def _settled(self, garments: list[Garment], body: BodyModel, pose: PoseInput) -> Batch:
        settled = Advanced(folds=STEPS, settle=ROUNDS)
        plan = plan_of(self._drapery, garments, resolution="fine", tier="accurate", advanced=settled)
        return Stream(plan, body.shape_count).frame(pose)


def worn_digest(garments: list[Garment], garment: Garment) -> str:
    """Returns a digest that distinguishes ``garment``, worn with ``garments``, from other garments of its name."""
    return "+".join(item.digest[:8] for item in ([garment, *garments] if len(garments) > 1 else garments))


def outfits(names: list[str]) -> Iterator[list[Garment]]:
    """Yields the garments of each of ``names``, names, files or folders; () stands for all shipped ones."""
    body = load_body()
    return (open_outfit(path, body) for path in find_garments(names))


@Benchmark(
    "stills",
    "Cloth at rest in poses of clips.",
    COLUMNS,
    *inputs(quick_garments=("tshirt",), quick_motions=("walk",)),
    Option("--frames", 120, "of a clip at most", 30),
    *CAPTURED,
    Option("--anew", False, "makes those that the record has as well"),
    Option("--exact", False, "makes the exact drape of each garment that is worn alone"),
)
def main(run: Run) -> None:
    """Adds to ``run`` the rows of every garment in the measured poses of every clip, and the other rows of the
    record."""
    options, body = run.options, load_body()
    stills = Stills(DrapeRuntime(Settings(threads=1, model=options.model)), anew=options.anew)
    _make(stills, options.garments, read_case_clips(options, body, FPS), exact_too=options.exact)
    captured = lively_clips(options.captured, options.captured_frames, body)
    if captured:
        _make(stills, options.captured_garments, captured, exact_too=options.exact)
    run.add(row for _, row in sorted(stills.rows.items()))


def _make(stills: Stills, names: Sequence[str], clips: Sequence[CaseClip], *, exact_too: bool) -> None:
    """Makes what ``stills`` lack of garments of ``names`` over ``clips``."""
    for garments in outfits(list(names)):
        for clip in clips:
            for frame in chain(*posed_at(clip)):
                stills.of(garments, clip, frame)
                if exact_too and len(garments) == 1:
                    stills.exact_of(garments[0], clip, frame, computes=True)


if __name__ == "__main__":
    main.command()
